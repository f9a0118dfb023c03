"""The control law as it runs: identities, rates, bad input, reset."""

import math

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import TRUSTED
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode
from tests.firmware.law.cases import CAR, other_cars

DESIGN = design(CAR, DesignSpecification())
OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))


def _drive(firmware: Firmware, reference: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Commands and d̂, shape (ticks, 3)."""
    return np.array([firmware.step(r, m)[:3] for r, m in zip(reference, y, strict=True)])


@pytest.mark.compiled
@pytest.mark.parametrize("variant", ["physics", "published"])
def test_estimate_equals_the_lost_channel_after_the_fault(variant):
    """(2.9): d̂ = G1 u1, what torque would have given; settled it is the whole reference."""
    plant = steer_by_wire(variant=variant)  # type: ignore[arg-type]
    table = build(design(plant, DesignSpecification()), Target(1e-3))
    left = np.ones((8000, 2))
    left[4000:, 0] = 0.0
    trace = simulate(table, sample(plant, 1e-3), np.ones(8000), effectiveness=left)
    assert np.abs(trace.error[3000:4000]).max() < 1e-9
    assert np.abs(trace.error[-500:]).max() < 1e-9
    # F̂ rings at 17.7 rad/s with damping .20: after 4 s e^-14 of it is left
    np.testing.assert_allclose(trace.fault_estimate[-500:], 1.0, rtol=1e-5)
    np.testing.assert_allclose(trace.command_1[-1], 1.0 / plant.g1.dc_gain, rtol=1e-5)
    np.testing.assert_allclose(trace.command_2[-1], 1.0 / plant.g2.dc_gain, rtol=1e-5)


@pytest.mark.compiled
def test_a_batch_is_its_members():
    tables = [build(DESIGN, Target(1e-3)), build(DESIGN, Target(1e-3, 2, "zoh"))]
    many = np.zeros(2, tables[0].dtype)
    for i, table in enumerate(tables):
        many[i] = table
    states = controller.init(tables[0], n=2)
    singles = [Firmware(t) for t in tables]
    for k in range(20):
        inputs = np.array([0.1 * k, 1.0]), np.array([0.05 * k, 0.3])
        controller.step_many(many, states, *inputs)
        for i, single in enumerate(singles):
            answer = single.step(inputs[0][i], inputs[1][i])
            assert states["command_2"][i] == answer.command_2


@pytest.mark.compiled
def test_float32_table_follows_the_float64_one():
    """Settled loop in single precision: D* within a few float32 roundings of the reference."""
    trace = simulate(
        build(DESIGN, Target(1e-3, estimator="zoh", precision="float32")),
        sample(CAR, 1e-3),
        np.ones(4000),
    )
    assert np.abs(trace.error[-500:]).max() < 1e-5
    assert np.abs(trace.fault_estimate[-500:]).max() < 1e-3


# --- limits --------------------------------------------------------------------------------------


@pytest.mark.parametrize("limited", [1, 2])
def test_the_rate_of_either_channel_is_limited_alone(limited):
    """d̂ follows a step of D* within the tick, and so do both commands, but for the limited one."""
    rate = {1: 2000.0, 2: 5e4}[limited]
    target = Target(1e-3, estimator="zoh", **{f"rate_{limited}": rate})  # type: ignore[arg-type]
    commands = _drive(Firmware(build(DESIGN, target)), np.ones(4), np.full(4, -0.5))[:, :2]
    change = np.abs(np.diff(commands, axis=0, prepend=0.0))
    slew = rate * 1e-3
    np.testing.assert_allclose(change[:, limited - 1], slew, rtol=1e-12)
    assert change[0, 2 - limited] > 100.0 * slew


# --- reset, input that is no number, overflow ----------------------------------------------------


@pytest.mark.compiled
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_reference_that_is_no_number_holds_the_last_good_command(bad):
    table = build(DESIGN, Target(1e-3, estimator="zoh"))
    plant = sample(CAR, 1e-3)
    healthy, dropout = np.ones(1500), np.zeros(1500)
    dropout[1000:1010] = bad
    trace = simulate(table, plant, healthy + dropout)
    np.testing.assert_array_equal(trace.command_1[1000:1010], trace.command_1[999])
    np.testing.assert_array_equal(trace.command_2[1000:1010], trace.command_2[999])
    assert np.isfinite(trace.command_1).all()
    assert np.isfinite(trace.fault_estimate).all()
    assert np.abs(trace.fault_estimate[1010:]).max() < 1e-10  # F1 followed the held command
    assert abs(trace.error[-1]) < 1e-4

    firmware = Firmware(table)
    assert firmware.step(1.0, 0.0).mode == Mode.RUN
    before = firmware.step(1.0, 0.1)
    held = firmware.step(bad, 0.1)
    assert held.mode == Mode.BLIND
    assert held[:3] == before[:3]
    assert firmware.step(1.0, 0.1).mode == Mode.RUN


@pytest.mark.compiled
@pytest.mark.parametrize("mismatch", [TRUSTED, other_cars(2)], ids=["trusted", "other cars"])
@pytest.mark.parametrize("overflow", [1.7e308, -1.7e308])
def test_an_overflow_of_the_measurement_leaves_a_confirmed_loss_compensated(overflow, mismatch):
    """F1, w and F̂ follow commands, which are finite: only C, that sees D*, begins anew."""
    target = Target(
        1e-3, 1, "zoh", limit_1=400.0, limit_2=1e4, mismatch=mismatch, on_confirmation=True
    )
    tame = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
    left, noise = np.ones((3000, 2)), np.zeros(3000)
    left[300:, 0] = 0.0
    noise[1000] = overflow
    plant, table = sample(CAR, 1e-3), build(tame, target)
    trace = simulate(table, plant, np.ones(3000), effectiveness=left, noise=noise)
    assert trace.fault_state[999] == FaultState.CONFIRMED
    assert trace.mode[1000] == Mode.BLIND
    assert (trace.fault_state[1000:] == FaultState.CONFIRMED).all()
    assert np.abs(trace.error[1001:]).max() < 0.7  # D* follows C, which begins at zero
    assert abs(trace.error[-1]) < 0.01
    assert trace.command_2[-1] == pytest.approx(1.0 / CAR.g2.dc_gain, rel=0.01)


def test_reset_of_the_open_loop():
    firmware = Firmware(build(OPEN_LOOP, Target(1e-3)))
    firmware.reset(2.0)
    y = 2.0 * (chapter_2().g1.dc_gain + chapter_2().g2.dc_gain)
    answer = firmware.step(2.0, y)
    assert answer[:3] == pytest.approx((2.0, 2.0, 0.0), abs=1e-9)
