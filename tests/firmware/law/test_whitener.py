"""The whitener as it runs: scipy's answers, its steady state, sums of signals."""

from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.discretisation.whitening import whitening
from firmware_model.law.structs import zeroed
from firmware_model.law.supervision.whitener import (
    Constants,
    State,
    add_signal,
    settle_whitener,
    whiten,
)
from tests.firmware.law.cases import CAR, TICK_S

DRAWN = np.random.default_rng(3).standard_normal((2, 60))


def constants_of(**noise: float) -> tuple[Any, Any]:
    """The constants of a target's whitener, and scipy's sections of the same filter."""
    sections = whitening(zoh(CAR.g1, TICK_S), Target(TICK_S, noise_rms=0.01, **noise)).sections
    constants: Any = zeroed(Constants, "float64")[0]
    constants.n = len(sections.coefficients)
    constants.coefficients[: constants.n] = sections.coefficients
    return constants, sections.sos


def at_rest() -> Any:
    return zeroed(State, "float64")[0]


@pytest.mark.parametrize("noise", [{"noise_pole": 0.6}, {"noise_pole": 0.6, "disturbance": 0.2}])
def test_the_answers_are_those_of_scipy(noise):
    constants, sos = constants_of(**noise)
    state = at_rest()
    ours = [whiten(constants, state, u) for u in DRAWN[0]]
    np.testing.assert_allclose(ours, signal.sosfilt(sos, DRAWN[0]), atol=1e-12)


@pytest.mark.parametrize(
    "noise", [{}, {"noise_pole": 0.6}, {"noise_pole": 0.6, "disturbance": 0.2}]
)
def test_a_settled_whitener_goes_on_with_the_gain_at_rest(noise):
    constants, sos = constants_of(**noise)
    state = at_rest()
    state.memory[:] = 7.0
    settle_whitener(constants, state, 3.0)
    gain = float(np.prod(sos[:, :3].sum(axis=1) / sos[:, 3:].sum(axis=1)))
    for _ in range(5):
        assert whiten(constants, state, 3.0) == pytest.approx(3.0 * gain, abs=1e-12)


def test_a_section_without_memory_keeps_none():
    constants, _ = constants_of()
    constants.n = 1
    constants.coefficients[0] = 2.0, 0.0, 0.0, 0.0, 0.0
    state = at_rest()
    settle_whitener(constants, state, 3.0)
    assert not state.memory.any()
    assert whiten(constants, state, 3.0) == 6.0


def test_memories_add_up_like_signals():
    """Linear: the memory of u + f v is that of u plus f times that of v."""
    constants, _ = constants_of(noise_pole=0.6, disturbance=0.2)
    own, other, both = at_rest(), at_rest(), at_rest()
    for u, v in DRAWN.T:
        whiten(constants, own, u)
        whiten(constants, other, v)
        whiten(constants, both, u - 2.5 * v)
    add_signal(constants, own, -2.5, other)
    np.testing.assert_allclose(own.memory, both.memory, atol=1e-12)
