"""A plant behind dead times and lags, tick by tick and as a loop, against what is continuous."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, law_in
from firmware_model.analysis.sampled_loop import sampled_loop
from firmware_model.analysis.sampled_plant import follow, sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from firmware_model.firmware import Firmware
from firmware_model.law.structs import FloatArray

CAR = steer_by_wire()
TICK_S = 0.001
delays = st.floats(0.0, 0.005)


def continuously(plant: Plant, commands: FloatArray, left: FloatArray) -> FloatArray:
    """y and what the sensor reads at every tick, by an ODE solver from cut to cut."""
    ticks = len(commands)
    cuts = {k * TICK_S for k in range(ticks + 1)}
    for dead_s in plant.dead_times_s:
        cuts |= {k * TICK_S + dead_s for k in range(ticks)}
    late = {max(k * TICK_S - plant.sensor_dead_time_s, 0.0) for k in range(ticks + 1)}
    times = np.array(sorted(t for t in cuts | late if t <= ticks * TICK_S))
    times = times[np.concatenate([[True], np.diff(times) > 1e-12])]
    x, states = np.zeros(len(plant.a)), [np.zeros(len(plant.a))]
    for begin, end in itertools.pairwise(times):
        middle = 0.5 * (begin + end)
        u = np.zeros(2)
        for channel, dead_s in enumerate(plant.dead_times_s):
            k = int(np.floor((middle - dead_s) / TICK_S))
            if k >= 0:
                u[channel] = commands[k, channel] * left[int(middle / TICK_S), channel]
        x = solve_ivp(
            lambda _, x, u: plant.a @ x + plant.b @ u, (begin, end), x, args=(u,),
            rtol=1e-10, atol=1e-13, method="DOP853",
        ).y[:, -1]  # fmt: skip
        states.append(x)
    seen = np.array(states)
    assert plant.sensed is not None
    rows = []
    for k in range(1, ticks + 1):
        now = np.argmin(np.abs(times - k * TICK_S))
        before = np.argmin(np.abs(times - max(k * TICK_S - plant.sensor_dead_time_s, 0.0)))
        rows.append([plant.sensed[0] @ seen[now], plant.c[0] @ seen[before]])
    return np.array(rows)


@settings(max_examples=8, deadline=None)
@given(delays, delays, delays, st.integers(0, 2**31))
@example(0.003, 0.001, 0.002, 3)  # whole ticks
def test_any_dead_time_is_exact(first_s, second_s, sensor_s, seed):
    plant = actuated(
        CAR,
        Stage(0.004, dead_time_s=first_s),
        Stage(natural_frequency_rad_per_s=300.0, damping=0.5, dead_time_s=second_s),
        Stage(0.003, dead_time_s=sensor_s),
    )
    draw = np.random.default_rng(seed)
    commands = draw.normal(0.0, [300.0, 900.0], (12, 2))
    left = np.where(np.arange(12)[:, None] < 7, 1.0, [[0.3, 1.0]])
    sampled = sample(plant, TICK_S)
    constants, memory = sampled.constants, sampled.memory
    found = [follow(constants, memory, k, *commands[k], *left[k]) for k in range(12)]
    expected = continuously(plant, commands, left)
    assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


KNOWN = actuated(
    CAR,
    Stage(0.010, dead_time_s=0.0024),
    Stage(0.020, dead_time_s=0.001),
    Stage(0.001, dead_time_s=0.0006),
)
SLOW = DesignSpecification(tau_s=0.02, alpha=3, tau_q_s=0.03, alpha_q=4)


@pytest.mark.compiled
def test_f1_waits_for_the_dead_times_of_each_channel():
    """Whole ticks, sensor included; a loop without a fault then has no d̂."""
    whole = actuated(
        CAR, Stage(0.01, dead_time_s=0.003), Stage(0.02, dead_time_s=0.001), Stage(0.001)
    )
    table = build(design(whole, SLOW), Target(TICK_S, latency_ticks=2, estimator="zoh"))
    trace = simulate(table, sample(whole, TICK_S), np.ones(3000))
    assert np.abs(trace.fault_estimate).max() < 1e-9
    assert np.abs(trace.command_1).max() > 10.0
    assert trace.measured[-1] == pytest.approx(1.0, rel=1e-3)
    ignorant = build(design(CAR, SLOW), Target(TICK_S, latency_ticks=2, estimator="zoh"))
    unknown = simulate(ignorant, sample(whole, TICK_S), np.ones(300))
    assert np.abs(unknown.fault_estimate).max() > 1e-3


@pytest.mark.parametrize("tick_s", [0.0, -1.0, math.inf, math.nan])
def test_a_tick_that_is_no_tick_is_refused(tick_s):
    with pytest.raises(ParameterError, match="tick_s"):
        sample(CAR, tick_s)


@pytest.mark.compiled
@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD])
@pytest.mark.parametrize("plant", [CAR, KNOWN], ids=["unknown", "known"])
def test_the_loop_s_matrix_is_the_simulation(plant, left):
    """Dead times are in the design, or only in the plant."""
    chosen = DesignSpecification(tau_s=0.02, alpha=3, tau_q_s=0.03, alpha_q=4)
    table = build(design(plant, chosen), Target(TICK_S, latency_ticks=1, estimator="zoh"))
    loop = sampled_loop(law_in(table, left), KNOWN, TICK_S, left)
    ticks = 400
    reference = np.ones(ticks)
    trace = simulate(
        table, sample(KNOWN, TICK_S), reference, effectiveness=np.tile(left, (ticks, 1))
    )
    xi, expected = np.zeros(len(loop.a)), []
    for r in reference:
        y = loop.c @ xi
        expected.append(y)
        xi = loop.a @ xi + loop.b @ np.array([y, r])
    assert_allclose(trace.measured, expected, rtol=1e-6, atol=1e-9)
    grows = np.abs(expected[-1]) > 100.0
    assert (loop.spectral_radius() > 1.0) == grows


def test_a_reset_fills_what_is_in_the_dead_times():
    """From the settled loop on, nothing moves and nothing looks like a loss."""
    late = actuated(CAR, Stage(0.01, dead_time_s=0.003), Stage(dead_time_s=0.005), IDEAL)
    firmware = Firmware(build(design(late, SLOW), Target(TICK_S, latency_ticks=2, estimator="zoh")))
    firmware.reset(1.0)
    torque, _ = firmware.commands
    for _ in range(20):
        answer = firmware.step(1.0, 1.0)
        assert answer.fault_estimate == pytest.approx(0.0, abs=1e-9)
        assert answer.command_1 == pytest.approx(torque, rel=1e-6)
        assert answer.command_2 == pytest.approx(0.0, abs=1e-6)
    assert torque == pytest.approx(1.0 / CAR.g1.dc_gain)
