"""What other plants show where the model is not stable: each explains its own output."""

import math

import numpy as np
import pytest
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import STEP, Channels, Mismatch
from firmware_model.design.plants import Plant
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.coprime import sampled_factors, sampled_over
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.core.biquad import advance, at_rest
from firmware_model.law.core.estimator import model_output
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray
from tests.firmware.discretisation.test_coprime import (
    PENDULUM,
    SATELLITE,
    SWINGING,
    TICK_S,
    WEAVING,
)
from tests.firmware.law.cases import NEVER, changed

SPECIFICATION = DesignSpecification(tau_s=0.005, alpha=2, tau_q_s=0.05, alpha_q=3)
PLANTS = [PENDULUM, WEAVING, SATELLITE, SWINGING]
TICKS = 160


def other(plant: Plant, gain_1: float, gain_2: float, speed: float) -> Channels:
    first, second = (
        ZeroPoleGain(
            tuple(speed * zero for zero in g.zeros),
            tuple(speed * pole for pole in g.poles),
            gain * g.gain * speed**g.relative_degree,
        )
        for g, gain in ((plant.g1, gain_1), (plant.g2, gain_2))
    )
    return first, second


def drive(
    model: Plant, cars: tuple[Channels, ...], plant: Plant, missing: range
) -> tuple[FloatArray, FloatArray]:
    """d̂, u1, u2, y (4, ticks) and x (cars, ticks) of ``plant`` under ``model``'s controller."""
    target = Target(TICK_S, estimator="zoh", noise_rms=0.01, mismatch=Mismatch(cars))
    table = changed(build(design(model, SPECIFICATION), target), decision=NEVER)[0]
    state, held, x = controller.init(table)[0], sample(plant, TICK_S), np.zeros(len(plant.a))
    signals, shown = [], []
    for k in range(TICKS):
        y = float(held.c @ x)
        controller.step(table, state, math.sin(0.05 * k), math.nan if k in missing else y)
        commands = float(state.command_1), float(state.command_2)
        signals.append((float(state.fault_estimate), *commands, y))
        shown.append(state.supervision.other_cars.shown[: len(cars)].copy())
        x = held.phi @ x + held.gamma @ commands
    return np.array(signals).T, np.array(shown).T


@pytest.mark.compiled
@pytest.mark.parametrize("differs", [(1.03, 0.97, 1.0), (1.02, 1.01, 1.04)])
@pytest.mark.parametrize("model", PLANTS, ids=lambda plant: plant.name)
def test_a_plant_that_is_one_of_them_shows_what_is_expected_of_it(model, differs):
    """M_i y = N1_i u1 + N2_i u2, so d̂ is -x_i, of the first tick on."""
    car = other(model, *differs)
    plant = Plant.from_transfer_functions("other", *car)
    (estimate, *_), shown = drive(model, (car,), plant, range(0))
    assert np.abs(estimate).max() > 1e-4
    np.testing.assert_allclose(STEP * shown[0], -estimate, atol=1e-8 * np.abs(estimate).max())


@pytest.mark.parametrize("model", PLANTS, ids=lambda plant: plant.name)
def test_they_go_on_where_measurements_are_missing(model):
    """y of a missing tick is the one that the model expects."""
    cars = (other(model, 1.0, 1.0, 1.05), other(model, 1.05, 0.95, 1.0))
    (_, u1, u2, y), shown = drive(model, cars, model, range(80, 95))
    slowest = 0.1 / SPECIFICATION.tau_q_s
    own = sampled_factors((model.g1, model.g2), slowest, "zoh", TICK_S)
    for car, x in zip(cars, shown, strict=True):
        its = sampled_over(car, own, "zoh", TICK_S)
        expected = sum(
            sign * (signal.sosfilt(a.sos, s) - signal.sosfilt(b.sos, s))
            for a, b, s, sign in (
                (its.numerators[0], own.numerators[0], u1, 1.0),
                (its.numerators[1], own.numerators[1], u2, 1.0),
                (its.denominator, own.denominator, y, -1.0),
            )
        )
        np.testing.assert_allclose(STEP * x, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("reference", [1.0, math.nan])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_an_unstable_plant_is_expected_where_what_is_not_lost_takes_it(share, reference):
    """M y = N1 u1 + N2 u2 - s w, at which d̂ is the known loss."""
    table = build(design(PENDULUM, SPECIFICATION), Target(TICK_S, 0, "zoh"))
    state = controller.init(table)[0]
    state.command_1, state.command_2 = 5.0, 300.0
    state.fault_state = FaultState.CONFIRMED if share else FaultState.CLEAR
    state.supervision.loss_model.share = share
    before = at_rest()
    for _ in range(3):
        model_1, model_2 = model_output(table.estimator, state.estimator, 0.0, 0.0)
        before.accumulators[:] = state.estimator.measurement.accumulators
        controller.step(table, state, reference, math.nan)
        shown = advance(table.estimator.measurement, before, state.estimator.measured)
        # all of channel 1 has been lost from the start, so w is N1 u1
        assert shown == pytest.approx(model_1 + model_2 - share * model_1, rel=1e-9)
    assert model_1 != 0.0
