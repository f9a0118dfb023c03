"""What a tick, a hold, a safe stop and a reset leave behind, in a few ticks each."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import chapter_2
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.filters.biquad import advance, at_rest
from firmware_model.law.filters.estimator import model_output
from firmware_model.law.status import FaultState, Mode, Verdict
from tests.firmware.discretisation.test_coprime import PENDULUM
from tests.firmware.law.cases import DESIGN, NEVER, TICK_S, changed

UNSTABLE = design(PENDULUM, DesignSpecification(tau_s=0.005, alpha=2, tau_q_s=0.05, alpha_q=3))
OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))


def table_of(latency: int = 1, of: Any = DESIGN, **target: Any) -> Any:
    return build(of, Target(TICK_S, latency, "zoh", **target))


def driven(cascade: Any, inputs: list[float]) -> Any:
    """The state of a filter after these inputs."""
    state = at_rest()
    for u in inputs:
        advance(cascade, state, u)
    return state


def test_a_controller_is_one_where_no_more_are_asked_for() -> None:
    assert len(controller.init(table_of())) == 1
    assert len(controller.init(table_of(), 3)) == 3


def test_in_a_safe_stop_f1_follows_what_the_actuators_still_do() -> None:
    table = table_of(0, safe_stop_s=4 * TICK_S)
    state = controller.init(table)[0]
    state.command_1 = 8.0
    state.hypotheses.verdict = Verdict.BOTH_LOST
    state.monitor.powerless = table.safe_stop.certain
    for _ in range(4):
        controller.step(table, state, 1.0, 0.3)
    assert state.mode == Mode.SAFE_STOP
    expected = driven(table.estimator.channel_1, [6.0, 4.0, 2.0, 0.0])
    np.testing.assert_allclose(state.estimator.channel_1.accumulators, expected.accumulators)


def test_the_signatures_go_on_in_every_tick() -> None:
    """Of a torque that is off by 1 N m, and a drift of 1 m/s² a tick, since the start."""
    table = table_of()
    state = controller.init(table)[0]
    for _ in range(5):
        controller.step(table, state, 0.0, 0.0)
    own = state.hypotheses.signatures
    expected = driven(table.estimator.channel_1, [-1.0] * 5)
    np.testing.assert_allclose(own.torque_offset.answer.accumulators, expected.accumulators)
    assert own.ramp == -5.0


def test_what_an_unstable_plants_sensor_adds_goes_on_through_m() -> None:
    table = changed(table_of(of=UNSTABLE), decision=NEVER)[0]
    state = controller.init(table)[0]
    state.hypotheses.sensor_error.offset = 0.1
    for _ in range(5):
        controller.step(table, state, 0.0, 0.0)
    expected = driven(table.estimator.measurement, [0.1] * 5)
    answer = state.hypotheses.sensor_error.answer
    np.testing.assert_allclose(answer.accumulators, expected.accumulators)


@pytest.mark.parametrize("reference", [1.0, math.nan])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_an_unstable_plant_is_expected_where_what_is_not_lost_takes_it(
    share: float, reference: float
) -> None:
    """M y = N1 u1 + N2 u2 - s w, at which d̂ is the known loss."""
    table = table_of(0, of=UNSTABLE)
    state = controller.init(table)[0]
    state.command_1, state.command_2 = 5.0, 300.0
    state.fault_state = FaultState.CONFIRMED if share else FaultState.CLEAR
    state.loss_model.share = share
    before = at_rest()
    for _ in range(3):
        model_1, model_2 = model_output(table.estimator, state.estimator, 0.0, 0.0)
        before.accumulators[:] = state.estimator.measurement.accumulators
        controller.step(table, state, reference, math.nan)
        shown = advance(table.estimator.measurement, before, state.estimator.measured)
        # all of channel 1 has been lost from the start, so w is N1 u1
        assert shown == pytest.approx(model_1 + model_2 - share * model_1, rel=1e-9)
    assert model_1 != 0.0


def test_a_reset_knows_what_both_channels_add() -> None:
    """In the open loop both have a part of the reference."""
    table = table_of(0, of=OPEN_LOOP)
    state = controller.init(table)[0]
    controller.reset(table, state, 2.0)
    both = 2.0 * (chapter_2().g1.dc_gain + chapter_2().g2.dc_gain)
    assert state.mismatch.previous_model_output == pytest.approx(both, rel=1e-9)
