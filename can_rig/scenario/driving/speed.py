"""The speed of a scenario's car over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from can_rig import paged
from can_rig.errors import ScenarioError
from can_rig.scenario.driving.csv_columns import over_time
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.drive import FASTEST_MPS, SLOWEST_MPS
from firmware_model.target.structs import FloatArray

ROUNDING = 1e-9  # relative, against refusing the fastest allowed rate


@dataclass(frozen=True)
class SpeedProfile:
    """Straight lines between (``time_s``, ``speed_mps``), shape (n,) each; end values hold."""

    time_s: FloatArray
    speed_mps: FloatArray

    def __call__(self, time_s: FloatArray) -> FloatArray:
        """The speed at ``time_s``, of any shape, m/s."""
        return np.interp(time_s, self.time_s, self.speed_mps)

    @property
    def range_mps(self) -> tuple[float, float]:
        """The lowest and the highest speed."""
        return float(self.speed_mps.min()), float(self.speed_mps.max())

    @property
    def fastest_change_mps2(self) -> float:
        """The largest rate of the speed, up or down."""
        rates = np.diff(self.speed_mps) / np.diff(self.time_s)
        return float(np.abs(rates).max(initial=0.0))


def speed_profile(scenario: Scenario) -> SpeedProfile:
    """The car's speed in a scenario with a drive.

    Raises:
        ScenarioError: an unreadable CSV, a speed out of bounds, or a speed that changes too fast.
    """
    drive = scenario.drive
    where = f"scenario {scenario.name}: drive"
    if drive.speed_mps is not None:
        return SpeedProfile(np.zeros(1), np.array([drive.speed_mps]))
    if drive.ramps:
        profile = SpeedProfile(*np.array(drive.ramps, dtype=np.float64).T)
    else:
        where += f".file = {drive.file!r}"
        profile = SpeedProfile(*over_time(drive.file, where, "speed_mps", scenario.duration_s))
        for speed in profile.range_mps:
            if not SLOWEST_MPS <= speed <= FASTEST_MPS:
                raise ScenarioError(
                    f"{where}: speed_mps = {speed:g}: must be {SLOWEST_MPS:g} to {FASTEST_MPS:g}"
                )
    fastest, most = profile.fastest_change_mps2, drive.speed_rate_max_mps2
    if fastest > most * (1.0 + ROUNDING):
        raise ScenarioError(
            f"{where}: the speed changes by {fastest:.4g} m/s²: must be at most "
            f"drive.speed_rate_max_mps2 = {most:g}"
        )
    return profile


def speeds_at_ticks(scenario: Scenario) -> FloatArray:
    """The speed at the start of every tick, shape (ticks,), m/s.

    Raises:
        ScenarioError: as ``speed_profile``.
    """
    profile, tick_s = speed_profile(scenario), scenario.tick_ns * 1e-9
    return paged.column(
        scenario.ticks, lambda rows: profile(np.arange(rows.start, rows.stop) * tick_s)
    )
