"""The keys of a fault: what fails, how, when, and for how long.

The first word of a kind says where it acts: in an actuator, in the sensor, or on a frame on its
way. A scenario has any number of faults, which may overlap.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, get_args

from pydantic import Field, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.stage_settings import STRICT

FaultKind = Literal[
    "none",
    "actuator-dead",
    "actuator-stuck",
    "actuator-offset",
    "actuator-drift",
    "actuator-oscillating",
    "actuator-rate-limited",
    "actuator-late",
    "sensor-biased",
    "sensor-dead",
    "sensor-stuck",
    "sensor-drift",
    "sensor-oscillating",
    "sensor-rate-limited",
    "sensor-late",
    "frames-missing",
    "frames-corrupted",
    "frames-repeated",
    "frames-late",
    "frames-forged",
]
Channel = Literal["torque", "force-difference"]
CHANNELS: Final[tuple[Channel, Channel]] = get_args(Channel)
"""The words for input 1 and input 2, of any plant."""
SENSOR: Final = "sensor"
"""In place of a channel, for the frame of the measured output."""
PLACES: Final = (*CHANNELS, SENSOR)
"""What can fail; the place of each is its number."""

MAX_DURATION_S: Final = 1e6
FOR_GOOD_NS: Final = 1 << 62  # later than any run
MAX_LATE_TICKS: Final = 1000

Moment = Annotated[float, Field(ge=0.0, le=MAX_DURATION_S)]
"""In a run, or a length of time that may be none, s."""

NUMBER: Final = {
    "actuator-dead": "left",
    "sensor-dead": "left",
    "actuator-stuck": "value",
    "sensor-stuck": "value",
    "actuator-offset": "offset",
    "actuator-drift": "drift_per_s",
    "sensor-drift": "drift_per_s",
    "actuator-oscillating": "amplitude",
    "sensor-oscillating": "amplitude",
    "actuator-rate-limited": "rate_per_s",
    "sensor-rate-limited": "rate_per_s",
    "actuator-late": "late_ticks",
    "sensor-late": "late_ticks",
    "sensor-biased": "bias_mps2",
    "frames-late": "late_ticks",
    "frames-forged": "value",
}
"""Of each kind that has one, the key of its one number."""

WHERE_IT_IS: Final = ("actuator-stuck", "sensor-stuck")
"""Kinds that mean something without their number too."""


@dataclass(frozen=True, config=STRICT)
class FaultSettings:
    """One fault from ``at_s`` on, for good or for ``for_s`` seconds, at every ``every``-th tick.

    ``channel`` is what an actuator's fault or a fault of frames concerns. ``value``, ``offset``,
    ``drift_per_s``, ``amplitude`` and ``rate_per_s`` are in the unit of what fails: N m, N or m/s².
    """

    kind: FaultKind = "none"
    channel: Literal["torque", "force-difference", "sensor"] = "torque"
    at_s: Moment = 10.0
    for_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] | None = None
    every: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    left: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    bias_mps2: float = 0.1
    value: float | None = None
    offset: float | None = None
    drift_per_s: float | None = None
    amplitude: float | None = None
    frequency_rad_per_s: PositiveFloat = 10.0
    rate_per_s: PositiveFloat | None = None
    late_ticks: Annotated[int, Field(ge=1, le=MAX_LATE_TICKS)] = 10

    def __post_init__(self) -> None:
        needed = None if self.kind in WHERE_IT_IS else NUMBER.get(self.kind)
        if needed is not None and getattr(self, needed) is None:
            raise ValueError(f"{needed}: must be set for {self.kind!r}")
        if self.channel == SENSOR and self.kind.startswith("actuator-"):
            raise ValueError(
                f"channel = {SENSOR!r}: must be torque or force-difference for {self.kind!r}"
            )

    @property
    def place(self) -> str:
        """What fails: one of ``PLACES``."""
        return SENSOR if self.kind.startswith("sensor-") else self.channel

    @property
    def acts_on_frames(self) -> bool:
        """Whether it is a fault of the bus and of who sends on it."""
        return self.kind.startswith("frames-")

    @property
    def adds_frames(self) -> bool:
        """Whether it puts frames on the bus that are not, damaged or not, those of their tick."""
        alone = "frames-missing" if self.place == SENSOR else "frames-corrupted"
        return self.acts_on_frames and self.kind not in {"frames-missing", alone}

    @property
    def loses_a_channel(self) -> bool:
        """Whether an actuator does not do what it is told, in full or in part."""
        return self.kind != "none" and self.place != SENSOR

    @property
    def span_ns(self) -> tuple[int, int]:
        """When it begins, and when it is over; whole nanoseconds, so no tick by rounding."""
        if self.kind == "none":
            return FOR_GOOD_NS, FOR_GOOD_NS
        begin_ns = round(self.at_s * 1e9)
        if self.for_s is None:
            return begin_ns, FOR_GOOD_NS
        return begin_ns, begin_ns + round(self.for_s * 1e9)

    def ticks(self, tick_ns: int, run: range) -> range:
        """The ticks of ``run`` at which it is there."""
        begin, end = (-(-time_ns // tick_ns) for time_ns in self.span_ns)
        steps = -(-max(run.start - begin, 0) // self.every)
        return range(begin + steps * self.every, min(end, run.stop), self.every)
