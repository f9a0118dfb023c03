"""A plant between two ticks: exact for held commands, as actuators on a bus hold commands.

A fractional dead time makes an input change within the interval, from the older of two commands to
the newer, and a sensor look back into the interval. Both are exact: the code cuts the interval at
each change and combines the pieces into one step

    x⁺ = Φx + Γ u(k - m) + Γ' u(k - m - 1)

with m the whole ticks of each input's dead time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from scipy import linalg

from firmware_model.analysis.witnesses import NO_READINGS, Readings
from firmware_model.compiled import compiled, firmware
from firmware_model.design.plants import Plant
from firmware_model.errors import ParameterError
from firmware_model.law.structs import FloatArray

WHOLE = 1e-9  # of a tick: tolerance for a whole number of ticks


class AnyPlant(Protocol):
    """A plant with its actuators and sensor, at rest when it is given to ``simulate``."""

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """Advance by a tick; return the output before the sensor and the sensor's reading.

        The commands reach the actuators now; ``left_1`` and ``left_2`` are the remaining
        effectiveness.
        """


@dataclass(frozen=True)
class SampledPlant:
    """The step above, the sensor's reading at the end, and the output before the sensor.

    Attributes:
        phi: (n, n). gamma: (n, 2). c: (n,). Read-only, float64.
        tick_s: the tick, seconds.
        gamma_old: (n, 2), Γ'; zero where dead times are whole ticks.
        sensed: (n,), the output before the sensor.
        dead_ticks: m of each input.
        looks_back: (n + 4,), the sensor's reading within the interval from the initial state, u(k -
            m) and u(k - m - 1); zero for a dead time of whole ticks: then the sensor reads ``c`` at
            the end.
        sensor_dead_ticks: the whole ticks of the sensor's dead time.
        readings: of further sensors.
    """

    phi: FloatArray
    gamma: FloatArray
    c: FloatArray
    tick_s: float
    gamma_old: FloatArray
    sensed: FloatArray
    dead_ticks: tuple[int, int]
    looks_back: FloatArray
    sensor_dead_ticks: int
    readings: Readings = NO_READINGS

    @property
    def rest(self) -> FloatArray:
        """A state at rest, shape (n,)."""
        return np.zeros(len(self.c))

    @property
    def constants(self) -> Any:
        """The constants of ``follow``, for compiled code."""
        inputs = (self.phi, self.gamma, self.gamma_old, bool(self.gamma_old.any()))
        outputs = (self.sensed, self.c, self.looks_back, bool(self.looks_back.any()))
        dead = np.array([*self.dead_ticks, self.sensor_dead_ticks], np.int64)
        return inputs, outputs, dead, not (dead.any() or inputs[3] or outputs[3])

    @property
    def memory(self) -> Any:
        """The memory of ``follow``, at rest.

        The state, room for the next one, and rings of commands and of samples.
        """
        length = max(self.dead_ticks) + 2
        return self.rest, self.rest, np.zeros((length, 2)), np.zeros(self.sensor_dead_ticks + 1)


def sample(plant: Plant, tick_s: float, readings: Readings = NO_READINGS) -> SampledPlant:
    """Discretise ``plant`` exactly for commands held over ``tick_s`` seconds.

    ``readings`` are those of further sensors.

    Raises:
        ParameterError: a tick that is not a finite time above zero.
    """
    if not 0.0 < tick_s < float("inf"):
        raise ParameterError(f"tick_s = {tick_s:g}: must be finite and above 0 s")
    (whole_1, part_1), (whole_2, part_2), (whole, part) = (
        split_ticks(dead_time_s / tick_s)
        for dead_time_s in (*plant.dead_times_s, plant.sensor_dead_time_s)
    )
    phi, gamma, gamma_old = held_input(plant.a, plant.b, tick_s, (part_1, part_2))
    looks_back = np.zeros(len(phi) + 4)
    if part > 0.0:
        begin = held_input(plant.a, plant.b, tick_s, (part_1, part_2), until=1.0 - part)
        looks_back = np.concatenate([plant.c[0] @ matrix for matrix in begin])
    c = np.ascontiguousarray(plant.c[0])
    sensed = c if plant.sensed is None else np.ascontiguousarray(plant.sensed[0])
    for array in (phi, gamma, gamma_old, c, sensed, looks_back):
        array.flags.writeable = False
    return SampledPlant(
        phi, gamma, c, tick_s, gamma_old, sensed, (whole_1, whole_2), looks_back, whole, readings
    )


def split_ticks(ticks: float) -> tuple[int, float]:
    """Whole ticks and the remaining fraction of a tick; a fraction within rounding is zero."""
    whole = math.floor(ticks + WHOLE)
    part = ticks - whole
    return whole, part if part > WHOLE else 0.0


def held_input(
    a: FloatArray, b: FloatArray, tick_s: float, late: tuple[float, ...], until: float = 1.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Φ (n, n), Γ, Γ' (n, m) of x⁺ = Φx + Γu + Γ'u' over the part ``until`` of ``tick_s``.

    Args:
        a: (n, n).
        b: (n, m).
        tick_s: the tick, seconds.
        late: after which part of the tick each input goes over from u' to u.
        until: where it ends.
    """
    n, m = b.shape
    phi, gamma, gamma_old = np.eye(n), np.zeros((n, m)), np.zeros((n, m))
    cuts = sorted({0.0, until, *(part for part in late if part < until)})
    for begin, end in pairwise(cuts):
        step, drive = _exponential(a, b, (end - begin) * tick_s)
        new = np.array([begin >= part for part in late])
        gamma, gamma_old = step @ gamma + drive * new, step @ gamma_old + drive * ~new
        phi = step @ phi
    return phi, gamma, gamma_old


def _exponential(a: FloatArray, b: FloatArray, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """e^{At} and ∫e^{At}dt B over ``duration_s``."""
    n, m = b.shape
    augmented = np.zeros((n + m, n + m))
    augmented[:n, :n] = a
    augmented[:n, n:] = b
    exponential = linalg.expm(augmented * duration_s)
    return np.ascontiguousarray(exponential[:n, :n]), np.ascontiguousarray(exponential[:n, n:])


@firmware
def advance_plant(phi: Any, gamma: Any, x: Any, after: Any, u1: float, u2: float) -> None:
    """The state one tick later, in place; plain loops fix the order of additions on all machines.

    ``after`` is scratch memory of the shape of ``x``.
    """
    n = len(x)
    for i in range(n):
        total = gamma[i, 0] * u1 + gamma[i, 1] * u2
        for j in range(n):
            total += phi[i, j] * x[j]
        after[i] = total
    for i in range(n):
        x[i] = after[i]


@firmware
def measure_plant(c: Any, x: Any) -> float:
    """The output y = cx."""
    total = 0.0
    for j in range(len(x)):
        total += c[j] * x[j]
    return total


@compiled
def follow_plant(phi: Any, gamma: Any, c: Any, x: Any, u1: float, u2: float) -> float:
    """Advance by a tick, in place, and measure."""
    advance_plant(phi, gamma, x, np.empty(len(x)), u1, u2)
    return measure_plant(c, x)


@firmware
def follow(
    constants: Any, memory: Any, k: int, u1: float, u2: float, left_1: float, left_2: float
) -> tuple[float, float]:
    """Advance from tick ``k`` to the next; return the output before the sensor and the reading.

    Args:
        constants: constants of a ``SampledPlant``.
        memory: memory of the plant; changed in place.
        k: the tick, counted from rest.
        u1: the command that reaches actuator 1 now, before its dead time.
        u2: the command of actuator 2.
        left_1: effectiveness of actuator 1, applied after the dead time.
        left_2: effectiveness of actuator 2.
    """
    (phi, gamma, gamma_old, changes), (sensed, c, looks_back, within), dead, immediate = constants
    x, after, commands, samples = memory
    if immediate:  # no dead time: nothing waits
        advance_plant(phi, gamma, x, after, left_1 * u1, left_2 * u2)
        return measure_plant(sensed, x), measure_plant(c, x)
    length = len(commands)
    commands[k % length, 0] = u1
    commands[k % length, 1] = u2
    new_1 = left_1 * commands[(k - dead[0]) % length, 0]
    new_2 = left_2 * commands[(k - dead[1]) % length, 1]
    old_1 = left_1 * commands[(k - dead[0] - 1) % length, 0]
    old_2 = left_2 * commands[(k - dead[1] - 1) % length, 1]
    reading = 0.0
    if within:
        n = len(x)
        reading = looks_back[n] * new_1 + looks_back[n + 1] * new_2
        reading += looks_back[n + 2] * old_1 + looks_back[n + 3] * old_2
        for j in range(n):
            reading += looks_back[j] * x[j]
    advance_plant(phi, gamma, x, after, new_1, new_2)
    if changes:
        for i in range(len(x)):
            x[i] += gamma_old[i, 0] * old_1 + gamma_old[i, 1] * old_2
    if not within:
        reading = measure_plant(c, x)
    samples[(k + 1) % len(samples)] = reading
    return measure_plant(sensed, x), samples[(k + 1 - dead[2]) % len(samples)]
