"""What a run achieved, as the numbers of ``run.json`` and of the closing table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from can_rig.scenario import Scenario
from can_rig.signals import Signals
from firmware_model.sections import FloatArray

Metrics = dict[str, float | None]


def metrics(scenario: Scenario, signals: Signals) -> Metrics:
    """Errors in m/s², times in s, commands in N m and N; None where the run has no such moment.

    The windows "before" and "settled" are the last 2 s before the fault and of the run, or two
    periods of a slower reference.
    """
    window_s = 2.0
    if scenario.reference.kind == "sine":
        window_s = max(window_s, 4.0 * math.pi / scenario.reference.frequency_rad_per_s)
    time_s, error = signals.time_s, np.abs(signals.error_mps2)
    end_s = len(signals) * scenario.tick_s
    fault_s = scenario.fault.at_s if scenario.fault.kind != "none" else math.inf
    lost = time_s >= fault_s
    before = (time_s < min(fault_s, end_s)) & (time_s >= min(fault_s, end_s) - window_s)
    settled = lost & (time_s >= end_s - window_s)
    estimate = np.abs(signals.fault_estimate_mps2)
    return {
        "error_before_fault_mps2": _peak(error[before]),
        "error_peak_after_fault_mps2": _peak(error[lost]),
        "error_settled_after_fault_mps2": _peak(error[settled]),
        "fault_estimate_peak_before_fault_mps2": _peak(estimate[~lost]),
        "fault_estimate_settled_mps2": _peak(estimate[settled]),
        "fault_seen_after_s": _first(
            time_s[lost & (estimate > scenario.design.fault_threshold_mps2)], fault_s
        ),
        "torque_peak_nm": _peak(np.abs(signals.torque_nm)),
        "torque_peak_after_fault_nm": _peak(np.abs(signals.torque_nm[lost])),
        "force_difference_peak_n": _peak(np.abs(signals.force_difference_n)),
        "force_difference_settled_n": _peak(np.abs(signals.force_difference_n[settled])),
    }


def _peak(values: FloatArray) -> float | None:
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else None


def _first(times_s: FloatArray, since_s: float) -> float | None:
    return float(times_s[0] - since_s) if len(times_s) else None


def rows(values: Metrics, units: dict[str, str]) -> list[tuple[str, str]]:
    """The closing table, label and text, for the metrics that this run has."""
    out: list[tuple[str, str]] = []
    for key, label, unit in _TABLE:
        value: Any = values.get(key)
        text = "none seen" if value is None else f"{value:.4g} {units.get(unit, unit)}".rstrip()
        out.append((label, text))
    return out


_TABLE = (
    ("error_before_fault_mps2", "|error| before the fault, settled", "y"),
    ("error_peak_after_fault_mps2", "|error| after the fault, peak", "y"),
    ("error_settled_after_fault_mps2", "|error| after the fault, settled", "y"),
    ("fault_seen_after_s", "fault estimate over its threshold after", "s"),
    ("fault_estimate_peak_before_fault_mps2", "|fault estimate| while healthy, peak", "y"),
    ("torque_peak_nm", "|command 1|, peak", "u1"),
    ("force_difference_peak_n", "|command 2|, peak", "u2"),
    ("force_difference_settled_n", "|command 2|, settled", "u2"),
)
