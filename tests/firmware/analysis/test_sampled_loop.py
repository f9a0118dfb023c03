"""The loop's matrix: against scipy's parts put together by hand, and against the loop itself."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg, signal

from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.plants import Plant, chapter_2
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from tests.firmware.analysis.loops import CAR, PUBLISHED, SLOW, loop_of
from tests.firmware.law.cases import changed

pytestmark = pytest.mark.filterwarnings("ignore::scipy.signal.BadCoefficients")

OPEN_LOOP = design(chapter_2(), DesignSpecification(tau_s=0.01, feedback=False))
SHAPED = design(
    CAR, DesignSpecification(tau_s=0.01, tau_q_s=0.02, q=ZeroPoleGain((0.0,), (-20.0,), -1.0))
)
Matrices = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]


def cascade(sections: Sections) -> Matrices:
    """A minimal state space of each section, in series; scipy's canonical forms, in δ."""
    a, b, c, d = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1))
    for b0, b1, b2, a1, a2 in sections.coefficients:
        if a2 == 0.0 and b2 == 0.0:
            part = signal.tf2ss([b0, b1], [1.0, a1]) if a1 or b1 else signal.tf2ss([b0], [1.0])
        else:
            part = signal.tf2ss([b0, b1, b2], [1.0, a1, a2])
        ai, bi, ci, di = part if (a1 or b1 or a2 or b2) else (*_nothing(), np.array([[b0]]))
        a = np.block([[a, np.zeros((len(a), len(ai)))], [bi @ c, ai]])
        b, c, d = np.vstack([b, bi @ d]), np.hstack([di @ c, ci]), di @ d
    return a + np.eye(len(a)), b, c, d  # from δ to z


def _nothing() -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    return np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))


def delay_line(ticks: int) -> Matrices:
    if ticks == 0:
        return (*_nothing(), np.ones((1, 1)))
    return (np.eye(ticks, k=-1), np.eye(ticks, 1), np.eye(1, ticks, ticks - 1), np.zeros((1, 1)))


def by_hand(
    designed: ContinuousDesign, target: Target, plant: Plant, left: tuple[float, float], extra: int
) -> NDArray[Any]:
    """Poles of the block diagram: all parts side by side, wired by a matrix of zeros and ones.

    With v = Kw the wiring, x⁺ = Ax + Bv, w = Cx + Dv closes to A + BK(I - DK)⁻¹C.
    """
    filters = discretise(designed, target)
    phi, gamma, c, d, _ = signal.cont2discrete(
        (plant.a, plant.b * left, plant.c, np.zeros((1, 2))), target.tick_s
    )
    n = target.latency_ticks
    parts = [
        (phi, gamma, c, d),  # inputs 0, 1 -> y = w0
        cascade(filters.tracking),  # Q: input 2 -> u1 = w1
        cascade(filters.compensator),  # input 3 -> u2 = w2
        cascade(filters.estimator_1),  # input 4 -> w3
        cascade(filters.estimator_2),  # input 5 -> w4
        cascade(filters.one_plus_q),  # input 6 -> d̂ = w5
        delay_line(n),  # input 7 -> u1 as F1 believes it, w6
        delay_line(n),  # input 8 -> w7
        delay_line(n + extra),  # input 9 -> u1 at the plant, w8
        delay_line(n + extra),  # input 10 -> w9
    ]
    a, b, c, d = (linalg.block_diag(*matrices) for matrices in zip(*parts, strict=True))
    k = np.zeros((11, 10))
    k[0, 8] = k[1, 9] = 1.0
    if designed.tracking is not None:  # Q (r - y + G1 u1)
        k[2, 0], k[2, 3] = -1.0, 1.0
    k[3, 5] = 1.0
    k[4, 6] = k[5, 7] = 1.0
    k[6, 3] = k[6, 4] = 1.0
    k[6, 0] = -1.0
    k[7, 1] = k[9, 1] = 1.0
    k[8, 2] = k[10, 2] = 1.0
    return np.linalg.eigvals(a + b @ k @ np.linalg.solve(np.eye(10) - d @ k, c))


@pytest.mark.parametrize(("left", "extra"), [(HEALTHY, 2), (TORQUE_DEAD, 0), ((0.5, 1.0), 2)])
@pytest.mark.parametrize(
    ("latency", "rule"), [(0, "tustin"), (0, "zoh"), (1, "tustin-held"), (3, "zoh")]
)
@pytest.mark.parametrize("designed", [PUBLISHED, SLOW, SHAPED, OPEN_LOOP])
def test_poles_are_those_of_the_block_diagram(designed, latency, rule, left, extra):
    target = Target(1e-3, latency, rule)
    loop = loop_of(designed, target, left, extra)
    expected = by_hand(designed, target, designed.plant, left, extra)
    assert loop.spectral_radius() == pytest.approx(np.abs(expected).max(), rel=1e-8)
    # Poles far from zero match in pairs; poles of unheard delays are zero to a root of eps.
    ours = loop.poles()
    for pole in expected[np.abs(expected) > 0.9]:
        assert np.abs(ours - pole).min() < 1e-5


@pytest.mark.compiled
@pytest.mark.parametrize("left", [HEALTHY, (0.3, 0.8)])
@pytest.mark.parametrize(("latency", "rule"), [(0, "tustin"), (1, "zoh"), (3, "tustin-held")])
@pytest.mark.parametrize("designed", [SLOW, SHAPED, OPEN_LOOP])
def test_many_ticks_of_the_matrix_are_the_simulation(designed, latency, rule, left):
    """Measurement noise, reference, commands, d̂ and y, all signals of the loop, all inputs."""
    ticks = 300
    reference, noise = np.random.default_rng(8).standard_normal((2, ticks))
    never = {"confirm": np.inf}  # no verdict on noise that the table does not know
    table = changed(build(designed, Target(1e-3, latency, rule)), decision=never)[0]
    trace = simulate(
        table,
        sample(designed.plant, 1e-3),
        reference,
        effectiveness=np.tile(left, (ticks, 1)),
        noise=noise,
    )
    loop = sampled_loop(linear_controller(table), designed.plant, 1e-3, left)
    xi, rows = np.zeros(len(loop.a)), []
    for r, v in zip(reference, noise, strict=True):
        y = loop.c @ xi
        inputs = np.array([y + v, r])
        rows.append([y, *(loop.h @ xi + loop.d @ inputs)])
        xi = loop.a @ xi + loop.b @ inputs
    ours = np.array(rows).T
    theirs = (trace.measurement, trace.command_1, trace.command_2, trace.fault_estimate)
    for got, expected in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9 * np.abs(expected).max())


def test_limits_and_grid_and_precision_do_not_enter():
    """The linear loop of a float32 table with limits is that of its coefficients."""
    rough = Target(
        1e-3,
        2,
        "zoh",
        limit_1=1e-3,
        limit_2=1.0,
        rate_1=1e-3,
        rate_2=1.0,
        lsb_1=0.5,
        lsb_2=0.5,
        noise_rms=1e-9,
    )
    smooth = Target(1e-3, 2, "zoh")
    ours, plain = (linear_controller(build(SLOW, target)) for target in (rough, smooth))
    for name in "abcd":
        np.testing.assert_array_equal(getattr(ours, name), getattr(plain, name))
    single = linear_controller(build(SLOW, Target(1e-3, 2, "zoh", precision="float32")))
    assert single.a.dtype == np.float64
    np.testing.assert_allclose(single.a, plain.a, rtol=1e-5, atol=1e-5 * np.abs(plain.a).max())


def test_memories_that_nothing_excites_are_left_out():
    """C: 4, F1: 4 and 4, F̂: 4 of the car (G2's 3 zeros, q), 1 + Q: none; no eigenvalue at 1."""
    law = linear_controller(build(SLOW, Target(1e-3, 2)))
    assert len(law.a) == 4 + 4 + 4 + SLOW.compensator.order + 2 * 2  # type: ignore[union-attr]
    loop = loop_of(SLOW, Target(1e-3, 2))
    assert np.abs(np.linalg.eigvals(loop.closed()) - 1.0).min() > 1e-4


def test_integrator_that_the_dead_channel_leaves_open_is_no_pole_of_the_loop():
    """C's own without compensation, d̂'s own when the force difference is lost; both harmless."""
    bare = design(CAR, DesignSpecification(compensation=False))
    for designed, left in ((bare, TORQUE_DEAD), (SLOW, (1.0, 0.0))):
        loop = loop_of(designed, Target(1e-3, 1, "zoh"), left)
        everything = np.linalg.eigvals(loop.lumped.closed())
        assert (np.abs(everything - 1.0) < 1e-7).sum() == 1
        assert len(loop.poles()) == len(everything) - 1
        assert loop.spectral_radius() < 0.9999


def test_a_loop_that_only_the_controller_sees_still_counts():
    """Force difference dead: the plant hears nothing of d̂ → u2 → d̂, whose poles must be stable."""
    fast = design(CAR, DesignSpecification(tau_s=1e-4, tau_q_s=0.02))
    loop = loop_of(fast, Target(1e-3, 1, "zoh"), (1.0, 0.0))
    assert loop.spectral_radius() > 1.5


@pytest.mark.parametrize("fraction", [0.25, 0.75])
def test_a_part_of_a_tick_is_a_finer_tick(fraction):
    """Controller every 4 ticks of a plant that is stepped at T/4, commands 1 or 3 of those late."""
    tick_s, table = 4e-3, build(SLOW, Target(4e-3, 1, "zoh"))
    law, fine = linear_controller(table), sample(CAR, 1e-3)
    loop = sampled_loop(law, CAR, tick_s, HEALTHY, fraction)
    rng = np.random.default_rng(9)
    x, older, old = rng.standard_normal(4) * 1e-3, np.array([30.0, 200.0]), np.array([20.0, 100.0])
    memory = rng.standard_normal(len(law.a))
    xi = np.concatenate([x, old, older, memory])
    after = loop.a @ xi + loop.b @ np.zeros(2)
    for quarter in range(4):
        u = older if quarter < 4 * fraction else old
        x = fine.phi @ x + fine.gamma @ u
    np.testing.assert_allclose(after[:4], x, rtol=1e-9)
    np.testing.assert_allclose(after[4:6], law.c[:2] @ memory)
    np.testing.assert_array_equal(after[6:8], old)


@pytest.mark.parametrize("late", [-1.0, math.nan, math.inf])
def test_a_delay_that_is_none_is_refused(late):
    with pytest.raises(ParameterError, match="extra_delay_ticks"):
        sampled_loop(linear_controller(build(SLOW, Target(1e-3))), CAR, 1e-3, HEALTHY, late)


@pytest.mark.parametrize("left", [(-0.1, 1.0), (1.0, 1.1), (math.nan, 1.0)])
def test_an_actuator_that_is_none_is_refused(left):
    with pytest.raises(ParameterError, match="effectiveness"):
        sampled_loop(linear_controller(build(SLOW, Target(1e-3))), CAR, 1e-3, left)
