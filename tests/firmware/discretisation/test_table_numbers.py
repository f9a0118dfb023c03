"""Each number of the table from what it means, computed another way than the table is filled."""

from __future__ import annotations

import cmath
import math
from typing import Any

import numpy as np
import pytest

from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.discretisation import tables
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.errors import DesignError, ParameterError
from firmware_model.target.structs import MAX_SECTIONS

CLOSED = design(steer_by_wire(), DesignSpecification())
OPEN = design(chapter_2(), DesignSpecification(feedback=False))
TICKS_S = (5e-4, 1e-3, 5e-3)
FAR = np.array([1e9 + 0j])  # z → ∞


def at_infinity(sections: Sections) -> float:
    return float(sections(FAR)[0].real)


@pytest.mark.parametrize("tick_s", TICKS_S)
def test_memories_keep_a_part_in_e_over_their_time_constants(tick_s: float) -> None:
    table = build(CLOSED, Target(tick_s))
    for memory, time_constant_s in (
        (table.loss_model.memory, 0.05),
        (table.adaptive_threshold.change_memory, 0.02),
        (table.adaptive_threshold.peak_memory, 0.6),
        (table.decision.share_memory, 1.0),
    ):
        assert memory ** (time_constant_s / tick_s) == pytest.approx(math.exp(-1.0), rel=1e-12)
    assert table.bumpless_transfer.slowest_pace == pytest.approx(tick_s / 0.05, rel=1e-12)


def test_a_tick_that_leaves_no_memory_still_has_a_pace() -> None:
    """exp(-T/0.05 s) is 0 for a tick of a minute, and its logarithm no number."""
    table = build(OPEN, Target(60.0))
    assert table.loss_model.memory == 0.0
    assert 700.0 < table.bumpless_transfer.slowest_pace < 710.0


@pytest.mark.parametrize("tick_s", TICKS_S)
@pytest.mark.parametrize(
    ("plan", "acceleration", "enabled"),
    [(CLOSED, 250.0, 1), (CLOSED, math.inf, 0), (OPEN, 250.0, 0), (OPEN, math.inf, 0)],
    ids=["closed", "closed, no limit", "open", "open, no limit"],
)
def test_the_reference_shaper_belongs_to_a_loop_and_a_limit(
    plan: ContinuousDesign, acceleration: float, enabled: int, tick_s: float
) -> None:
    """Its acceleration is a second difference: that of a t²/2 is a T²."""
    shaper = build(plan, Target(tick_s, reference_acceleration=acceleration)).reference_shaper
    assert shaper.enabled == enabled
    if enabled:
        parabola = acceleration * (np.arange(3) * tick_s) ** 2 / 2
        assert shaper.acceleration == pytest.approx(np.diff(parabola, 2)[0], rel=1e-9)


@pytest.mark.parametrize("tick_s", TICKS_S)
def test_tracking_of_the_closed_loop(tick_s: float) -> None:
    tracking = build(CLOSED, Target(tick_s)).tracking
    assert (tracking.feedback, tracking.integrates) == (1.0, 1)
    c = discretise(CLOSED, Target(tick_s)).tracking
    assert tracking.conditioning * at_infinity(c) == pytest.approx(1.0, rel=1e-6)
    # The command that holds y = 1 with G1(0): what the car at rest in a bend needs.
    g1_at_rest = CLOSED.plant.g1(np.array([0j]))[0].real
    assert tracking.steady_command * g1_at_rest == pytest.approx(1.0, rel=1e-9)


def test_in_open_loop_the_reference_is_the_command() -> None:
    table = build(OPEN, Target(1e-3))
    assert (table.tracking.feedback, table.tracking.integrates) == (0.0, 0)
    assert (table.tracking.conditioning, table.tracking.steady_command) == (1.0, 1.0)
    assert table.tracking.filter.n == 1
    assert table.tracking.filter.coefficients[0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]
    assert table.compensator.reference_share == 1.0


def test_without_compensation_nothing_is_added() -> None:
    table = build(design(steer_by_wire(), DesignSpecification(compensation=False)), Target(1e-3))
    assert not table.compensator.filter.coefficients.any()
    assert (table.compensator.feedthrough, table.compensator.loop_inverse) == (0.0, 1.0)
    assert table.compensator.reference_share == 0.0


@pytest.mark.parametrize("latency", [0, 1, 2])
def test_what_acts_within_the_tick(latency: int) -> None:
    """G2 sees this tick's command only if it acts at once; 1 + Q always sees this tick's sample."""
    target = Target(1e-3, latency)
    filters, table = discretise(CLOSED, target), build(CLOSED, target)
    expected = at_infinity(filters.estimator_2) if latency == 0 else 0.0
    assert table.estimator.feedthrough_2 == pytest.approx(expected, rel=1e-6)
    assert table.estimator.one_plus_q_feedthrough == pytest.approx(
        at_infinity(filters.one_plus_q), rel=1e-6
    )
    assert table.compensator.feedthrough == pytest.approx(
        at_infinity(filters.compensator), rel=1e-6
    )
    # u2 = F̂ d̂ with d̂ = … + gain · u2 and gain T/(2τ+T) = 1/3 for τ = T: once around is 1.5.
    assert table.compensator.loop_inverse == pytest.approx(1.5 if latency == 0 else 1.0, rel=1e-9)


def test_limits_of_a_second_become_those_of_a_tick() -> None:
    target = Target(2e-3, rate_1=50.0, rate_2=7.0, limit_1=3.0, limit_2=4.0, lsb_1=0.5, lsb_2=0.25)
    table = build(CLOSED, target)
    for actuator, slew, limit, lsb in (
        (table.actuator_1, 0.1, 3.0, 0.5),
        (table.actuator_2, 0.014, 4.0, 0.25),
    ):
        assert (actuator.slew, actuator.limit, actuator.lsb) == (pytest.approx(slew), limit, lsb)


def test_what_is_asked_for_the_decision() -> None:
    target = Target(
        1e-3, threshold=0.3, model_share=0.2, clear_ratio=0.15, confirm_ticks=7, clear_ticks=11,
        on_confirmation=True,
    )  # fmt: skip
    table = build(CLOSED, target)
    threshold, decision = table.adaptive_threshold, table.decision
    assert (threshold.threshold, threshold.model_share, threshold.clear_ratio) == (0.3, 0.2, 0.15)
    assert (decision.confirm_ticks, decision.clear_ticks) == (7, 11)
    assert table.compensator.on_confirmation == 1
    assert build(CLOSED, Target(1e-3)).compensator.on_confirmation == 0


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("probe_rad_per_s", [10.0, 33.0])
def test_the_probe_is_two_whole_periods_of_its_sine(probe_rad_per_s: float, latency: int) -> None:
    tick_s = 1e-3
    target = Target(tick_s, latency, probe=0.6, probe_rad_per_s=probe_rad_per_s)
    probe = build(CLOSED, target).probe
    assert abs(probe.ticks * tick_s - 2 * 2 * math.pi / probe_rad_per_s) <= tick_s / 2
    assert probe.amplitude == 0.3
    assert probe.least_share == 0.4
    rotation = complex(*probe.rotation)
    assert rotation**probe.ticks == pytest.approx(1.0)
    assert cmath.phase(rotation) == pytest.approx(2 * math.pi / probe.ticks)
    # What G1 answers to the sine of that frequency, computed by running it until it has settled.
    omega = 2 * 2 * math.pi / probe.ticks
    n = np.arange(40_000)
    command = np.exp(1j * omega * (n - latency))
    answer = run(discretise(CLOSED, target).estimator_1, command)
    assert complex(*probe.response) == pytest.approx(answer[-1] / np.exp(1j * omega * n[-1]))


def run(sections: Sections, signal: Any) -> Any:
    for b0, b1, b2, a1, a2 in sections.coefficients:
        out, first, second = np.empty_like(signal), 0j, 0j
        for k, u in enumerate(signal):  # y = (b0 δ² + b1 δ + b2) / (δ² + a1 δ + a2) u
            out[k] = b0 * u + first
            first, second = (
                first + (b1 * u - a1 * out[k]) + second,
                second + (b2 * u - a2 * out[k]),
            )
        signal = out
    return signal


@pytest.mark.parametrize("amplitude", [0.0, 0.5])
def test_a_table_has_a_probe_only_if_one_is_asked_for(amplitude: float) -> None:
    probe = build(CLOSED, Target(1e-3, probe=amplitude)).probe
    assert (probe.ticks > 0) == (amplitude > 0.0)
    assert probe.amplitude == amplitude / 2


def test_the_largest_filter_of_the_layout_is_built_and_one_more_is_not() -> None:
    alpha = 2 * MAX_SECTIONS - 3  # F̂ has three poles beside those of q
    largest = design(steer_by_wire(), DesignSpecification(alpha=alpha))
    assert build(largest, Target(1e-3)).compensator.filter.n == MAX_SECTIONS
    with pytest.raises(ParameterError, match=rf"order {2 * MAX_SECTIONS + 2} is more than"):
        build(design(steer_by_wire(), DesignSpecification(alpha=alpha + 1)), Target(1e-3))


@pytest.mark.parametrize("gain", [1.0, 1.5, math.nan])
def test_an_algebraic_loop_of_one_or_more_is_refused(
    gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "algebraic_loop_gain", lambda filters, latency: gain)
    with pytest.raises(DesignError, match="algebraic loop"):
        build(CLOSED, Target(1e-3))
