"""What the decision on the fault estimate made of a loss, and what nothing could avoid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from can_rig.assessment.resolve import load
from can_rig.results.metrics import metrics
from can_rig.scenario.settings import Scenario
from firmware_model.design.plants import steer_by_wire
from tests.rig.results.quiet import quiet

LSB_MPS2 = 1e-8


CLEAR, SUSPECTED, CONFIRMED, CANNOT_TELL = 0.0, 1.0, 2.0, 3.0


def states(scenario: Scenario, *changes: tuple[int, float]) -> np.ndarray:
    """The fault state of every tick: CLEAR, and from each tick named what it changes to."""
    state = np.full(scenario.ticks, CLEAR)
    for tick, value in changes:
        state[tick:] = value
    return state


def test_the_decision_is_what_the_status_frames_say() -> None:
    scenario = load("thesis-step", ["duration_s=3.6", "fault.at_s=1.0", "fault.for_s=1.0"])
    state = states(
        scenario,
        (100, CONFIRMED),  # a false alarm before the loss detects nothing
        (200, CLEAR),
        (300, SUSPECTED),  # is none
        (301, CLEAR),
        (1100, SUSPECTED),
        (1234, CONFIRMED),  # stays so after the channel has come back: no other alarm
        (2500, CLEAR),
        (2600, CONFIRMED),  # another one
    )
    values = metrics(scenario, quiet(scenario, fault_state=state))
    assert values["suspected_after_s"] == 0.1
    assert values["detection_delay_s"] == 0.234
    assert values["missed_detection"] is False
    assert values["false_alarms"] == 2
    assert values["false_alarms_per_hour"] == pytest.approx(2 * 3600.0 / 2.6)


def test_a_loss_that_is_never_confirmed_is_missed_unless_it_could_not_show() -> None:
    scenario = load("thesis-step", ["duration_s=2.0", "fault.at_s=1.0"])
    for state, missed in ((SUSPECTED, True), (CLEAR, True), (CANNOT_TELL, None)):
        signals = quiet(scenario, fault_state=states(scenario, (0, state)))
        values = metrics(scenario, signals)
        assert values["missed_detection"] is missed
        assert values["detection_delay_s"] is None
    nothing_lost = metrics(scenario.healthy, quiet(scenario))
    assert nothing_lost["missed_detection"] is None
    assert nothing_lost["false_alarms_per_hour"] == 0.0


@pytest.mark.parametrize("latency", [0, 1, 2, 5])
@pytest.mark.parametrize("left", [0.0, 0.4])
def test_unavoidable_is_what_a_loss_does_before_anything_can_answer(
    latency: int, left: float
) -> None:
    """A step of the torque, missing in part for n + 1 ticks: scipy's step response of G1."""
    settings = [f"latency_ticks={latency}", f"fault.left={left}", "duration_s=11.0"]
    scenario = load("thesis-step", [*settings, "design.tau_s=0.02", "design.tau_q_s=0.02"])
    torque = 40.0
    signals = quiet(scenario, torque_nm=np.full(scenario.ticks, torque))
    g1 = steer_by_wire().g1
    times = np.linspace(0.0, (latency + 1) * scenario.tick_s, 2001)
    _, step = signal.step(signal.ZerosPolesGain(g1.zeros, g1.poles, g1.gain), T=times)
    found = metrics(scenario, signals)["unavoidable_deviation_mps2"]
    assert found == pytest.approx((1.0 - left) * torque * step[-1], rel=1e-6)
    # MATHS, trap 11
    short = 0.5 * g1.gain * torque * ((latency + 1) * scenario.tick_s) ** 2
    assert found == pytest.approx((1.0 - left) * short, rel=0.05)


def test_there_is_nothing_unavoidable_where_no_actuator_dies_in_the_log() -> None:
    for settings in (["fault.kind=none"], ["fault.kind=frames-missing"], ["duration_s=2.0"]):
        scenario = load("thesis-step", ["tick_s=0.01", *settings])
        assert metrics(scenario, quiet(scenario))["unavoidable_deviation_mps2"] is None
