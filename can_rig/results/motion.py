"""The path of a car over its road, and the paths of the same car without fault or compensation.

Position and heading are integrated from speed, yaw rate and side slip as the plant reports them.
The lane is the path of the car without faults, disturbances and noise.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

import numpy as np

from can_rig.drawing.names import fault_label, names_of
from can_rig.errors import RigError
from can_rig.logs.columns import SECOND_MASS
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.without_bus import run_without_bus
from can_rig.results.counterfactual import applied_commands
from can_rig.results.signals import Signals, signals_of_columns
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.law.structs import FloatArray

YAW_RATE: Final = "yaw_rate_rad_per_s"
SIDE_SLIP: Final = "side_slip_rad"
STEERING: Final = "steering_angle_rad"

MOST_TICKS: Final = 500_000
"""Of a run that is repeated without fault and without compensation: eight minutes at 1 kHz."""

ROWS_PER_S: Final = 50
"""Rows of a scene: as many as a film needs."""


class Track(NamedTuple):
    """Where a car is, (ticks,) each: from the origin, x ahead, y to the left."""

    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray


class Tracks(NamedTuple):
    """The tracks of a run's car, and of the same car in other runs; None: unknown."""

    driven: Track
    lane: Track | None
    without: Track | None
    """Without compensation."""


def track_of(scenario: Scenario, signals: Signals, step: int = 1) -> Track | None:
    """The track of a run's car; None: the plant reports no yaw rate or no side slip.

    Args:
        scenario: the run.
        signals: the recorded signals.
        step: every ``step``-th tick is in the track.
    """
    reported = signals.plant
    if YAW_RATE not in reported or SIDE_SLIP not in reported or not len(signals):
        return None
    speeds = reported.get("speed_mps")
    turned, *gone = (_Integral(scenario.tick_s) for _ in Track._fields)
    kept: list[list[FloatArray]] = [[] for _ in Track._fields]
    for rows in paged.blocks(len(signals)):
        heading = turned.over(np.nan_to_num(reported[YAW_RATE][rows]))
        course = heading + np.nan_to_num(reported[SIDE_SLIP][rows])
        speed = scenario.plant.speed_mps if speeds is None else np.nan_to_num(speeds[rows])
        x_m, y_m = (
            way.over(speed * part(course)) for way, part in zip(gone, (np.cos, np.sin), strict=True)
        )
        for some, values in zip(kept, (x_m, y_m, heading), strict=True):
            some.append(values[-rows.start % step :: step].copy())  # no view of all ticks
    return Track(*(np.concatenate(some) for some in kept))


class _Integral:
    """The integral over the ticks of a run, part by part, by the trapezoidal rule."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._total = 0.0
        self._last: float | None = None

    def over(self, values: FloatArray) -> FloatArray:
        """(n,), from the first tick of the run to each of the next n ticks."""
        before = np.concatenate([[values[0] if self._last is None else self._last], values])
        steps = 0.5 * self._tick_s * (before[1:] + before[:-1])
        if self._last is None:
            steps[0] = 0.0
        total: FloatArray = np.cumsum(np.concatenate([[self._total], steps]))[1:]
        self._total, self._last = float(total[-1]), float(values[-1])
        return total


def tracks(scenario: Scenario, signals: Signals, step: int = 1) -> Tracks | None:
    """The tracks of a run, every ``step``-th tick; None: the plant is no car that reports motion.

    Long runs, runs that need a bus and other controllers have the driven track alone.
    """
    driven = track_of(scenario, signals, step)
    if driven is None:
        return None
    simple = scenario.controller.is_ours and network_of(scenario).is_the_rigs
    begins = signals.time_s[0] < 0.5 * scenario.tick_s
    if not simple or not begins or len(signals) > MOST_TICKS:
        return Tracks(driven, None, None)
    whole = replace(scenario, duration_s=len(signals) * scenario.tick_s)
    lane = _track_of_run(replace(whole.undisturbed, disturbance=()), step)
    off = replace(whole, design=replace(whole.design, compensation="off"))
    needs_bus = any(fault.needs_a_bus for fault in scenario.faults)
    hit = bool(scenario.faults or scenario.disturbances)
    is_off = scenario.design.compensation == "off"
    without = None if needs_bus or not hit or is_off else _track_of_run(off, step)
    return Tracks(driven, lane, without)


def _track_of_run(scenario: Scenario, step: int) -> Track | None:
    """The track of another run; the recorded frames of that run are not kept."""
    with TemporaryDirectory() as folder:
        log = Path(folder) / "bus.log"
        try:
            columns = run_without_bus(scenario, log, StopRequest(), lambda _tick: None).columns
        except RigError:  # a car that leaves its model
            return None
        assert columns is not None
        return track_of(scenario, signals_of_columns(columns, scenario.tick_s, log), step)


def scene(scenario: Scenario, signals: Signals) -> dict[str, Any] | None:
    """The numbers of the drawing for ``scene.js``: a row for each 20 ms; None: nothing to draw.

    A car has its tracks, and ``other`` names the second car; another plant has its output, and the
    position ``x`` of a second mass, if any.
    """
    if not len(signals):
        return None
    step = max(1, round(1.0 / (ROWS_PER_S * scenario.tick_s)))
    applied_1, applied_2 = applied_commands(scenario, signals)
    drawn = {"time": signals.time_s, "applied_1": applied_1, "applied_2": applied_2}
    columns: dict[str, FloatArray] = {}
    moves = scenario.plant.is_car or YAW_RATE in signals.plant
    found = tracks(scenario, signals, step) if moves else None
    if found is not None:
        drawn["steering"] = signals.plant.get(STEERING, np.zeros(len(signals)))
        for prefix, track in zip(("", "lane_", "other_"), found, strict=True):
            if track is not None:
                for name, values in track._asdict().items():
                    columns[prefix + name.rpartition("_")[0]] = values
    else:
        drawn |= {"output": signals.dstar_mps2, "reference": signals.reference_mps2}
        drawn |= {"x": signals.plant[SECOND_MASS]} if SECOND_MASS in signals.plant else {}
    for name, values in drawn.items():
        columns[name] = values[::step].copy()
        paged.let_go()
    return {
        **setting_of(scenario, found is not None),
        "dead": dead_of(scenario),
        "other": "without compensation",
        "columns": columns,
    }


def setting_of(scenario: Scenario, moves: bool | None = None) -> dict[str, Any]:
    """What ``scene.js`` draws: a car with its sizes, an angle, a position, or the loop as blocks.

    Args:
        scenario: the run.
        moves: whether the plant reports the motion of a car; None: as its settings suggest.
    """
    plant, names = scenario.plant, names_of(scenario.plant)
    kind = {"rad": "angle", "m": "position"}.get(names.output.unit)
    if moves if moves is not None else kind is None and (plant.is_car or plant.is_own):
        kind = "car"
    return {
        "kind": kind or "blocks",
        "names": [each.name for each in names],
        "units": [each.unit for each in names],
        "limits": (scenario.limits.torque_nm, scenario.limits.force_difference_n),
        "feedback": scenario.design.feedback,
        "sizes": (plant.front_axle_distance_m, plant.rear_axle_distance_m, plant.rear_track_m),
        "speed": plant.speed_mps,
    }


def dead_of(scenario: Scenario) -> list[dict[str, Any]]:
    """The failed parts: place, begin and end in s, and the fault in words."""
    names = names_of(scenario.plant)
    return [
        {
            "place": fault.place,
            "begin": fault.at_s,
            "end": fault.for_s and fault.end_s,
            "words": fault_label(fault, names),
        }
        for fault in scenario.faults
    ]
