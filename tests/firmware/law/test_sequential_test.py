"""Evidence for a loss: against the likelihoods of two Gaussian hypotheses, computed as a whole.

The test adds up innovations tick by tick. Here the same data are one Gaussian vector, with the
covariance that noise and another car give it, and scipy says how likely it is with and without
what a loss would add.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal, stats

from firmware_model.analysis.sampled_plant import follow_plant, sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.mismatch import TRUSTED, Mismatch
from firmware_model.discretisation.tables import SHARE, build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import zoh
from firmware_model.law import controller
from firmware_model.law.core.biquad import output
from firmware_model.law.layout import Table
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray, Records
from firmware_model.law.supervision.decision import restart_test
from firmware_model.law.supervision.likelihood_ratio import is_stale, lost_share
from tests.firmware.law.cases import CAR, DESIGN, NEVER, TICK_S, changed, other_cars

PLANT = sample(CAR, TICK_S)
NOISE_RMS = 0.01
FOR_EVER = {"sequential_test": {"restart": -math.inf}, "decision": NEVER}


@dataclass(frozen=True)
class Run:
    """By tick: command 1, d̂, evidence, and what of the filter's motion is not under test here."""

    command_1: FloatArray
    estimate: FloatArray
    evidence: FloatArray
    regressor: FloatArray
    memory: FloatArray
    extent: FloatArray
    change: FloatArray
    remainder: FloatArray
    share: FloatArray


def drive(tables: Records[Table], measured: FloatArray, starts: tuple[int, ...] = ()) -> Run:
    """The law on a reference that swings, D* as given; a candidate begins at ``starts``."""
    states = controller.init(tables[0])
    state, rows = states[0], []
    own = state.supervision
    for k, y in enumerate(measured.tolist()):
        if k in starts:
            restart_test(tables[0], state, state.supervision)
        controller.step(tables[0], state, math.sin(0.05 * k), y)
        known = own.mismatch
        rows.append((
            state.command_1, state.fault_estimate, own.sequential_test.candidate.predicted,
            known.regressor.copy(), known.memory.copy(),
            known.extent, known.change, known.remainder,
            lost_share(tables[0].sequential_test, own.sequential_test.candidate)
        ))  # fmt: skip
    return Run(*(np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)))


def target(latency: int = 1, mismatch: Mismatch = TRUSTED, **changes: Any) -> Target:
    chosen = {"noise_rms": NOISE_RMS, "mismatch": mismatch, **changes}
    return Target(TICK_S, latency, "zoh", **chosen)


def lost_output(run: Run, latency: int, start: int) -> FloatArray:
    """w in d̂: G1, by scipy, of the commands that have acted since ``start``."""
    acting = np.concatenate([np.zeros(latency), run.command_1])[: len(run.command_1)]
    acting[:start] = 0.0
    return np.asarray(signal.sosfilt(zoh(CAR.g1, TICK_S).sos, acting))


@pytest.mark.parametrize("latency", [0, 1, 3, 8])
@pytest.mark.parametrize("start", [0, 17])
@pytest.mark.parametrize(("cars", "colour"), [(0, 0.0), (2, 0.0), (2, 0.6)])
def test_it_is_that_of_all_data_at_once(cars, colour, start, latency):
    """Cov(xᵀθ of two ticks) from θ's own steps; whitened data, because its noise is coloured.

    Of a trusted model the data are white noise.
    """
    of = target(latency, other_cars(cars), noise_pole=colour)
    table = build(DESIGN, of)
    run = drive(
        changed(table, **FOR_EVER), 0.01 * np.random.default_rng(2).standard_normal(60), (start,)
    )
    constants, ticks = table.mismatch, len(run.estimate)
    n = int(constants.n)
    seen = signal.lfilter([1.0, -colour], [1.0], run.estimate)
    # w is nothing before the start, and d̂ not yet whitened against a w of before.
    signature = SHARE * signal.lfilter([1.0, -colour], [1.0], lost_output(run, latency, start))
    theta = np.diag(([0.0, 0.0] + [0.36] * cars + [0.0])[:n])  # nothing is lost
    p = np.zeros((ticks, ticks))
    x = run.regressor[:, :n]
    for j in range(ticks):
        later = theta
        for i in range(j, ticks):
            p[i, j] = p[j, i] = x[i] @ later @ x[j]
            later = run.memory[i, :n, None] * later
        wander = min(run.change[j] / run.extent[j], 1.0) if run.extent[j] > 0.0 else 1.0
        grows = constants.growth[:n] * ([0.0, 0.0] + [wander] * cars + [run.remainder[j]])[:n]
        phi = np.diag(run.memory[j, :n])
        theta = phi @ theta @ phi + np.diag(grows)
    p += np.diag((1.0 - colour**2) * NOISE_RMS**2 + constants.white * run.remainder)
    expected = [
        stats.multivariate_normal.logpdf(seen[:k], signature[:k], p[:k, :k])
        - stats.multivariate_normal.logpdf(seen[:k], np.zeros(k), p[:k, :k])
        for k in range(start + 1, ticks + 1)
    ]
    assert np.abs(expected).max() > 1.0
    np.testing.assert_allclose(run.evidence[start:], expected, rtol=1e-5, atol=1e-6)


@pytest.mark.compiled
@pytest.mark.parametrize("mismatch", [TRUSTED, other_cars(2)], ids=["trusted", "other cars"])
@pytest.mark.parametrize("colour", [0.0, 0.8])
def test_noise_takes_a_candidate_beyond_h_as_seldom_as_wald_says(colour, mismatch):
    """At most e^-h of the candidates; three deviations of the count more are chance."""
    ticks = 200_000
    draw = np.random.default_rng(3)
    white = NOISE_RMS * math.sqrt(1.0 - colour**2) * draw.standard_normal(ticks)
    noise = signal.lfilter([1.0], [1.0, -colour], white)
    tables = changed(build(DESIGN, target(1, mismatch, noise_pole=colour)), decision=NEVER)
    trace = simulate(tables[0], PLANT, np.sin(0.005 * np.arange(ticks)), noise=noise)
    began = np.flatnonzero(trace.evidence == 0.0)
    largest = np.maximum.reduceat(trace.evidence, began)
    assert len(began) > 1000
    for h in (2.0, 3.0, 4.0):
        bound = len(began) * math.exp(-h)
        assert (largest > h).sum() <= bound + 3.0 * math.sqrt(bound)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 1, 3, 8])
@pytest.mark.parametrize("left", [0.0, 0.5])
def test_without_noise_a_loss_is_found_at_its_first_sample_and_so_is_its_share(left, latency):
    """The tick of the loss is the last whose sample is still whole."""
    lost, back, ticks = 300, 2300, 2600
    table = build(DESIGN, target(latency, noise_rms=0.0, on_confirmation=True))
    effectiveness = np.ones((ticks, 2))
    effectiveness[lost:back, 0] = left
    trace = simulate(table, PLANT, np.ones(ticks), effectiveness=effectiveness)
    confirmed = trace.fault_state == FaultState.CONFIRMED
    assert not confirmed[: lost + 1].any()
    assert confirmed[lost + 1 : back + 1].all()
    assert not confirmed[back + 1 :].any()
    whole = 1.0 / CAR.g2.dc_gain
    assert trace.command_2[back - 1] == pytest.approx((1.0 - left) * whole, rel=0.05)


@pytest.mark.compiled
@pytest.mark.parametrize("left", [0.0, 0.3, 0.6])
def test_the_share_is_the_part_of_the_torque_that_is_lost(left):
    """Least squares over all ticks since the start, for a candidate that knows the moment."""
    lost, ticks = 40, 400
    tables = changed(build(DESIGN, target(0)), **FOR_EVER)
    noise = NOISE_RMS * np.random.default_rng(6).standard_normal(ticks)
    states = controller.init(tables[0])
    state, x, y, shares = states[0], PLANT.rest.copy(), 0.0, 0.0
    for k in range(ticks):
        if k == lost:
            restart_test(tables[0], state, state.supervision)
        controller.step(tables[0], state, math.sin(0.02 * k), y + noise[k])
        working = left if k >= lost else 1.0
        u1, u2 = working * float(state.command_1), float(state.command_2)
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, u1, u2)
        shares = float(
            lost_share(tables[0].sequential_test, state.supervision.sequential_test.candidate)
        )
    assert shares == pytest.approx(1.0 - left, abs=0.02)


def test_a_candidate_is_as_old_as_the_ticks_that_it_has_seen():
    tables = changed(build(DESIGN, target()), **FOR_EVER)
    state, ages = controller.init(tables[0])[0], []
    for k in range(8):
        if k == 5:
            restart_test(tables[0], state, state.supervision)
        controller.step(tables[0], state, 0.1 * k, 0.0)
        ages.append(int(state.supervision.sequential_test.candidate.age))
    assert ages == [1, 2, 3, 4, 5, 1, 2, 3]


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_loss_that_is_a_tick_older_adds_the_answer_to_one_command(latency):
    """The pulse response of G1, by scipy; the next command stands for a forgotten command."""
    start, ticks = 17, 60
    table = build(DESIGN, target(latency))
    tables = changed(table, **FOR_EVER)
    state, commands, answers = controller.init(tables[0])[0], [], []
    for k in range(ticks):
        if k == start:
            restart_test(tables[0], state, state.supervision)
        answers.append(
            output(table.estimator.channel_1, state.supervision.sequential_test.earlier, 0.0)
        )
        controller.step(tables[0], state, math.sin(0.05 * k), 0.0)
        commands.append(float(state.command_1))
    pulse = np.zeros(ticks)
    pulse[start - 1] = commands[start - latency] if latency else commands[start - 1]
    expected = signal.sosfilt(zoh(CAR.g1, TICK_S).sos, pulse)
    assert np.abs(expected).max() > 0.0
    np.testing.assert_allclose(answers[start:], expected[start:], rtol=1e-6)


def test_evidence_that_overflowed_begins_again():
    tables: NDArray[Any] = changed(build(DESIGN, target()), decision=NEVER)
    state = controller.init(tables[0])[0]
    state.supervision.sequential_test.candidate.predicted = math.nan
    controller.step(tables[0], state, 1.0, 0.0)
    assert state.supervision.sequential_test.candidate.predicted == 0.0


@pytest.mark.every_case
@pytest.mark.parametrize(
    ("age", "half_age", "information", "half_information", "gained", "stale"),
    [
        (3.0, 0.0, 10.0, 10.0, 1.0, False),  # too young to ask
        (9.0, 5.0, 10.0, 10.0, 1.0, False),
        (4.0, 1.0, 10.9, 10.0, 1.0, True),
        (10.0, 5.0, 11.0, 10.0, 1.0, False),
        (10.0, 5.0, 11.0, 10.0, -0.9, False),
        (10.0, 5.0, 11.0, 10.0, -1.1, True),  # the later half alone rejects the onset
        (10.0, 5.0, 1023.9, 1000.0, 1.0, True),  # enough to decide, at any amount of information
        (10.0, 5.0, 1024.0, 1000.0, 1.0, False),
    ],
)
def test_a_candidate_twice_as_old_that_has_learnt_little_is_stale(
    age, half_age, information, half_information, gained, stale
):
    numbers = {"freshness": 0.1, "needed": 24.0}
    table = changed(build(DESIGN, Target(TICK_S, 1, "zoh")), sequential_test=numbers)[0]
    test = controller.init(table)[0].supervision.sequential_test
    test.candidate.age, test.half_age = age, half_age
    test.candidate.information, test.half_information = information, half_information
    test.candidate.predicted, test.half_predicted = 30.0 + gained, 30.0
    assert is_stale(table.sequential_test, test) == stale
