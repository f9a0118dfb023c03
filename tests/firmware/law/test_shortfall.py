"""What an actuator could not do: how the next commands make up for it."""

from dataclasses import replace

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import Trace, simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray

CAR = steer_by_wire()
DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.01, alpha_q=3))
TICK_S, LATENCY = 0.001, 1


def driven(of: Target, makes_up: bool, reference: FloatArray, **how: FloatArray) -> Trace:
    """The car, with and without make-up."""
    table = build(DESIGN, of).copy()
    if not makes_up:
        table.shortfall_1.gain[:] = table.shortfall_2.gain[:] = 0.0
    return simulate(table, sample(CAR, TICK_S), reference, **how)


@pytest.mark.compiled
@pytest.mark.parametrize("rate", [1000.0, 5000.0, 50_000.0, np.inf])
def test_what_a_limit_took_is_given_back(rate):
    """The squares of what D* misses are fewer, whatever the rate, and nothing swings."""
    limit, step = 60.0, np.ones(4000)  # 42.5 hold 1 m/s²
    of = Target(TICK_S, LATENCY, "zoh", limit_1=limit, rate_1=rate, on_confirmation=True)
    alone, made_up = driven(of, False, step), driven(of, True, step)
    ideal = driven(Target(TICK_S, LATENCY, "zoh", on_confirmation=True), True, step).measurement
    left, right = (((t.measurement - ideal) ** 2).sum() for t in (made_up, alone))
    assert left < right
    assert np.abs(made_up.error[3000:]).max() < 1e-3
    assert np.abs(made_up.command_1).max() <= limit
    assert np.abs(np.diff(made_up.command_1)).max() <= rate * TICK_S * (1.0 + 1e-12)


@pytest.mark.compiled
def test_a_saturated_loss_is_made_up_when_the_demand_is_feasible():
    """1 m/s² takes 3 kN: 2.5 kN miss the demand, and 0.5 m/s² is feasible again."""
    free = Target(TICK_S, LATENCY, "zoh", on_confirmation=True)
    of = replace(free, limit_2=2500.0)
    reference = np.where(np.arange(5000) < 3000, 1.0, 0.5)
    left = np.ones((5000, 2))
    left[1000:, 0] = 0.0
    made_up, alone = (driven(of, it, reference, effectiveness=left) for it in (True, False))
    ideal = driven(free, True, reference, effectiveness=left).measurement
    assert abs(made_up.command_2[2900]) == 2500.0
    assert np.abs(made_up.error[3150:]).max() < 0.02
    left_over, right = (((t.measurement - ideal)[3000:] ** 2).sum() for t in (made_up, alone))
    assert left_over < 0.7 * right


def stalled(
    lost: range, tell: bool, latency: int = LATENCY, dead_from: int | None = None
) -> FloatArray:
    """D* of a car in a bend of 1 m/s² that gets no torque in the ticks ``lost``.

    Where the motor is dead from some tick on, it gets no force either.
    """
    firmware = Firmware(build(DESIGN, Target(TICK_S, latency, "zoh", on_confirmation=True)))
    plant = sample(CAR, TICK_S)
    state, measured, waiting = plant.rest, [], [(0.0, 0.0)] * latency
    for tick in range(lost.stop + 400):
        acting = waiting.pop(0)
        if tick in lost:
            acting = (0.0, acting[1] if dead_from is None else 0.0)
            firmware.act(*acting)
            if not tell:
                firmware._states[0].shortfall_1.accumulators[:] = 0.0
        measured.append(float(plant.c @ state))
        answer = firmware.step(1.0, measured[-1])
        waiting.append((answer.command_1, answer.command_2))
        if dead_from is not None and tick >= dead_from:
            acting = (0.0, acting[1])
            known = tick > dead_from + 100
            assert not known or answer.fault_state == FaultState.CONFIRMED, tick
        state = plant.phi @ state + plant.gamma @ acting
    return np.array(measured)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_commands_that_came_too_late_are_made_up_for(latency):
    lost = range(1000, 1020)
    made_up, alone = (np.abs(stalled(lost, tell, latency)[1000:] - 1.0) for tell in (True, False))
    unavoidable = made_up[: 20 + latency].max()
    assert alone.max() > 0.1
    assert made_up.max() < 0.025
    assert made_up.max() < 1.5 * unavoidable
    assert made_up[60:].max() < 0.02


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [1, 3])
def test_a_lost_motor_stays_lost_while_commands_come_too_late(latency):
    lost = range(1000, 1020)
    away = np.abs(stalled(lost, True, latency, dead_from=600)[1000:] - 1.0)
    unavoidable = away[: 20 + latency].max()
    assert unavoidable > 0.1
    assert away.max() < 1.5 * unavoidable
    assert away[150:].max() < 0.02
