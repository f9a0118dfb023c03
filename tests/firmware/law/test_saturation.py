"""Commands that an actuator can follow: saturated in magnitude and rate, without wind-up."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware

CAR = steer_by_wire()
DESIGN = design(CAR, DesignSpecification())


def _drive(firmware: Firmware, reference: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Commands and d̂, shape (ticks, 3)."""
    return np.array([firmware.step(r, m)[:3] for r, m in zip(reference, y, strict=True)])


@pytest.mark.compiled
@given(y=st.lists(st.floats(-1.0, 1.0), min_size=5, max_size=40))
def test_algebraic_loop_is_solved_under_saturation(y):
    """u2 = sat(F̂'s answer to the d̂ that this very u2 gives), tick by tick, but for a make-up."""
    limit = 200.0
    target = Target(1e-3, limit_2=limit)
    filters = discretise(DESIGN, target)
    n = len(y)
    table = build(DESIGN, target).copy()
    table.shortfall_2.gain[:] = 0.0
    _, u2, estimate = _drive(Firmware(table), np.zeros(n), np.array(y)).T
    asked = signal.sosfilt(filters.compensator.sos, estimate)
    np.testing.assert_allclose(
        u2, np.clip(asked, -limit, limit), atol=1e-7 * (1.0 + np.abs(asked).max())
    )


@pytest.mark.compiled
@settings(max_examples=20)
@given(
    latency=st.integers(0, 3),
    rule=st.sampled_from(["tustin", "tustin-held", "zoh"]),
    limit=st.floats(1.0, 1e4),
)
def test_no_command_leaves_its_limits(latency, rule, limit):
    target = Target(1e-3, latency, rule, limit_1=limit, limit_2=limit)  # type: ignore[arg-type]
    trace = simulate(build(DESIGN, target), sample(CAR, 1e-3), np.ones(300))
    assert np.abs(trace.command_1).max() <= limit
    assert np.abs(trace.command_2).max() <= limit


@pytest.mark.compiled
def test_rates_are_limited_and_the_estimator_knows():
    slow = design(CAR, DesignSpecification(tau_s=0.02, tau_q_s=0.02, alpha_q=3))
    table = build(slow, Target(1e-3, 1, "zoh", rate_1=2000.0, rate_2=5e4))
    left = np.ones((3000, 2))
    left[1500:, 0] = 0.0
    trace = simulate(table, sample(CAR, 1e-3), np.ones(3000), effectiveness=left)
    assert np.abs(np.diff(trace.command_1)).max() <= 2.0 * (1 + 1e-9)
    assert np.abs(np.diff(trace.command_2)).max() <= 50.0 * (1 + 1e-9)
    assert np.abs(trace.fault_estimate[:1500]).max() < 1e-12
    assert abs(trace.error[1499]) < 1e-3


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
