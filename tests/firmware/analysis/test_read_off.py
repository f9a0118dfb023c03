"""The matrices of a controller, read off its answers to impulses."""

import numpy as np
import pytest

from firmware_model.analysis.read_off import NotLinearError, read_off
from firmware_model.law.structs import FloatArray

A = np.array([[0.9, 0.1], [0.0, 0.5]])
B = np.array([[1.0, 0.3], [0.0, 2.0]])
C = np.array([[1.0, 0.0], [0.2, -1.0], [0.0, 3.0]])
D = np.array([[0.0, 0.4], [1.0, 0.0], [0.0, 0.0]])


def linear(inputs: FloatArray) -> FloatArray:
    x, answers = np.zeros(2), np.empty((len(inputs), 3))
    for k, w in enumerate(inputs):
        answers[k] = C @ x + D @ w
        x = A @ x + B @ w
    return answers


def test_a_linear_controller_is_found_up_to_the_choice_of_its_states():
    found = read_off(linear, 3)
    assert found.latency_ticks == 3
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(found.a)), [0.5, 0.9], rtol=1e-6)
    for z in (1.0, -1.0, 1j):
        expected = C @ np.linalg.solve(z * np.eye(2) - A, B) + D
        ours = found.c @ np.linalg.solve(z * np.eye(len(found.a)) - found.a, found.b) + found.d
        np.testing.assert_allclose(ours, expected, rtol=1e-6, atol=1e-9)


def test_a_controller_that_never_answers_has_no_state():
    found = read_off(lambda inputs: np.zeros((len(inputs), 3)), 0)
    assert found.a.shape == (0, 0)
    assert not found.d.any()


def test_a_limit_is_no_linear_controller():
    with pytest.raises(NotLinearError, match="not linear: off by"):
        read_off(lambda inputs: np.clip(linear(inputs), -2e-6, 2e-6), 0)


def test_a_controller_that_is_hardly_linear_is_off_by_a_figure_above_zero():
    """The largest answer is 0.02 % too large."""

    def clipped(inputs: FloatArray) -> FloatArray:
        answers = linear(inputs)
        if inputs[1:].any():  # not an impulse
            answers[:, 0][np.argmax(np.abs(answers[:, 0]))] *= 1.0002
        return answers

    with pytest.raises(NotLinearError, match=r"off by 0\.02%$"):
        read_off(clipped, 0)


@pytest.mark.filterwarnings("error")
def test_matrices_that_explode_are_off_by_more_than_all_of_the_answers():
    """Powers of an unstable matrix overflow; their dozens of digits say nothing."""

    def echoes(inputs: FloatArray) -> FloatArray:
        answers = np.zeros((len(inputs), 3))
        for tick, gain in ((1, 1.0), (17, 1e9), (33, 1e18)):
            answers[tick] = gain * inputs[0].sum()
        return answers

    with pytest.raises(NotLinearError, match=r"off by more than 100%$"):
        read_off(echoes, 0)
