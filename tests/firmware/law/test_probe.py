"""The torque probe: its measurement, its way through C, and its weight in the decision."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import Trace, simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.errors import ParameterError
from firmware_model.law import controller
from firmware_model.law.fault_decision.probe import (
    begin_probe,
    correlate,
    end_probe,
    probe_torque,
)
from firmware_model.law.status import FaultState

TICK_S, TICKS, LOST, PROBE_NM = 1e-3, 8000, 3000, 2.0
CAR = steer_by_wire()
TUNED = design(CAR, DesignSpecification(tau_s=0.003, tau_q_s=0.005))


def target(**changes: object) -> Target:
    chosen = {"noise_rms": 0.002, "probe": PROBE_NM, "probe_pause_s": 0.2}
    return Target(TICK_S, 1, "zoh", **{**chosen, **changes})  # type: ignore[arg-type]


def drive(of: Target, left: float = 1.0, bias: float = 0.0, car=CAR, rms: float = 0.0) -> Trace:  # type: ignore[no-untyped-def]
    """A step of 1 m/s²; from LOST on the torque has ``left`` of its effect, D* a bias."""
    effectiveness = np.ones((TICKS, 2))
    effectiveness[LOST:, 0] = left
    noise = rms * np.random.default_rng(5).standard_normal(TICKS)
    noise[LOST:] += bias
    step = 1.0 - np.exp(-4.0 * TICK_S * np.arange(TICKS))  # gentle: no other car stands out
    return simulate(
        build(TUNED, of), sample(car, TICK_S), step, effectiveness=effectiveness, noise=noise
    )


@settings(max_examples=30)
@given(st.floats(-1.0, 2.0), st.floats(-10.0, 10.0), st.floats(1e-3, 100.0), st.floats(0.0, 6.2))
def test_share_is_that_of_w_in_the_estimate_whatever_is_constant(
    share: float, constant: float, size: float, angle: float
) -> None:
    table = build(TUNED, target(probe_rad_per_s=200.0))
    state = controller.init(table)[0]
    begin_probe(state.probe)
    ticks, over = int(table.probe.ticks), False
    for k in range(ticks):
        assert not over
        w = size * math.sin(4.0 * math.pi * k / ticks + angle) + 3.0 * constant
        over = correlate(table.probe, state.probe, share * w + constant, w)
    assert over
    assert end_probe(state.probe) == pytest.approx(share, abs=1e-9 * (1.0 + abs(constant) / size))
    assert state.probe.tick == 0


def test_what_comes_a_quarter_of_a_period_late_is_no_part_of_w() -> None:
    table = build(TUNED, target(probe_rad_per_s=200.0))
    state = controller.init(table)[0].probe
    begin_probe(state)
    for angle in 4.0 * np.pi * np.arange(table.probe.ticks) / table.probe.ticks + np.pi / 4.0:
        correlate(table.probe, state, np.cos(angle), np.sin(angle))
    assert end_probe(state) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("before", [1, 40])
def test_a_probe_knows_nothing_of_the_one_before(before: int) -> None:
    table = build(TUNED, target(probe_rad_per_s=200.0))
    fresh, used = (controller.init(table)[0].probe for _ in range(2))
    begin_probe(used)
    for _ in range(before):
        correlate(table.probe, used, 0.7, 0.4)
    for state in (fresh, used):
        begin_probe(state)
    for _ in range(int(table.probe.ticks)):
        assert probe_torque(table.probe, used) == probe_torque(table.probe, fresh)
        for state in (fresh, used):
            correlate(table.probe, state, 0.1 * float(state.sine), float(state.cosine))
    assert used == fresh


@pytest.mark.parametrize("rad_per_s", [5.0, 10.0, 31.0])
def test_probe_is_two_periods_that_swell_and_fade(rad_per_s: float) -> None:
    table = build(TUNED, target(probe_rad_per_s=rad_per_s))
    state = controller.init(table)[0]
    begin_probe(state.probe)
    torque, over = [], False
    while not over:
        torque.append(probe_torque(table.probe, state.probe))
        over = correlate(table.probe, state.probe, 0.0, 0.0)
    k = np.arange(len(torque)) / len(torque)
    expected = PROBE_NM * np.sin(4 * np.pi * k) * (1.0 - np.cos(2 * np.pi * k)) / 2.0
    np.testing.assert_allclose(torque, expected, atol=1e-11 * PROBE_NM)
    assert len(torque) * TICK_S == pytest.approx(4 * np.pi / rad_per_s, rel=0.01)


@pytest.mark.compiled
def test_c_lets_the_probe_pass() -> None:
    """On the car that is the model the torque gets the probe whole, and D* what G1 makes of it."""
    trace = drive(target(), bias=-0.05)
    settled = simulate(
        build(TUNED, target(probe=0.0)), sample(CAR, TICK_S), trace.reference,
        noise=np.r_[np.zeros(LOST), np.full(TICKS - LOST, -0.05)],
    )  # fmt: skip
    added = trace.command_1 - settled.command_1
    ticks = round(4.0 * math.pi / (10.0 * TICK_S))
    k = np.arange(ticks) / ticks
    sine = PROBE_NM * np.sin(4.0 * np.pi * k) * (1.0 - np.cos(2.0 * np.pi * k)) / 2.0
    start = int(np.flatnonzero(np.abs(added) > 1e-9)[0]) - 1  # its first tick adds nothing
    assert LOST <= start < LOST + 50
    np.testing.assert_allclose(added[start : start + ticks], sine, atol=1e-6 * PROBE_NM)
    late = np.concatenate([[0.0], added[:-1]])
    moved = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, late)
    np.testing.assert_allclose(trace.measurement - settled.measurement, moved, atol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("rms", [0.0, 0.005])
@pytest.mark.parametrize("on_confirmation", [False, True])
@pytest.mark.parametrize(
    ("left", "bias", "lost"),
    [(0.0, 0.0, True), (0.5, 0.0, True), (1.0, 0.1, False), (1.0, -0.3, False)],
)
def test_a_lost_torque_is_confirmed_and_a_bias_is_not(
    left: float, bias: float, lost: bool, on_confirmation: bool, rms: float
) -> None:
    probing = drive(target(on_confirmation=on_confirmation), left, bias, rms=rms)
    states = set(probing.fault_state[LOST:])
    assert (FaultState.CONFIRMED in states) == lost
    assert FaultState.SUSPECTED in states
    if lost:  # which is found without the probe too
        blind = drive(target(on_confirmation=on_confirmation, probe=0.0), left, bias, rms=rms)
        assert FaultState.CONFIRMED in blind.fault_state[LOST:]


@pytest.mark.compiled
@pytest.mark.parametrize(
    "changed",
    [
        {"mass_kg": 1680.0},
        {"mass_kg": 1120.0},
        {"speed_mps": 12.0},
        {"speed_mps": 8.0},
        {"front_cornering_stiffness_n_per_rad": 26960.0},
        {"rear_cornering_stiffness_n_per_rad": 44960.0},
    ],
)
def test_a_car_that_is_twenty_percent_off_is_not_taken_for_a_loss(
    changed: dict[str, float],
) -> None:
    car = steer_by_wire(VehicleParameters(**changed))
    trace = drive(target(), car=car)
    assert FaultState.CONFIRMED not in trace.fault_state
    lost = drive(target(), left=0.0, car=car)
    assert FaultState.CONFIRMED in lost.fault_state[LOST:]


@pytest.mark.compiled
def test_while_nothing_is_suspected_there_is_no_probe() -> None:
    with_probe, without = drive(target()), drive(target(probe=0.0))
    np.testing.assert_array_equal(with_probe.command_1, without.command_1)


def test_a_probe_without_an_answer_finds_nothing_lost() -> None:
    state = controller.init(build(TUNED, target()))[0]
    begin_probe(state.probe)
    assert end_probe(state.probe) == 0.0


@pytest.mark.compiled
@pytest.mark.parametrize("left", [0.0, 1.0])
def test_a_quick_probe_confirms_a_loss_and_no_bias(left: float) -> None:
    table = build(TUNED, target(probe_rad_per_s=60.0))
    effectiveness, bias = np.ones((1000, 2)), np.zeros(1000)
    effectiveness[400:, 0] = left
    bias[400:] = 0.1 * left
    trace = simulate(
        table, sample(CAR, TICK_S), np.full(1000, 0.5), effectiveness=effectiveness, noise=bias
    )
    assert (FaultState.CONFIRMED in trace.fault_state[400:]) == (left == 0.0)


def test_reset_ends_a_probe() -> None:
    table = build(TUNED, target())
    state = controller.init(table)[0]
    begin_probe(state.probe)
    controller.reset(table, state, 1.0)
    assert state.probe.tick == 0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"probe": -1.0}, "probe = -1"),
        ({"probe": math.inf}, "probe = inf"),
        ({"probe_rad_per_s": 0.0}, "probe_rad_per_s = 0"),
        ({"probe_rad_per_s": 800.0}, "at most an eighth"),
        ({"probe_rad_per_s": math.nan}, "probe_rad_per_s = nan"),
    ],
)
def test_no_such_probe(changes: dict[str, float], named: str) -> None:
    with pytest.raises(ParameterError, match=named):
        target(**changes)
