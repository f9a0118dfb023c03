"""P in factors is P: against plain matrices, and where plain matrices fail."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from firmware_model.law.structs import Precision, zeroed
from firmware_model.law.supervision import covariance
from firmware_model.law.supervision.covariance import (
    LOSS_STATES,
    MAX_STATES,
    clear_covariance,
    fade,
    grow,
    measure,
    replace_loss,
    variance_of,
)

Matrix = NDArray[np.float64]
N = MAX_STATES


def matrix(state: Any) -> Matrix:
    """L D Lᵀ, in double."""
    lower = np.tril(state.lower.astype(float), -1) + np.eye(N)
    return lower * state.variances.astype(float) @ lower.T


VARIANCES = np.array([1.0, 2.0, 0.5, 0.0, 0.3, 4.0, 0.7])


def begun(precision: Precision = "float64", variances: Any = VARIANCES) -> Any:
    state = zeroed(covariance.State, precision)[0]
    state.variances[:] = variances
    return state


numbers = st.lists(st.floats(-3.0, 3.0), min_size=N, max_size=N).map(np.array)
parts = st.lists(st.floats(0.0, 1.0), min_size=N, max_size=N).map(np.array)


@pytest.mark.compiled
@given(measurements=st.lists(numbers, max_size=8))
def test_a_variance_is_on_the_diagonal(measurements):
    state = begun()
    for x in measurements:
        measure(state, N, x, 0.5, np.zeros(N))
    variances = [variance_of(state, i) for i in range(N)]
    np.testing.assert_allclose(variances, matrix(state).diagonal(), atol=1e-12)


@given(measurements=st.lists(numbers, min_size=1, max_size=8), noise=st.floats(1e-3, 10.0))
def test_a_measurement_is_that_of_full_matrices(measurements, noise):
    """S, K and P of Joseph's form (I - K xᵀ) P (I - K xᵀ)ᵀ + K Kᵀ noise."""
    state, gain = begun(), np.zeros(N)
    p = np.diag(VARIANCES)
    for x in measurements:
        variance = measure(state, N, x, noise, gain)
        s = x @ p @ x + noise
        k = p @ x / s
        left = np.eye(N) - np.outer(k, x)
        p = left @ p @ left.T + noise * np.outer(k, k)
        assert variance == pytest.approx(s, rel=1e-9)
        np.testing.assert_allclose(gain, k, atol=1e-9)
        np.testing.assert_allclose(matrix(state), p, atol=1e-9)


@given(x=numbers, memory=parts.map(lambda part: 0.01 + 0.99 * part), added=parts)
def test_what_fades_and_what_is_added_is_that_of_full_matrices(x, memory, added):
    state = begun()
    measure(state, N, x, 0.1, np.zeros(N))
    before = matrix(state)
    fade(state, N, memory)
    faded = before * np.outer(memory, memory)
    np.testing.assert_allclose(matrix(state), faded, atol=1e-12)
    for i in range(N):
        grow(state, N, i, added[i])
    np.testing.assert_allclose(matrix(state), faded + np.diag(added), atol=1e-12)


@given(measurements=st.lists(numbers, min_size=1, max_size=8),
       share=st.floats(0.0, 4.0), moment=st.floats(0.0, 4.0))  # fmt: skip
def test_new_states_of_a_loss_know_nothing_of_each_other_and_the_rest(measurements, share, moment):
    """The covariances of the rest stay."""
    state = begun()
    for x in measurements:
        measure(state, N, x, 0.1, np.zeros(N))
    expected = matrix(state)
    expected[:LOSS_STATES, :] = expected[:, :LOSS_STATES] = 0.0
    expected[0, 0], expected[1, 1] = share, moment
    replace_loss(state, N, share, moment)
    np.testing.assert_allclose(matrix(state), expected, atol=1e-12)


def test_what_is_cleared_is_zero():
    state = begun()
    measure(state, N, np.arange(1.0, 1.0 + N), 0.1, np.zeros(N))
    assert np.tril(matrix(state), -1).any()
    clear_covariance(state)
    assert not state.lower.any()  # which would be seen once the variances grow again
    assert not state.variances.any()


@pytest.mark.compiled
@pytest.mark.parametrize("precision", ["float64", "float32"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), noise=st.sampled_from([1e-18, 1e-6, 1e-2]),
       size=st.sampled_from([1e-2, 1.0, 1e2]), grows=st.sampled_from([0.0, 1e-6]))  # fmt: skip
def test_it_stays_positive_semidefinite_and_the_innovation_s_variance_above_its_noise(
    seed, noise, size, grows, precision
):
    """Where the same x is measured again and again, which leaves P itself indefinite."""
    draw, state = np.random.default_rng(seed), begun(precision, 0.36)
    x = (size * draw.standard_normal(N)).astype(precision)
    gain = np.zeros(N, precision)
    for _ in range(300):
        x *= (1.0 + 1e-3 * draw.standard_normal(N)).astype(precision)
        variance = measure(state, N, x, state.variances.dtype.type(noise), gain)
        assert variance >= np.dtype(precision).type(noise)
        for i in range(N):
            grow(state, N, i, state.variances.dtype.type(grows))
        p = matrix(state)
        assert np.isfinite(p).all()
        assert (state.variances >= 0.0).all()
        assert np.linalg.eigvalsh(p).min() >= -1e-14 * np.abs(p).max()
