"""The keys of a drive: how fast the car goes, and how fast that may change."""

from __future__ import annotations

import itertools
from typing import Annotated, Final

from pydantic import Field, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.stage_settings import STRICT
from can_rig.scenario.tables.fault import Moment

SLOWEST_MPS: Final = 1.0  # below that a tire rolls as no slip angle of ours says
FASTEST_MPS: Final = 100.0

Speed = Annotated[float, Field(ge=SLOWEST_MPS, le=FASTEST_MPS)]


@dataclass(frozen=True, config=STRICT)
class DriveSettings:
    """How fast the car goes, at most one of three ways; the controller hears it on the bus.

    ``speed_mps`` is constant; ``ramps`` has pairs of time in s and speed in m/s, with straight
    lines between them; ``file`` is a CSV of these two columns. Before the first and after the last
    pair the speed stays. Without any, it is ``plant.speed_mps``, and no frame says it.
    """

    speed_mps: Speed | None = None
    ramps: tuple[tuple[Moment, Speed], ...] | None = None
    file: str = ""
    speed_rate_max_mps2: PositiveFloat = 8.0

    def __post_init__(self) -> None:
        given = [key for key in ("speed_mps", "ramps", "file") if getattr(self, key)]
        if len(given) > 1:
            raise ValueError(f"{given[1]}: must not stand beside {given[0]}; a drive has one speed")
        times = [time_s for time_s, _ in self.ramps or ()]
        for before, after in itertools.pairwise(times):
            if not after > before:
                raise ValueError(f"ramps: time {after:g} s after {before:g} s: times must increase")

    @property
    def is_given(self) -> bool:
        """Whether the scenario has one."""
        return bool(self.speed_mps or self.ramps or self.file)
