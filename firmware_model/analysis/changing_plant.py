"""A plant with matrices that change with the speed, between two ticks, to fourth order.

    ẋ = A(V) x + B u,   y = C(V) x,   A(V) = A₁ V + A₂ + A₃/V + A₄/V²,   C(V) likewise

is a linear time-varying system for a known speed V(t). Over an interval h with constant commands
the state advances by

    [x; u] → e^Ω [x; u],   Ω = h/2 (M₁ + M₂) + √3/12 h² (M₂ M₁ - M₁ M₂),   M = [A B; 0 0]

with M₁ and M₂ at the Gauss points h (1/2 ∓ √3/6): the Magnus series to fourth order (Iserles and
Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983). For constant V the step is exact. A corner of V
within a tick lowers the order only in the same tick.

e^Ω acts on a vector, so the code never forms the matrix e^Ω: a Taylor series in steps of norm at
most 1 suffices (Al-Mohy and Higham, SIAM J. Sci. Comput. 33 (2011) 488).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Final

import numpy as np

from firmware_model.analysis.sampled_plant import split_ticks
from firmware_model.compiled import firmware
from firmware_model.design.plants import Plant
from firmware_model.target.structs import FloatArray

POWERS: Final = (1, 0, -1, -2)
"""Of V, in whose multiples every matrix of the car is."""

FITTED_AT: Final = (0.1, 0.25, 0.5, 1.0)
"""Parts of a speed at which the multiples are read off, far enough apart to keep all digits."""

GAUSS: Final = (0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0)
COMMUTATOR: Final = math.sqrt(3.0) / 12.0
TERMS: Final = 18  # of e^Ω for a norm of 1: 1/19! is below rounding


@dataclass(frozen=True)
class ChangingPlant:
    """A plant in multiples of powers of its speed; n states.

    Attributes:
        a: (4, n, n). b: (n, 2). c: (4, n), the sensor's reading. sensed: (4, n), the sensor's
            input.
        tick_s: the tick, seconds.
        dead_ticks: whole ticks of dead time of each input.
        sensor_dead_ticks: whole ticks of the sensor's dead time.
        cuts: parts of a tick, ascending from 0 to 1, at which an input or the reading changes.
        new: (len(cuts) - 1, 2), whether an input already uses the newer command.
        read_at: the interval that ends at the delayed sensor reading.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    sensed: FloatArray
    tick_s: float
    dead_ticks: tuple[int, int]
    sensor_dead_ticks: int
    cuts: FloatArray
    new: FloatArray
    read_at: int

    @property
    def constants(self) -> Any:
        """The constants of ``follow_changing``, for compiled code."""
        dead = np.array([*self.dead_ticks, self.sensor_dead_ticks, self.read_at], np.int64)
        return self.a, self.b, self.c, self.sensed, np.diff(self.cuts) * self.tick_s, self.new, dead

    @property
    def work(self) -> FloatArray:
        """Room for ``follow_changing``: two matrices A, Ω, and vectors in the rows of a fourth."""
        size = len(self.b) + 2
        return np.zeros((4, size, size))

    def speeds(self, at: Callable[[FloatArray], FloatArray], ticks: int) -> FloatArray:
        """(ticks, intervals, 3): the speed at both Gauss points and at the end of each interval.

        Args:
            at: the speed at times in s, shape as the argument.
            ticks: of the run.
        """
        parts = [
            [begin + part * (end - begin) for part in (*GAUSS, 1.0)]
            for begin, end in pairwise(self.cuts.tolist())
        ]
        ticks_on = np.arange(ticks, dtype=np.float64)[:, None, None] + np.array(parts)
        return at(ticks_on * self.tick_s)


def changing_plant(
    plant_at: Callable[[float], Plant], fastest_mps: float, tick_s: float
) -> ChangingPlant:
    """The plant of ``plant_at`` over all speeds V above 0.

    Args:
        plant_at: the plant at a speed in m/s; B and the dead times must not depend on it.
        fastest_mps: the highest speed of interest.
        tick_s: the tick, seconds.
    """
    speeds = [part * fastest_mps for part in FITTED_AT]
    plants = [plant_at(speed) for speed in speeds]
    one = plants[-1]
    (whole_1, part_1), (whole_2, part_2), (whole, part) = (
        split_ticks(dead_time_s / tick_s)
        for dead_time_s in (*one.dead_times_s, one.sensor_dead_time_s)
    )
    cuts = np.array(sorted({0.0, part_1, part_2, 1.0 - part, 1.0}))
    new = cuts[:-1, None] >= np.array([part_1, part_2])
    return ChangingPlant(
        a=_multiples(speeds, [plant.a for plant in plants]),
        b=np.ascontiguousarray(one.b),
        c=_multiples(speeds, [plant.c[0] for plant in plants]),
        sensed=_multiples(
            speeds, [(plant.c if plant.sensed is None else plant.sensed)[0] for plant in plants]
        ),
        tick_s=tick_s,
        dead_ticks=(whole_1, whole_2),
        sensor_dead_ticks=whole,
        cuts=cuts,
        new=new.astype(np.float64),
        read_at=int(np.flatnonzero(cuts == 1.0 - part)[0]) - 1,
    )


def _multiples(speeds: Sequence[float], matrices: Sequence[FloatArray]) -> FloatArray:
    """(4, ...), the coefficients of ``matrices`` over the ``POWERS`` of the speed."""
    scaled = np.array(speeds) / speeds[-1]
    powers = np.array([scaled**power for power in POWERS]).T
    flat = np.linalg.solve(powers, np.reshape(matrices, (len(speeds), -1)))
    scale = np.array([speeds[-1] ** -power for power in POWERS])
    return np.ascontiguousarray((flat * scale[:, None]).reshape(4, *matrices[0].shape))


@firmware
def follow_changing(
    constants: Any,
    memory: Any,
    work: Any,
    speeds: Any,
    k: int,
    u1: float,
    u2: float,
    left_1: float,
    left_2: float,
) -> tuple[float, float]:
    """``sampled_plant.follow`` of a ``ChangingPlant``.

    Args:
        constants: of a ``ChangingPlant``.
        memory: of a ``SampledPlant`` of the same plant at any speed; changed in place.
        work: of the ``ChangingPlant``.
        speeds: likewise, of the whole run.
        k: the tick; the commands that reach the actuators now; what a fault leaves of them.
        u1: see ``k``.
        u2: see ``k``.
        left_1: see ``k``.
        left_2: see ``k``.
    """
    a, b, c, sensed, lengths, new, dead = constants
    x, _, commands, samples = memory
    length = len(commands)
    commands[k % length, 0] = u1
    commands[k % length, 1] = u2
    reading = 0.0
    for interval in range(len(lengths)):
        now_1 = k - dead[0] if new[interval, 0] != 0.0 else k - dead[0] - 1
        now_2 = k - dead[1] if new[interval, 1] != 0.0 else k - dead[1] - 1
        drive_1 = left_1 * commands[now_1 % length, 0]
        drive_2 = left_2 * commands[now_2 % length, 1]
        v = speeds[k, interval]
        exponent(a, b, v[0], v[1], lengths[interval], work)
        act(work, x, drive_1, drive_2)
        if interval == dead[3]:
            reading = seen(c, v[2], x)
    samples[(k + 1) % len(samples)] = reading
    return seen(sensed, v[2], x), samples[(k + 1 - dead[2]) % len(samples)]


@firmware
def multiple(parts: Any, v: float, i: int, j: int) -> float:
    """Element i, j at the speed ``v``."""
    value: float = parts[0, i, j] * v + parts[1, i, j] + (parts[2, i, j] + parts[3, i, j] / v) / v
    return value


@firmware
def seen(parts: Any, v: float, x: Any) -> float:
    """C(v) x."""
    total = 0.0
    for j in range(len(x)):
        total += (parts[0, j] * v + parts[1, j] + (parts[2, j] + parts[3, j] / v) / v) * x[j]
    return total


@firmware
def exponent(a: Any, b: Any, v1: float, v2: float, h: float, work: Any) -> None:
    """Ω of an interval of ``h`` seconds with these speeds at its Gauss points, into ``work[2]``."""
    first, second, omega = work[0], work[1], work[2]
    n = len(b)
    for i in range(n):
        for j in range(n):
            first[i, j] = multiple(a, v1, i, j)
            second[i, j] = multiple(a, v2, i, j)
    for i in range(n):
        for j in range(n):
            commutator = 0.0
            if v1 != v2:
                for m in range(n):
                    commutator += second[i, m] * first[m, j] - first[i, m] * second[m, j]
            mean = 0.5 * (first[i, j] + second[i, j])
            omega[i, j] = h * mean + COMMUTATOR * h * h * commutator
        for j in range(2):
            commutator = 0.0
            for m in range(n):
                commutator += (second[i, m] - first[i, m]) * b[m, j]
            omega[i, n + j] = h * b[i, j] + COMMUTATOR * h * h * commutator


@firmware
def act(work: Any, x: Any, u1: float, u2: float) -> None:
    """x after e^Ω has acted on [x; u], in place."""
    omega, term, following = work[2], work[3, 0], work[3, 1]
    n = len(x)
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(omega[i, j])
        norm = max(norm, row)
    steps = max(1, math.ceil(norm))
    for _ in range(steps):
        for i in range(n):
            term[i] = x[i]
        term[n], term[n + 1] = u1, u2
        for order in range(1, TERMS + 1):
            for i in range(n):
                total = 0.0
                for j in range(n + 2):
                    total += omega[i, j] * term[j]
                following[i] = total / (order * steps)
            for i in range(n):
                term[i] = following[i]
                x[i] += following[i]
            term[n] = term[n + 1] = 0.0
