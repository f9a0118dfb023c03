"""The inputs of a drive: the speed over time, and the designs at the speeds."""

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from can_rig.errors import ScenarioError
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.recording import Column, Recording, over_time
from can_rig.scenario.remembered import remembered, state_of_file
from can_rig.scenario.settings import FASTEST_MPS, DriveSettings, Scenario
from can_rig.storage import paged
from firmware_model.compiled import compiled
from firmware_model.design.vehicle import LOW_SPEED_MPS, WORLD
from firmware_model.law.schedule import MAX_SPEEDS
from firmware_model.law.structs import FloatArray

ROUNDING = 1e-9  # relative, against refusing the fastest allowed rate
MPS_PER_KMH, MPS_PER_MPH = 1.0 / 3.6, 0.44704  # exact by definition
USUAL_INTERVALS: Final = 10  # the longest interval between rows that is no gap

_KMH = dict.fromkeys(("km/h", "kmh", "kph", "kmph", "kmhr"), MPS_PER_KMH)
_MPH = dict.fromkeys(("mph", "mi/h"), MPS_PER_MPH)
UNITS: Final = {"mps": 1.0, "m/s": 1.0, **_KMH, **_MPH}
SPEED_WORDS: Final = frozenset(("speed", "velocity", "v", "vel", "spd", "vehiclespeed", *UNITS))

BANK_PERCENT, FRICTION = "bank_percent", "friction"
WORLD_COLUMNS: Final = (*WORLD, "front_friction", "rear_friction")
"""The world's inputs, and the friction factors of both axles; a drive may have such columns."""
INSTEAD: Final = {BANK_PERCENT: ("bank_rad",), FRICTION: WORLD_COLUMNS[-2:]}
"""Further columns of a drive, and the columns that they replace."""
BOUNDS: Final = {
    "side_force_n": (-1e5, 1e5),
    "yaw_moment_nm": (-1e6, 1e6),
    "bank_rad": (-0.8, 0.8),
    "steering_kick_nm": (-1e5, 1e5),
    "front_friction": (0.01, 2.0),
    "rear_friction": (0.01, 2.0),
    BANK_PERCENT: (-100.0, 100.0),
    FRICTION: (0.01, 2.0),
}
"""As a disturbance's keys have them."""
SPEED_COLUMN: Final = "speed_mps"
COLUMNS: Final = (
    Column(SPEED_COLUMN, SPEED_WORDS, UNITS, gaps=True),
    *(Column(name, optional=True) for name in BOUNDS),
)


@dataclass(frozen=True)
class SpeedProfile:
    """Straight lines between (``time_s``, ``speed_mps``), shape (n,) each; end values hold.

    Attributes:
        world: columns of the world at the same times, shape (n,) each, by ``WORLD_COLUMNS``.
        notes: what was made of a recording, a line each.
    """

    time_s: FloatArray
    speed_mps: FloatArray
    world: dict[str, FloatArray] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __call__(self, time_s: FloatArray) -> FloatArray:
        """The speed at ``time_s``, of any shape, m/s."""
        return np.interp(time_s, self.time_s, self.speed_mps)

    def world_at(self, name: str, time_s: FloatArray) -> FloatArray:
        """A column of ``world`` at ``time_s``, of any shape."""
        return np.interp(time_s, self.time_s, self.world[name])

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

    The speed of a recording follows its rows at ``drive.speed_rate_max_mps2`` at most.

    Raises:
        ScenarioError: an unreadable CSV, a speed out of bounds, a gap in a recording, or ramps
            that change the speed too fast.
    """
    drive = scenario.drive
    where = f"scenario {scenario.name}: drive"
    if drive.speed_mps is not None:
        return SpeedProfile(np.zeros(1), np.array([drive.speed_mps]))
    if not drive.ramps:
        return _recorded(f"{where}.file = {drive.file!r}", drive, scenario.duration_s)
    profile = SpeedProfile(*np.array(drive.ramps, dtype=np.float64).T)
    fastest, most = profile.fastest_change_mps2, drive.speed_rate_max_mps2
    if fastest > most * (1.0 + ROUNDING):
        raise ScenarioError(
            f"{where}: the speed changes by {fastest:.4g} m/s²: must be at most "
            f"drive.speed_rate_max_mps2 = {most:g}"
        )
    return profile


@remembered(4, by=lambda where, drive, end_s: (where, drive, end_s, *state_of_file(drive.file)))
def _recorded(where: str, drive: DriveSettings, end_s: float) -> SpeedProfile:
    recorded = over_time(drive.file, where, COLUMNS, end_s)
    speeds = recorded.values.pop(SPEED_COLUMN)
    _refuse_values(where, recorded, SPEED_COLUMN, speeds, (0.0, FASTEST_MPS))
    for name, values in recorded.values.items():
        _refuse_values(where, recorded, name, values, BOUNDS[name])
    _refuse_gaps(where, recorded, drive.gap_max_s)
    for name, instead in INSTEAD.items():
        if name not in recorded.values:
            continue
        if both := recorded.values.keys() & set(instead):
            raise ScenarioError(f"{where}: {name}: must not stand beside {min(both)}")
        values = recorded.values.pop(name)
        values = np.arctan(values / 100.0) if name == BANK_PERCENT else values
        recorded.values.update(dict.fromkeys(instead, values))
    driven = speeds.copy()
    follow_rows(recorded.time_s, driven, drive.speed_rate_max_mps2 * (1.0 + ROUNDING))
    notes = []
    if len(limited := np.flatnonzero(driven != speeds)):
        worst = float(np.abs(driven - speeds).max())
        notes.append(
            f"note: {where}: the speed changes by more than drive.speed_rate_max_mps2 = "
            f"{drive.speed_rate_max_mps2:g}: {len(limited)} of {len(speeds)} rows are limited, by "
            f"{worst:.3g} m/s at most, the first in line {recorded.lines[int(limited[0])]}"
        )
    if recorded.unused:
        notes.append(f"note: {where}: columns without effect: {', '.join(recorded.unused)}")
    return SpeedProfile(recorded.time_s, driven, recorded.values, tuple(notes))


def _refuse_values(
    where: str, recorded: Recording, name: str, values: FloatArray, bounds: tuple[float, float]
) -> None:
    low, high = bounds
    beyond = np.flatnonzero((values < low) | (values > high))
    if len(beyond):
        row = int(beyond[0])
        raise ScenarioError(
            f"{where}: line {recorded.lines[row]}: {name} = {values[row]:g}: "
            f"must be {low:g} to {high:g}"
        )


def _refuse_gaps(where: str, recorded: Recording, longest_s: float) -> None:
    """Refuse a time without a speed that no straight line should bridge.

    Rows without a speed are a gap, as is an interval much longer than most intervals.
    """
    intervals = np.diff(recorded.time_s)
    if not len(intervals):
        return
    unusual = intervals > USUAL_INTERVALS * np.median(intervals)
    is_gap = (unusual | (np.array(recorded.skipped)[1:] > 0)) & (intervals > longest_s)
    if is_gap.any():
        row = int(np.argmax(is_gap))
        last, line = recorded.lines[row], recorded.lines[row + 1]
        raise ScenarioError(
            f"{where}: line {line}: {intervals[row]:.4g} s without a speed since line {last}: "
            f"must be at most drive.gap_max_s = {longest_s:g}"
        )


@compiled
def follow_rows(time_s: FloatArray, speed_mps: FloatArray, rate_mps2: float) -> None:
    """Let each row's speed, in place, be at most ``rate_mps2`` away from the row before."""
    for k in range(1, len(time_s)):
        reach = rate_mps2 * (time_s[k] - time_s[k - 1])
        before = speed_mps[k - 1]
        speed_mps[k] = min(max(speed_mps[k], before - reach), before + reach)


def notes_of_drive(scenario: Scenario) -> tuple[str, ...]:
    """What was made of the recording of a scenario with a drive, a line each.

    Raises:
        ScenarioError: as ``speed_profile``.
    """
    return speed_profile(scenario).notes if scenario.drive.is_given else ()


def speeds_at_ticks(scenario: Scenario) -> FloatArray:
    """The speed at the start of every tick, shape (ticks,), m/s.

    Raises:
        ScenarioError: as ``speed_profile``.
    """
    profile, tick_s = speed_profile(scenario), scenario.tick_ns * 1e-9
    return paged.column(
        scenario.ticks, lambda rows: profile(np.arange(rows.start, rows.stop) * tick_s)
    )


RATIO = 1.12  # of neighbouring speeds: a blend is far closer to the right design than another car


def design_speeds(scenario: Scenario) -> tuple[float, ...]:
    """The design speeds of the controller, ascending, from ``LOW_SPEED_MPS`` on if not given.

    Raises:
        ScenarioError: see ``speed_profile``.
    """
    if scenario.design.speeds_mps:
        return scenario.design.speeds_mps
    slowest, fastest = speed_profile(scenario).range_mps
    if slowest < LOW_SPEED_MPS:  # two designs at least, for a controller that hears the speed
        slowest, fastest = LOW_SPEED_MPS, max(fastest, RATIO * LOW_SPEED_MPS)
    steps = min(math.ceil(math.log(fastest / slowest) / math.log(RATIO) - 1e-9), MAX_SPEEDS - 1)
    return tuple(np.geomspace(slowest, fastest, steps + 1).tolist())


def frozen(scenario: Scenario, speed_mps: float) -> Scenario:
    """The scenario with car and design at one constant speed."""
    return replace(
        scenario,
        drive=DriveSettings(),
        plant=replace(scenario.plant, speed_mps=speed_mps),
        model=replace(scenario.model, speed_mps=speed_mps),
        design=replace(scenario.design, speeds_mps=None),
    )


def at_speed_of(scenario: Scenario, fault: FaultSettings) -> Scenario:
    """The scenario with the car's speed at the begin of ``fault``, for figures of a single speed.

    Raises:
        ScenarioError: see ``speed_profile``.
    """
    if not scenario.drive.is_given:
        return scenario
    speed = speed_profile(scenario)(np.array([fault.at_s]))
    return frozen(scenario, designed_for(scenario, float(speed[0])))


def designed_for(scenario: Scenario, speed_mps: float) -> float:
    """The speed itself, or the slowest with a design if slower, where that design goes on."""
    speeds = design_speeds(scenario)
    return max(speed_mps, speeds[0] if len(speeds) > 1 else LOW_SPEED_MPS)
