"""The least deviation that a loss can cause, by closed forms and a sum of its own."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import toeplitz

from can_rig.assessment.limitations import unavoidable
from can_rig.assessment.resolve import load
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

STEADY_NM = 42.5  # for 1 m/s², docs/design.md


def acceleration_per_nm(scenario: Scenario) -> float:
    """D̈* that a torque of 1 N m causes at once, m/s⁴: C A B of a channel of relative degree 2."""
    plant = continuous_plant(scenario.plant)
    assert float(np.abs(plant.c @ plant.b[:, 0]).max()) == pytest.approx(0.0, abs=1e-12)
    return (plant.c @ plant.a @ plant.b[:, 0]).item()


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("left", [0.0, 0.5])
def test_without_noise_it_is_what_the_loss_does_until_the_next_command_acts(
    latency: int, left: float
) -> None:
    """One tick to show and ``latency`` more to act: a constant acceleration from rest."""
    scenario = load("ideal", [f"latency_ticks={latency}", f"fault.left={left}"])
    found = unavoidable(scenario, np.full(50, STEADY_NM))
    assert found is not None
    assert found.detection_ticks == 1
    acts_s = (latency + 1) * 1e-3
    expected = 0.5 * acceleration_per_nm(scenario) * (1.0 - left) * STEADY_NM * acts_s**2
    assert found.deviation_mps2 == pytest.approx(expected, rel=0.05)


def responses(scenario: Scenario, command: float, ticks: int) -> FloatArray:
    """Step response of G1 times ``command``, by its residues: no state and no sampling."""
    plant = continuous_plant(scenario.plant)
    poles, vectors = np.linalg.eig(plant.a)
    weights = (plant.c @ vectors).ravel() * np.linalg.solve(vectors, plant.b[:, 0])
    times = scenario.tick_s * np.arange(1, ticks + 1)
    return np.real(np.expm1(np.outer(times, poles)) @ (weights / poles)) * command


@pytest.mark.parametrize("noise", [0.001, 0.005, 0.05])
def test_with_noise_the_loss_shows_when_its_evidence_is_that_of_the_allowed_alarms(
    noise: float,
) -> None:
    scenario = load("ideal", [f"plant.sensor.noise_mps2={noise}", "latency_ticks=2"])
    found = unavoidable(scenario, np.full(1000, STEADY_NM))
    assert found is not None
    deviation = responses(scenario, STEADY_NM, 1000)
    evidence = np.cumsum(deviation**2) / (2.0 * noise**2)
    allowed = math.log(3600.0 / (1e-3 * scenario.budget.false_alarms_per_hour))
    ticks = int(np.argmax(evidence > allowed)) + 1
    assert found.detection_ticks == ticks > 5
    assert found.deviation_mps2 == pytest.approx(abs(deviation[ticks + 1]), rel=1e-9)


def test_more_noise_fewer_alarms_and_a_smaller_loss_take_longer() -> None:
    def ticks(*settings: str) -> int:
        scenario = load("ideal", ["plant.sensor.noise_mps2=0.005", *settings])
        found = unavoidable(scenario, np.full(2000, STEADY_NM))
        assert found is not None
        return found.detection_ticks

    usual = ticks()
    assert ticks("plant.sensor.noise_mps2=0.02") > usual
    assert ticks("budget.false_alarms_per_hour=1e-9") > usual
    assert ticks("fault.left=0.5") > usual
    assert ticks("plant.sensor.resolution_mps2=0.05") > usual


def test_coloured_noise_is_weighed_by_its_covariance() -> None:
    """δᵀ R⁻¹ δ / 2 with all of R, from long before the loss; no whitening filter."""
    noise, corner_hz, before = 0.005, 200.0, 100
    scenario = load(
        "ideal", [f"plant.sensor.noise_mps2={noise}", f"model.sensor.corner_hz={corner_hz}"]
    )
    found = unavoidable(scenario, np.full(1000, STEADY_NM))
    white = unavoidable(
        load("ideal", [f"plant.sensor.noise_mps2={noise}"]), np.full(1000, STEADY_NM)
    )
    assert found is not None
    assert white is not None
    colour = math.exp(-2.0 * math.pi * corner_hz * 1e-3)
    allowed = math.log(3600.0 / (1e-3 * scenario.budget.false_alarms_per_hour))
    evidence = 0.0
    ticks = 0
    while evidence <= allowed:
        ticks += 1
        signal = np.concatenate([np.zeros(before), responses(scenario, STEADY_NM, ticks)])
        covariance = noise**2 * toeplitz(colour ** np.arange(len(signal)))
        evidence = 0.5 * float(signal @ np.linalg.solve(covariance, signal))
    assert found.detection_ticks == ticks > white.detection_ticks


def test_a_dead_time_of_the_actuator_delays_the_loss_as_well() -> None:
    immediate, late = (
        unavoidable(
            load("ideal", [f"plant.torque_actuator.dead_time_s={dead_time_s}"]),
            np.full(50, STEADY_NM),
        )
        for dead_time_s in (0.0, 0.003)
    )
    assert immediate == late


def test_a_loss_that_does_nothing_never_shows() -> None:
    noisy = load("ideal", ["plant.sensor.noise_mps2=0.005"])
    assert unavoidable(noisy, np.zeros(1000)) is None
    assert unavoidable(noisy, np.full(3, STEADY_NM)) is None  # too short to decide
