"""The results of a run, as the numbers of ``run.json`` and of the closing table.

First the errors and commands of a run; then the detection of a loss, and the least possible
deviation after a loss; last the harm, of the run beside the same run without compensation.

The controller claims that the torque is lost by the fault state CONFIRMED, that the force
difference is lost by its verdict. A claim finds a loss where it begins while a sample can show
this loss. What was claimed before is a false alarm and finds nothing.

The harm compares both runs with an undisturbed run: the same car, drive and noise, without faults,
disturbances and compensation. So the metrics also judge a healthy car, and a car in the wind. All
use D* of the car before its sensor.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from can_rig.assessment.limitations import Unavoidable, can_be_told, control_authority, unavoidable
from can_rig.drawing.names import fault_in_words, metric_in_words, names_of, with_unit
from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.results.counterfactual import (
    deviation_from,
    fault_free,
    noise_free,
    output_of_car,
    signals_without_log,
    uncompensated,
    undisturbed,
    without_fault,
)
from can_rig.results.isolation import NO_FAULT
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of, target
from can_rig.scenario.driving import at_speed_of
from can_rig.scenario.fault_settings import CHANNELS, SENSOR, FaultSettings
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.discretisation.targets import HOUR_S
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray

Metrics = dict[str, float | bool | str | None]
Mask = NDArray[np.bool_]
TORQUE, FORCE = CHANNELS

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
    last_ns, changed_ns = time_ns.max(initial=0.0), 0
    for fault in scenario.faults:
        begin_ns, its_end_ns = fault.span_ns
        its = (time_ns >= begin_ns) & (time_ns < its_end_ns)
        after |= time_ns >= begin_ns
        active |= its
        lost |= its & fault.loses_a_channel
        changed_ns = max([changed_ns, *(ns for ns in fault.span_ns if ns <= last_ns)])
    return Windows(
        before=~after,
        after=after,
        active=active,
        lost=lost,
        settled_before=_end(time_ns, ~after, wanted_s),
        settled_after=_end(time_ns, after & (time_ns >= changed_ns), wanted_s),
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
    loses_torque = window.lost.any() and any(f.place == TORQUE for f in scenario.faults)
    lost_at = at_speed_of(scenario, scenario.loss)
    authority = control_authority(lost_at) if loses_torque else None
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
        **harm_metrics(scenario, signals),
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
    names = names_of(plant)
    own = {key: signal.name for key, signal in names._asdict().items()}
    faulted = values.get("deviation_peak_after_fault_mps2") is not None
    out: list[tuple[str, str]] = []
    for key, label, healthy_label in _TABLE:
        value = values.get(key)
        text = label if faulted else healthy_label
        if isinstance(value, int | float) and text:
            unit = "x" if key.endswith("_over_unavoidable") else metric_in_words(key, names)[1]
            out.append((text.format(**own), with_unit(f"{value:.4g}", unit)))
        elif key == "detection_delay_s" and values.get("missed_detection") is not None:
            found = "compensated without a confirmation"  # as an echo tells
            if values.get("false_alarms") != 0:
                found = "confirmed before it"
            out.append((text, "missed" if values["missed_detection"] else found))
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
    length_ns = round(min(wanted_s * 1e9, int(last_ns - first_ns) // 2))
    end: Mask = part & (time_ns >= last_ns - length_ns)
    return end


#: key, label with a fault, label without (empty: no row)
_TABLE = (
    ("error_before_fault_mps2", "|error| before the fault, settled", "|error|, settled"),
    ("error_peak_after_fault_mps2", "|error| after the fault, peak", ""),
    ("error_settled_after_fault_mps2", "|error| after the fault, settled", ""),
    ("deviation_peak_after_fault_mps2", "deviation from the fault-free run, peak", ""),
    ("deviation_over_unavoidable", "    times the least possible", ""),
    ("deviation_peak_uncompensated_mps2", "    without compensation", ""),
    ("error_integral_after_fault_mps", "|error| after the fault, integral", ""),
    ("detection_delay_s", "loss confirmed after", ""),
    ("false_alarms_per_hour", "false alarms", "false alarms"),
    (
        "fault_estimate_peak_before_fault_mps2",
        "|fault estimate| while healthy, peak",
        "|fault estimate|, peak",
    ),
    ("torque_peak_nm", "|{command_1}|, peak", "|{command_1}|, peak"),
    ("force_difference_peak_n", "|{command_2}|, peak", "|{command_2}|, peak"),
    (
        "force_difference_noise_rms_n",
        "|{command_2}|, rms from noise",
        "|{command_2}|, rms from noise",
    ),
    ("force_difference_settled_n", "|{command_2}|, settled", "|{command_2}|, settled"),
    ("dstar_carried_mps2", "|{output}| held by the {command_2} alone", ""),
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


NOT_THE_TORQUE: Final = (
    Verdict.FORCE_LOST,
    Verdict.SENSOR_WRONG,
    Verdict.SENSOR_DRIFTING,
    Verdict.SENSOR_FROZEN,
)
"""Verdicts that name another place; with them a confirmation finds no loss of the torque."""
COMPENSATED: Final = 0.5
"""Of the rms deviation without compensation: a loss that causes no more is compensated."""


class Detection(NamedTuple):
    """The detection of one loss.

    Attributes:
        suspected_after_s: from the start of the loss to the first suspicion within the loss.
        detection_delay_s: likewise to the confirmation; None for a missed loss.
        missed_detection: None without a loss, and for a loss beyond the best possible test.
    """

    suspected_after_s: float | None = None
    detection_delay_s: float | None = None
    missed_detection: bool | None = None


def unavoidable_deviation(
    scenario: Scenario, signals: Signals, fault: FaultSettings
) -> Unavoidable | None:
    """The deviation that no controller can avoid, with the commands of the log.

    None unless ``fault`` is a dead actuator within the log, and for a loss that never shows.
    """
    lost = _commands_lost(scenario, signals, fault)
    return None if lost is None else unavoidable(at_speed_of(scenario, fault), lost, fault)


def _commands_lost(scenario: Scenario, signals: Signals, fault: FaultSettings) -> FloatArray | None:
    """The commands at a dead actuator from its loss on, zero after its end.

    None for an incomplete log.
    """
    n = scenario.latency_ticks
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    begin, end = fault.span_ticks(scenario.tick_ns)
    at = begin - first
    if fault.kind != "actuator-dead" or fault.every > 1 or at < n:
        return None
    lost = _commands(signals, fault)[at - n :]
    return np.where(np.arange(len(lost)) < end - begin, lost, 0.0)


def decision_metrics(scenario: Scenario, signals: Signals) -> dict[str, float | bool | None]:
    """Delay, false alarms and a missed loss, from the fault state of the status frames.

    With several losses, any missed loss counts, and the longest delay. A false alarm is a
    confirmation that begins while no sample can show a loss of the torque; suspicions are counted
    by the same rule. A controller without a fault state has none of these figures.
    """
    losses = range(len(scenario.faults))
    found = [detection_of(scenario, signals, at) for at in losses]
    missed = {each.missed_detection for each in found} - {None}
    suspected_s = [each.suspected_after_s for each in found if each.suspected_after_s is not None]
    delay_s = [each.detection_delay_s for each in found if each.detection_delay_s is not None]
    lost, shown = (_of_the_torque(scenario, signals, ticks) for ticks in (_there, _shown))
    healthy_s = float((~lost).sum()) * scenario.tick_s
    confirmed, suspected = _claims(signals, TORQUE), _suspicions(signals)
    alarms = int((_begins(confirmed) & ~shown).sum())
    says = _says(scenario, signals.fault_state) and len(signals) > 0
    return {
        "suspected_after_s": max(suspected_s, default=None),
        "detection_delay_s": None if True in missed else max(delay_s, default=None),
        "missed_detection": any(missed) if missed else None,
        "suspicions": int((_begins(suspected) & ~shown).sum()) if says else None,
        "false_alarms": alarms if says else None,
        "false_alarms_per_hour": alarms * HOUR_S / healthy_s if says and healthy_s else None,
        "torque_healthy_s": round(healthy_s, DECIMALS) if len(signals) else None,
    }


def _says(scenario: Scenario, codes: FloatArray | None) -> bool:
    """Whether the controller says these codes; the rig's own law does, perhaps in lost frames."""
    known = codes is not None and bool(np.isfinite(codes).any())
    return known or scenario.controller.is_ours


def _of_the_torque(
    scenario: Scenario, signals: Signals, ticks: Callable[[Scenario, Signals, FaultSettings], Mask]
) -> Mask:
    """(ticks,), the ``ticks`` of any fault of the torque."""
    found = np.zeros(len(signals), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.place == TORQUE:
            found |= ticks(scenario, signals, fault)
    return found


def detection_of(scenario: Scenario, signals: Signals, at: int) -> Detection:
    """The detection of the fault number ``at``.

    A loss is missed unless a confirmation begins in the loss and stands at its end. A compensated
    loss is not missed after a false alarm that still stands, nor if the last verdict names the
    torque: what an echo tells is compensated without a confirmation.

    Raises:
        AssertionError: an impossible delay; the message names the run.
    """
    fault = scenario.faults[at]
    shown = _shown(scenario, signals, fault)
    codes = signals.fault_state if fault.place == TORQUE else signals.verdict
    if not fault.loses_a_channel or not shown.any() or not _says(scenario, codes):
        return Detection()
    said = _claims(signals, fault.place)
    found = _own(said, shown)
    if fault.place == TORQUE and signals.verdict is not None:
        found &= ~_among(_held(signals.verdict), *NOT_THE_TORQUE)
    delay_s = _delay(scenario, signals, fault, found)
    suspected = found
    if fault.place == TORQUE:
        suspected = found | _own(_suspicions(signals), shown)
    suspected_s = _delay(scenario, signals, fault, suspected)
    last = len(shown) - 1 - int(np.argmax(shown[::-1]))
    if said[last] and delay_s is not None:
        return Detection(suspected_s, delay_s, missed_detection=False)
    begun = int(np.flatnonzero(_begins(said)[: last + 1])[-1]) if said[last] else last
    stands = said[last] and not shown[begun]
    if stands and _known_already(scenario, signals, at, begun):
        return Detection()
    known = stands or (fault.place == TORQUE and _names_torque(signals, last))
    if known and _compensated(scenario, signals, _there(scenario, signals, fault)):
        return Detection(suspected_s, None, missed_detection=False)
    return Detection(suspected_s, None, _could_show(scenario, signals, at) or None)


def _held(codes: FloatArray) -> NDArray[np.int16]:
    """``codes`` without gaps: the last known code stays; 0 before the first code."""
    return _last(codes, np.isfinite(codes))


def _last(values: FloatArray | Mask, known: Mask) -> NDArray[np.int16]:
    """The last known value in each tick, in little memory for a long run."""
    held, last = np.zeros(len(values), dtype=np.int16), 0
    for rows in paged.blocks(len(values)):
        places = np.where(known[rows], np.arange(1, rows.stop - rows.start + 1), 0)
        held[rows] = np.append(last, values[rows])[np.maximum.accumulate(places)]
        last = held[rows.stop - 1]
    return held


def _among(codes: NDArray[np.int16], *wanted: int) -> Mask:
    """``np.isin`` without its copy in 64 bits."""
    found = np.zeros(len(codes), dtype=np.bool_)
    for code in wanted:
        found |= codes == code
    return found


def _claims(signals: Signals, place: str) -> Mask:
    """The ticks with a claim that this channel is lost."""
    if place == TORQUE:
        return _among(_held(signals.fault_state), FaultState.CONFIRMED)
    if signals.verdict is None:
        return np.zeros(len(signals), dtype=np.bool_)
    return _among(_held(signals.verdict), Verdict.FORCE_LOST, Verdict.BOTH_LOST)


def _names_torque(signals: Signals, tick: int) -> bool:
    """Whether the verdict of a tick names the torque, as a believed echo does."""
    of_torque = (Verdict.TORQUE_LOST, Verdict.TORQUE_OFFSET, Verdict.BOTH_LOST)
    return signals.verdict is not None and bool(_held(signals.verdict)[tick] in of_torque)


def _suspicions(signals: Signals) -> Mask:
    return _among(_held(signals.fault_state), FaultState.SUSPECTED, FaultState.CONFIRMED)


def _begins(state: Mask) -> Mask:
    begins: Mask = state & ~np.append([False], state[:-1])
    return begins


def _own(said: Mask, shown: Mask) -> Mask:
    """The ticks of a loss with a claim that began in the loss."""
    own: Mask = said & shown & (_last(shown, _begins(said)) != 0)
    return own


def _there(scenario: Scenario, signals: Signals, fault: FaultSettings, late_ns: int = 0) -> Mask:
    """The ticks of a fault, shifted by ``late_ns``."""
    begin_ns, end_ns = fault.span_ns
    there = np.zeros(len(signals), dtype=np.bool_)
    for rows in paged.blocks(len(signals)):
        ticks = np.rint(signals.time_s[rows] / scenario.tick_s).astype(np.int64)
        time_ns = ticks * scenario.tick_ns - late_ns
        there[rows] = (time_ns >= begin_ns) & (time_ns < end_ns)
    return there


def _shown(scenario: Scenario, signals: Signals, fault: FaultSettings) -> Mask:
    """The ticks with a sample of D* that a fault can have changed.

    The sample of a tick precedes the action of the actuators. So the first such tick is one tick
    and the sensor's dead time after the fault; a dead actuator must also have received a command.
    """
    dead_ticks = int(scenario.plant.sensor.dead_time_s / scenario.tick_s + 1e-9)
    late = 1 + dead_ticks
    shown = _there(scenario, signals, fault, late * scenario.tick_ns)
    if fault.kind == "actuator-dead":
        told = np.roll(_commands(signals, fault) != 0.0, late + scenario.latency_ticks)
        told[: late + scenario.latency_ticks] = True  # before the log
        shown &= np.logical_or.accumulate(told & shown)
    return shown


def _commands(signals: Signals, fault: FaultSettings) -> FloatArray:
    return (signals.torque_nm, signals.force_difference_n)[CHANNELS.index(fault.place)]


def _delay(scenario: Scenario, signals: Signals, fault: FaultSettings, found: Mask) -> float | None:
    if not found.any():
        return None
    delay_s = round(float(signals.time_s[np.argmax(found)]) - fault.at_s, 9)
    if delay_s < scenario.tick_s * (1.0 - 1e-6):
        raise AssertionError(
            f"scenario {scenario.name}, seed {scenario.seed}: the loss at {fault.at_s:g} s is said "
            f"to be found after {delay_s:g} s; no sample shows it within {scenario.tick_s:g} s"
        )
    return delay_s


def _known_already(scenario: Scenario, signals: Signals, at: int, begun: int) -> bool:
    """Whether the claim began in another, unfinished fault of the same channel."""
    begin_ns, _ = scenario.faults[at].span_ns
    return any(
        other.place == scenario.faults[at].place
        and other.span_ns[0] <= begin_ns < other.span_ns[1]
        and bool(_shown(scenario, signals, other)[begun])
        for number, other in enumerate(scenario.faults)
        if number != at
    )


def _compensated(scenario: Scenario, signals: Signals, there: Mask) -> bool:
    """Whether compensation keeps D* of the car close to the run without the fault."""
    if not scenario.controller.is_ours:  # no other controller has a switch for its compensation
        return False
    healthy = fault_free(scenario, signals).car_mps2[there]
    with_it, without = (
        float(np.sqrt(np.nanmean((car[there] - healthy) ** 2)))
        for car in (output_of_car(scenario, signals), uncompensated(scenario, signals).car_mps2)
    )
    return with_it <= COMPENSATED * without


def _could_show(scenario: Scenario, signals: Signals, at: int) -> bool:
    """Whether the best test could tell the loss, complete or partial.

    For a dead actuator the missing effect of its commands counts, otherwise the deviation of D*.
    """
    fault = scenario.faults[at]
    if _commands_lost(scenario, signals, fault) is not None:
        return unavoidable_deviation(scenario, signals, fault) is not None
    deviation = deviation_from(scenario, signals, without_fault(scenario, at, signals))
    return can_be_told(scenario, deviation[_there(scenario, signals, fault)])


DRIVER_S: Final = 2.0
"""Time until a surprised driver steers; until then nobody corrects the car's path."""

DECIMALS: Final = 9
"""Of sums over a run; a long run is added up in other parts, with other rounding."""

ACTS: Final = 0.01
"""Of the largest force difference: a smaller command compensates nothing."""

NAMED: Final[dict[Verdict, frozenset[str]]] = {
    Verdict.TORQUE_LOST: frozenset({TORQUE}),
    Verdict.TORQUE_OFFSET: frozenset({TORQUE}),
    Verdict.FORCE_LOST: frozenset({FORCE}),
    Verdict.SENSOR_WRONG: frozenset({SENSOR}),
    Verdict.SENSOR_DRIFTING: frozenset({SENSOR}),
    Verdict.SENSOR_FROZEN: frozenset({SENSOR}),
    Verdict.BOTH_LOST: frozenset({TORQUE, FORCE}),
}
"""The places that a verdict names; ``CANNOT_BE_TOLD`` names no place."""


def harm_metrics(scenario: Scenario, signals: Signals) -> dict[str, float | bool | str | None]:
    """The metrics of the whole run beside the same run without compensation."""
    with_it = without = path = path_without = None
    output = signals.plant.get(TRUE_OUTPUT)
    if output is not None and len(signals):
        goal = undisturbed(scenario, signals).output_mps2
        with_it, path = _away(output, goal, scenario.tick_s)
        if scenario.controller.is_ours:  # no other controller has a switch for its compensation
            other = uncompensated(scenario, signals).output_mps2
            without, path_without = _away(other, goal, scenario.tick_s)
    network = network_of(scenario)
    force, limit_n = signals.force_difference_n, target(scenario, network).limit_2
    works = ~_of_the_torque(scenario, signals, _there)
    acts = works & (np.abs(force) > ACTS * limit_n)
    least = max(network.feedback.lsb, 10.0**-DECIMALS)
    ratio = None if with_it is None or without is None or without < least else with_it / without
    return {
        "deviation_peak_mps2": with_it,
        "deviation_peak_uncompensated_mps2": without,
        "deviation_over_uncompensated": ratio,
        "astray_m": path,
        "astray_uncompensated_m": path_without,
        "torque_rms_nm": _rms(signals.torque_nm),
        "force_difference_unneeded_rms_n": _rms(force, works),
        "force_difference_unneeded_peak_n": peak_of(_magnitude(force), works),
        "compensated_unneeded_s": float(acts.sum()) * scenario.tick_s if len(signals) else None,
        **_placed(scenario, signals),
    }


def _placed(scenario: Scenario, signals: Signals) -> dict[str, bool | str | None]:
    """Where the faults are, the longest verdict since the first fault, and its truth."""
    end_s = signals.time_s[-1] + 1e-9 if len(signals) else 0.0
    begun = [fault for fault in scenario.faults if fault.at_s <= end_s]
    faulty = {fault.place for fault in begun}
    place = " and ".join(sorted(faulty)) or "nothing" if len(signals) else None
    if signals.verdict is None or not len(signals) or not _says(scenario, signals.verdict):
        return {"place": place, "verdict": None, "right_place": None, "wrong_place": None}
    first = min((fault.at_s for fault in begun), default=0.0)
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
