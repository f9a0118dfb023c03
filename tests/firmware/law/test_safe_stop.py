"""Both actuators are lost: the commands go to zero in a straight line, and stay there."""

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode, Verdict
from tests.firmware.analysis.loops import SLOW as DESIGN

TICK_S = 0.001
TICKS = 20


def lost(safe_stop_s: float = TICKS * TICK_S, **changes: Any) -> tuple[Any, Any]:
    """In the tick after the verdict, with commands on both channels."""
    table = build(DESIGN, Target(TICK_S, 1, "zoh", safe_stop_s=safe_stop_s, **changes))
    state = controller.init(table)[0]
    controller.step(table, state, 0.0, 0.0)
    state.command_1, state.command_2 = 8.0, -400.0
    state.supervision.hypotheses.verdict = Verdict.BOTH_LOST
    state.monitor.powerless = table.safe_stop.certain
    return table, state


def commands(table: Any, state: Any, ticks: int, y: float = 0.3) -> np.ndarray:
    """Of the next ticks, (2, ticks)."""
    found = []
    for _ in range(ticks):
        controller.step(table, state, 1.0, y)
        found.append((float(state.command_1), float(state.command_2)))
    return np.array(found).T


@pytest.mark.parametrize("y", [0.3, math.nan])
def test_they_go_to_zero_in_a_straight_line_whatever_is_measured(y):
    table, state = lost()
    found = commands(table, state, TICKS + 5, y)
    line = np.maximum(1.0 - np.arange(1, TICKS + 6) / TICKS, 0.0)
    np.testing.assert_allclose(found, np.outer([8.0, -400.0], line), atol=1e-12)
    assert state.mode == Mode.SAFE_STOP
    assert (found[:, TICKS:] == 0.0).all()


def test_a_resolution_and_a_rate_are_kept_to_on_the_way():
    table, state = lost(lsb_1=0.01, lsb_2=0.5, rate_2=5000.0)
    torque, force = commands(table, state, 100)
    assert np.abs(torque[:TICKS] - 8.0 * (1.0 - np.arange(1, TICKS + 1) / TICKS)).max() < 0.011
    np.testing.assert_allclose(np.diff([-400.0, *force])[:79], 5.0)  # 20 in a tick were asked for
    assert torque[-1] == force[-1] == 0.0


def test_without_a_duration_the_verdict_changes_no_command():
    found = []
    for verdict in (Verdict.NOTHING, Verdict.BOTH_LOST):
        table, state = lost(0.0)
        state.supervision.hypotheses.verdict = verdict
        found.append(commands(table, state, 3))
        assert state.mode == Mode.RUN
    np.testing.assert_array_equal(*found)


@pytest.mark.parametrize(
    ("fault_state", "verdict", "missing", "mode"),
    [
        (FaultState.CLEAR, Verdict.BOTH_LOST, 0.0, Mode.SAFE_STOP),
        (FaultState.CONFIRMED, Verdict.NOTHING, 0.0, Mode.SAFE_STOP),
        (FaultState.CLEAR, Verdict.BOTH_LOST, 1.0, Mode.RUN),
        (FaultState.CONFIRMED, Verdict.NOTHING, 1.0, Mode.RUN),
        (FaultState.SUSPECTED, Verdict.FORCE_LOST, 0.0, Mode.RUN),
    ],
)
def test_a_lost_torque_and_commands_without_effect_stop(fault_state, verdict, missing, mode):
    table, state = lost()
    assert table.safe_stop.certain == pytest.approx(0.3 / TICK_S)
    state.fault_state, state.supervision.hypotheses.verdict = fault_state, verdict
    state.monitor.powerless = table.safe_stop.certain - missing
    commands(table, state, 3)
    assert state.mode == mode
    assert (state.supervision.hypotheses.verdict == Verdict.BOTH_LOST) == (mode == Mode.SAFE_STOP)


def test_it_ends_with_a_reset_and_begins_anew():
    table, state = lost()
    commands(table, state, 7)
    controller.reset(table, state, 0.0)
    first = commands(table, state, 1)
    assert state.mode == Mode.RUN
    assert np.abs(first).max() > 0.0
    state.command_1, state.command_2 = 8.0, -400.0
    state.supervision.hypotheses.verdict = Verdict.BOTH_LOST
    state.monitor.powerless = table.safe_stop.certain
    np.testing.assert_allclose(commands(table, state, 1)[:, 0], [7.6, -380.0])


@pytest.mark.parametrize("duration_s", [-1.0, math.inf, math.nan])
def test_a_duration_must_be_a_time(duration_s):
    with pytest.raises(ParameterError, match=r"safe_stop_s = .*: must be finite and 0 or above"):
        Target(TICK_S, safe_stop_s=duration_s)
