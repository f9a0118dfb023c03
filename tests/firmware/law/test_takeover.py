"""A controller that begins while the plant moves."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections, realisation
from firmware_model.discretisation.takeover import (
    LISTENING,
    fill_takeover,
    largest_variance,
    observer,
)
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.firmware import Firmware
from firmware_model.law import controller
from firmware_model.law.status import FaultState, Mode
from firmware_model.law.structs import zeroed
from firmware_model.law.supervision.decision import needed_evidence
from firmware_model.law.supervision.takeover import (
    Constants,
    advance_motion,
    begin_takeover,
    show_motion,
    wanted_level,
)
from tests.firmware.law.cases import TICK_S, Loop, restarted_table

MEMORY = 50.0


def model() -> tuple[np.ndarray, np.ndarray]:
    g1 = restarted_table().estimator.channel_1
    phi, _, c, *_ = realisation(Sections(np.array(g1.coefficients[: g1.n], float), TICK_S))
    return phi, c


def restarted(away: int, begins: int = 2000) -> tuple[Loop, float]:
    """A loop in a sine whose controller begins anew after ``away`` ticks without commands.

    Returns:
        The loop, and the largest torque before.
    """
    loop = Loop(restarted_table())
    before = loop.run(begins)
    for _ in range(away):
        loop.state = Loop.plant.phi @ loop.state
        loop.ticks += 1
    loop.acting = np.zeros(2) if away else loop.acting
    loop.firmware = Firmware(restarted_table())
    loop.firmware.begin()
    return loop, max(abs(answer.command_1) for answer in before[500:])


@pytest.mark.compiled
@pytest.mark.parametrize("begins", [1500, 2000, 2500, 3000])
@pytest.mark.parametrize("away", [0, 30, 300])
def test_the_car_comes_back_to_its_reference_and_nothing_is_called_a_fault(away, begins):
    loop, usual = restarted(away, begins)
    answers = loop.run(3000)
    states = {answer.fault_state for answer in answers}
    assert states <= {FaultState.CLEAR, FaultState.CANNOT_TELL}
    assert max(abs(answer.command_1) for answer in answers) < 2.0 * usual
    assert max(abs(answer.command_2) for answer in answers) == 0.0
    assert abs(loop.output - loop.reference) < 0.1  # the lag of C


@pytest.mark.compiled
@pytest.mark.parametrize("begins", [1500, 2000, 2500, 3000])
def test_a_restart_within_a_tick_moves_the_car_little(begins):
    loop, usual = restarted(0, begins)
    undisturbed = Loop(restarted_table())
    undisturbed.run(begins)
    last = loop.acting[0]
    apart = []
    for tick in range(1000):
        (answer,) = loop.run(1)
        if tick == 0:
            assert abs(answer.command_1 - last) < 1.2 * usual
        undisturbed.run(1)
        apart.append(abs(loop.output - undisturbed.output))
    assert max(apart) < 0.1
    assert apart[-1] < 0.005


@pytest.mark.compiled
def test_without_a_takeover_the_same_restart_is_a_jump():
    """The measure of the tests above: a controller that believes the car at rest."""
    loop, usual = restarted(0)
    last = loop.acting[0]
    loop.firmware = Firmware(restarted_table())
    (answer, *_) = loop.run(200)
    assert abs(answer.command_1 - last) > 1.5 * usual


@pytest.mark.compiled
def test_a_motor_that_died_before_is_found():
    loop, _ = restarted(0)
    loop.working = 0.0
    answers = loop.run(3000)
    assert answers[-1].fault_state == FaultState.CONFIRMED
    assert abs(loop.output - loop.reference) < 0.1


def test_in_a_takeover_a_loss_needs_the_evidence_that_chance_gives_once_in_a_hundred():
    """One candidate a tick, each beyond h by chance with e^-h (Wald)."""
    table = restarted_table()
    limits, test = table.decision, controller.init(table)[0].supervision.sequential_test
    ticks, needed = float(table.takeover.lasting), []
    for of_takeover in (0, 1):
        test.of_takeover = of_takeover
        needed.append(
            needed_evidence(table, test, controller.init(table)[0].supervision.echoes.actuators[0])
        )
    assert needed[0] == limits.confirm
    assert ticks * math.exp(-needed[1]) == pytest.approx(1e-2, rel=1e-9)
    lax = restarted_table(false_alarms_per_hour=1e3)
    assert lax.decision.takeover == lax.decision.confirm < needed[1]


@pytest.mark.compiled
def test_actuators_at_rest_are_met_at_rest():
    loop, usual = restarted(30)
    loop.firmware.begin(at_rest=True)
    (answer,) = loop.run(1)
    assert abs(answer.command_1) < 0.01 * usual
    loop.run(3000)
    assert abs(loop.output - loop.reference) < 0.1


@pytest.mark.compiled
def test_a_plant_at_rest_is_not_taken_over():
    """The same bits as of a controller that is told so, noise or not."""
    table = restarted_table(noise_rms=0.01, resolution=0.001)
    begun, told = (Loop(table, noise_rms=0.01) for _ in range(2))
    begun.firmware.begin()
    assert begun.run(300) == told.run(300)


@pytest.mark.compiled
def test_the_takeover_waits_for_the_first_tick_with_both_inputs():
    loop, usual = restarted(0)
    last = loop.acting[0]
    for inputs in ((np.nan, np.nan), (1.0, np.nan), (np.nan, loop.output)):
        answer = loop.firmware.step(*inputs)
        assert (answer.mode, answer.command_1) == (Mode.BLIND, 0.0)
    (answer,) = loop.run(1)
    assert abs(answer.command_1 - last) < 1.2 * usual


@pytest.mark.compiled
def test_an_output_that_is_lost_meanwhile_does_not_end_the_takeover():
    loop, usual = restarted(0)
    loop.run(40)
    for _ in range(40):
        loop.go_on(loop.firmware.step(loop.reference, np.nan))
    answers = loop.run(3000)
    assert max(abs(answer.command_1) for answer in answers) < 2.0 * usual
    assert abs(loop.output - loop.reference) < 0.1


@given(st.floats(-9, 9), st.floats(-9, 9))
def test_the_level_is_what_motion_and_reference_share(reference, y):
    level = wanted_level(reference, y)
    same = np.sign(reference) == np.sign(y)
    assert level == (np.copysign(min(abs(reference), abs(y)), y) if same else 0.0)


def test_the_observer_is_least_squares_with_a_fading_memory():
    phi, c = model()
    gain, covariance = observer(phi, c, MEMORY)
    rng, ticks = np.random.default_rng(3), 600
    heard = rng.standard_normal(ticks)
    estimate = np.zeros(len(c))
    for sample_ in heard:
        estimate = phi @ estimate + gain * (sample_ - c @ estimate)
    back = [c]  # c Φ^-n: sample n ticks ago, in the state of the next tick
    inverse = np.linalg.inv(phi)
    rows = []
    for _ in range(ticks):
        rows.append(back[-1] @ inverse)
        back.append(rows[-1])
    weights = np.exp(-np.arange(ticks) / MEMORY)
    lhs = np.array(rows) * weights[:, None]
    found = np.linalg.lstsq(lhs, heard[::-1] * weights, rcond=None)[0]
    assert c @ estimate == pytest.approx(c @ found, rel=0.02)
    spread = np.linalg.pinv(lhs) * weights
    for ahead in (0, 50, 200):
        row = c @ np.linalg.matrix_power(phi, ahead)
        assert row @ covariance @ row == pytest.approx(row @ spread @ spread.T @ row, rel=0.05)


@pytest.mark.parametrize(("lags", "solved"), [(5, True), *((n, False) for n in range(6, 11))])
def test_without_a_trustworthy_observer_there_is_no_takeover(lags, solved):
    """Lags a rad/s apart, a tick of 1 ms: the sum of more than five is beyond double precision.

    What scipy returns for them depends on the processor, and is sometimes a stable observer.
    """
    poles = -np.arange(1.0, 1.0 + lags)
    zeros = np.roots(np.polyder(np.poly(poles)))
    g1 = zoh(ZeroPoleGain(tuple(zeros), tuple(poles), float(lags)), TICK_S)
    constants = zeroed(Constants, "float64")[0]
    fill_takeover(constants, Target(tick_s=TICK_S), g1)
    assert constants.enabled == solved


def test_the_doubt_is_the_variance_that_noise_leaves():
    phi, c = model()
    gain, covariance = observer(phi, c, MEMORY)
    rng, trials = np.random.default_rng(2), 2000
    states = np.zeros((trials, len(c)))
    for _ in range(round(2.0 * LISTENING * MEMORY)):
        states = states @ phi.T + np.outer(rng.standard_normal(trials) - states @ c, gain)
    largest = 0.0
    for _ in range(1000):
        largest = max(largest, float(np.var(states @ c)))
        states = states @ phi.T
    assert largest_variance(phi, c, covariance) == pytest.approx(largest, rel=0.1)


def test_a_takeover_ends_once_its_motion_has_faded():
    table = restarted_table()
    state, g1 = controller.init(table)[0].supervision.takeover, table.estimator.channel_1
    begin_takeover(g1, state, 0.0, 1.0)
    shown = []
    while state.active:
        show_motion(g1, state)
        shown.append(float(state.shown))
        advance_motion(table.takeover, g1, state)
    assert len(shown) == table.takeover.lasting
    assert shown[0] == pytest.approx(1.0)
    assert abs(shown[-1]) < 0.01
    show_motion(g1, state)
    assert state.shown == 0.0
