"""The car with matrices that change with speed and road, between two ticks, to fourth order.

    ẋ = A x + B u + E w,   y = C x + F w

with A, C and E known functions of time: of the speed V(t), through the regular speed V_r and the
share s = V/V_r of ``vehicle``, and of the friction factors μ_f(t) and μ_r(t). All matrices are
multiples of V_r, 1, 1/V_r, 1/V_r², and affine in μ_f, in μ_r and in s:

    A = A₀ + (μ_f - 1) A_f + (μ_r - 1) A_r + (s - 1) A_s + (μ_f - 1)(s - 1) A_fs.

The commands u are constant over an interval h; the world's inputs w and both factors are straight
lines between two ticks. So with w = w₀ + w' t/h the state advances by

    [x; u; 1; t/h] → e^Ω [x; u; 1; t/h],   M = [A B E w₀ E w'; 0 0 0 0; 0 0 0 0; 0 0 1/h 0],
    Ω = h/2 (M₁ + M₂) + √3/12 h² (M₂ M₁ - M₁ M₂)

with M₁ and M₂ at the Gauss points h (1/2 ∓ √3/6): the Magnus series to fourth order (Iserles and
Nørsett, Phil. Trans. R. Soc. A 357 (1999) 983). For constant V and μ the step is exact. A corner of
V or μ within a tick lowers the order only in the same tick.

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
from firmware_model.analysis.witnesses import Reading, filtered_readings
from firmware_model.compiled import firmware
from firmware_model.design.actuator_dynamics import Stage, actuated_state_space
from firmware_model.design.plants import Plant
from firmware_model.design.vehicle import (
    LOW_SPEED_MPS,
    SPECIFIC_FORCE,
    WORLD,
    StateSpace,
    Variant,
    VehicleParameters,
    WorldInputs,
    regular_speed,
    single_track,
)
from firmware_model.errors import ParameterError
from firmware_model.law.structs import FloatArray

POWERS: Final = (1, 0, -1, -2)
"""Of V_r, in whose multiples every matrix of the car is."""

FITTED_AT: Final = (0.1, 0.25, 0.5, 1.0)
"""Parts of a speed at which the multiples are read off, far enough apart to keep all digits."""

GAUSS: Final = (0.5 - math.sqrt(3.0) / 6.0, 0.5 + math.sqrt(3.0) / 6.0)
FIRST, SECOND = GAUSS
COMMUTATOR: Final = math.sqrt(3.0) / 12.0
TERMS: Final = 18  # of e^Ω for a norm of 1: 1/19! is below rounding

INPUTS: Final = len(WORLD)
FRONT_FRICTION, REAR_FRICTION, WORLD_ROW = INPUTS, INPUTS + 1, INPUTS + 2
"""The places of both friction factors in a row of the world, after ``WORLD``, and its length."""

NO_WORLD: Final[FloatArray] = np.zeros((0, WORLD_ROW))
"""The calm world: no input, a dry road."""

CAR_STATES: Final = 4  # the first; only their columns depend on the road
SHARES: Final = 4  # μ_f - 1, μ_r - 1, s - 1 and (μ_f - 1)(s - 1)
BEHIND_A: Final = 3
"""Rows below A: of the reading, the output before the sensor, the acceleration; then those of
further sensors."""


@dataclass(frozen=True)
class ChangingPlant:
    """A car in multiples of powers of its regular speed; n states.

    Attributes:
        dry: (4, n + 3 + r, n), by ``POWERS`` for V_r = V and dry roads: A, then the rows of the
            sensor's reading, of the output before the sensor, of the specific force and of r
            further sensors.
        road: (4, 4, n + 3 + r, n), likewise A_f, A_r, A_s and A_fs.
        b: (n, 2).
        e: (4, n + 3 + r, 4), likewise E and the direct effects of ``WORLD`` on the rows.
        acting: (r, 2), the direct effects of what acts on the inputs.
        tick_s: the tick, seconds.
        dead_ticks: whole ticks of dead time of each input.
        sensor_dead_ticks: whole ticks of the sensor's dead time.
        cuts: parts of a tick, ascending from 0 to 1, at which an input or the reading changes.
        new: (len(cuts) - 1, 2), whether an input already uses the newer command.
        read_at: the interval that ends at the delayed sensor reading.
    """

    dry: FloatArray
    road: FloatArray
    b: FloatArray
    e: FloatArray
    acting: FloatArray
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
        cuts = (self.cuts, np.diff(self.cuts) * self.tick_s)
        return (self.dry, self.road, self.e), self.b, cuts, self.new, dead

    @property
    def work(self) -> FloatArray:
        """Room for ``follow_changing``: two matrices A, Ω, and vectors in the rows of a fourth."""
        size = len(self.b) + 4
        return np.zeros((4, size, size))

    def speeds(self, at: Callable[[FloatArray], FloatArray], ticks: range) -> FloatArray:
        """(len(ticks), intervals, 3): the speed at both Gauss points and the end of each interval.

        Args:
            at: the speed at times in s, shape as the argument.
            ticks: consecutive.

        Raises:
            ParameterError: a speed below 0; no tire rolls backward here.
        """
        parts = [
            [begin + part * (end - begin) for part in (*GAUSS, 1.0)]
            for begin, end in pairwise(self.cuts.tolist())
        ]
        ticks_on = np.arange(ticks.start, ticks.stop, dtype=np.float64)[:, None, None]
        speeds = at((ticks_on + np.array(parts)) * self.tick_s)
        if not (speeds >= 0.0).all():
            raise ParameterError(f"speed = {speeds.min():g} m/s: must be 0 or above")
        return speeds


def changing_plant(
    car: VehicleParameters,
    variant: Variant,
    stages: tuple[Stage, Stage, Stage],
    fastest_mps: float,
    tick_s: float,
    readings: Sequence[Reading] = (),
) -> ChangingPlant:
    """``car`` with its actuators and its sensor, at all speeds from 0 on and on every road.

    Args:
        car: its speed has no effect.
        variant: of C.
        stages: of both actuators and of the sensor.
        fastest_mps: the highest speed of interest.
        tick_s: the tick, seconds.
        readings: the further sensors.
    """

    def at(
        speed: float, friction: tuple[float, float] = (1.0, 1.0), share: float = 1.0
    ) -> tuple[FloatArray, ...]:
        """``_matrices`` as if V_r were ``speed``."""
        state_space, world = single_track(car, variant, friction, (speed, share))
        return _matrices(state_space, world, stages, readings)

    speeds = [part * max(fastest_mps, LOW_SPEED_MPS) for part in FITTED_AT]
    dry = [at(speed) for speed in speeds]
    others = [
        [at(speed, friction, share) for speed in speeds]
        for friction, share in (
            ((2.0, 1.0), 1.0),
            ((1.0, 2.0), 1.0),
            ((1.0, 1.0), 2.0),
            ((2.0, 1.0), 2.0),
        )
    ]
    n = len(dry[0][0])
    road = np.zeros((SHARES, len(POWERS), n + BEHIND_A + len(readings), n))
    for kind, changed in enumerate(others):
        both = zip(dry, changed, strict=True)
        difference = [np.concatenate([new[0] - old[0], new[2] - old[2]]) for old, new in both]
        road[kind] = _multiples(speeds, difference)
    road[3] -= road[0] + road[2]
    rows = [_multiples(speeds, [each[2][row] for each in dry]) for row in range(len(dry[0][2]))]
    return _with_times(
        np.concatenate(
            [_multiples(speeds, [each[0] for each in dry]), np.stack(rows, axis=1)], axis=1
        ),
        road,
        _multiples(speeds, [np.concatenate([each[3], each[4]]) for each in dry]),
        (dry[0][1], dry[0][5]),
        stages,
        tick_s,
    )


def pushed_plant(
    plant: Plant,
    stages: tuple[Stage, Stage, Stage],
    tick_s: float,
    readings: Sequence[Reading] = (),
) -> ChangingPlant:
    """A plant by numbers that the world pushes: the matrices are constant.

    Args:
        plant: with a ``world``, before its ``stages``.
        stages: of both actuators and of the sensor.
        tick_s: the tick, seconds.
        readings: the further sensors.
    """
    assert plant.world is not None
    a, b, rows, e, direct, acting = _matrices(
        (plant.a, plant.b, plant.c), plant.world, stages, readings
    )
    n, powers = len(a), len(POWERS)
    dry, along = np.zeros((powers, n + len(rows), n)), np.zeros((powers, n + len(rows), INPUTS))
    constant = POWERS.index(0)
    dry[constant], along[constant] = np.concatenate([a, rows]), np.concatenate([e, direct])
    road = np.zeros((SHARES, *dry.shape))
    return _with_times(dry, road, along, (b, acting), stages, tick_s)


def _matrices(
    state_space: StateSpace,
    world: WorldInputs,
    stages: tuple[Stage, Stage, Stage],
    readings: Sequence[Reading],
) -> tuple[FloatArray, ...]:
    """A, B, the rows, E, their direct effects and what acts."""
    (a, b, c, sensed), pushed = actuated_state_space(state_space, world, stages)
    assert pushed is not None
    force = slice(SPECIFIC_FORCE, SPECIFIC_FORCE + 1)
    rows = np.concatenate([c, sensed, pushed.rows[force]])
    (a, b, e), further = filtered_readings(a, b, pushed, stages, readings)
    rows = np.hstack([rows, np.zeros((BEHIND_A, len(a) - rows.shape[1]))])
    direct = [pushed.read, pushed.f, pushed.direct[force], further.direct]
    return a, b, np.concatenate([rows, further.rows]), e, np.concatenate(direct), further.acting


def _with_times(
    dry: FloatArray,
    road: FloatArray,
    e: FloatArray,
    of_inputs: tuple[FloatArray, FloatArray],
    stages: tuple[Stage, Stage, Stage],
    tick_s: float,
) -> ChangingPlant:
    """The plant of these multiples, cut where an input or the reading changes."""
    (whole_1, part_1), (whole_2, part_2), (whole, part) = (
        split_ticks(stage.dead_time_s / tick_s) for stage in stages
    )
    cuts = np.array(sorted({0.0, part_1, part_2, 1.0 - part, 1.0}))
    new = cuts[:-1, None] >= np.array([part_1, part_2])
    return ChangingPlant(
        dry=dry,
        road=road,
        b=np.ascontiguousarray(of_inputs[0]),
        e=e,
        acting=of_inputs[1],
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
    world: Any,
) -> tuple[float, float]:
    """``sampled_plant.follow`` of a ``ChangingPlant``.

    Args:
        constants: of a ``ChangingPlant``.
        memory: of a ``SampledPlant`` of the same plant at any speed; changed in place.
        work: of the ``ChangingPlant``.
        speeds: (intervals, 3), of this tick.
        k: the tick; the commands that reach the actuators now; what a fault leaves of them.
        u1: see ``k``.
        u2: see ``k``.
        left_1: see ``k``.
        left_2: see ``k``.
        world: (2, ``WORLD_ROW``), at this tick and at the next; or ``NO_WORLD``.
    """
    parts, b, (cuts, lengths), new, dead = constants
    x, _, commands, samples = memory
    n = len(x)
    length = len(commands)
    commands[k % length, 0] = u1
    commands[k % length, 1] = u2
    pushes = False
    for row in range(len(world)):
        for each in range(INPUTS):
            pushes = pushes or world[row, each] != 0.0
    reading = output = 0.0
    for interval in range(len(lengths)):
        now_1 = k - dead[0] if new[interval, 0] != 0.0 else k - dead[0] - 1
        now_2 = k - dead[1] if new[interval, 1] != 0.0 else k - dead[1] - 1
        drive_1 = left_1 * commands[now_1 % length, 0]
        drive_2 = left_2 * commands[now_2 % length, 1]
        v = speeds[interval]
        begin, end = cuts[interval], cuts[interval + 1]
        first = conditions(v[0], world, begin + FIRST * (end - begin))
        second = conditions(v[1], world, begin + SECOND * (end - begin))
        exponent(parts, b, first, second, lengths[interval], work)
        if pushes:
            push(parts, first, second, lengths[interval], work, world, begin, end)
        act(work, x, drive_1, drive_2, pushes)
        last = conditions(v[2], world, end)
        if interval == dead[3]:
            reading = seen(parts, n, last, x, world, end)
        if interval == len(lengths) - 1:
            output = seen(parts, n + 1, last, x, world, end)
    samples[(k + 1) % len(samples)] = reading
    return output, samples[(k + 1 - dead[2]) % len(samples)]


@firmware
def specific_force(constants: Any, x: Any, speed_mps: float, world: Any) -> float:
    """The specific force [m/s²] at the begin of a tick; for the arguments ``follow_changing``."""
    parts = constants[0]
    force: float = seen(parts, len(x) + 2, conditions(speed_mps, world, 0.0), x, world, 0.0)
    return force


@firmware
def read_changing(
    constants: Any,
    x: Any,
    speed_mps: float,
    world: Any,
    acting: Any,
    acted_1: float,
    acted_2: float,
    found: Any,
) -> None:
    """The further sensors at the begin of a tick, into ``found`` (r,).

    ``acting`` is the plant's, ``acted_1`` and ``acted_2`` what acted on its inputs just before; for
    the other arguments see ``follow_changing``.
    """
    parts, at = constants[0], conditions(speed_mps, world, 0.0)
    for each in range(len(found)):
        row = len(x) + BEHIND_A + each
        found[each] = acting[each, 0] * acted_1 + acting[each, 1] * acted_2
        found[each] += seen(parts, row, at, x, world, 0.0)


_regular_speed = firmware(regular_speed)


@firmware
def conditions(speed_mps: float, world: Any, part: float) -> tuple[float, float, float, float]:
    """V_r, μ_f - 1, μ_r - 1 and s - 1 at a ``part`` of the tick."""
    front = rear = share = 0.0
    if len(world) > 0:
        front = between(world, FRONT_FRICTION, part) - 1.0
        rear = between(world, REAR_FRICTION, part) - 1.0
    regular = _regular_speed(speed_mps)
    if regular != speed_mps:
        share = speed_mps / regular - 1.0
    return regular, front, rear, share


@firmware
def between(world: Any, each: int, part: float) -> float:
    """A number of the world at a ``part`` of the tick, on the straight line."""
    value: float = world[0, each] + part * (world[1, each] - world[0, each])
    return value


@firmware
def multiple(parts: Any, v: float, i: int, j: int) -> float:
    """Element i, j at the regular speed ``v``."""
    value: float = parts[0, i, j] * v + parts[1, i, j] + (parts[2, i, j] + parts[3, i, j] / v) / v
    return value


@firmware
def element(parts: Any, at: Any, i: int, j: int) -> float:
    """Element i, j under the conditions ``at``."""
    dry, road, _ = parts
    v, front, rear, share = at
    value: float = multiple(dry, v, i, j)
    if j < CAR_STATES:
        if front != 0.0:
            value += front * multiple(road[0], v, i, j)
        if rear != 0.0:
            value += rear * multiple(road[1], v, i, j)
        if share != 0.0:
            value += share * (multiple(road[2], v, i, j) + front * multiple(road[3], v, i, j))
    return value


@firmware
def seen(parts: Any, row: int, at: Any, x: Any, world: Any, part: float) -> float:
    """A row of the plant for the state ``x`` and the world at a ``part`` of the tick."""
    total = 0.0
    for j in range(len(x)):
        total += element(parts, at, row, j) * x[j]
    if len(world) > 0:
        for each in range(INPUTS):
            total += multiple(parts[2], at[0], row, each) * between(world, each, part)
    return total


@firmware
def exponent(parts: Any, b: Any, at_1: Any, at_2: Any, h: float, work: Any) -> None:
    """Ω for x and u of an interval of ``h`` s, with the conditions at its Gauss points.

    ``work[2]`` takes Ω, ``work[0]`` and ``work[1]`` take A at both points.
    """
    first, second, omega = work[0], work[1], work[2]
    n = len(b)
    for i in range(n):
        for j in range(n):
            first[i, j] = element(parts, at_1, i, j)
            second[i, j] = element(parts, at_2, i, j)
    changes = at_1 != at_2
    for i in range(n):
        for j in range(n):
            commutator = 0.0
            if changes:
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
def push(
    parts: Any, at_1: Any, at_2: Any, h: float, work: Any, world: Any, begin: float, end: float
) -> None:
    """Ω for the world's inputs, beside ``exponent``: the columns of 1 and of t/h."""
    first, second, omega = work[0], work[1], work[2]
    n = len(omega) - 4
    # E w₀ and E w' at the first point, then at the second.
    for i in range(n):
        for column in range(4):
            work[3, column, i] = 0.0
        for each in range(INPUTS):
            start = between(world, each, begin)
            rise = between(world, each, end) - start
            e_1 = multiple(parts[2], at_1[0], i, each)
            e_2 = multiple(parts[2], at_2[0], i, each)
            work[3, 0, i] += e_1 * start
            work[3, 1, i] += e_1 * rise
            work[3, 2, i] += e_2 * start
            work[3, 3, i] += e_2 * rise
    for i in range(n):
        for column in range(2):
            commutator = 0.0
            if column == 0:
                commutator = (work[3, 3, i] - work[3, 1, i]) / h
            for m in range(n):
                commutator += second[i, m] * work[3, column, m]
                commutator -= first[i, m] * work[3, 2 + column, m]
            mean = 0.5 * (work[3, column, i] + work[3, 2 + column, i])
            omega[i, n + 2 + column] = h * mean + COMMUTATOR * h * h * commutator


@firmware
def act(work: Any, x: Any, u1: float, u2: float, pushes: bool) -> None:
    """x after e^Ω has acted on [x; u; 1; 0], in place; without the last two unless ``pushes``."""
    omega, term, following = work[2], work[3, 0], work[3, 1]
    n = len(x)
    columns = n + 4 if pushes else n + 2
    norm = 0.0
    for i in range(n):
        row = 0.0
        for j in range(n):
            row += abs(omega[i, j])
        norm = max(norm, row)
    steps = max(1, math.ceil(norm))
    for step in range(steps):
        for i in range(n):
            term[i] = x[i]
        term[n], term[n + 1] = u1, u2
        term[n + 2], term[n + 3] = 1.0, step / steps
        for order in range(1, TERMS + 1):
            for i in range(n):
                total = 0.0
                for j in range(columns):
                    total += omega[i, j] * term[j]
                following[i] = total / (order * steps)
            for i in range(n):
                term[i] = following[i]
                x[i] += following[i]
            term[n] = term[n + 1] = 0.0
            term[n + 3] = term[n + 2] / steps  # t/h grows with the first order
            term[n + 2] = 0.0
