"""A plant by numbers that the world pushes, against scipy alone."""

import numpy as np
import pytest
from scipy import signal

from firmware_model.analysis.changing_plant import WORLD_ROW, follow_changing, pushed_plant
from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.actuator_dynamics import IDEAL
from firmware_model.design.plants import Plant, push
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ParameterError

A = [[-1.0, 2.0, 0.5], [-2.0, -1.5, 0.0], [0.3, 0.0, -4.0]]
B = [[1.0, 0.5], [0.0, 1.0], [2.0, -1.0]]
C = [[0.4, -1.0, 0.7]]
E = [0.3, -2.0, 1.0]
TICK_S, TICKS = 0.01, 300
FIRST, SECOND = ZeroPoleGain((-3,), (-1, -2), 1.0), ZeroPoleGain((-6,), (-4, -5), 1.0)
TWICE, THRICE = ZeroPoleGain((), (0, 0), 2.0), ZeroPoleGain((-1,), (0, 0, -3), 3.0)


def by_functions(first: ZeroPoleGain, second: ZeroPoleGain, gw: ZeroPoleGain) -> Plant:
    return Plant.from_transfer_functions("pushed", first, second, gw)


def system_of(gw: ZeroPoleGain) -> signal.lti:
    return signal.lti(list(gw.zeros), list(gw.poles), gw.gain)


LEAK = ZeroPoleGain((-0.5,), (-2, -1 + 3j, -1 - 3j), 4.0)
PRESSURE = ZeroPoleGain((-4,), (0, 0, -2), 0.5)
CASES = {
    "column": (
        Plant.from_state_space("pushed", A, B, C, push(E)),
        signal.lti(A, np.c_[E], C, [[0.0]]),
    ),
    "function": (by_functions(FIRST, SECOND, LEAK), system_of(LEAK)),
    "shared poles at 0": (by_functions(TWICE, THRICE, PRESSURE), system_of(PRESSURE)),
    "beside poles at 0": (by_functions(TWICE, THRICE, LEAK), system_of(LEAK)),
}


@pytest.mark.parametrize(("plant", "system"), CASES.values(), ids=CASES)
def test_a_push_is_that_of_its_column_or_function(plant, system):
    """The commands act as without the push."""
    world = np.zeros((TICKS + 1, WORLD_ROW))
    world[:, 4:] = 1.0
    world[:, 0] = np.cumsum(np.random.default_rng(3).normal(size=TICKS + 1))
    world[0, 0] = 0.0
    commands = np.random.default_rng(4).normal(size=(TICKS, 2))
    made, calm = pushed_plant(plant, (IDEAL,) * 3, TICK_S), sample(plant, TICK_S)
    speeds = made.speeds(lambda time_s: np.full_like(time_s, 1.0), range(TICKS))
    memory, quiet, work = calm.memory, calm.memory, made.work
    found, without = [0.0], [0.0]
    for k, (u1, u2) in enumerate(commands.tolist()):
        rows = np.ascontiguousarray(world[k : k + 2])
        inputs = (k, u1, u2, 1.0, 0.5)
        found.append(follow_changing(made.constants, memory, work, speeds[k], *inputs, rows)[0])
        none = np.ascontiguousarray(world[:1].repeat(2, axis=0))
        without.append(follow_changing(made.constants, quiet, work, speeds[k], *inputs, none)[0])
    time_s = TICK_S * np.arange(TICKS + 1)
    expected = signal.lsim(system, world[:, 0], time_s, interp=True)[1]
    assert np.abs(np.array(found) - without - expected).max() <= 1e-9 * np.abs(expected).max()
    _, answer, _ = signal.dlsim(
        (calm.phi, calm.gamma, calm.c[None], np.zeros((1, 2)), TICK_S),
        np.vstack([commands * [1.0, 0.5], [0.0, 0.0]]),
    )
    assert np.abs(np.array(without) - answer[:, 0]).max() <= 1e-9 * np.abs(answer).max()


def test_a_push_with_unstable_modes_of_its_own_is_refused():
    with pytest.raises(ParameterError, match=r"unstable poles of Gw: 0.5 rad/s: must be none, or "):
        by_functions(TWICE, THRICE, ZeroPoleGain((), (0.5,), 1.0))
