"""The control law as it runs: identities, saturation, bad input, reset, order of convergence."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import TRUSTED
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import tustin
from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode
from tests.firmware.law.cases import CAR, changed, late, other_cars, through

DESIGN = design(CAR, DesignSpecification())
OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))


def _drive(firmware: Firmware, reference: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Commands and d̂, shape (ticks, 3)."""
    return np.array([firmware.step(r, m)[:3] for r, m in zip(reference, y, strict=True)])


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("rule", ["tustin", "tustin-held", "zoh"])
def test_estimator_works_on_the_commands_as_the_plant_gets_them(rule, latency):
    """Limited, rounded and late: d̂ + y is F1 of exactly those commands."""
    steps = {"lsb_1": 0.25, "lsb_2": 2.0}
    target = Target(1e-3, latency, rule, limit_1=40.0, limit_2=500.0, **steps)  # type: ignore[arg-type]
    n = 300
    y = 0.01 * np.random.default_rng(4).standard_normal(n)
    u1, u2, estimate = _drive(Firmware(build(DESIGN, target)), np.zeros(n), y).T
    assert np.abs(u1).max() == 40.0
    np.testing.assert_array_equal(u1 % 0.25, 0.0)
    np.testing.assert_array_equal(u2 % 2.0, 0.0)
    assert np.abs(u2).max() <= 500.0
    filters = discretise(DESIGN, target)
    modelled = through(filters.estimator_1, late(u1, latency))
    modelled += through(filters.estimator_2, late(u2, latency))
    np.testing.assert_allclose(estimate, modelled - y, atol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize("variant", ["physics", "published"])
@pytest.mark.parametrize("latency", [0, 1, 2, 5])
def test_exact_estimator_is_silent_while_healthy(variant, latency):
    """d̂ is zero to rounding for any reference and any latency."""
    plant = steer_by_wire(variant=variant)  # type: ignore[arg-type]
    slow = DesignSpecification(tau_s=0.02, tau_q_s=0.02)
    table = build(design(plant, slow), Target(1e-3, latency, "zoh"))
    reference = np.sign(np.sin(np.arange(5000) * 3e-3)) + np.sin(np.arange(5000) * 0.05)
    trace = simulate(table, sample(plant, 1e-3), reference)
    assert np.abs(trace.fault_estimate).max() < 1e-12 * np.abs(trace.measurement).max()


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
@pytest.mark.parametrize(("design_of", "tick_s"), [(DESIGN, 5e-4), (OPEN_LOOP, 5e-3)])
def test_smooth_input_converges_with_order_two(design_of, tick_s):  # type: ignore[no-untyped-def]
    """Firmware fed smooth r(t), y(t) against the continuous law fed the same, by lsim.

    Eliminating the loop, d̂ = (G1 u1 - y)/(1 - G2 F̂) and u2 = F̂ d̂; with G2 F̂ = q that is
    d̂ = (1 + 1/(τs))(G1 u1 - y).
    """
    tau_s = design_of.specification.tau_s
    duration_s = 0.6
    fine_s = tick_s / 16.0

    def smooth(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rise = np.where(time_s > 0, time_s, 0.0) ** 4 / (0.1 + time_s**4)
        return rise * np.cos(3.0 * time_s), 0.98 * rise * np.cos(3.0 * time_s + 0.01)

    def continuous() -> np.ndarray:
        time_s = np.arange(round(duration_s / fine_s)) * fine_s
        reference, y = smooth(time_s)

        def answer(g: ZeroPoleGain, values: np.ndarray) -> np.ndarray:
            system = signal.ZerosPolesGain(g.zeros, g.poles, g.gain)
            return signal.lsim(system.to_ss(), values, time_s)[1]

        feedback = design_of.tracking is not None
        u1 = answer(design_of.tracking.controller, reference - y) if feedback else reference
        lost = answer(design_of.plant.g1, u1) - y
        if not feedback:
            lost = lost + answer(design_of.plant.g2, reference)
        estimate = lost + answer(ZeroPoleGain((), (0.0,), 1.0 / tau_s), lost)
        u2 = answer(design_of.compensator, estimate) + (0.0 if feedback else reference)
        return np.stack([u1, u2, estimate])[:, ::16]

    exact = continuous()

    def distance(step: int) -> np.ndarray:
        time_s = np.arange(0, exact.shape[1], step) * tick_s
        reference, y = smooth(time_s)
        never = {"confirm": math.inf}  # this y, of which u2 has no part, is a channel 2 lost
        table = changed(build(design_of, Target(tick_s * step)), decision=never)[0]
        ours = _drive(Firmware(table), reference, y).T
        return np.abs(ours - exact[:, ::step]).max(axis=1)

    coarse, middle = distance(4), distance(2)
    names = ("u1", "u2", "d") if design_of.tracking is not None else ("u2", "d")  # u1 is r itself
    for name, far, near in list(zip(("u1", "u2", "d"), coarse, middle, strict=True))[-len(names) :]:
        assert math.log2(far / near) == pytest.approx(2.0, abs=0.2), name


@pytest.mark.compiled
def test_free_parameter_q_filters_the_estimate():
    """Theorem 2.3.1 with 1 + Q = 1/(0.05s+1): d̂ is that filter of (2.9)'s d̂."""
    lag = ZeroPoleGain.lag(0.05, 1)
    minus_high_pass = ZeroPoleGain((0.0,), (-20.0,), -1.0)  # Q = lag - 1 = -s/(s + 20)
    plain = design(CAR, DesignSpecification(compensation=False))
    shaped = design(CAR, DesignSpecification(compensation=False, q=minus_high_pass))
    n = 500
    y = np.random.default_rng(5).standard_normal(n)
    unfiltered = _drive(Firmware(build(plain, Target(1e-3))), np.zeros(n), y)[:, 2]
    filtered = _drive(Firmware(build(shaped, Target(1e-3))), np.zeros(n), y)[:, 2]
    expected = through(tustin(lag, 1e-3), unfiltered)
    np.testing.assert_allclose(filtered, expected, atol=1e-6 * np.abs(expected).max())


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


@pytest.mark.parametrize("reference", [1.0, -0.4, 0.0])
@pytest.mark.parametrize("latency", [0, 2])
def test_reset_to_steady_state_repeats_the_settled_commands(reference, latency):
    firmware = Firmware(build(DESIGN, Target(1e-3, latency, "zoh")))
    firmware.step(0.3, 0.1)
    firmware.reset(reference)
    for _ in range(200):
        answer = firmware.step(reference, reference)
        assert answer.command_1 == pytest.approx(reference / CAR.g1.dc_gain, rel=1e-9)
        assert answer.command_2 == pytest.approx(0.0, abs=1e-6)
        assert answer.fault_estimate == pytest.approx(0.0, abs=1e-9)


def test_reset_of_the_open_loop():
    firmware = Firmware(build(OPEN_LOOP, Target(1e-3)))
    firmware.reset(2.0)
    y = 2.0 * (chapter_2().g1.dc_gain + chapter_2().g2.dc_gain)
    answer = firmware.step(2.0, y)
    assert answer[:3] == pytest.approx((2.0, 2.0, 0.0), abs=1e-9)
