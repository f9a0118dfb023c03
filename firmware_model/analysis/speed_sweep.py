"""The loop of a scheduled controller around a car at every speed, and while the speed changes.

Frozen at one speed the loop is a ``SampledLoop``. Stability at each frozen speed does not prove
stability under a changing speed (Rugh and Shamma, Automatica 36 (2000) 1401). So the speed also
cycles up and down without a rest, at the fastest allowed change, through all speeds and between
neighbouring designs. Over a cycle a state ξ goes to Φ ξ,

    Φ = A(V_n)^k T_n ... A(V_1)^k T_1,

k ticks at each speed of a fine grid, T the turn of the models' states between two speeds by
``target.schedule``; the state of the car stays. The cycle is stable if all eigenvalues of Φ
(Floquet multipliers) are inside the unit circle, whatever the units of the states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import linalg

from firmware_model.analysis.margins import HEALTHY, law_in
from firmware_model.analysis.sampled_loop import SampledLoop, field_of, memories_of, sampled_loop
from firmware_model.design.plants import Plant
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.discretisation.sections import reaching
from firmware_model.law import controller
from firmware_model.law.layout import Table, precision_of
from firmware_model.law.schedule import State, change_first_speed
from firmware_model.law.structs import FloatArray, copied, zeroed

BETWEEN = 4  # speeds of the grid for each interval between two designs


@dataclass(frozen=True)
class SpeedSweep:
    """Stability of the loop between the slowest design and the fastest.

    Attributes:
        speeds: number of examined speeds.
        spectral_radius: largest spectral radius over all frozen speeds.
        at_mps: the speed of the largest radius.
        while_changing: largest multiplier of all cycles, as a mean per tick:
            |multiplier|^(1/ticks).
        between_mps: the speeds of the cycle with the largest multiplier.
    """

    speeds: int
    spectral_radius: float
    at_mps: float
    while_changing: float
    between_mps: tuple[float, float]

    @property
    def stable(self) -> bool:
        """Whether the loop is stable at every speed and under speed changes."""
        return self.spectral_radius < 1.0 and self.while_changing < 1.0


def sweep(
    of: Scheduled,
    plant_at: Callable[[float], Plant],
    tick_s: float,
    rate_mps2: float,
    effectiveness: tuple[float, float] = HEALTHY,
) -> SpeedSweep:
    """The loop of a schedule with ``effectiveness`` left of its actuators.

    Args:
        of: with a schedule.
        plant_at: the car at a speed.
        tick_s: the tick, seconds.
        rate_mps2: the fastest change of speed.
        effectiveness: see ``sampled_loop``; a loss has been confirmed.
    """
    assert of.schedule is not None
    designs = of.schedule.speed[: of.schedule.n].astype(np.float64)
    speeds = np.concatenate([
        designs[:1], *(np.linspace(*pair, BETWEEN + 1)[1:] for pair in pairwise(designs))
    ])  # fmt: skip
    loops = [
        sampled_loop(
            law_in(table_at(of, speed), effectiveness), plant_at(speed), tick_s, effectiveness
        )
        for speed in speeds.tolist()
    ]
    radii = [loop.spectral_radius() for loop in loops]
    worst = int(np.argmax(radii))
    cycles = _cycles(of, loops, speeds, rate_mps2)
    between = max(cycles, key=lambda ends: cycles[ends])
    low, high = (float(speeds[end]) for end in between)
    return SpeedSweep(len(speeds), radii[worst], float(speeds[worst]), cycles[between], (low, high))


def table_at(of: Scheduled, speed: float) -> Table:
    """The table of ``of`` at ``speed``."""
    return _moved(of, np.zeros(0), speed, speed)[0]


def _cycles(
    of: Scheduled, loops: list[SampledLoop], speeds: FloatArray, rate_mps2: float
) -> dict[tuple[int, int], float]:
    """The radius of each cycle by the numbers of its lowest and its highest speed."""
    middle = loops[len(loops) // 2]
    kept = np.ix_(*(np.flatnonzero(reaching(middle.closed(), middle.c)),) * 2)
    _, scaling = linalg.matrix_balance(middle.closed()[kept], permute=False)
    scale = np.diag(scaling)
    ticks = np.maximum(1, np.rint(np.diff(speeds) / (rate_mps2 * middle.tick_s))).astype(int)

    def way(before: int, after: int) -> FloatArray:
        turn = _turn(of, speeds[before], speeds[after], len(middle.c))[kept]
        step = np.linalg.matrix_power(loops[after].closed()[kept], ticks[min(before, after)])
        balanced: FloatArray = (step @ turn) * scale / scale[:, None]
        return balanced

    up = [way(k, k + 1) for k in range(len(ticks))]
    down = [way(k + 1, k) for k in range(len(ticks))]
    last = len(ticks)
    ends = [(0, last), *((k, k + BETWEEN) for k in range(0, last, BETWEEN))]
    found = {}
    for low, high in ends:
        product = np.eye(len(scale))
        for step in (*up[low:high], *reversed(down[low:high])):
            product = step @ product
        radius = float(np.abs(np.linalg.eigvals(product)).max())
        found[low, high] = radius ** (0.5 / int(ticks[low:high].sum()))
    return found


def _turn(of: Scheduled, before: float, after: float, size: int) -> FloatArray:
    """(size, size): what a change of speed makes of the loop's state; the last are memories."""
    memories = memories_of(of.table)
    turn = np.eye(size)
    first = size - len(memories)
    for j in range(len(memories)):
        unit = np.zeros(len(memories))
        unit[j] = 1.0
        _, turn[first:, first + j] = _moved(of, unit, before, after)
    return turn


def _moved(
    of: Scheduled, memories: FloatArray, before: float, after: float
) -> tuple[Table, FloatArray]:
    """The table at the speed ``after``, and ``memories`` carried from ``before`` to ``after``."""
    assert of.schedule is not None
    precision = precision_of(of.table)
    schedules, tables = copied(of.schedule), copied(of.table)
    owns = zeroed(State, precision)
    states = controller.init(tables[0])
    change_first_speed(schedules, owns, tables, states, before)
    places = memories_of(of.table) if len(memories) else []
    for value, (path, index) in zip(memories, places, strict=True):
        field_of(states, path)[(0, *index)] = value
    change_first_speed(schedules, owns, tables, states, after)
    return tables[0], np.array([field_of(states, path)[(0, *index)] for path, index in places])
