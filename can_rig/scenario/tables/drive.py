"""The keys of a drive: the car's speed, and its largest rate of change."""

from __future__ import annotations

import itertools
from typing import Annotated, Final

from pydantic import Field, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.stage_settings import STRICT
from can_rig.scenario.tables.fault import Moment

SLOWEST_MPS: Final = 1.0  # at lower speeds our slip angles fail to describe a rolling tire
FASTEST_MPS: Final = 100.0

Speed = Annotated[float, Field(ge=SLOWEST_MPS, le=FASTEST_MPS)]


@dataclass(frozen=True, config=STRICT)
class DriveSettings:
    """The car's speed, by at most one of three keys; the controller hears the speed on the bus.

    ``speed_mps`` is constant; ``ramps`` has pairs of time in s and speed in m/s, joined by straight
    lines; ``file`` is a CSV of these two columns. Before the first and after the last pair the
    speed stays. Without any key, the speed is ``plant.speed_mps``, and no frame carries the speed.
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
        """Whether the scenario has a drive."""
        return bool(self.speed_mps or self.ramps or self.file)
