"""Delay that a loop survives: against simulation at and beyond the edge, and closed formulas."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.delay_margin import EXACT_DELAY_TICKS, delay_margins
from firmware_model.analysis.margins import (
    HEALTHY,
    TORQUE_DEAD,
    is_stable_in,
    largest_latency_survived,
    margins,
)
from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.target.structs import MAX_LATENCY_TICKS
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


def test_published_tuning_survives_few_ticks_of_latency() -> None:
    """1 kHz: right at n = 0, from n = 1 diverging after the fault; 2 kHz: from 2; 10 kHz: never."""
    ends = (HEALTHY, TORQUE_DEAD)
    for tick_s, first_bad in ((1e-3, 1), (5e-4, 2), (1e-4, 3)):
        for n in range(3):
            target = Target(tick_s, n, "zoh")
            assert is_stable_in(PUBLISHED, target, CAR, [HEALTHY])
            assert is_stable_in(PUBLISHED, target, CAR, ends) == (n < first_bad)
    assert largest_latency_survived(PUBLISHED, Target(1e-3, 5, "zoh"), CAR) == 0
    assert largest_latency_survived(PUBLISHED, Target(5e-4, 5, "zoh"), CAR) == 1


def test_largest_latency_is_where_the_scan_ends() -> None:
    assert largest_latency_survived(SLOW, Target(1e-3), CAR, most=3) == 3
    assert largest_latency_survived(PUBLISHED, Target(1e-2), CAR) is None
    most = largest_latency_survived(SLOW, Target(4e-3, estimator="zoh"), CAR, [HEALTHY])
    assert most is not None
    assert 0 < most < MAX_LATENCY_TICKS
    for latency, stable in ((most, True), (most + 1, False)):
        assert is_stable_in(SLOW, Target(4e-3, latency, "zoh"), CAR, [HEALTHY]) == stable


def grows(trace: Any) -> bool:
    """Whether the last quarter is larger than the one before it."""
    size = np.abs(trace.measurement)
    quarter = len(size) // 4
    return bool(size[-quarter:].max() > size[-2 * quarter : -quarter].max())


@pytest.mark.long
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
    whole, ticks = delay_margins(loop, lambda delay: delay < 0.3)
    assert whole == 0
    assert ticks == pytest.approx(0.3, abs=1e-6)
