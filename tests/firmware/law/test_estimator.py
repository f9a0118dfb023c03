"""The model of the plant on the target: each command when the plant gets it, by scipy's filters."""

from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import tustin
from firmware_model.law.controller import init
from firmware_model.law.core.estimator import advance_model, model_output
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.steady_state import settle_estimator

CAR, TICK_S, TICKS = steer_by_wire(), 1e-3, 60
MODELS = tustin(CAR.g1, TICK_S).sos, tustin(CAR.g2, TICK_S).sos
COMMANDS = np.random.default_rng(7).standard_normal((2, TICKS))
LATENCIES = (0, 1, 3, 64)


def made(latency: int) -> tuple[Any, Any]:
    """Constants, and a state at rest."""
    q = ZeroPoleGain((0.0,), (-20.0,), -1.0)  # 1 + Q is a lag, which has a memory
    specification = DesignSpecification(compensation=False, q=q)
    table = build(design(CAR, specification), Target(TICK_S, latency))
    return table.estimator, init(table)[0].estimator


def run(constants: Any, state: Any, commands: FloatArray) -> FloatArray:
    """The outputs of both models, (2, ticks)."""
    outputs = []
    for one, two in commands.T:
        outputs.append(model_output(constants, state, one, two))
        advance_model(constants, state, one, two)
    return np.array(outputs).T


def delayed(commands: FloatArray, latency: int, before: float = 0.0) -> FloatArray:
    """What acts: the commands that many ticks later."""
    return np.hstack([np.full((2, latency), before), commands])[:, : commands.shape[1]]


def answers(commands: FloatArray) -> FloatArray:
    """Of both continuous models by Tustin's rule, from rest."""
    return np.array([signal.sosfilt(m, u) for m, u in zip(MODELS, commands, strict=True)])


@pytest.mark.parametrize("latency", LATENCIES)
def test_each_channel_is_its_model_of_the_commands_when_they_act(latency):
    constants, state = made(latency)
    outputs = run(constants, state, COMMANDS)
    expected = answers(delayed(COMMANDS, latency))
    np.testing.assert_allclose(outputs, expected, rtol=1e-9, atol=1e-15)
    assert (state.showing_1, state.showing_2) == tuple(delayed(COMMANDS, latency)[:, -1])


@pytest.mark.parametrize("latency", LATENCIES)
def test_a_settled_model_stays_until_new_commands_act(latency):
    """Wherever the ring was, and whatever was on its way in it."""
    constants, state = made(latency)
    run(constants, state, COMMANDS[:, :5])
    settle_estimator(constants, state, 4.0, -2.5, 0.0)
    assert (state.showing_1, state.showing_2) == (4.0, -2.5)
    settled = np.array([4.0 * CAR.g1.dc_gain, -2.5 * CAR.g2.dc_gain])
    outputs = run(constants, state, COMMANDS + np.array([[4.0], [-2.5]]))
    expected = settled[:, None] + answers(delayed(COMMANDS, latency))
    np.testing.assert_allclose(outputs, expected, rtol=1e-9)
