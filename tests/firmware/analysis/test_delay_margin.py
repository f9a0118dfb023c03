"""Delay that a loop survives: against simulation at and beyond the edge, and closed formulas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.margins import (
    EXACT_DELAY_TICKS,
    HEALTHY,
    TORQUE_DEAD,
    delay_margins,
    is_stable_in,
    largest_latency_survived,
    margins,
)
from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import (
    ContinuousDesign,
    DesignSpecification,
    design,
)
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from tests.firmware.analysis.loops import CAR, PUBLISHED, SLOW, loop_of, scalar_loop


@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_high_frequency_limit_of_an_estimator_that_ignores_the_delay(n: int) -> None:
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


@pytest.mark.compiled
def test_published_tuning_survives_as_much_latency_as_its_characteristic_equation_says() -> None:
    """The longer the tick, the fewer of them; a healthy car takes any, F1 has the bus in it."""
    survived = []
    for tick_s in (1e-3, 5e-4):
        unstable = [n for n in range(32) if turns_after_the_loss(PUBLISHED, tick_s, n)]
        survived.append(unstable[0] - 1)
        for n in (0, unstable[0] - 1, unstable[0], unstable[0] + 1):
            target = Target(tick_s, n, "zoh")
            assert is_stable_in(PUBLISHED, target, CAR, [HEALTHY])
            assert is_stable_in(PUBLISHED, target, CAR, [TORQUE_DEAD]) == (n not in unstable)
    assert 1 < survived[0] < survived[1]


def test_the_scan_of_latencies_ends_at_its_most_or_before_its_first() -> None:
    assert largest_latency_survived(SLOW, Target(1e-3), CAR, most=1) == 1
    assert largest_latency_survived(PUBLISHED, Target(1e-2), CAR) is None


@pytest.mark.compiled
def test_largest_latency_is_where_the_scan_ends() -> None:
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
def test_stable_at_the_delay_margin_and_unstable_beyond_in_simulation(
    rule: Any, left: tuple[float, float]
) -> None:
    """The bus is k ticks later than the controller knows: y at the car k ticks late, by noise."""
    tick_s, ticks = 1e-3, 1500
    table = build(SLOW, Target(tick_s, 1, rule))
    figures = margins(table, CAR, tick_s, left)
    assert figures.delay_margin_ticks is not None
    assert figures.delay_margin_s is not None
    whole = figures.delay_margin_ticks
    assert whole * tick_s <= figures.delay_margin_s <= (whole + 1) * tick_s
    for late, stable in ((whole, True), (whole + 1, False)):
        assert grows(simulate_late(table, tick_s, late, left, ticks)) != stable


def simulate_late(
    table: Any, tick_s: float, late: int, left: tuple[float, float], ticks: int
) -> Any:
    """The firmware against the sampled plant whose commands come ``late`` ticks later still."""
    from firmware_model.firmware import Firmware

    firmware, plant = Firmware(table), sample(CAR, tick_s)
    line = [(0.0, 0.0)] * (int(table.estimator.latency_ticks) + late)
    x, y = plant.rest, []
    for k in range(ticks):
        y.append(float(plant.c @ x))
        answer = firmware.step(1.0 if k < 5 else 0.0, y[-1])
        line.append((answer.command_1, answer.command_2))
        x = plant.phi @ x + plant.gamma @ (np.array(left) * line.pop(0))
    return type("Trace", (), {"measurement": np.array(y)})


def test_the_edge_in_seconds_has_its_poles_on_the_circle() -> None:
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


def test_delay_margin_of_a_fast_bus_is_that_of_its_crossovers() -> None:
    """Above 32 ticks no eigenvalue is asked; they would have said the same."""
    target = Target(2e-4, 1, "zoh")
    figures = margins(build(SLOW, target), CAR, 2e-4)
    assert figures.delay_margin_ticks is not None
    assert figures.delay_margin_ticks > EXACT_DELAY_TICKS
    for late, stable in ((0, True), (1, False)):
        radius = loop_of(SLOW, target, late=figures.delay_margin_ticks + late).spectral_radius()
        assert (radius < 1.0) == stable


def test_a_loop_that_amplifies_at_nyquist_survives_no_whole_tick() -> None:
    """x⁺ = -1.5 x + 1.2 y: L(-1) = -2.4, and a tick later z² + 1.5 z - 1.2 = 0 has -2.08."""
    loop = scalar_loop(-1.5, 1.2)
    assert loop.loop_gain(np.array([-1.0 + 0j]))[0] == pytest.approx(-2.4)
    assert np.abs(np.roots([1.0, 1.5, -1.2])).max() > 2.0
    whole, ticks = delay_margins(loop, lambda delay: 1.0 + (delay - 0.3))
    assert whole == 0
    assert ticks == pytest.approx(0.3, abs=1e-6)
