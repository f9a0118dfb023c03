"""Figures of merit: against simulation at and beyond the edge, and against closed formulas."""

import cmath
import math
from dataclasses import replace
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

from firmware_model.analysis.margins import (
    EXACT_DELAY_TICKS,
    HEALTHY,
    TORQUE_DEAD,
    delay_margins,
    gain_margins,
    is_stable_in,
    largest_latency_survived,
    law_in,
    margins,
    noise_gain,
    peak_sensitivity,
    zero,
)
from firmware_model.analysis.sampled_loop import linear_controller, lumped, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.plants import Plant, chapter_2
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from tests.firmware.analysis.loops import CAR, PUBLISHED, SLOW, loop_of, scalar_loop

BARE = design(CAR, DesignSpecification(compensation=False))
OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))


def test_what_cannot_be_built_is_not_stable():
    steep = design(CAR, DesignSpecification(q=ZeroPoleGain((-10.0,), (-100.0,), 10.0)))
    assert not is_stable_in(steep, Target(1e-3), CAR, [HEALTHY])


def test_a_loop_that_needs_its_gain_has_a_lower_margin_too():
    """x⁺ = 1.2 x - 0.5 g y is stable for 0.4 < g < 4.4."""
    loop = scalar_loop(1.2, -0.5)
    assert gain_margins(loop) == pytest.approx((0.4, 4.4), rel=1e-12)


@pytest.mark.parametrize("rule", ["zoh", "tustin", "tustin-held"])
def test_rounding_near_rest_makes_no_lower_gain_margin(rule):
    """Two integrators, of a plant of 1 rad/s at 1.3 kHz: L follows the negative axis for decades.

    In forty digits L stays on one side of the axis.
    """
    poles = (-0.45284520203450673, -0.8461437372723123, -3.265216622592923)
    g1 = ZeroPoleGain((1.2353642786940744, -3.573067329927216), poles, 72.42207701407439)
    g2 = ZeroPoleGain((1.236661000420139,), poles, 8.597295302937662)
    slow = DesignSpecification(tau_s=0.015, alpha=3, tau_q_s=0.0748, alpha_q=3)
    designed = design(Plant.from_transfer_functions("slow", g1, g2), slow)
    table = build(designed, Target(7.656795783537045e-4, estimator=rule))
    law = law_in(table, TORQUE_DEAD)
    loop = sampled_loop(law, designed.plant, 7.656795783537045e-4, TORQUE_DEAD)
    a, b, c = (mpmath.matrix(x) for x in (loop.lumped.a, loop.lumped.b[:, :1], loop.lumped.c[None]))
    with mpmath.workdps(40):
        for theta in (1e-5, 6e-5, 3e-4):
            resolvent = mpmath.expj(theta) * mpmath.eye(len(a)) - a
            exact = -complex((c * mpmath.lu_solve(resolvent, b))[0])
            assert exact.imag < 0.0
            assert loop.gain_at(theta) == pytest.approx(exact, rel=1e-6)
    assert gain_margins(loop)[0] == 0.0


@pytest.mark.parametrize("late", [0.0, 2.0, 2.5])
@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD])
def test_gain_margins_are_where_the_dense_eigenvalues_cross(late, left):
    """By bisection of the largest eigenvalue of the whole matrix, of which nothing is lumped."""
    loop = loop_of(SLOW, Target(1e-3, 4, "zoh"), left, late)
    reduction, gain = gain_margins(loop)
    assert reduction == 0.0

    def excess(factor: float) -> float:
        return float(np.abs(np.linalg.eigvals(loop.closed(factor))).max()) - 1.0

    grid = np.geomspace(1.0, 2.0 * gain, 400)
    beyond = next(factor for factor in grid if excess(factor) > 0.0)
    assert gain == pytest.approx(brentq(excess, beyond / 1.1, beyond, xtol=1e-13), rel=1e-9)


@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD, (0.5, 1.0)])
def test_equal_states_as_one_leave_the_loop_as_it_is(left):
    """The same poles but for those at 0, and the same L; each waiting command is one state."""
    loop = loop_of(SLOW, Target(1e-3, 12, "zoh"), left)
    few = loop.lumped
    assert len(loop.a) - len(few.a) == 2 * 12  # the estimator's rings, which the bus has too
    dense = np.linalg.eigvals(loop.closed())
    one = np.linalg.eigvals(few.closed())
    for pole in one[np.abs(one) > 0.5]:  # rounding spreads those at 0, the longer a chain
        assert np.abs(dense - pole).min() < 1e-6
    assert np.sum(np.abs(dense) > 0.5) == np.sum(np.abs(one) > 0.5)
    z = np.exp(1j * np.array([0.03, 0.1, 1.0, 3.0]))
    eye = np.eye(len(loop.a))
    direct = [-loop.c @ np.linalg.solve(each * eye - loop.a, loop.b[:, 0]) for each in z]
    np.testing.assert_allclose(loop.loop_gain(z), direct, rtol=1e-9)


@pytest.mark.compiled
@pytest.mark.parametrize(("designed", "latency"), [(PUBLISHED, 0), (SLOW, 2)])
def test_peak_sensitivity_is_what_a_sine_of_noise_becomes(designed, latency):
    """A measured sine at that frequency settles at |S| times its size, by simulation."""
    tick_s, ticks = 1e-3, 3000
    target = Target(tick_s, latency, "zoh")
    peak, at = peak_sensitivity(loop_of(designed, target))
    noise = np.cos(at * tick_s * np.arange(ticks))
    trace = simulate(build(designed, target), sample(CAR, tick_s), np.zeros(ticks), noise=noise)
    assert np.abs((trace.measurement + noise)[-600:]).max() == pytest.approx(peak, rel=5e-3)
    grid = np.exp(1j * np.linspace(1e-4, math.pi, 20001))
    size = np.abs(1.0 / (1.0 + loop_of(designed, target).loop_gain(grid)))
    assert peak == pytest.approx(size.max(), rel=1e-4)
    assert peak >= size.max() * (1.0 - 1e-9)


@pytest.mark.compiled
def test_noise_gain_is_the_impulse_response_summed():
    """Parseval: rms² = Σ h_k², h the answer to one tick of measurement noise."""
    target = Target(1e-3, 1, "zoh")
    table, impulse = build(SLOW, target), np.zeros(3000)
    impulse[0] = 1.0
    trace = simulate(table, sample(CAR, 1e-3), np.zeros(3000), noise=impulse)
    loop = loop_of(SLOW, target)
    answers = (trace.command_1, trace.command_2, trace.fault_estimate)
    for answer, response in enumerate(answers):
        assert noise_gain(loop, answer) == pytest.approx(math.sqrt(response @ response), rel=1e-6)
    figures = margins(table, CAR, 1e-3)
    assert figures.noise_to_command_1 == noise_gain(loop, 0)
    assert figures.noise_to_command_2 == noise_gain(loop, 1)


def test_noise_reaches_an_open_integrator_and_only_that_is_infinite():
    loop = loop_of(BARE, Target(1e-3), TORQUE_DEAD)
    assert noise_gain(loop, 0) == math.inf
    assert noise_gain(loop, 1) == 0.0
    lost_2 = loop_of(SLOW, Target(1e-3), (1.0, 0.0))
    assert noise_gain(lost_2, 0) == pytest.approx(
        noise_gain(
            loop_of(
                design(CAR, DesignSpecification(tau_q_s=0.02, compensation=False)), Target(1e-3)
            ),
            0,
        ),
        rel=1e-9,
    )
    assert noise_gain(lost_2, 1) == math.inf


def test_slowest_pole_is_the_decay_of_the_simulation():
    """|s| and damping by two lines: the logarithmic decrement and the zero crossings' period."""
    tick_s = 1e-3
    figures = margins(build(PUBLISHED, Target(tick_s, 1, "zoh")), CAR, tick_s)
    s = figures.slowest_rad_per_s * cmath.exp(1j * math.acos(-figures.slowest_damping))
    assert abs(cmath.exp(s * tick_s)) == pytest.approx(figures.spectral_radius, rel=1e-12)
    # F̂ rings at 17.7 rad/s, ζ = .20 (corrected (3.36))
    zero = max(CAR.g2.zeros, key=lambda z: z.imag)
    assert figures.slowest_rad_per_s == pytest.approx(abs(zero), rel=1e-3)
    assert figures.slowest_damping == pytest.approx(-zero.real / abs(zero), rel=1e-3)


def test_an_unstable_loop_has_no_margins():
    fast = design(CAR, DesignSpecification(tau_s=1e-4, tau_q_s=0.02))
    figures = margins(build(fast, Target(1e-3, 1, "zoh")), CAR, 1e-3, (1.0, 0.0))
    assert not figures.stable
    assert figures.slowest_damping < 0.0
    assert figures.delay_margin_ticks is None
    assert figures.delay_margin_s is None
    assert math.isnan(figures.gain_margin)
    assert math.isnan(figures.peak_sensitivity)
    assert figures.noise_to_command_1 == math.inf


def test_a_loop_that_is_open_survives_any_delay_and_gain():
    """Without compensation nothing acts on the car after the loss: stable, following nothing."""
    figures = margins(build(BARE, Target(1e-3)), CAR, 1e-3, TORQUE_DEAD)
    assert figures.stable
    assert figures.spectral_radius == pytest.approx(
        max(abs(cmath.exp(1e-3 * pole)) for pole in CAR.g1.poles), rel=1e-6
    )
    assert (figures.delay_margin_ticks, figures.delay_margin_s) == (None, None)
    assert figures.gain_margin == math.inf
    assert figures.peak_sensitivity == 1.0


def test_chapter_2_is_a_loop_of_the_compensator_alone():
    figures = margins(build(OPEN_LOOP, Target(1e-3)), OPEN_LOOP.plant, 1e-3, TORQUE_DEAD)
    assert figures.stable
    assert figures.spectral_radius == pytest.approx(math.exp(-1e-3), rel=1e-9)  # the pole -1


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 2])
@pytest.mark.parametrize("tau_q_s", [0.0005, 0.001, 0.002, 0.005])
@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD, (0.5, 1.0)])
def test_compensation_on_confirmation_is_predicted_as_it_simulates(latency, tau_q_s, left):
    """After the decision the loop is another one; its growth is that of its spectral radius."""
    designed = design(CAR, DesignSpecification(tau_s=0.0005, tau_q_s=tau_q_s))
    target = Target(1e-3, latency, "zoh", on_confirmation=True)
    table = build(designed, target)
    radius = sampled_loop(law_in(table, left), CAR, 1e-3, left).spectral_radius()
    whole = np.tile(left, (500, 1))  # lost from the start, so decided at once
    error = simulate(table, sample(CAR, 1e-3), np.ones(500), effectiveness=whole).error
    tail, later = np.abs(error[300:400]).max(), np.abs(error[400:]).max()
    if radius < 1.0:
        assert later < 1.05 * tail + 1e-9
    else:
        assert math.log(later / tail) / 100 == pytest.approx(math.log(radius), rel=0.1)


def test_only_a_confirmed_loss_lets_compensation_on_confirmation_act():
    """u2 is row 1: no input reaches it before, the model of the lost channel does after."""
    table = build(PUBLISHED, Target(1e-3, 1, "zoh", on_confirmation=True))
    whole, lost = law_in(table, HEALTHY), law_in(table, TORQUE_DEAD)
    memories, reached = whole.b, [whole.d[1]]
    for _ in range(len(whole.a)):
        reached.append(whole.c[1] @ memories)
        memories = whole.a @ memories
    assert not np.any(reached)
    assert lost.c[1].any()
    assert len(lost.a) == len(linear_controller(build(PUBLISHED, Target(1e-3, 1, "zoh"))).a) + 4


def test_lumps_answer_as_all_their_states_do_even_where_states_copy_in_a_circle():
    """States 0 and 1 copy each other, 2 and 3 both copy state 1, and 4 has dynamics and input."""
    a = np.zeros((5, 5))
    a[[0, 1, 2, 3], [1, 0, 1, 1]] = 1.0
    a[4] = (0.3, 0.0, 0.5, -0.2, 0.4)
    b = np.array([[0.0], [0.0], [0.0], [0.0], [1.0]])
    rows = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]])
    few_a, few_b, few_rows = lumped(a, b, rows)
    assert len(few_a) == 4  # 0, 1, 4, and one for both 2 and 3
    state, few = np.zeros(5), np.zeros(4)
    for tick in range(20):
        assert few_rows @ few == pytest.approx(rows @ state, rel=1e-12)
        state, few = a @ state + b[:, 0] * (tick + 1), few_a @ few + few_b[:, 0] * (tick + 1)


@pytest.mark.parametrize(
    "function",
    [lambda x: x * x * x - 0.2, lambda x: math.exp(30.0 * x) - 2.0,
     lambda x: math.tanh(1e4 * (x - 0.123)), lambda x: 1.0 if x > math.pi / 4.0 else -1.0],
    ids=["cubic", "steep at one end", "almost a jump", "a jump"],
)  # fmt: skip
def test_it_finds_what_scipy_finds(function):
    found = zero(function, 0.0, 1.0)
    assert found == pytest.approx(brentq(function, 0.0, 1.0, xtol=1e-15), rel=1e-14)


def test_it_ends_where_the_loop_gain_is_not_a_number():
    assert math.isnan(zero(lambda x: math.nan, 0.0, 1.0))


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_high_frequency_limit_of_an_estimator_that_ignores_the_delay(n):
    """Z^(n+1) - z^n + T/τ = 0, stable for T/τ < 2 sin(π/(2(2n+1))).

    T far below the plant's times, no tracking loop, a Tustin F1 and a bus n ticks late.
    """
    tick_s = 1e-6
    limit = 2.0 * math.sin(math.pi / (2.0 * (2 * n + 1)))
    for factor in (0.97, 1.03):
        ratio = factor * limit
        designed = design(CAR, DesignSpecification(tau_s=tick_s / ratio, feedback=False))
        loop = loop_of(designed, Target(tick_s), late=n)
        polynomial = np.zeros(n + 2)
        polynomial[0], polynomial[1], polynomial[-1] = 1.0, -1.0, ratio - (n == 0)
        if n == 0:
            polynomial = np.array([1.0, ratio - 1.0])
        fastest = np.abs(np.roots(polynomial)).max()
        assert (fastest < 1.0) == (factor < 1.0)
        assert (loop.spectral_radius() < 1.0) == (factor < 1.0)
        if factor > 1.0:
            assert loop.spectral_radius() == pytest.approx(fastest, abs=1e-4)


def turns_after_the_loss(designed: ContinuousDesign, tick_s: float, n: int) -> int:
    """How many poles the loop without torque has outside the unit circle, by the argument.

    D* is q z⁻ⁿ d̂, d̂ = z⁻ⁿ G1 u1 and u1 = Q (r - D* + z⁻ⁿ G1 u1): 1 - Q G1 z⁻ⁿ (1 - q z⁻ⁿ) = 0.
    """
    filters = discretise(designed, Target(tick_s, n, "zoh"))
    angle = np.linspace(0.0, 2.0 * math.pi, 40_001)
    z = np.exp(1j * angle)
    late = z**-n
    q_g1 = filters.tracking(z) * filters.estimator_1(z)
    q = filters.compensator(z) * filters.estimator_2(z)
    curve = np.unwrap(np.angle(1.0 - q_g1 * late * (1.0 - q * late)))
    return -round((curve[-1] - curve[0]) / (2.0 * math.pi))


def test_the_scan_of_latencies_ends_at_its_most_or_before_its_first():
    assert largest_latency_survived(SLOW, Target(1e-3), CAR, most=1) == 1
    assert largest_latency_survived(PUBLISHED, Target(1e-2), CAR) is None


@pytest.mark.compiled
def test_largest_latency_is_where_the_scan_ends():
    assert largest_latency_survived(SLOW, Target(1e-3), CAR, most=3) == 3
    most = largest_latency_survived(PUBLISHED, Target(1e-3, 5, "zoh"), CAR)
    assert most is not None
    counts = [turns_after_the_loss(PUBLISHED, 1e-3, n) for n in range(most + 2)]
    assert counts[:-1] == [0] * (most + 1)
    assert counts[-1] > 0


def grows(trace: Any) -> bool:
    """Whether the last quarter is larger than the one before it."""
    size = np.abs(trace.measurement)
    quarter = len(size) // 4
    return bool(size[-quarter:].max() > size[-2 * quarter : -quarter].max())


@pytest.mark.compiled
@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD])
@pytest.mark.parametrize("rule", ["tustin", "zoh"])
def test_stable_at_the_delay_margin_and_unstable_beyond_in_simulation(rule, left):
    """Both actuators wait for k ticks more than the controller knows."""
    tick_s, ticks = 1e-3, 1500
    table = build(SLOW, Target(tick_s, 1, rule))
    figures = margins(table, CAR, tick_s, left)
    assert figures.delay_margin_ticks is not None
    assert figures.delay_margin_s is not None
    whole = figures.delay_margin_ticks
    assert whole * tick_s <= figures.delay_margin_s <= (whole + 1) * tick_s
    for late, stable in ((whole, True), (whole + 1, False)):
        plant = sample(replace(CAR, dead_times_s=(late * tick_s, late * tick_s)), tick_s)
        pulse = np.where(np.arange(ticks) < 5, 1.0, 0.0)
        trace = simulate(table, plant, pulse, effectiveness=np.tile(left, (ticks, 1)))
        assert grows(trace) != stable


@pytest.mark.compiled
def test_the_edge_in_seconds_has_its_poles_on_the_circle():
    tick_s = 1e-3
    for designed, target in ((PUBLISHED, Target(tick_s)), (SLOW, Target(tick_s, 1, "zoh"))):
        figures = margins(build(designed, target), CAR, tick_s)
        assert figures.delay_margin_s is not None
        edge = figures.delay_margin_s / tick_s
        assert loop_of(designed, target, late=edge).spectral_radius() < 1.0
        assert loop_of(designed, target, late=edge + 1e-3).spectral_radius() > 1.0
        assert loop_of(designed, target, late=edge).spectral_radius() == pytest.approx(
            1.0, abs=1e-6
        )


def test_delay_margin_of_a_fast_bus_is_that_of_its_crossovers():
    """Above 32 ticks no eigenvalue is asked; they would have said the same."""
    target = Target(2e-4, 1, "zoh")
    figures = margins(build(SLOW, target), CAR, 2e-4)
    assert figures.delay_margin_ticks is not None
    assert figures.delay_margin_ticks > EXACT_DELAY_TICKS
    for late, stable in ((0, True), (1, False)):
        radius = loop_of(SLOW, target, late=figures.delay_margin_ticks + late).spectral_radius()
        assert (radius < 1.0) == stable


def test_a_loop_that_amplifies_at_nyquist_survives_no_whole_tick():
    """x⁺ = -1.5 x + 1.2 y: L(-1) = -2.4, and a tick later z² + 1.5 z - 1.2 = 0 has -2.08."""
    loop = scalar_loop(-1.5, 1.2)
    assert loop.loop_gain(np.array([-1.0 + 0j]))[0] == pytest.approx(-2.4)
    assert np.abs(np.roots([1.0, 1.5, -1.2])).max() > 2.0
    whole, ticks = delay_margins(loop, lambda delay: 1.0 + (delay - 0.3))
    assert whole == 0
    assert ticks == pytest.approx(0.3, abs=1e-6)
