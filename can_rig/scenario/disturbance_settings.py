"""The keys of a disturbance: what the world does to the car, when, and how strongly.

A scenario has any number of disturbances; pushes add up, and friction factors multiply.
"""

from dataclasses import fields
from typing import Annotated, Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from can_rig.scenario.fault_settings import MAX_DURATION_S, Moment, Spell
from can_rig.scenario.plant_settings import STRICT

DisturbanceKind = Literal["none", "gust", "turbulence", "bank", "friction", "steering-kick", "push"]

NEEDED: Final[dict[str, tuple[str, ...]]] = {
    "gust": ("force_n",),
    "turbulence": ("intensity_n", "length_m"),
    "bank": ("bank_percent",),
    "friction": ("front", "rear"),
    "steering-kick": ("torque_nm",),
    "push": ("size",),
}
"""The keys that each kind must have; friction needs one of its keys at least."""

OPTIONAL: Final = {"gust": ("arm_m",), "turbulence": ("arm_m",)}
RAMP_S: Final = 0.3
PUSH: Final = "push"
"""The kind, and the column, of what pushes a plant other than a car."""

Force = Annotated[float, Field(ge=-1e5, le=1e5)]
Arm = Annotated[float, Field(ge=-50.0, le=50.0)]
Friction = Annotated[float, Field(ge=0.01, le=2.0)]


@dataclass(frozen=True, config=STRICT)
class DisturbanceSettings(Spell):
    """One disturbance from ``at_s`` on, endless or for ``for_s`` seconds.

    It rises and falls within ``ramp_s``, in a straight line or as half a cosine. All keys from
    ``force_n`` on belong to single kinds.
    """

    noun = "disturbance"
    kind: DisturbanceKind
    at_s: Moment = 5.0
    for_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] | None = None
    ramp_s: Moment | None = None
    shape: Literal["ramp", "one-minus-cosine"] = "ramp"
    force_n: Force | None = None
    arm_m: Arm | None = None
    intensity_n: Annotated[float, Field(gt=0.0, le=1e5)] | None = None
    length_m: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    bank_percent: Annotated[float, Field(ge=-100.0, le=100.0)] | None = None
    front: Friction | None = None
    rear: Friction | None = None
    torque_nm: Force | None = None
    size: Annotated[float, Field(ge=-1e9, le=1e9)] | None = None

    def __post_init__(self) -> None:
        if self.kind == "none":
            return
        needed = NEEDED[self.kind]
        missing = [key for key in needed if getattr(self, key) is None]
        if missing == list(needed) or (missing and self.kind != "friction"):
            raise ValueError(f"{missing[0]}: must be set for {self.kind!r}")
        own = (*needed, *OPTIONAL.get(self.kind, ()))
        for key in OWN_KEYS:
            value = getattr(self, key)
            if value is not None and key not in own:
                raise ValueError(
                    f"{key} = {value:g}: says nothing of {self.kind!r}; must be {' or '.join(own)}"
                )
        if self.for_s is not None and self.ramp > 0.5 * self.for_s:
            raise ValueError(
                f"ramp_s = {self.ramp:g}: must be at most {0.5 * self.for_s:g}, half of for_s"
            )

    @property
    def columns(self) -> tuple[str, ...]:
        """The inputs of a plant on which the disturbance acts; see ``driving.WORLD_COLUMNS``."""
        if self.kind in {"gust", "turbulence"}:
            return ("side_force_n", *(("yaw_moment_nm",) if self.arm_m else ()))
        if self.kind == "friction":
            axles = (("front_friction", self.front), ("rear_friction", self.rear))
            return tuple(column for column, factor in axles if factor is not None)
        others = {"bank": "bank_rad", "steering-kick": "steering_kick_nm", PUSH: PUSH}
        return (others[self.kind],)

    @property
    def ramp(self) -> float:
        """The time of the rise and of the fall, s; by default a cosine fills all of ``for_s``."""
        if self.ramp_s is not None:
            return self.ramp_s
        if self.for_s is None:
            return RAMP_S
        half = 0.5 * self.for_s
        return half if self.shape == "one-minus-cosine" else min(RAMP_S, half)


OWN_KEYS: Final = tuple(field.name for field in fields(DisturbanceSettings))[5:]
"""The keys that belong to single kinds."""
