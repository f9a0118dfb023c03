"""The whitener's design: spectrum, energy and delay against independent computations."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy import signal

from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.discretisation.whitening import mean_delay, whitening
from tests.firmware.law.cases import CAR

TICK_S = 1e-3
G1 = zoh(CAR.g1, TICK_S)


@given(
    st.floats(1e-4, 1.0), st.floats(0.0, 0.99), st.floats(0.0, 0.1), st.floats(1e-3, 10.0)
)  # fmt: skip
def test_the_spectrum_behind_the_whitener_is_flat(noise, pole, resolution, disturbance):
    """|W|² Φ = S at every frequency, with Φ of the noise, the rounding and the random walk."""
    target = Target(
        TICK_S, noise_rms=noise, noise_pole=pole, resolution=resolution, disturbance=disturbance
    )
    found = whitening(G1, target)
    z = np.exp(1j * np.geomspace(1e-3, math.pi, 50))
    lag = math.exp(-2.0 / mean_delay(G1))
    white = (1.0 - pole**2) * noise**2
    rounding = max(resolution**2 / 12.0, (0.05 * disturbance) ** 2 - white)
    walk = disturbance * math.sqrt(TICK_S) / (z - 1.0) * ((1.0 - lag) / (z - lag)) ** 2
    sensor = noise * math.sqrt(1.0 - pole**2) / (1.0 - pole / z)
    spectrum = abs(walk) ** 2 + abs(sensor) ** 2 + rounding + 1e-18
    flat = abs(found.sections(z)) ** 2 * spectrum / found.variance
    np.testing.assert_allclose(flat, 1.0, rtol=1e-3)


@pytest.mark.parametrize("noise_pole", [0.0, 0.5])
def test_a_disturbance_that_noise_hides_leaves_the_whitener_of_the_noise(noise_pole):
    """Below a hundred-thousandth of the noise's white part in a tick; both sides have its size."""
    least = 1e-5 * 1000.0 * math.sqrt((1.0 - noise_pole**2) / TICK_S)
    noise = {"noise_rms": 1000.0, "noise_pole": noise_pole}
    alone = whitening(G1, Target(TICK_S, **noise))
    hidden = whitening(G1, Target(TICK_S, **noise, disturbance=0.99 * least))
    np.testing.assert_array_equal(hidden.sections.coefficients, alone.sections.coefficients)
    shown = whitening(G1, Target(TICK_S, **noise, disturbance=1.01 * least))
    assert shown.sections.coefficients.size > alone.sections.coefficients.size
    for each in (alone, shown):
        assert each.variance == pytest.approx(1000.0**2 * (1.0 - noise_pole**2), rel=1e-3)


@pytest.mark.parametrize("disturbance", [1e-3, 0.02, 1.0])
def test_a_perfect_sensor_does_not_know_a_disturbed_plant_perfectly(disturbance):
    """The white part of D* has a twentieth of the disturbance at least, by whatever noise."""
    alone = whitening(G1, Target(TICK_S, disturbance=disturbance))
    fine = whitening(G1, Target(TICK_S, disturbance=disturbance, noise_rms=0.01 * disturbance))
    assert alone.variance == pytest.approx(fine.variance)
    assert alone.variance >= (0.05 * disturbance) ** 2
    np.testing.assert_allclose(fine.sections.coefficients, alone.sections.coefficients, rtol=1e-6)


def test_white_noise_needs_no_whitener():
    found = whitening(G1, Target(TICK_S, noise_rms=0.02, resolution=0.3))
    assert found.sections.coefficients.size == 0
    assert found.variance == pytest.approx(0.02**2 + 0.3**2 / 12.0)


def test_coloured_noise_alone_leaves_its_own_white_part():
    found = whitening(G1, Target(TICK_S, noise_rms=0.02, noise_pole=0.7))
    z = np.exp(1j * np.array([0.01, 1.0, 3.0]))
    np.testing.assert_allclose(found.sections(z), 1.0 - 0.7 / z, rtol=1e-9)
    assert found.variance == pytest.approx(0.02**2 * (1.0 - 0.7**2))


def test_the_energy_is_that_of_the_step_response():
    found = whitening(G1, Target(TICK_S, noise_rms=0.02, noise_pole=0.3, disturbance=0.5))
    answer = signal.sosfilt(found.sections.sos, np.ones(300))
    assert found.energy(300) == pytest.approx(float(answer @ answer))
    assert answer[-1] == pytest.approx(0.0, abs=1e-2)  # a steady disturbance leaves nothing


def test_the_delay_is_the_mean_time_of_the_impulse_response():
    pulse = np.zeros(20_000)
    pulse[0] = 1.0
    answer = signal.sosfilt(G1.sos, pulse)
    mean = float(np.arange(len(answer)) @ answer / answer.sum())
    assert mean_delay(G1) == pytest.approx(mean, rel=1e-6)


@pytest.mark.parametrize("row", [[1.0, 0.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.1, 0.0]])
def test_without_a_gain_at_rest_there_is_no_delay(row):
    assert mean_delay(Sections(np.array([row]), TICK_S)) == 0.0
