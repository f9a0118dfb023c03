"""What the compensation does to the car: the run beside the same run without compensation.

Both are compared with an undisturbed run: the same car, drive and noise, without faults,
disturbances and compensation. So the metrics also judge a healthy car, and a car in the wind. All
use D* of the car before its sensor.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.results.counterfactual import uncompensated, undisturbed
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of, target
from can_rig.scenario.fault_settings import CHANNELS, SENSOR
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

Mask = NDArray[np.bool_]
TORQUE, FORCE = CHANNELS

DRIVER_S: Final = 2.0
"""Time until a surprised driver steers; until then nobody corrects the car's path."""

DECIMALS: Final = 9
"""Of sums over a run; a long run is added up in other parts, with other rounding."""

ACTS: Final = 0.01
"""Of the largest force difference: a smaller command compensates nothing."""

NO_FAULT: Final = (Verdict.NOTHING, Verdict.ANOTHER_CAR)
NAMED: Final[dict[Verdict, frozenset[str]]] = {
    Verdict.TORQUE_LOST: frozenset({TORQUE}),
    Verdict.TORQUE_OFFSET: frozenset({TORQUE}),
    Verdict.FORCE_LOST: frozenset({FORCE}),
    Verdict.SENSOR_BIASED: frozenset({SENSOR}),
    Verdict.SENSOR_DRIFTING: frozenset({SENSOR}),
    Verdict.SENSOR_FROZEN: frozenset({SENSOR}),
    Verdict.BOTH_LOST: frozenset({TORQUE, FORCE}),
}
"""The places that a verdict names; ``CANNOT_BE_TOLD`` names no place."""


def harm_metrics(
    scenario: Scenario, signals: Signals, lost: Mask
) -> dict[str, float | bool | str | None]:
    """The metrics of the whole run beside the same run without compensation.

    Args:
        scenario: the run.
        signals: its signals.
        lost: (ticks,), whether a fault of the torque exists.
    """
    with_it = without = path = path_without = None
    output = signals.plant.get(TRUE_OUTPUT)
    if output is not None and len(signals):
        goal = undisturbed(scenario, signals).output_mps2
        with_it, path = _away(output, goal, scenario.tick_s)
        if scenario.controller.is_ours:  # no other controller has a switch for its compensation
            other = uncompensated(scenario, signals).output_mps2
            without, path_without = _away(other, goal, scenario.tick_s)
    force, limit_n = signals.force_difference_n, target(scenario, network_of(scenario)).limit_2
    acts = ~lost & (np.abs(force) > ACTS * limit_n)
    spare_peak = _largest(force, ~lost)
    ratio = None if with_it is None or not without else with_it / without
    return {
        "deviation_peak_mps2": with_it,
        "deviation_peak_uncompensated_mps2": without,
        "deviation_over_uncompensated": ratio,
        "astray_m": path,
        "astray_uncompensated_m": path_without,
        "torque_rms_nm": _rms(signals.torque_nm),
        "force_difference_unneeded_rms_n": _rms(force, ~lost),
        "force_difference_unneeded_peak_n": spare_peak,
        "compensated_unneeded_s": float(acts.sum()) * scenario.tick_s if len(signals) else None,
        **_placed(scenario, signals),
    }


def _placed(scenario: Scenario, signals: Signals) -> dict[str, bool | str | None]:
    """Where the faults are, the longest verdict since the first fault, and its truth."""
    faulty = {fault.place for fault in scenario.faults}
    place = " and ".join(sorted(faulty)) or "nothing" if len(signals) else None
    if signals.verdict is None or not len(signals):
        return {"place": place, "verdict": None, "right_place": None, "wrong_place": None}
    first = min((fault.at_s for fault in scenario.faults), default=0.0)
    counts = np.zeros(len(Verdict), dtype=np.int64)
    for rows in paged.blocks(len(signals)):
        codes = signals.verdict[rows][signals.time_s[rows] >= first - 1e-9]
        known = codes[np.isfinite(codes)].astype(np.int64)
        counts += np.bincount(known, minlength=len(Verdict))[: len(Verdict)]
    counts[list(NO_FAULT)] = 0
    verdict = Verdict(int(np.argmax(counts))) if counts.any() else Verdict.NOTHING
    named = NAMED.get(verdict, frozenset())
    return {
        "place": place,
        "verdict": verdict.name,
        "right_place": bool(named and named <= faulty) if faulty else None,
        "wrong_place": bool(named - faulty),
    }


def _away(output: FloatArray, goal: FloatArray, tick_s: float) -> tuple[float | None, float | None]:
    """The largest deviation of ``output`` from ``goal``, m/s², and how far the path goes astray.

    The second is the largest lateral displacement that the deviation causes within ``DRIVER_S``,
    in m, from any moment on. A plant that has failed has neither.
    """
    n = round(DRIVER_S / tick_s)
    largest = farthest = 0.0
    for rows in paged.blocks(len(output)):
        begin = max(rows.start - n, 0)
        away = output[begin : rows.stop] - goal[begin : rows.stop]
        if not np.isfinite(away).all():
            return None, None
        largest = max(largest, float(np.abs(away[rows.start - begin :]).max()))
        calm = np.zeros(n + 1 - (rows.start - begin))
        speed = np.cumsum(np.concatenate([calm, away])) * tick_s
        place = np.cumsum(speed) * tick_s
        moved = place[n:] - place[:-n] - n * tick_s * speed[:-n]
        farthest = max(farthest, float(np.abs(moved).max()))
    return largest, round(farthest, DECIMALS)


def _rms(values: FloatArray, among: Mask | None = None) -> float | None:
    """The rms of the finite values ``among`` these ticks; None without a finite value."""
    total, count = 0.0, 0
    for rows in paged.blocks(len(values)):
        known = np.isfinite(values[rows])
        if among is not None:
            known &= among[rows]
        total += float(np.sum(np.square(values[rows]), where=known, initial=0.0))
        count += int(known.sum())
    return round((total / count) ** 0.5, DECIMALS) if count else None


def _largest(values: FloatArray, among: Mask) -> float | None:
    """The largest finite magnitude ``among`` these ticks; None without a finite value."""
    found = [
        float(np.abs(some[known]).max())
        for rows in paged.blocks(len(values))
        if (known := np.isfinite(some := values[rows]) & among[rows]).any()
    ]
    return max(found, default=None)
