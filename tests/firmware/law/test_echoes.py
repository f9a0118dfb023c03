"""What the actuators report: the modelled output of a healthy actuator, and its weight."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.actuator_dynamics import IDEAL, Stage, behind
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Answer, Firmware
from firmware_model.law.fault_decision.echoes import KEPT_TICKS
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray
from tests.firmware.law.cases import CAR, TICK_S

LAGS = (Stage(0.005), Stage(0.015))
SLOW = Stage(natural_frequency_rad_per_s=80.0, damping=0.6, dead_time_s=0.003)
FAULT, END, RMS = 400, 900, 0.005


def table_of(
    actuators: tuple[Stage, Stage] = LAGS, latency: int = 1, echoes: bool = True, **changes: Any
) -> Any:
    plant = behind(CAR, *actuators, IDEAL)
    known = {"on_confirmation": True, "noise_rms": RMS, **changes}
    target = Target(TICK_S, latency, "zoh", echoes=actuators if echoes else None, **known)
    return build(
        design(plant, DesignSpecification(tau_s=0.002, alpha=4, tau_q_s=0.015, alpha_q=4)), target
    )


def outputs(stage: Stage, commands: FloatArray) -> FloatArray:
    """The output at each tick just before the command of that tick arrives; scipy's answer."""
    late = round(stage.dead_time_s / TICK_S)
    arrived = np.concatenate([np.zeros(late), commands])[: len(commands)]
    a, b, c = stage.realisation
    if not len(a):
        return np.concatenate([[0.0], arrived[:-1]])
    held = signal.cont2discrete((a, b[:, None], c[None, :], np.zeros((1, 1))), TICK_S)[:4]
    _, found = signal.dlsim((*held, TICK_S), arrived)[:2]
    return np.asarray(found[:, 0])


@pytest.mark.parametrize("latency", [0, 1, 3])
@pytest.mark.parametrize("actuators", [LAGS, (SLOW, IDEAL), (IDEAL, SLOW)])
def test_a_working_actuator_has_no_error_at_any_age(
    actuators: tuple[Stage, Stage], latency: int
) -> None:
    firmware = Firmware(table_of(actuators, latency, on_confirmation=False))
    draw, sent = np.random.default_rng(4), []
    firmware.step(0.0, 0.0)
    sent.append((0.0, 0.0))
    for k in range(150):
        answer = firmware.step(math.sin(0.05 * k), draw.normal(0.0, 0.3))
        sent.append((answer.command_1, answer.command_2))
    assert np.ptp(np.array(sent), axis=0).min() > 0.0
    for channel, stage in enumerate(actuators):
        commands = np.array(sent)[:, channel]
        acting = np.concatenate([np.zeros(latency), commands, [0.0]])[: len(commands) + 1]
        reported = outputs(stage, acting)  # of the tick to come, last
        for age in range(KEPT_TICKS):
            firmware.hear(channel + 1, float(reported[-1 - age]), age)
            error = firmware.echo_errors[channel]
            assert error == pytest.approx(0.0, abs=1e-9 * np.abs(commands).max())


class Car:
    """The car behind ``LAGS``, sampled by scipy, with what its actuators report."""

    def __init__(self) -> None:
        plant = behind(CAR, *LAGS, IDEAL)
        blank = np.zeros((1, 2))
        system = signal.cont2discrete((plant.a, plant.b, plant.c, blank), TICK_S)
        self.a, self.b, self.c = system[:3]
        self.x = np.zeros(len(self.a))
        self.commands = (0.0, 0.0)

    @property
    def y(self) -> float:
        return float(self.c[0] @ self.x)

    @property
    def outputs(self) -> tuple[float, float]:
        return float(self.x[-2]), float(self.x[-1])

    def go_on(self, *inputs: float) -> None:
        self.x = self.a @ self.x + self.b @ np.array(inputs)


def drive(
    table: Any,
    channel: int,
    acts: Any,
    reports: Any = None,
    sensor: Any = None,
) -> list[Answer]:
    """A sine; from FAULT on ``acts`` says what the actuator of ``channel`` makes of a command.

    ``reports``: what the echo makes of the actuator's output, and of the command; ``sensor``: the
    error of the sensor, by tick. An echo comes every 10 ticks.
    """
    firmware, car, answers = Firmware(table), Car(), []
    noise = np.random.default_rng(7).normal(0.0, RMS, END)
    for k in range(END):
        if k % 10 == 0 and reports is not None:
            for each in range(2):
                echo = car.outputs[each]
                if each == channel - 1 and k >= FAULT:
                    echo = reports(echo, car.commands[each])
                firmware.hear(each + 1, echo)
        y = car.y + noise[k] + (sensor(k) if sensor is not None and k >= FAULT else 0.0)
        inputs = list(car.commands)
        answer = firmware.step(math.sin(0.006 * k), y)
        if k >= FAULT:
            inputs[channel - 1] = acts(inputs[channel - 1], k)
        car.go_on(*inputs)
        car.commands = (answer.command_1, answer.command_2)
        answers.append(answer)
    return answers


def dead(_command: float, _tick: int) -> float:
    return 0.0


def working(command: float, _tick: int) -> float:
    return command


def honest(output: float, _command: float) -> float:
    return output


def confirmed_after(answers: list[Answer]) -> int:
    states = [answer.fault_state for answer in answers]
    assert FaultState.CONFIRMED in states
    found = states.index(FaultState.CONFIRMED)
    assert found >= FAULT
    return found - FAULT


@pytest.mark.compiled
def test_a_loss_is_confirmed_sooner_with_an_echo_and_later_against_one() -> None:
    alone = confirmed_after(drive(table_of(), 1, dead))
    told = confirmed_after(drive(table_of(), 1, dead, honest))
    denied = confirmed_after(drive(table_of(), 1, dead, lambda _, command: command))
    assert told < alone < denied < 2 * alone


@pytest.mark.compiled
def test_a_wandering_sensor_is_no_loss_where_the_echo_denies_the_loss() -> None:
    def wanders(k: int) -> float:
        return 0.02 * math.sin(0.012 * (k - FAULT)) ** 2

    def confirmed(answers: list[Answer]) -> bool:
        return any(answer.fault_state == FaultState.CONFIRMED for answer in answers)

    assert confirmed(drive(table_of(), 1, working, sensor=wanders))
    assert not confirmed(drive(table_of(), 1, working, honest, sensor=wanders))


@pytest.mark.compiled
def test_a_force_of_its_own_is_found_by_its_echo_and_is_no_loss_of_the_torque() -> None:
    def swings(_command: float, k: int) -> float:
        return 2500.0 * math.sin(0.015 * (k - FAULT))

    answers = drive(table_of(), 2, swings, honest)
    assert Verdict.FORCE_LOST in [answer.verdict for answer in answers]
    assert FaultState.CONFIRMED not in [answer.fault_state for answer in answers]
    alone = drive(table_of(), 2, swings)
    assert FaultState.CONFIRMED in [answer.fault_state for answer in alone]


@pytest.mark.compiled
@pytest.mark.parametrize("channel", [1, 2])
def test_a_wrong_echo_of_a_working_actuator_moves_nothing(channel: int) -> None:
    answers = drive(table_of(), channel, working, lambda output, _: -output - 50.0)
    without = drive(table_of(), channel, working)
    assert [answer[:2] for answer in answers] == [answer[:2] for answer in without]
    assert {answer.verdict for answer in answers} <= {Verdict.NOTHING, Verdict.ANOTHER_CAR}


@pytest.mark.compiled
@pytest.mark.parametrize("lost", [1, 2])
def test_a_law_that_hears_nothing_is_the_law_without_echoes(lost: int) -> None:
    assert drive(table_of(), lost, dead) == drive(table_of(echoes=False), lost, dead)


@pytest.mark.parametrize("echo", [(1, math.nan, 0.0), (1, 5.0, math.nan), (1, 5.0, -1.0),
                                  (2, 5.0, float(KEPT_TICKS)), (3, 5.0, 0.0)])  # fmt: skip
def test_what_is_no_echo_is_ignored(echo: tuple[int, float, float]) -> None:
    firmware = Firmware(table_of())
    firmware.step(1.0, 0.0)
    firmware.hear(*echo)
    assert firmware.echo_errors == (0.0, 0.0)


@pytest.mark.parametrize("channel", [1, 2])
def test_an_echo_counts_until_it_has_stayed_away_for_long(channel: int) -> None:
    table = table_of()
    firmware = Firmware(table)
    firmware.reset(0.0)
    firmware.hear(channel, -7.0)
    for _ in range(int(table.echoes.longest) - 1):
        assert firmware.echo_errors[channel - 1] == 7.0
        firmware.step(0.0, 0.0)
    firmware.step(0.0, 0.0)
    assert firmware.echo_errors == (0.0, 0.0)


def test_a_settled_actuator_has_followed_its_command() -> None:
    firmware = Firmware(table_of())
    firmware.reset(0.7)
    torque, force = firmware.commands
    firmware.hear(1, torque, 30.0)
    firmware.hear(2, force, 0.0)
    assert firmware.echo_errors == pytest.approx((0.0, 0.0), abs=1e-12)
    firmware.step(0.7, 0.7)
    firmware.hear(1, torque)
    assert firmware.echo_errors[0] == pytest.approx(0.0, abs=1e-9)
