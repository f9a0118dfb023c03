"""What the actuators report: the modelled output of a healthy actuator, and its weight."""

import math
from typing import Any

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Reporting, Target
from firmware_model.firmware import Answer, Firmware
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Verdict
from firmware_model.law.structs import FloatArray
from firmware_model.law.supervision.echoes import (
    FORCE,
    KEPT_TICKS,
    TORQUE,
    contradicts_share,
    moves,
    told_share,
)
from firmware_model.law.supervision.further_sensors import hear
from firmware_model.law.supervision.verdict import standing
from tests.firmware.law.cases import CAR, TICK_S, changed

LAGS = (Stage(0.005), Stage(0.015))
SLOW = Stage(natural_frequency_rad_per_s=80.0, damping=0.6, dead_time_s=0.003)
FAULT, END, RMS = 120, 420, 0.005


def table_of(
    actuators: tuple[Stage, Stage] = LAGS,
    latency: int = 1,
    echoes: bool = True,
    echo_rms: float = 0.0,
    **changes: Any,
) -> Any:
    plant = actuated(CAR, *actuators, IDEAL)
    reporting = Reporting(actuators[0], echo_rms), Reporting(actuators[1], echo_rms)
    known = {"on_confirmation": True, "noise_rms": RMS, **changes}
    target = Target(TICK_S, latency, "zoh", echoes=reporting if echoes else None, **known)
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


@pytest.mark.parametrize("latency", [0, 3])
@pytest.mark.parametrize("actuators", [LAGS, (IDEAL, SLOW), (SLOW, SLOW)])
def test_a_working_actuator_has_no_error_at_any_age(actuators, latency):
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
        plant = actuated(CAR, *LAGS, IDEAL)
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
    table: Any, acts: Any, hears: Any = None, sensor: Any = None, ticks: int = END
) -> list[Answer]:
    """A sine; from FAULT on ``acts`` makes what the actuators do of both commands and the tick.

    ``hears``: makes the echoes of outputs, commands and the tick, every 5 ticks; None: no echo is
    heard. ``sensor``: the error of the sensor, by ticks since FAULT.
    """
    firmware, car, answers = Firmware(table), Car(), []
    noise = np.random.default_rng(7).normal(0.0, RMS, ticks)
    for k in range(ticks):
        if hears is not None and k % 5 == 0:
            for channel, echo in enumerate(hears(car.outputs, car.commands, k), 1):
                firmware.hear(channel, echo)
        y = car.y + noise[k] + (sensor(k - FAULT) if sensor is not None and k >= FAULT else 0.0)
        inputs = car.commands
        answer = firmware.step(math.sin(0.01 * k), y)
        car.go_on(*(acts(*inputs, k - FAULT) if k >= FAULT else inputs))
        car.commands = (answer.command_1, answer.command_2)
        answers.append(answer)
    return answers


def dead(_torque: float, force: float, _k: int) -> tuple[float, float]:
    return 0.0, force


def working(torque: float, force: float, _k: int) -> tuple[float, float]:
    return torque, force


def both_dead(_torque: float, _force: float, k: int) -> tuple[float, float]:
    return 0.0, 0.0 if k > 60 else _force


def force_swings(torque: float, _force: float, k: int) -> tuple[float, float]:
    return torque, 3000.0 * math.sin(0.02 * k) if k < 150 else 0.0


def torque_swings(torque: float, force: float, k: int) -> tuple[float, float]:
    return torque + (20.0 * math.sin(0.015 * k) if k < 200 else 0.0), force


def honest(outputs: Any, _commands: Any, _k: int) -> Any:
    return outputs


def lying(_outputs: Any, commands: Any, _k: int) -> Any:
    return commands


def states(answers: list[Answer]) -> list[int]:
    return [answer.fault_state for answer in answers]


def verdicts(answers: list[Answer]) -> list[int]:
    return [answer.verdict for answer in answers]


def confirmed_after(answers: list[Answer]) -> int:
    found = states(answers).index(FaultState.CONFIRMED)
    assert found >= FAULT
    return found - FAULT


@pytest.mark.compiled
def test_a_loss_is_confirmed_sooner_with_an_echo_and_against_a_lying_one():
    alone, told, denied = (
        confirmed_after(drive(table_of(), dead, hears)) for hears in (None, honest, lying)
    )
    assert told < denied <= alone


def test_an_echo_that_denied_the_loss_does_not_end_the_loss():
    """First it repeats the command, later half of the command, which contradicts a whole loss."""

    def lying_by_halves(_outputs: Any, commands: Any, k: int) -> Any:
        return (commands[0] * (1.0 if k < FAULT + 45 else 0.5), commands[1])

    found = drive(table_of(echo_rms=1.0), dead, lying_by_halves, ticks=FAULT + 80)
    assert set(states(found)[FAULT + confirmed_after(found) :]) == {FaultState.CONFIRMED}


@pytest.mark.compiled
def test_a_gust_is_no_loss_for_the_echo_denies_it():
    def gust(k: int) -> float:
        return 0.4 * min(k / 300, 1.0)

    alone = drive(table_of(), working, honest, gust)
    assert FaultState.CONFIRMED in states(alone)
    told = drive(table_of(gust=0.35), working, honest, gust)
    assert FaultState.CONFIRMED not in states(told)
    assert Verdict.TORQUE_LOST not in verdicts(told)
    assert max(abs(answer.command_2) for answer in told) == 0.0


def test_a_force_of_its_own_is_found_by_its_echo_and_is_no_loss_of_the_torque():
    answers = drive(table_of(), force_swings, honest)
    assert FaultState.CONFIRMED not in states(answers)
    found = verdicts(answers).index(Verdict.FORCE_LOST)
    assert 0 < found - FAULT < 60
    assert set(verdicts(answers)[found : FAULT + 120]) == {Verdict.FORCE_LOST}
    assert Verdict.FORCE_LOST not in verdicts(drive(table_of(), force_swings))


@pytest.mark.compiled
def test_a_swinging_torque_is_compensated_until_it_works_again():
    ticks = FAULT + 700

    def peak(answers: list[Answer]) -> float:
        return max(abs(answer.command_2) for answer in answers[FAULT : FAULT + 200])

    answers = drive(table_of(), torque_swings, honest, ticks=ticks)
    assert FaultState.CONFIRMED not in states(answers)
    assert Verdict.TORQUE_OFFSET in verdicts(answers)
    assert peak(answers) > 0.0
    assert verdicts(answers)[-1] in (Verdict.NOTHING, Verdict.ANOTHER_CAR)
    assert abs(answers[-1].command_2) < 0.2 * peak(answers)


def offset(torque: float, force: float, _k: int) -> tuple[float, float]:
    return torque - 20.0, force


def swings_fast(torque: float, force: float, k: int) -> tuple[float, float]:
    return torque + 20.0 * math.sin(0.035 * k), force


def drifts_slowly(torque: float, force: float, k: int) -> tuple[float, float]:
    return torque + min(0.03 * k, 20.0), force


@pytest.mark.compiled
@pytest.mark.parametrize("acts", [offset, swings_fast, drifts_slowly])
def test_a_faulty_motor_that_moves_has_lost_no_share_of_its_command(acts):
    """The force carries what the echo misses, 20 N m at most, and begins without a jump."""
    answers = drive(table_of(), acts, honest)
    assert FaultState.CONFIRMED not in states(answers)
    assert {Verdict.TORQUE_OFFSET, Verdict.TORQUE_LOST} & set(verdicts(answers))
    whole = abs(CAR.g1.dc_gain / CAR.g2.dc_gain) * 20.0
    force = np.array([answer.command_2 for answer in answers])
    assert 0.0 < np.abs(force).max() < 1.5 * whole
    assert np.abs(np.diff(force)).max() < 0.2 * whole


@pytest.mark.parametrize(
    ("left", "off"), [(0.8, 20.0), pytest.param(0.7, 25.0, marks=pytest.mark.compiled)]
)
def test_a_loss_behind_a_believed_echo_ends_no_belief(left, off):
    """The echo shows the motor's offset, but the car misses a part of the reported torque too."""

    def acts(torque: float, force: float, _k: int) -> tuple[float, float]:
        return left * (torque - off), force

    def hears(outputs: Any, _commands: Any, k: int) -> Any:
        return outputs if k < FAULT else (outputs[0] / left, outputs[1])

    found = verdicts(drive(table_of(), acts, hears, ticks=FAULT + 130))
    believed = found.index(Verdict.TORQUE_LOST)
    assert believed < FAULT + 30
    assert set(found[believed:]) == {Verdict.TORQUE_LOST}


@pytest.mark.compiled
def test_an_echo_that_contradicts_a_confirmed_loss_takes_over_without_a_jump():
    def comes_back(torque: float, force: float, k: int) -> tuple[float, float]:
        return 0.0 if k < 150 else torque - 25.0, force

    answers = drive(table_of(), comes_back, honest, ticks=END + 300)
    found = confirmed_after(answers) + FAULT
    end = found + states(answers)[found:].index(FaultState.CLEAR)
    assert 0 < end - (FAULT + 150) <= 10  # the second echo
    assert FaultState.CONFIRMED not in states(answers)[end:]
    assert set(verdicts(answers)[end + 1 :]) <= {Verdict.TORQUE_OFFSET, Verdict.TORQUE_LOST}
    changes = np.abs(np.diff([answer.command_2 for answer in answers]))
    assert changes[end - 1 :].max() < 60.0 < changes[:end].max()


def heard(*told: tuple[float, float]) -> tuple[Any, Any]:
    """The torque's constants and its echo, after each modelled output and its report."""
    table = table_of()
    state = controller.init(table)[0]
    for output, echo in told:
        state.supervision.echoes.actuators[TORQUE].outputs[:] = output
        hear(table, state, 1.0, echo, 0.0)
    return table.echoes.actuators[TORQUE], state.supervision.echoes.actuators[TORQUE]


@pytest.mark.parametrize(
    ("echo", "share", "contradicts"),
    [
        (0.0, 1.0, False),  # dead
        (0.0, 0.6, False),  # dead, the share learnt in another car
        (0.0, 0.4, True),
        (50.0, 0.5, False),
        (50.0, 1.0, True),
        (130.0, 0.5, True),  # more than the command
        (100.0, 1.0, False),  # reports no fault: proves nothing
    ],
)
def test_an_echo_contradicts_a_share_that_explains_less_than_half(echo, share, contradicts):
    assert contradicts_share(*heard((100.0, echo)), share) == contradicts


@pytest.mark.every_case  # a case each of few lines
@pytest.mark.parametrize(
    ("told", "share"),
    [
        ([(100.0, 50.0), (100.0, 50.0)], 0.5),
        ([(100.0, 20.0), (120.0, 24.0), (150.0, 30.0)], 0.8),
        ([(100.0, 0.0), (-60.0, 0.0)], 1.0),  # dead
        ([(100.0, 40.0), (100.0, 40.0)], 0.6),  # off by 60, which a steady command does not show
        ([(100.0, 40.0), (140.0, 80.0), (160.0, 100.0)], 0.0),  # off by 60
        ([(100.0, 40.0), (100.0, 160.0)], 0.0),  # swings
        ([(100.0, 100.0), (100.0, 50.0)], 0.0),  # faulty since this echo
        ([(100.0, 150.0), (100.0, 150.0)], 0.0),  # more than the command
    ],
)
def test_an_echo_tells_a_share_where_e_and_its_changes_follow_the_output(told, share):
    assert told_share(*heard((100.0, 100.0), (100.0, 100.0), *told)) == pytest.approx(share)


@pytest.mark.every_case  # a case each of few lines
@pytest.mark.parametrize(
    ("told", "seen"),
    [
        ([(100.0, 40.0), (140.0, 80.0), (160.0, 100.0)], True),  # off by 60
        ([(100.0, 20.0), (160.0, 80.0), (100.0, 20.0)], True),
        ([(100.0, 40.0), (101.0, 41.0), (102.0, 42.0)], False),  # hardly seen
        ([(100.0, 0.0), (140.0, 0.0), (90.0, 0.0)], False),  # dead
        # dead, behind a lag
        ([(100.0, 50.0), (98.0, 20.0), (95.0, 5.0), (90.0, 0.0), (80.0, 0.0)], False),
        ([(100.0, 30.0), (100.0, 30.0)], False),  # stands still
    ],
)
def test_an_actuator_moves_where_its_output_changes_more_than_e(told, seen):
    assert moves(*heard((100.0, 100.0), (100.0, 100.0), *told)) == seen


def test_an_echo_that_sticks_in_a_gust_is_not_taken_for_a_stuck_motor():
    """Compensation of what such an echo claims takes 28 kN and more; without echoes 2 kN."""
    before = []

    def stuck(outputs: Any, _commands: Any, k: int) -> Any:
        if k < FAULT:
            before[:] = [outputs[0]]
        return before[0], outputs[1]

    def gust(k: int) -> float:
        return 0.25 * math.sin(0.013 * max(k - 150, 0))

    answers = drive(table_of(), working, stuck, gust)
    assert 0.0 < max(abs(answer.command_2) for answer in answers) < 10e3


@pytest.mark.compiled
def test_the_noise_of_an_echo_explains_no_swing_of_the_sensor():
    """A large d̂ fits any noise by chance: the fit is no evidence of a faulty actuator."""
    draw = np.random.default_rng(0)

    def noisy(outputs: Any, _commands: Any, _k: int) -> Any:
        return np.asarray(outputs) + draw.normal(0.0, 8.0, 2)

    def swings(k: int) -> float:
        return 0.05 * math.sin(0.03 * k)

    answers = drive(table_of(echo_rms=8.0), working, noisy, swings)
    assert Verdict.TORQUE_OFFSET not in verdicts(answers)


@pytest.mark.compiled
def test_a_motor_that_drifts_and_obeys_makes_up_for_its_own_drift():
    """The force carries the drift of half a second, not the sum of all drift."""
    per_tick, ticks = 0.03, FAULT + 3000

    def drifts(torque: float, force: float, k: int) -> tuple[float, float]:
        return torque + per_tick * k, force

    answers = drive(table_of(), drifts, honest, ticks=ticks)
    assert Verdict.TORQUE_OFFSET in verdicts(answers)
    whole = abs(CAR.g1.dc_gain / CAR.g2.dc_gain) * per_tick * 3000
    late = np.array([answer[:2] for answer in answers[-630:]])  # a whole period of the sine
    assert abs(late[:, 1].mean()) < 0.35 * whole
    assert abs(late[:, 0].mean() + per_tick * (3000 - 315)) < 0.35 * per_tick * 3000


@pytest.mark.compiled
def test_a_motor_that_is_stuck_makes_up_for_nothing():
    """A law without the hand-over commands the same, within the error before the fault shows."""

    def stuck(_torque: float, force: float, _k: int) -> tuple[float, float]:
        return 30.0, force

    table = table_of()
    without = changed(table, echoes={"hand_over": 0.0})[0]
    answers, others = (drive(each, stuck, honest, ticks=FAULT + 1000) for each in (table, without))
    apart = np.abs(np.array([answer[:2] for answer in answers]) - [each[:2] for each in others])
    most = np.abs([answer[:2] for answer in answers]).max(0)
    assert (apart.max(0) < 0.002 * most).all()
    assert Verdict.TORQUE_OFFSET in verdicts(answers)


@pytest.mark.compiled
def test_a_force_that_dies_beside_a_lost_torque_is_the_loss_of_both():
    answers = drive(table_of(), both_dead, honest)
    assert Verdict.BOTH_LOST in verdicts(answers)


@pytest.mark.compiled
@pytest.mark.parametrize("channel", [1, 2])
def test_a_wrong_echo_of_a_working_actuator_moves_nothing(channel):
    def wrong(outputs: Any, _commands: Any, _k: int) -> Any:
        return [-output - 50.0 if at == channel else output for at, output in enumerate(outputs, 1)]

    answers = drive(table_of(), working, wrong)
    without = drive(table_of(), working)
    assert [answer[:2] for answer in answers] == [answer[:2] for answer in without]
    assert set(verdicts(answers)) <= {Verdict.NOTHING, Verdict.ANOTHER_CAR}


@pytest.mark.compiled
def test_a_law_that_hears_nothing_is_the_law_without_echoes():
    assert drive(table_of(), dead) == drive(table_of(echoes=False), dead)


def test_an_echo_that_falls_silent_takes_its_evidence_along():
    def falls_silent(outputs: Any, _commands: Any, k: int) -> Any:
        return outputs if k < FAULT - 20 else (math.nan, math.nan)

    assert Verdict.FORCE_LOST not in verdicts(drive(table_of(), force_swings, falls_silent))


@pytest.mark.parametrize("echo", [(1, math.nan, 0.0), (1, 5.0, math.nan), (1, 5.0, -1.0),
                                  (2, 5.0, float(KEPT_TICKS)), (3, 5.0, 0.0)])  # fmt: skip
def test_what_is_no_echo_is_ignored(echo):
    firmware = Firmware(table_of())
    firmware.step(1.0, 0.0)
    firmware.hear(*echo)
    assert firmware.echo_errors == (0.0, 0.0)


@pytest.mark.parametrize("channel", [1, 2])
def test_an_echo_counts_until_it_has_stayed_away_for_long(channel):
    table = table_of()
    firmware = Firmware(table)
    firmware.reset(0.0)
    firmware.hear(channel, -7.0)
    for _ in range(int(table.echoes.longest) - 1):
        assert firmware.echo_errors[channel - 1] == 7.0
        firmware.step(0.0, 0.0)
    firmware.step(0.0, 0.0)
    assert firmware.echo_errors == (0.0, 0.0)


def test_a_settled_actuator_has_followed_its_command():
    firmware = Firmware(table_of())
    firmware.reset(0.7)
    torque, force = firmware.commands
    firmware.hear(1, torque, 30.0)
    firmware.hear(2, force, 0.0)
    assert firmware.echo_errors == pytest.approx((0.0, 0.0), abs=1e-12)
    firmware.step(0.7, 0.7)
    firmware.hear(1, torque)
    assert firmware.echo_errors[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("channel", "verdict"), [(1, Verdict.TORQUE_OFFSET), (2, Verdict.FORCE_LOST)]
)
def test_many_good_echoes_end_a_verdict(channel, verdict):
    table = table_of()
    state = controller.init(table)[0]
    own = state.supervision
    own.hypotheses.verdict = verdict
    own.echoes.actuators[TORQUE].outputs[:] = own.echoes.actuators[FORCE].outputs[:] = 5.0
    for _ in range(int(table.echoes.working)):
        assert standing(table, own.hypotheses, own.echoes, False) == verdict
        hear(table, state, float(channel), 4.9, 0.0)
    assert standing(table, own.hypotheses, own.echoes, False) == Verdict.NOTHING
    hear(table, state, float(channel), 2.0, 0.0)
    assert standing(table, own.hypotheses, own.echoes, False) == verdict


@pytest.mark.parametrize(("error", "ends"), [(0.2, False), (0.05, True)])
def test_a_believed_error_of_a_fifth_of_the_output_lasts(error, ends):
    """The error of an echo that nobody believes is a fault from a quarter of the output on."""
    table = table_of()
    state = controller.init(table)[0]
    echo = state.supervision.echoes.actuators[TORQUE]
    echo.outputs[:], echo.believed = 100.0, 1
    for _ in range(int(table.echoes.working)):
        hear(table, state, 1.0, 100.0 * (1.0 - error), 0.0)
    assert (echo.believed == 0) == ends
