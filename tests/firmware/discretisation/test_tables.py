"""From a design to the table, and everything a target refuses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_model.design.continuous_design import (
    ContinuousDesign,
    DesignSpecification,
    design,
)
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tables import algebraic_loop_gain, build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.errors import DesignError, ParameterError
from tests.firmware.discretisation.test_coprime import PENDULUM

DESIGN = design(steer_by_wire(), DesignSpecification())
UNSTABLE = design(PENDULUM, DesignSpecification(alpha=2, tau_q_s=0.05, alpha_q=3))


@given(tau_s=st.floats(1e-4, 1.0), tick_s=st.floats(1e-4, 1e-2))
def test_algebraic_loop_gain_is_that_of_the_text(tau_s: float, tick_s: float) -> None:
    """F̂ and Tustin's G2 together are q, so the gain is T/(2τ+T); 1/3 at T = τ."""
    filters = discretise(design(steer_by_wire(), DesignSpecification(tau_s=tau_s)), Target(tick_s))
    assert algebraic_loop_gain(filters, 0) == pytest.approx(tick_s / (2 * tau_s + tick_s), rel=1e-9)


@pytest.mark.parametrize(("latency", "rule"), [(1, "tustin"), (0, "zoh"), (0, "tustin-held")])
def test_no_loop_within_the_tick_when_the_command_acts_later(latency: int, rule: Any) -> None:
    target = Target(1e-3, latency, rule)
    assert algebraic_loop_gain(discretise(DESIGN, target), latency) == 0.0
    assert build(DESIGN, target).compensator.loop_inverse == 1.0


def test_a_loop_gain_of_one_or_more_is_refused() -> None:
    """1 + Q with a high-frequency gain of 10 amplifies 1/3 to more than 1."""
    q = ZeroPoleGain((-10.0,), (-100.0,), 10.0).scaled(1.0)
    steep = design(steer_by_wire(), DesignSpecification(q=q))
    with pytest.raises(DesignError, match="algebraic loop"):
        build(steep, Target(1e-3))
    build(steep, Target(1e-3, estimator="zoh"))


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("designed", [DESIGN, UNSTABLE], ids=["stable", "unstable"])
def test_the_table_is_the_filters(designed: ContinuousDesign, precision: Any) -> None:
    target = Target(1e-3, 2, "zoh", precision=precision, limit_1=10.0, lsb_2=0.5)
    table, filters = build(designed, target), discretise(designed, target)
    estimator = table.estimator
    assert table.tracking.excuses_limits == (designed is DESIGN)
    assert (filters.stabiliser is None) == (designed is DESIGN)
    none = Sections(np.zeros((0, 5)), target.tick_s)
    for cascade, sections in (
        (table.tracking.filter, filters.tracking),
        (table.tracking.stabiliser, filters.stabiliser or none),
        (estimator.measurement, filters.measurement),
        (estimator.channel_1, filters.estimator_1),
        (estimator.channel_2, filters.estimator_2),
        (estimator.one_plus_q, filters.one_plus_q),
        (table.compensator.filter, filters.compensator),
    ):
        n, stored = len(sections.coefficients), cascade.coefficients
        assert cascade.n == n
        assert stored.dtype == np.dtype(precision)
        np.testing.assert_array_equal(stored[:n], sections.coefficients.astype(precision))
        np.testing.assert_array_equal(stored[n:], 0.0)
    assert (table.actuator_1.limit, table.actuator_2.lsb) == (10.0, 0.5)
    assert math.isinf(table.actuator_2.limit)
    assert estimator.latency_ticks == 2


def test_the_table_is_constant() -> None:
    with pytest.raises(ValueError, match="read-only"):
        build(DESIGN, Target(1e-3)).actuator_1.limit = 1.0


@pytest.mark.parametrize("tick_s", [0.0, math.nan])
def test_a_tick_that_is_no_tick_is_refused(tick_s: float) -> None:
    with pytest.raises(ParameterError, match="tick_s"):
        build(DESIGN, Target(tick_s))
