"""Further sensors of a plant: readings and contents of frames, tick by tick.

A reading is a row of the plant's state, of the world's inputs and of the actuators' outputs:

    y(k) = R x(k) + D w(k) + S v(k-),

v(k-) the values that reached the plant's inputs just before tick k. A filter of first order is one
more state of the plant, so the reading after the filter is exact too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from firmware_model.analysis import hardware
from firmware_model.compiled import firmware
from firmware_model.design.actuator_dynamics import Stage
from firmware_model.design.plants import Plant
from firmware_model.design.vehicle import WITNESSES, WorldInputs
from firmware_model.law.structs import FloatArray

LIES, SWAPPED, INVALID, STANDING = range(hardware.DISTORTION, hardware.DISTORTION + 4)
"""After the places of ``hardware``: whether an echo reports the command; the sensor whose reading
comes instead, -1 for none; whether the frame is marked invalid; whether the sample's tick stands
still."""

DISTORTION: Final = hardware.DISTORTION + 4
HEALTHY: Final[FloatArray] = np.array([*hardware.HEALTHY, 0.0, -1.0, 0.0, 0.0])

PERIOD, PHASE, DELAY = range(3)
"""The places in the timing of a sensor, ticks."""

NOT_SENT, NOT_VALID, VALID = -1, 0, 1
"""What becomes of a sensor in a tick."""


@dataclass(frozen=True, eq=False)
class Readings:
    """R (r, n), D (r, m) and S (r, 2) of the equation above, for r sensors."""

    rows: FloatArray
    direct: FloatArray
    acting: FloatArray

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def constants(self) -> Any:
        """The constants of ``read_witnesses``, for compiled code."""
        return self.rows, self.acting


@dataclass(frozen=True)
class Reading:
    """One further sensor: what it reads, and the time constant of its filter.

    Attributes:
        of: a row of ``vehicle.WITNESSES``, or ``ECHO`` and the number of the channel.
        lag_s: 0: no filter.
    """

    of: int
    lag_s: float = 0.0


ECHO: Final = len(WITNESSES)
"""From here on, ``Reading.of`` counts the actuators."""


def with_readings(
    plant: Plant, stages: tuple[Stage, Stage, Stage], readings: Sequence[Reading]
) -> tuple[Plant, Readings]:
    """``plant`` with a state for each filter, and the readings of its states.

    Args:
        plant: after the ``stages``; see ``actuator_dynamics.actuated``.
        stages: of both actuators and of the sensor.
        readings: the further sensors.
    """
    (a, b, e), found = filtered_readings(plant.a, plant.b, plant.world, stages, readings)
    if len(a) == len(plant.a):
        return plant, found
    more = len(a) - len(plant.a)

    def wider(matrix: FloatArray) -> FloatArray:
        return np.hstack([matrix, np.zeros((len(matrix), more))])

    world = plant.world
    return (
        replace(
            plant,
            a=a,
            b=b,
            c=wider(plant.c),
            sensed=wider(plant.c if plant.sensed is None else plant.sensed),
            world=None if world is None else replace(world, e=e, rows=wider(world.rows)),
        ),
        found,
    )


def filtered_readings(
    a: FloatArray,
    b: FloatArray,
    world: WorldInputs | None,
    stages: tuple[Stage, Stage, Stage],
    readings: Sequence[Reading],
) -> tuple[tuple[FloatArray, FloatArray, FloatArray], Readings]:
    """A, B and E with a state for each filter, and the readings."""
    n, m = len(a), len(WITNESSES) if world is None else world.direct.shape[1]
    lags = [len(stage.realisation[0]) for stage in stages]
    actuators = n - sum(lags), n - sum(lags[1:])  # where the states of each actuator begin
    rows, direct, acting = np.zeros((len(readings), n)), np.zeros((len(readings), m)), []
    for at, reading in enumerate(readings):
        channel = reading.of - ECHO
        acting.append(np.zeros(2))
        if channel < 0:
            assert world is not None
            rows[at], direct[at] = world.rows[reading.of], world.direct[reading.of]
        elif lags[channel]:
            own = slice(actuators[channel], actuators[channel] + lags[channel])
            rows[at, own] = stages[channel].realisation[2]
        else:
            acting[at][channel] = 1.0
    feed = np.array(acting).reshape(len(readings), 2)
    filtered = [at for at, reading in enumerate(readings) if reading.lag_s > 0.0]
    size = n + len(filtered)
    wide_a, wide_b, wide_e = np.zeros((size, size)), np.zeros((size, 2)), np.zeros((size, m))
    wide_a[:n, :n], wide_b[:n] = a, b
    wide_e[:n] = 0.0 if world is None else world.e
    wide_rows = np.hstack([rows, np.zeros((len(readings), len(filtered)))])
    for state, at in enumerate(filtered, start=n):
        lag_s = readings[at].lag_s
        wide_a[state, :n], wide_a[state, state] = rows[at] / lag_s, -1.0 / lag_s
        wide_b[state], wide_e[state] = feed[at] / lag_s, direct[at] / lag_s
        wide_rows[at], direct[at], feed[at] = 0.0, 0.0, 0.0
        wide_rows[at, state] = 1.0
    return (wide_a, wide_b, wide_e), Readings(wide_rows, direct, feed)


NO_READINGS: Final = Readings(np.zeros((0, 0)), np.zeros((0, len(WITNESSES))), np.zeros((0, 2)))


@firmware
def acting_before(
    constants: Any, memory: Any, k: int, u: float, left: float, channel: int
) -> float:
    """What acted on an input of a ``SampledPlant`` just before tick ``k + 1``.

    Args:
        constants: of the plant.
        memory: of the plant, after ``follow`` of tick ``k``.
        k: the tick.
        u: the command that reached the actuator at ``k``.
        left: what a fault left of the command.
        channel: of the input.
    """
    _, _, dead, immediate = constants
    commands = memory[2]
    if not immediate:
        u = commands[(k - dead[channel]) % len(commands), channel]
    return left * u


@firmware
def read_witnesses(constants: Any, x: Any, acted_1: float, acted_2: float, found: Any) -> None:
    """The readings at a tick in a calm world, into ``found`` (r,).

    Args:
        constants: of the ``Readings``.
        x: (n,), the state.
        acted_1: what acted on input 1 just before.
        acted_2: on input 2.
        found: filled in.
    """
    rows, acting = constants
    for each in range(len(found)):
        total = acting[each, 0] * acted_1 + acting[each, 1] * acted_2
        for j in range(len(x)):
            total += rows[each, j] * x[j]
        found[each] = total


@firmware
def sense(
    k: int,
    truth: Any,
    told: Any,
    bias: Any,
    noise: Any,
    faults: Any,
    constants: Any,
    memory: Any,
    values: Any,
    samples: Any,
    states: Any,
) -> None:
    """Tick ``k`` of r sensors: readings → contents of the frames.

    Args:
        k: the tick.
        truth: (r,), the readings without errors.
        told: (r,), what a lying echo says instead.
        bias: (r,), added before the noise.
        noise: (r,).
        faults: (r, ``DISTORTION``).
        constants: timing (r, 3), resolution (r,) and frames (r, ``GRID``).
        memory: ring of readings (L, r), last values (r,) and ticks of the last samples (r,);
            changed in place.
        values: (r,), filled in: the value that a frame carries.
        samples: (r,), filled in: the tick of its sample.
        states: (r,), filled in: ``NOT_SENT``, ``NOT_VALID`` or ``VALID``.
    """
    timing, resolution, frames = constants
    ring, said, stamps = memory
    for each in range(len(truth)):
        value = truth[each]
        if faults[each, LIES] != 0.0:
            value = told[each]
        ring[k % len(ring), each] = hardware.sensor_reading(
            value, bias[each], noise[each], resolution[each]
        )
    for each in range(len(truth)):
        source, at = each, k - timing[each, DELAY]
        stamp = at
        if faults[each, SWAPPED] >= 0.0:
            source = int(faults[each, SWAPPED])
        at -= int(faults[each, hardware.LATE])
        late = ring[at % len(ring), source] if at >= 0 else 0.0
        said[each] = hardware.distorted(late, said[each], faults[each])
        if faults[each, STANDING] == 0.0:
            stamps[each] = stamp
        samples[each] = stamps[each]
        values[each] = hardware.carried(said[each], frames[each])
        states[each] = VALID
        if faults[each, INVALID] != 0.0:
            states[each] = NOT_VALID
        if k < timing[each, PHASE] or (k - timing[each, PHASE]) % timing[each, PERIOD] != 0:
            states[each] = NOT_SENT
