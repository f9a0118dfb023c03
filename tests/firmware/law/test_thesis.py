"""The thesis's law alone: scipy's filters of its own commands, and inputs that are missing."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode
from tests.firmware.law.cases import DESIGN, TICK_S, late, through

TICKS = 40
DRAW = np.random.default_rng(4)
REFERENCE, MEASURED = 0.02 * np.cumsum(DRAW.standard_normal((2, TICKS)), axis=1)
FEEDING = ["tustin", "tustin-held", "zoh"]


def run(target: Target, reference: NDArray[Any], measured: NDArray[Any]) -> dict[str, Any]:
    table = build(DESIGN, target)
    state, rows = controller.init(table)[0], []
    names = ("command_1", "command_2", "fault_estimate", "mode", "fault_state")
    for r, y in zip(reference, measured, strict=True):
        controller.step(table, state, r, y)
        rows.append([float(state[name]) for name in names])
    return dict(zip(names, np.array(rows).T, strict=True))


@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("rule", FEEDING)
def test_alone_the_law_is_the_filters_of_chapter_3(rule, latency):
    """u1 = Q (r - y + G1 u1), d̂ = G1 u1 + G2 u2 - y, u2 = r2 + F̂ d̂, each a filter of scipy."""
    target = Target(TICK_S, latency, rule, supervised=False)
    told, filters = run(target, REFERENCE, MEASURED), discretise(DESIGN, target)
    model_1 = through(filters.estimator_1, late(told["command_1"], latency))
    model_2 = through(filters.estimator_2, late(told["command_2"], latency))
    asked = through(filters.tracking, REFERENCE - MEASURED + model_1)
    np.testing.assert_allclose(told["command_1"], asked, rtol=1e-9, atol=1e-9)
    d_hat = model_1 + model_2 - MEASURED
    np.testing.assert_allclose(told["fault_estimate"], d_hat, rtol=1e-9, atol=1e-9)
    carried = through(filters.compensator, d_hat)
    np.testing.assert_allclose(told["command_2"], carried, atol=1e-8 * np.abs(carried).max())
    assert (told["mode"] == Mode.RUN).all()
    assert (told["fault_state"] == FaultState.CLEAR).all()


@pytest.mark.parametrize("which", ["reference", "measurement"])
def test_a_missing_input_keeps_its_last_value(which):
    given = {"reference": REFERENCE.copy(), "measurement": MEASURED.copy()}
    held = {name: values.copy() for name, values in given.items()}
    given[which][20:25], held[which][20:25] = np.nan, held[which][19]
    target = Target(TICK_S, 1, "zoh", supervised=False)
    told = run(target, given["reference"], given["measurement"])
    expected = run(target, held["reference"], held["measurement"])
    for name in ("command_1", "command_2", "fault_estimate"):
        np.testing.assert_array_equal(told[name], expected[name])
    assert np.flatnonzero(told["mode"] == Mode.BLIND).tolist() == [*range(20, 25)]


def test_an_overflow_holds_the_commands():
    reference = REFERENCE.copy()
    reference[20] = 1e308
    told = run(Target(TICK_S, supervised=False), reference, MEASURED)
    assert told["mode"][20] == Mode.BLIND
    assert told["command_1"][20] == told["command_1"][19]
    assert math.isfinite(told["command_2"][20])
