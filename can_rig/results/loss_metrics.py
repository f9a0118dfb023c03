"""What a loss could do to D* at least, and what the decision on d̂ made of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from can_rig.assessment.unavoidable import Unavoidable, unavoidable
from can_rig.results.signals import Signals
from can_rig.scenario.driving.schedule import at_speed_of
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.fault import CHANNELS, FaultSettings
from firmware_model.discretisation.targets import HOUR_S
from firmware_model.target.status import FaultState
from firmware_model.target.structs import FloatArray

Mask = NDArray[np.bool_]


def unavoidable_deviation(
    scenario: Scenario, signals: Signals, fault: FaultSettings
) -> Unavoidable | None:
    """What no controller can avoid, with the commands of the log.

    None where ``fault`` is no actuator that dies in the log, and where its loss never shows.
    """
    n = scenario.latency_ticks
    lost = round(fault.at_s / scenario.tick_s)
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    at = lost - first
    if fault.kind != "actuator-dead" or fault.every > 1 or not n <= at < len(signals):
        return None
    command = (signals.torque_nm, signals.force_difference_n)[CHANNELS.index(fault.place)]
    return unavoidable(at_speed_of(scenario, fault), command[at - n :], fault)


def decision_metrics(
    scenario: Scenario, signals: Signals, lost: Mask
) -> dict[str, float | bool | None]:
    """Delay, false alarms and a missed loss, from the fault state of the status frames.

    A loss is missed if it is never confirmed; None where it could not show: the torque did so
    little all the time that the firmware itself says CANNOT_TELL, or X_diff is what was lost and
    was zero all that time. None as well where there was no loss. A false alarm is a confirmation
    while nothing is lost, and so is a suspicion that is counted.
    """
    state = signals.fault_state
    confirmed = state == FaultState.CONFIRMED
    suspected = confirmed | (state == FaultState.SUSPECTED)
    alarms = _begun(confirmed & ~lost, confirmed)
    healthy_h = float((~lost).sum()) * scenario.tick_s / HOUR_S
    known = lost & np.isfinite(state)
    told = bool((state[known] != FaultState.CANNOT_TELL).any()) and _acted(scenario, signals, lost)
    return {
        "suspected_after_s": _delay(scenario, signals.time_s[suspected & lost]),
        "detection_delay_s": _delay(scenario, signals.time_s[confirmed & lost]),
        "missed_detection": not bool(confirmed[lost].any()) if told else None,
        "suspicions": _begun(suspected & ~lost, suspected) if len(signals) else None,
        "false_alarms": alarms if len(signals) else None,
        "false_alarms_per_hour": alarms / healthy_h if healthy_h > 0.0 else None,
    }


def _begun(wanted: Mask, state: Mask) -> int:
    """How often ``state`` begins at a tick that is ``wanted``."""
    return int((wanted & ~np.concatenate([[False], state[:-1]])).sum())


def _acted(scenario: Scenario, signals: Signals, lost: Mask) -> bool:
    """Whether the lost channel had something to do; the torque always may have.

    Of an actuator the log has it, late by the latency; of lost frames it has the last one before.
    """
    losses = [fault for fault in scenario.faults if fault.loses_a_channel]
    if any(fault.place == CHANNELS[0] for fault in losses):
        return True
    before = 1 if losses[0].acts_on_frames else scenario.latency_ticks
    ticks = np.flatnonzero(lost)
    acting = signals.force_difference_n[max(ticks[0] - before, 0) : ticks[-1] + 1]
    return bool(np.nan_to_num(acting).any())


def _delay(scenario: Scenario, times_s: FloatArray) -> float | None:
    """From the first loss on."""
    if not len(times_s):
        return None
    first_s = min(fault.at_s for fault in scenario.faults if fault.loses_a_channel)
    return round(float(times_s[0]) - first_s, 9)
