"""The results of a run, as the numbers of ``run.json`` and of the closing table."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from can_rig.assessment.limitations import control_authority
from can_rig.drawing.names import fault_in_words, names_of, with_unit
from can_rig.results.counterfactual import (
    deviation_from,
    fault_free,
    noise_free,
    output_of_car,
    signals_without_log,
    without_fault,
)
from can_rig.results.harm import harm_metrics
from can_rig.results.loss_metrics import (
    decision_metrics,
    detection_of,
    torque_lost,
    unavoidable_deviation,
)
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import at_speed_of
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

Metrics = dict[str, float | bool | str | None]
Mask = NDArray[np.bool_]

SETTLED_S = 2.0


@dataclass(frozen=True)
class Windows:
    """Masks of the ticks of a run, each of shape (ticks,).

    ``before`` the first fault, ``after`` its start, ``active`` during any fault, ``lost`` during
    the loss of a channel; ``settled_before`` and ``settled_after`` are the ends of the healthy time
    and of the run: 2 s, or two periods of a slower reference, but at most the second half of the
    time since the last change.
    """

    before: Mask
    after: Mask
    active: Mask
    lost: Mask
    settled_before: Mask
    settled_after: Mask


def windows(scenario: Scenario, signals: Signals) -> Windows:
    """The windows of a run; faults begin and end in whole ticks, as in the nodes."""
    wanted_s = SETTLED_S
    if scenario.reference.kind == "sine":
        wanted_s = max(wanted_s, 4.0 * math.pi / scenario.reference.frequency_rad_per_s)
    time_ns = paged.column(
        len(signals),
        lambda rows: np.rint(signals.time_s[rows] / scenario.tick_s) * scenario.tick_ns,
    )
    after, active, lost = np.zeros((3, len(signals)), dtype=np.bool_)
    end_ns = 0
    for fault in scenario.faults:
        begin_ns, its_end_ns = fault.span_ns
        its = (time_ns >= begin_ns) & (time_ns < its_end_ns)
        after |= time_ns >= begin_ns
        active |= its
        lost |= its & fault.loses_a_channel
        end_ns = max(end_ns, its_end_ns)
    recovered = after & (time_ns >= end_ns)
    return Windows(
        before=~after,
        after=after,
        active=active,
        lost=lost,
        settled_before=_end(time_ns, ~after, wanted_s),
        settled_after=_end(time_ns, recovered if recovered.any() else after, wanted_s),
    )


def metrics(scenario: Scenario, signals: Signals) -> Metrics:
    """Errors in m/s², times in s, commands in N m and N; None: no such moment in the run.

    The error is None in an open loop. The deviation, from D* of the same run without the fault, has
    a meaning in every loop. Both use D* of the car, without the errors of a faulty sensor;
    ``signals.csv`` and the picture show the measured D*. The needed and the available X_diff occur
    with a loss of the torque.
    """
    window = windows(scenario, signals)
    error = absolute_error(scenario, signals)
    estimate, torque, force = map(
        _magnitude, (signals.fault_estimate_mps2, signals.torque_nm, signals.force_difference_n)
    )
    deviation = paged.column(len(signals), _unknown)
    if window.after.any():
        deviation = deviation_from(scenario, signals, fault_free(scenario, signals))
    settled = window.settled_after if window.after.any() else window.settled_before
    loses_torque = window.lost.any() and any(f.place == CHANNELS[0] for f in scenario.faults)
    lost_at = at_speed_of(scenario, scenario.loss)
    authority = control_authority(lost_at, network_of(scenario)) if loses_torque else None
    alone = scenario.faults[0] if len(scenario.faults) == 1 else None
    bound = None if alone is None else unavoidable_deviation(scenario, signals, alone)
    unavoidable = None if bound is None else bound.deviation_mps2
    peak = peak_of(deviation, window.after)
    decided = decision_metrics(scenario, signals)
    delay, least_s = decided["detection_delay_s"], None
    if bound is not None:
        least_s = round(bound.detection_ticks * scenario.tick_s, 9)
    return {
        "error_before_fault_mps2": peak_of(error, window.settled_before),
        "error_peak_after_fault_mps2": peak_of(error, window.after),
        "error_peak_while_lost_mps2": peak_of(error, window.lost),
        "error_settled_after_fault_mps2": peak_of(error, window.settled_after),
        "error_integral_after_fault_mps": _integral(error[window.after], scenario.tick_s),
        "deviation_peak_after_fault_mps2": peak,
        "unavoidable_deviation_mps2": unavoidable,
        "unavoidable_detection_delay_s": least_s,
        "detection_over_unavoidable": delay / least_s if delay and least_s else None,
        "deviation_over_unavoidable": peak / unavoidable if peak and unavoidable else None,
        "deviation_settled_after_fault_mps2": peak_of(deviation, window.settled_after),
        "fault_estimate_peak_before_fault_mps2": peak_of(estimate, window.before),
        "fault_estimate_peak_while_lost_mps2": peak_of(estimate, window.lost),
        "fault_estimate_settled_mps2": peak_of(estimate, window.settled_after),
        **decided,
        "torque_peak_nm": peak_of(torque),
        "torque_at_fault_nm": peak_of(torque[np.flatnonzero(window.after)[:1]]),
        "torque_peak_after_fault_nm": peak_of(torque, window.after),
        "force_difference_peak_n": peak_of(force),
        "force_difference_settled_n": peak_of(force, settled),
        "force_difference_noise_rms_n": _noise_rms(scenario, signals, window.settled_before),
        "force_difference_needed_n": None if authority is None else authority.needed_n,
        "force_difference_available_n": None if authority is None else authority.available_n,
        "dstar_carried_mps2": None if authority is None else authority.carries_mps2,
        **harm_metrics(scenario, signals, torque_lost(scenario, signals)),
    }


def metrics_of(scenario: Scenario) -> Metrics:
    """The metrics of a run without records: equal to those of a run folder.

    Raises:
        RigError: an impossible run, or an end before the last tick.
    """
    return metrics(scenario, signals_without_log(scenario))


def absolute_error(scenario: Scenario, signals: Signals) -> FloatArray:
    """(ticks,), |e| = |r - D*| of the car; nan in an open loop."""

    def part(rows: slice) -> FloatArray:
        some = signals[rows]
        return np.abs(some.reference_mps2 - output_of_car(scenario, some))

    return paged.column(len(signals), part if scenario.design.feedback else _unknown)


def _magnitude(signal: FloatArray) -> FloatArray:
    return paged.column(len(signal), lambda rows: np.abs(signal[rows]))


def _unknown(rows: slice) -> FloatArray:
    return np.full(rows.stop - rows.start, np.nan)


def _noise_rms(scenario: Scenario, signals: Signals, settled: Mask) -> float | None:
    """Rms of the noise in X_diff, N: the run minus the run without noise."""
    if scenario.plant.sensor.noise_mps2 == 0.0 or not settled.any():
        return None
    rows = int(np.flatnonzero(settled)[-1]) + 1
    quiet = noise_free(scenario, signals, rows).force_difference_n
    added = paged.column(len(signals), lambda some: signals.force_difference_n[some] - quiet[some])
    added = added[settled & np.isfinite(added)]
    return float(np.sqrt(np.mean(added**2))) if len(added) else None


def _integral(values: FloatArray, tick_s: float) -> float | None:
    return float(np.nansum(values)) * tick_s if np.isfinite(values).any() else None


def rows(values: Metrics, plant: PlantSettings) -> list[tuple[str, str]]:
    """The closing table, label and text: the metrics with a meaning in this run."""
    signals = names_of(plant)
    names = {key: signal.name for key, signal in signals._asdict().items()}
    output = signals.output.unit
    units = {
        "y": output,
        "y.s": f"{output} s".lstrip(),
        "u1": signals.command_1.unit,
        "u2": signals.command_2.unit,
    }
    faulted = values.get("deviation_peak_after_fault_mps2") is not None
    out: list[tuple[str, str]] = []
    for key, label, healthy_label, unit in _TABLE:
        value = values.get(key)
        text = label if faulted else healthy_label
        if isinstance(value, int | float) and text:
            number = f"{value:.4g} {units.get(unit, unit)}".rstrip()
            out.append((text.format(**names), number))
        elif key == "detection_delay_s" and values.get("missed_detection") is not None:
            out.append((text, "missed" if values["missed_detection"] else "confirmed before it"))
    return out


def peak_of(values: FloatArray, among: Mask | None = None) -> float | None:
    """The largest finite value ``among`` these ticks; None without a finite value."""
    largest = -math.inf
    for rows in paged.blocks(len(values)):
        known = np.isfinite(values[rows])
        if among is not None:
            known &= among[rows]
        largest = float(np.max(values[rows], where=known, initial=largest))
    return largest if math.isfinite(largest) else None


def _end(time_ns: FloatArray, part: Mask, wanted_s: float) -> Mask:
    """The last ``wanted_s`` of a part of the run, at most its second half."""
    if not part.any():
        return part
    first_ns = time_ns[np.argmax(part)]
    last_ns = time_ns[len(part) - 1 - np.argmax(part[::-1])]
    length_ns = min(round(wanted_s * 1e9), int(last_ns - first_ns) // 2)
    end: Mask = part & (time_ns >= last_ns - length_ns)
    return end


#: key, label with a fault, label without (empty: no row), unit
_TABLE = (
    ("error_before_fault_mps2", "|error| before the fault, settled", "|error|, settled", "y"),
    ("error_peak_after_fault_mps2", "|error| after the fault, peak", "", "y"),
    ("error_settled_after_fault_mps2", "|error| after the fault, settled", "", "y"),
    ("deviation_peak_after_fault_mps2", "deviation from the fault-free run, peak", "", "y"),
    ("deviation_over_unavoidable", "    times the least possible", "", "x"),
    ("deviation_peak_uncompensated_mps2", "    without compensation", "", "y"),
    ("error_integral_after_fault_mps", "|error| after the fault, integral", "", "y.s"),
    ("detection_delay_s", "loss confirmed after", "", "s"),
    ("false_alarms_per_hour", "false alarms", "false alarms", "1/h"),
    (
        "fault_estimate_peak_before_fault_mps2",
        "|fault estimate| while healthy, peak",
        "|fault estimate|, peak",
        "y",
    ),
    ("torque_peak_nm", "|{command_1}|, peak", "|{command_1}|, peak", "u1"),
    ("force_difference_peak_n", "|{command_2}|, peak", "|{command_2}|, peak", "u2"),
    (
        "force_difference_noise_rms_n",
        "|{command_2}|, rms from noise",
        "|{command_2}|, rms from noise",
        "u2",
    ),
    ("force_difference_settled_n", "|{command_2}|, settled", "|{command_2}|, settled", "u2"),
    ("dstar_carried_mps2", "|{output}| held by the {command_2} alone", "", "y"),
)


def fault_metrics(scenario: Scenario, signals: Signals) -> list[dict[str, Any]]:
    """A table for each fault, in the order of the scenario; None: the run lacks the moment.

    A deviation is from the same run without this one fault; both runs contain the other faults.
    ``settled`` is the end of the fault's time or of the run, as in ``metrics``.
    """
    return [_of(scenario, signals, at) for at in range(len(scenario.faults))]


def fault_rows(scenario: Scenario, faults: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """Lines of the closing table, label and text: one for each of several faults."""
    if len(faults) < 2:
        return []
    names = names_of(scenario.plant)
    end_s = scenario.ticks * scenario.tick_s
    return [
        (fault_in_words(fault, names, end_s), _said(values, names.output.unit))
        for fault, values in zip(scenario.faults, faults, strict=True)
    ]


def _said(values: dict[str, Any], unit: str) -> str:
    peak, delay_s = values["deviation_peak_mps2"], values["detection_delay_s"]
    parts = [] if peak is None else [f"deviation up to {with_unit(f'{peak:.4g}', unit)}"]
    parts += [] if delay_s is None else [f"confirmed after {delay_s:.4g} s"]
    parts += ["missed"] if values["missed_detection"] else []
    return ", ".join(parts) or "nothing"


def _of(scenario: Scenario, signals: Signals, at: int) -> dict[str, Any]:
    fault = scenario.faults[at]
    alone = replace(scenario, fault=(fault,))
    window = windows(alone, signals)
    values: dict[str, Any] = {
        "kind": fault.kind,
        "place": fault.place,
        "at_s": fault.at_s,
        "for_s": fault.for_s,
    }
    error = deviation = absolute_error(scenario, signals)
    if window.after.any():
        deviation = deviation_from(scenario, signals, without_fault(scenario, at, signals))
    values |= {
        "deviation_peak_mps2": peak_of(deviation, window.after),
        "deviation_settled_mps2": peak_of(deviation, window.settled_after),
        "error_peak_mps2": peak_of(error, window.active),
        "fault_estimate_peak_mps2": peak_of(_magnitude(signals.fault_estimate_mps2), window.active),
    }
    bound = unavoidable_deviation(scenario, signals, fault)
    values["unavoidable_deviation_mps2"] = None if bound is None else bound.deviation_mps2
    return values | detection_of(scenario, signals, at)._asdict()
