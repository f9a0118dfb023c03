"""The whole continuous design, and the class of every refusal."""

import math
from dataclasses import replace

import numpy as np
import pytest

from firmware_model.design.continuous_design import (
    DesignSpecification,
    compensator,
    design,
    fault_estimator,
    tracking,
)
from firmware_model.design.plants import Plant, chapter_2, steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import (
    AxisZeroError,
    ImproperError,
    ParameterError,
    UnstableFilterError,
    UnstablePlantError,
    ZeroChannelError,
)

PUBLISHED = DesignSpecification()
S = 1j * np.logspace(-2, 4, 25)


def _plant(numerator_1: list[float], numerator_2: list[float], denominator: list[float]) -> Plant:
    """Observer canonical form: [N1 N2]/D with the coefficients given, D monic."""
    n = len(denominator) - 1
    a = np.eye(n, k=1)
    a[:, 0] = -np.array(denominator[1:])
    b = np.zeros((n, 2))
    for column, numerator in enumerate((numerator_1, numerator_2)):
        b[n - len(numerator) :, column] = numerator
    return Plant.from_state_space("made", a, b, np.eye(1, n))


PRINTED = _plant(
    [2.0093, 46.2900, 413.5481],
    [0.0023, 0.00352, 0.8719, 5.8851],
    [1, 27.8684, 494.8547, 5616.1, 20333],
)


@pytest.mark.parametrize("plant", [steer_by_wire(), steer_by_wire(variant="published")])
def test_the_published_design(plant):
    whole = design(plant, PUBLISHED)
    assert whole.plant is plant
    assert whole.specification is PUBLISHED
    assert whole.estimator == fault_estimator(plant.coprime(0.001))
    assert whole.compensator == compensator(plant.g2, 0.001, 1)
    assert whole.tracking == tracking(plant.g1, 0.001, 2)
    assert (whole.inner, whole.outer) == (ZeroPoleGain.constant(1.0), plant.g2)


@pytest.mark.parametrize("plant", [steer_by_wire(), PRINTED])
def test_after_the_loss_the_loop_closes_through_channel_2(plant):
    """u1 = C e, d̂ = G1 u1, y = G2 F̂ d̂: 1/(1 + L) = (1 - q̂)/(1 - q̂ + q̂ q G2i)."""
    whole = design(plant, PUBLISHED)
    loop = plant.g2(S) * whole.compensator(S) * plant.g1(S) * whole.tracking.controller(S)
    q, q_hat = ZeroPoleGain.lag(0.001, 1)(S), ZeroPoleGain.lag(0.001, 2)(S)
    expected = (1 - q_hat) / (1 - q_hat + q_hat * q * whole.inner(S))
    assert 1 / (1 + loop) == pytest.approx(expected, rel=1e-8)


def test_printed_3_36_is_factored_and_its_channel_1_tracked():
    whole = design(PRINTED, PUBLISHED)
    assert whole.inner.zeros[0] == pytest.approx(2.37 + 20.1j, abs=0.05)
    assert whole.compensator.is_stable()


def test_what_is_not_asked_for_is_not_refused():
    axis_zero = _plant([1, 0], [1, 3], [1, 3, 2])
    assert design(axis_zero, DesignSpecification(feedback=False)).tracking is None
    double_lag = _plant([1, 1], [2], [1, 3, 2])
    assert design(double_lag, DesignSpecification(compensation=False)).compensator is None
    mute = DesignSpecification(q=ZeroPoleGain.constant(-1.0), compensation=False)
    assert design(chapter_2(), mute).estimator.one_plus_q.gain == 0


@pytest.mark.parametrize(
    ("plant", "change", "error", "named"),
    [(chapter_2(), {"q": ZeroPoleGain((), (1, -2), 1.0)}, UnstableFilterError, "Q has a pole at 1"),
     (chapter_2(), {"q": ZeroPoleGain((-1,), (), 1.0)}, ImproperError, "Q has 1 zeros"),
     (chapter_2(), {"q": ZeroPoleGain.constant(-1.0)}, ZeroChannelError, "q = -1"),
     (_plant([1, 3], [1, 0], [1, 3, 2]), {}, AxisZeroError, "zero at 0"),
     (_plant([1, 3], [2], [1, 3, 2]), {}, ImproperError, "alpha must be at least 2"),
     (_plant([1, 3], [1, -1], [1, 1, -2]), {}, UnstablePlantError,
      r"input 2 does not reach the unstable mode at 1 rad/s"),
     (_plant([1, -1], [2, -2], [1, 1, -2]), {}, UnstablePlantError,
      "no input moves the output through the unstable mode at 1 rad/s"),
     (_plant([1, 3], [1, 4], [1, 1, -2]), {"feedback": False}, UnstablePlantError,
      "pole at 1.* without feedback"),
     (_plant([1, 0], [1, 3], [1, 3, 2]), {}, AxisZeroError, "G1 has a zero at 0"),
     (steer_by_wire(), {"alpha_q": 1}, ImproperError, "alpha_q must be at least 2"),
     (steer_by_wire(replace(TABLE_3_2, lateral_weight=0.0)), {}, ImproperError,
      "alpha_q must be at least 3")],
)  # fmt: skip
def test_every_assumption_has_its_error(plant, change, error, named):
    with pytest.raises(error, match=named):
        design(plant, replace(PUBLISHED, **change))


@pytest.mark.parametrize(
    ("field", "alone"),
    [("tau_s", lambda value: compensator(chapter_2().g2, value, 1)),
     ("tau_q_s", lambda value: tracking(chapter_2().g1, value, 2)),
     ("alpha", lambda value: compensator(chapter_2().g2, 0.001, value)),
     ("alpha_q", lambda value: tracking(chapter_2().g1, 0.001, value))],
)  # fmt: skip
def test_numbers_of_no_filter_are_refused_by_name(field, alone):
    """By the specification, and where a part is designed alone."""
    is_time = field.startswith("tau")
    meant = "finite and > 0" if is_time else "an integer >= 1"
    for value in (0.0, -1.0, math.nan, math.inf) if is_time else (0, -1, 1.0, 1.5, True, "2"):
        for made in (alone, lambda value: replace(PUBLISHED, **{field: value})):
            with pytest.raises(ParameterError, match=rf"^{field} = {value!r}: must be {meant}"):
                made(value)
