"""A car with its actuators and its sensor: stages of unity gain in series with both channels.

    y = S e^(-d s) (G1 A1 e^(-d1 s) u1 + G2 A2 e^(-d2 s) u2)

A1, A2 and S are lags of first order, 1/(1 + τs), or of second, ω²/(s² + 2ζωs + ω²). The stages add
poles and no zero, so a channel's relative degree rises and the zeros stay. Dead times are no
rational functions: a plant stores dead times beside G1 and G2.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from firmware_model.design.plants import Plant
from firmware_model.design.vehicle import Matrix, StateSpace, WorldInputs
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ParameterError, require_positive

Realisation = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class Stage:
    """An actuator or a sensor: a lag of first or second order, and a dead time.

    ``lag_s`` is τ; ``natural_frequency_rad_per_s`` and ``damping`` are ω and ζ. Without either the
    stage is immediate.

    Raises ``ParameterError`` for a time below zero, for both lags at once, and for a natural
    frequency or a damping that is not above zero.
    """

    lag_s: float = 0.0
    natural_frequency_rad_per_s: float | None = None
    damping: float = 1.0
    dead_time_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("lag_s", "dead_time_s"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ParameterError(f"{name} = {getattr(self, name):g}: must be 0 or above")
        require_positive("damping", self.damping)
        if self.natural_frequency_rad_per_s is None:
            return
        require_positive("natural_frequency_rad_per_s", self.natural_frequency_rad_per_s)
        if self.lag_s > 0.0:
            raise ParameterError(
                f"lag_s = {self.lag_s:g}: must be 0 beside natural_frequency_rad_per_s = "
                f"{self.natural_frequency_rad_per_s:g}; a stage has one of the two"
            )

    @property
    def transfer_function(self) -> ZeroPoleGain:
        """The lag alone, 1 at s = 0."""
        omega = self.natural_frequency_rad_per_s
        if omega is not None:
            root = cmath.sqrt(self.damping**2 - 1.0)
            if self.damping < 1.0:
                pole = omega * (-self.damping + root)
                return ZeroPoleGain((), (pole, pole.conjugate()), omega**2)
            fast = -omega * (self.damping + root.real)  # the slow one is ω²/fast: no difference
            return ZeroPoleGain((), (fast, omega**2 / fast), omega**2)
        if self.lag_s > 0.0:
            return ZeroPoleGain.lag(self.lag_s, 1)
        return ZeroPoleGain.constant(1.0)

    @property
    def realisation(self) -> Realisation:
        """A (k, k), b (k,) and c (k,) of the lag, k = 0, 1 or 2; its output is the first state."""
        omega = self.natural_frequency_rad_per_s
        if omega is not None:
            a = np.array([[0.0, 1.0], [-(omega**2), -2.0 * self.damping * omega]])
            return a, np.array([0.0, omega**2]), np.array([1.0, 0.0])
        if self.lag_s > 0.0:
            return np.array([[-1.0 / self.lag_s]]), np.array([1.0 / self.lag_s]), np.ones(1)
        return np.zeros((0, 0)), np.zeros(0), np.zeros(0)


IDEAL = Stage()


def actuated(car: Plant, actuator_1: Stage, actuator_2: Stage, sensor: Stage) -> Plant:
    """``car`` with a stage before each input and a stage after the output.

    The states are those of the car, of actuator 1, of actuator 2 and of the sensor, in this order.
    With only immediate stages the result is ``car``.
    """
    if actuator_1 == actuator_2 == sensor == IDEAL:
        return car
    stages = (actuator_1, actuator_2, sensor)
    (a, b, c, sensed), world = actuated_state_space((car.a, car.b, car.c), car.world, stages)
    first, second, last = (stage.transfer_function for stage in stages)
    return replace(
        car,
        a=a,
        b=b,
        c=c,
        g1=car.g1 * first * last,
        g2=car.g2 * second * last,
        sensed=sensed,
        dead_times_s=(actuator_1.dead_time_s, actuator_2.dead_time_s),
        sensor_dead_time_s=sensor.dead_time_s,
        world=world,
    )


def actuated_state_space(
    car: StateSpace, world: WorldInputs | None, stages: tuple[Stage, Stage, Stage]
) -> tuple[tuple[Matrix, Matrix, Matrix, Matrix], WorldInputs | None]:
    """A, B, the reading's C and the C before the sensor of ``actuated``, and its world.

    Args:
        car: A (n, n), B (n, 2) and C (1, n).
        world: of the car.
        stages: of both actuators and of the sensor; their dead times have no effect here.
    """
    lags = [stage.realisation for stage in stages]
    n = len(car[0])
    at = np.cumsum([n] + [len(lag[0]) for lag in lags])
    size = int(at[-1])
    a, b, c = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((1, size))
    sensed = np.zeros((1, size))
    a[:n, :n], sensed[:, :n] = car[0], car[2]
    for channel in range(2):
        own = slice(at[channel], at[channel + 1])
        lag_a, lag_b, lag_c = lags[channel]
        if len(lag_a):
            a[own, own], b[own, channel] = lag_a, lag_b
            a[:n, own] = np.outer(car[1][:, channel], lag_c)
        else:
            b[:n, channel] = car[1][:, channel]
    own = slice(at[2], at[3])
    lag_a, lag_b, lag_c = lags[2]
    if len(lag_a):
        a[own, own], c[0, own] = lag_a, lag_c
        a[own, :n] = np.outer(lag_b, car[2][0])
    else:
        c = sensed
    if world is None:
        return (a, b, c, sensed), None
    e, rows = np.zeros((size, world.e.shape[1])), np.zeros((len(world.rows), size))
    e[:n], rows[:, :n] = world.e, world.rows
    e[own] = np.outer(lag_b, world.f[0])
    read = np.zeros_like(world.f) if len(lag_a) else world.f
    return (a, b, c, sensed), WorldInputs(e, world.f, read, rows, world.direct)
