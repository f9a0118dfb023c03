"""The least possible deviation after a loss, and the detection of the loss.

The controller claims that the torque is lost by the fault state CONFIRMED, that the force
difference is lost by its verdict. A claim finds a loss where it begins while a sample can show
this loss. What was claimed before is a false alarm and finds nothing.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from can_rig.assessment.limitations import Unavoidable, can_be_told, unavoidable
from can_rig.results.counterfactual import (
    deviation_from,
    fault_free,
    output_of_car,
    uncompensated,
    without_fault,
)
from can_rig.results.signals import Signals
from can_rig.scenario.driving import at_speed_of
from can_rig.scenario.fault_settings import CHANNELS, FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.discretisation.targets import HOUR_S
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray

Mask = NDArray[np.bool_]

TORQUE, FORCE = CHANNELS
NOT_THE_TORQUE: Final = (
    Verdict.FORCE_LOST,
    Verdict.SENSOR_BIASED,
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
    """The commands at a dead actuator from its loss on; None for an incomplete log."""
    n = scenario.latency_ticks
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    at = -(-fault.span_ns[0] // scenario.tick_ns) - first
    if fault.kind != "actuator-dead" or fault.every > 1 or at < n:
        return None
    return _commands(signals, fault)[at - n :]


def decision_metrics(scenario: Scenario, signals: Signals) -> dict[str, float | bool | None]:
    """Delay, false alarms and a missed loss, from the fault state of the status frames.

    With several losses, any missed loss counts, and the longest delay. A false alarm is a
    confirmation that begins while no sample can show a loss of the torque; suspicions are counted
    by the same rule.
    """
    losses = range(len(scenario.faults))
    found = [detection_of(scenario, signals, at) for at in losses]
    missed = {each.missed_detection for each in found} - {None}
    suspected_s = [each.suspected_after_s for each in found if each.suspected_after_s is not None]
    delay_s = [each.detection_delay_s for each in found if each.detection_delay_s is not None]
    lost, shown = torque_lost(scenario, signals), np.zeros(len(signals), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.loses_a_channel and fault.place == TORQUE:
            shown |= _shown(scenario, signals, fault)
    healthy_h = float((~lost).sum()) * scenario.tick_s / HOUR_S
    confirmed, suspected = _claims(signals, TORQUE), _suspicions(signals)
    alarms = int((_begins(confirmed) & ~shown).sum())
    return {
        "suspected_after_s": max(suspected_s, default=None),
        "detection_delay_s": None if True in missed else max(delay_s, default=None),
        "missed_detection": any(missed) if missed else None,
        "suspicions": int((_begins(suspected) & ~shown).sum()) if len(signals) else None,
        "false_alarms": alarms if len(signals) else None,
        "false_alarms_per_hour": alarms / healthy_h if healthy_h > 0.0 else None,
    }


def torque_lost(scenario: Scenario, signals: Signals) -> Mask:
    """(ticks,), whether a fault of the torque exists."""
    lost = np.zeros(len(signals), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.loses_a_channel and fault.place == TORQUE:
            lost |= _there(scenario, signals, fault)
    return lost


def detection_of(scenario: Scenario, signals: Signals, at: int) -> Detection:
    """The detection of the fault number ``at``.

    A loss is missed unless a confirmation begins in the loss and stands at its end. After a false
    alarm that still stands, a compensated loss is not missed.

    Raises:
        AssertionError: an impossible delay; the message names the run.
    """
    fault = scenario.faults[at]
    shown = _shown(scenario, signals, fault)
    if not fault.loses_a_channel or not shown.any():
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
    if said[last] and not shown[begun]:
        if _known_already(scenario, signals, at, begun):
            return Detection()
        if _compensated(scenario, signals, _there(scenario, signals, fault)):
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
        other.loses_a_channel
        and other.place == scenario.faults[at].place
        and other.span_ns[0] <= begin_ns < other.span_ns[1]
        and bool(_shown(scenario, signals, other)[begun])
        for number, other in enumerate(scenario.faults)
        if number != at
    )


def _compensated(scenario: Scenario, signals: Signals, there: Mask) -> bool:
    """Whether compensation keeps D* of the car close to the run without the fault."""
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
