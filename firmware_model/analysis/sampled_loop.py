"""The sampled closed loop as one matrix, read off the target's code.

Without limits, grid and threshold a tick of ``controller.step`` is a linear map of memories and
inputs. So column j of its matrix is one tick from unit memory j: no finite difference, no second
copy of the control law, exact to rounding. Plant, hold and bus are linear algebra:

    x⁺ = Φx + Γ Λ u(k - m) + Γ' Λ u(k - m - 1),   y = cx

with m whole ticks of latency and dead time of each channel, Λ the effectiveness of the actuators,
and a fractional delay as a command that changes within the tick (Åström and Wittenmark,
"Computer-Controlled Systems", section on systems with time delays). From command to measurement the
sensor's dead time counts as a dead time before both inputs.

The loop is kept open at the measurement, y_m, and closed with y_m = gain · y when asked.

Lumping of permanently equal states.

A dead time is a chain of states; each state takes over the previous state's value after a tick. The
bus, the actuators, the sensor and the controller's model of all three each hold such a chain of the
same commands. Equal states stay equal from the first tick on, so a single state represents the
group: the loop behaves as before, with fewer poles at z = 0. Eigenvalues take the cube of the size,
and a dead time of 50 ms at 1 kHz is 100 states instead of 200 or 300.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from firmware_model.analysis.sampled_plant import held_input, split_ticks
from firmware_model.design.plants import Plant
from firmware_model.discretisation.sections import ComplexArray, reaching
from firmware_model.errors import ParameterError
from firmware_model.law import controller
from firmware_model.law.core import biquad
from firmware_model.law.layout import State, Table
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray, Records, zeroed


def lumps(a: FloatArray, b: FloatArray) -> NDArray[np.int_]:
    """The number of each state's lump, shape (n,), 0, 1, ... in the order of their first states.

    Args:
        a: (n, n), of ξ⁺ = Aξ + Bu.
        b: (n, m).
    """
    single = (np.count_nonzero(a, axis=1) == 1) & ~b.any(axis=1)
    source = np.argmax(a != 0.0, axis=1)
    copies = single & (a[np.arange(len(a)), source] == 1.0)
    numbers: dict[object, int] = {}
    lump = np.full(len(a), -1)
    for state in range(len(a)):
        chain, at = [], state
        while lump[at] < 0 and copies[at] and at not in chain:
            chain.append(at)
            at = int(source[at])
        if lump[at] < 0:  # the begin of a chain, or a place in a circle of copies
            own = at if at in chain else (a[at].tobytes(), b[at].tobytes())
            lump[at] = numbers.setdefault(own, len(numbers))
        for copy in reversed(chain):
            if lump[copy] < 0:
                lump[copy] = numbers.setdefault(("after", lump[source[copy]]), len(numbers))
    return lump


def lumped(
    a: FloatArray, b: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and ``rows`` (r, n) of the lumped system."""
    lump = lumps(a, b)
    _, first = np.unique(lump, return_index=True)
    belongs = np.zeros((len(a), len(first)))
    belongs[np.arange(len(a)), lump] = 1.0
    return a[first] @ belongs, b[first], rows @ belongs


def integrators(a: FloatArray) -> int:
    """How many independent states of ``a`` (n, n), n ≥ 1, integrate: A - I is singular.

    Their eigenvalues, 1, come with errors of 1e-6 where other poles are near; singular values come
    with an error of the last digit.
    """
    sizes = np.linalg.svd(a - np.eye(len(a)), compute_uv=False)
    return int(np.count_nonzero(sizes <= SINGULAR * np.linalg.norm(a, 2)))


ANSWERS = ("command_1", "command_2", "fault_estimate")
QUEUES = (("queue_1", "shown_ticks_1"), ("queue_2", "shown_ticks_2"))  # length in ticks
OPEN_INTEGRATOR = 1e-7  # |z - 1| below which a pole is an integrator
SINGULAR = 1e-14  # a singular value over the largest: 0 but for rounding
Memory = tuple[tuple[str, ...], tuple[int, ...]]  # a path in the controller's state, an index


@dataclass(frozen=True)
class LinearController:
    """ξ⁺ = Aξ + B(y_m, r), (u1, u2, d̂) = Cξ + D(y_m, r), k memories ξ.

    Attributes:
        a: (k, k). b: (k, 2). c: (3, k). d: (3, 2).
        latency_ticks: of the commands, as the controller believes.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    latency_ticks: int


@dataclass(frozen=True)
class SampledLoop:
    """The loop, open at the measurement: ξ⁺ = Aξ + B(y_m, r), y = cξ, (u1, u2, d̂) = Hξ + D(y_m, r).

    The state consists of the plant's state, the waiting commands (newest first) and the
    controller's state.

    Attributes:
        a: (n, n). b: (n, 2). c: (n,). h: (3, n). d: (3, 2).
        tick_s: the tick, seconds.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    h: FloatArray
    d: FloatArray
    tick_s: float

    def closed(self, gain: float = 1.0) -> FloatArray:
        """The tick's matrix (n, n) with y_m = gain · y."""
        return self.a + gain * np.outer(self.b[:, 0], self.c)

    @cached_property
    def lumped(self) -> SampledLoop:
        """The same loop with equal states lumped; each waiting value counts once."""
        a, b, rows = lumped(self.a, self.b, np.vstack([self.c, self.h]))
        return replace(self, a=a, b=b, c=rows[0], h=rows[1:])

    def poles(self) -> ComplexArray:
        """Eigenvalues of the lumped closed loop that decide its stability.

        A dead channel can leave an integrator of the controller open: the integrator of C after the
        loss of an uncompensated torque channel, the integrator of d̂ (1 - q = 0 at s = 0) after a
        lost force difference. An open integrator drifts with its input, but neither grows by itself
        nor reaches the plant, so the result omits its eigenvalue. "Does not reach" is a question
        about exact zeros of the matrix.
        """
        a = self.lumped.closed()
        reaches = reaching(a, self.lumped.c)
        if reaches.all():
            return np.linalg.eigvals(a).astype(np.complex128)
        acting = np.linalg.eigvals(a[np.ix_(reaches, reaches)])
        rest = a[np.ix_(~reaches, ~reaches)]
        idle = np.linalg.eigvals(rest)
        nearest = np.argsort(np.abs(idle - 1.0))
        return np.concatenate([acting, idle[nearest[integrators(rest) :]]]).astype(np.complex128)

    def spectral_radius(self) -> float:
        """Largest magnitude of a pole: what is left, or grown, of a disturbance a tick later."""
        return float(np.abs(self.poles()).max())

    def loop_gain(self, z: ComplexArray) -> ComplexArray:
        """L(z) = -c(zI - A)⁻¹b from measurement to measurement, for ``z`` of shape (m,).

        Back-substitution in the Schur form, for all ``z`` at once. The form mixes all states: near
        z = 1, with several slow poles there, ``gain_at`` has more digits.
        """
        triangle, b, c = self._triangular
        x = np.zeros((len(b), len(z)), dtype=np.complex128)
        for i in reversed(range(len(b))):
            x[i] = (b[i] + triangle[i, i + 1 :] @ x[i + 1 :]) / (z - triangle[i, i])
        return np.asarray(-(c @ x), dtype=np.complex128)

    def gain_at(self, theta: float) -> complex:
        """L(e^{jθ}) by elimination in δ = e^{jθ} - 1."""
        a, b, c = self._balanced
        delta = 2j * cmath.sin(theta / 2.0) * cmath.exp(0.5j * theta)
        eye = np.eye(len(a))
        return complex(-(c @ np.linalg.solve(delta * eye - (a - eye), b)))

    @cached_property
    def _balanced(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A, b and c of states of similar size: commands are 1e5 times D*."""
        loop = self.lumped
        balanced, scaling = linalg.matrix_balance(loop.a, permute=False)
        scale = np.diag(scaling)
        return balanced, loop.b[:, 0] / scale, loop.c * scale

    @cached_property
    def _triangular(self) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """A's Schur form, b and c with it."""
        a, b, c = self._balanced
        triangle, unitary = linalg.schur(a, output="complex")
        return triangle, unitary.conj().T @ b, c @ unitary

    @cached_property
    def angles(self) -> FloatArray:
        """ωT, ascending to π: a logarithmic grid, closer where a pole is near the unit circle.

        The step is at most an eighth of a turn of the longest delay in the loop.
        """
        waiting = self.lumped.a
        poles = np.concatenate([np.linalg.eigvals(waiting), self.poles()])
        distance = np.abs(poles - 1.0)
        lowest = 1e-2 * distance[distance > OPEN_INTEGRATOR].min(initial=math.pi)
        resonant = poles[(poles.imag > 0.0) & (np.abs(poles) > 0.5)]
        around = np.linspace(-4.0, 4.0, 33)
        close = np.angle(resonant)[:, None] + (1.0 - np.abs(resonant))[:, None] * around
        even = np.linspace(0.0, math.pi, 4 * len(waiting))
        angles = np.concatenate([np.geomspace(lowest, math.pi, 1500), even, close.ravel()])
        return np.unique(angles[(angles >= lowest) & (angles <= math.pi)])


def linear_controller(table: Table, confirmed: float = 0.0) -> LinearController:
    """The matrices of ``controller.step`` for ``table``, in float64 for any table precision.

    ``confirmed`` is the confirmed lost share of channel 1; 0: no loss. The share changes the law
    only for a table that compensates on confirmation.
    """
    memories = memories_of(table)
    k = len(memories)
    tables = without_limits(table, k + 2)
    states = controller.init(tables[0], k + 2)
    if confirmed > 0.0:
        states["fault_state"] = FaultState.CONFIRMED
        for name in ("share", "between", "followed"):
            states["supervision"]["loss_model"][name] = confirmed
    for j, (path, index) in enumerate(memories):
        field_of(states, path)[(j, *index)] = 1.0
    inputs = np.zeros((2, k + 2))
    inputs[:, k:] = np.eye(2)
    controller.step_many(tables, states, inputs[1], inputs[0])
    latency = int(table.estimator.latency_ticks)
    estimator = states["estimator"]
    for name, length in QUEUES:  # the ring has turned by one: oldest first again
        ring = estimator[name]["commands"][:, : int(table.estimator[length])]
        ring[:] = np.roll(ring, -estimator[name]["index"][0], axis=1)
    after = np.array([field_of(states, path)[(slice(None), *index)] for path, index in memories])
    after = after.reshape(k, k + 2)  # valid without any memory, too
    answers = np.array([states[name] for name in ANSWERS])
    return LinearController(after[:, :k], after[:, k:], answers[:, :k], answers[:, k:], latency)


def sampled_loop(
    law: LinearController,
    plant: Plant,
    tick_s: float,
    effectiveness: tuple[float, float] = (1.0, 1.0),
    extra_delay_ticks: float = 0.0,
) -> SampledLoop:
    """The loop of ``law`` around ``plant``.

    Args:
        law: ``linear_controller`` of a table that was built for ``tick_s``.
        plant: the car, not necessarily the table's design car.
        tick_s: the tick, seconds.
        effectiveness: effectiveness of each actuator, 1 healthy, 0 dead.
        extra_delay_ticks: delay of commands beyond the controller's ``latency_ticks``; fractions
            allowed.

    Raises:
        ParameterError: a delay that is not finite and >= 0, an effectiveness outside 0..1.
    """
    if not (math.isfinite(extra_delay_ticks) and extra_delay_ticks >= 0.0):
        raise ParameterError(
            f"extra_delay_ticks = {extra_delay_ticks:g}: must be finite and 0 or above"
        )
    for left in effectiveness:
        if not 0.0 <= left <= 1.0:
            raise ParameterError(f"effectiveness = {left:g}: must be 0 (dead) to 1 (healthy)")
    delays = [
        split_ticks(law.latency_ticks + extra_delay_ticks + dead_time_s / tick_s)
        for dead_time_s in plant.path_dead_times_s
    ]
    phi, gamma_new, gamma_old = held_input(plant.a, plant.b, tick_s, (delays[0][1], delays[1][1]))
    gamma_new, gamma_old = gamma_new * effectiveness, gamma_old * effectiveness
    waiting = max(whole + bool(part) for whole, part in delays)

    n, k = len(phi), len(law.a)
    size = n + 2 * waiting + k
    x, queue, memory = slice(0, n), slice(n, size - k), slice(size - k, size)
    command = np.zeros((waiting + 1, 2, size))  # [j]: u(k - j) out of the loop's state ...
    command[0, :, memory] = law.c[:2]
    command[1:, :, queue] = np.eye(2 * waiting).reshape(waiting, 2, 2 * waiting)
    direct = np.zeros((waiting + 1, 2, 2))  # ... and out of this tick's inputs
    direct[0] = law.d[:2]

    a, b = np.zeros((size, size)), np.zeros((size, 2))
    a[x, x] = phi
    for channel, (whole, part) in enumerate(delays):
        for gamma, late in ((gamma_new, whole), (gamma_old, whole + 1))[: 1 + bool(part)]:
            a[x] += np.outer(gamma[:, channel], command[late, channel])
            b[x] += np.outer(gamma[:, channel], direct[late, channel])
    a[queue], b[queue] = command[:-1].reshape(-1, size), direct[:-1].reshape(-1, 2)
    a[memory, memory], b[memory] = law.a, law.b
    h = np.zeros((3, size))
    h[:, memory] = law.c
    c = np.zeros(size)
    c[x] = plant.c[0]
    return SampledLoop(a, b, c, h, law.d, tick_s)


def field_of(states: Records[State], path: tuple[str, ...]) -> Any:
    """A view of the field at ``path`` in all ``states``."""
    found: Any = states
    for name in path:
        found = found[name]
    return found


def memories_of(table: Table) -> list[Memory]:
    """All memories from tick to tick, except accumulators that stay zero for ever.

    No signal excites the second accumulator of a first-order section or the accumulators of a gain;
    counting such accumulators would add eigenvalues at 1 without effect.
    """
    memories: list[Memory] = []
    estimator = table.estimator
    cascades: dict[tuple[str, ...], biquad.Constants] = {
        ("tracking", "filter"): table.tracking.filter,
        ("tracking", "stabiliser"): table.tracking.stabiliser,
        ("estimator", "channel_1"): estimator.channel_1,
        ("estimator", "channel_2"): estimator.channel_2,
        ("estimator", "one_plus_q"): estimator.one_plus_q,
        ("estimator", "measurement"): estimator.measurement,
        ("compensator", "filter"): table.compensator.filter,
    }
    if table.compensator.on_confirmation:
        w = ("supervision", "loss_model", "channel_1")  # another state of G1
        cascades[w] = estimator.channel_1
    for path, cascade in cascades.items():
        for i in range(cascade.n):
            _, b1, b2, a1, a2 = cascade.coefficients[i]
            if b1 or a1 or b2 or a2:
                memories.append(((*path, "accumulators"), (i, 0)))
            if b2 or a2:
                memories.append(((*path, "accumulators"), (i, 1)))
    for name, length in QUEUES:
        memories += [(("estimator", name, "commands"), (j,)) for j in range(estimator[length])]
    return memories


def without_limits(table: Table, n: int) -> Records[Table]:
    """``n`` linear copies of ``table`` in float64."""
    tables = zeroed(Table, "float64", n)
    tables[:] = np.array(table)
    for actuator in ("actuator_1", "actuator_2"):
        tables[actuator]["limit"] = tables[actuator]["slew"] = math.inf
        tables[actuator]["lsb"] = 0.0
    for name in ("confirm", "recover", "suspect"):
        tables["decision"][name] = math.inf
    tables["reference_shaper"]["enabled"] = tables["monitor"]["enabled"] = 0
    return tables
