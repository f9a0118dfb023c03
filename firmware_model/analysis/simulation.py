"""The one loop without frames: ``step``, what lies between it and a plant, and the plant.

What a bus does to the loop is an input of it: which commands arrive, what the sensor adds, on which
grid D* is. A command that has come is limited as its actuator is, then it waits for its dead time
and goes through its lag; what a fault leaves is of what enters that lag. So it gives the signals of
a run on a bus, bit for bit, in a fraction of the time. A linear plant runs compiled as a whole; for
any other the same ``tick`` alternates with the plant's own ``follow``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_model.analysis.sampled_plant import SampledPlant, follow
from firmware_model.compiled import firmware
from firmware_model.target import controller
from firmware_model.target.structs import FloatArray, Record, RecordArray

BoolArray = NDArray[np.bool_]
Vectors = tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]

# Rows of the signals of a tick.
_OUTPUT, _MEASURED, _COMMAND_1, _COMMAND_2, _ESTIMATE, _EVIDENCE, _ACTING_1, _ACTING_2 = range(8)

NO_LIMITS: FloatArray = np.full((2, 2), np.inf)


class AnyPlant(Protocol):
    """A plant behind its actuators and sensor, at rest when it is given to ``simulate``."""

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """A tick later: the output before the sensor, and what the sensor reads.

        The commands reach their actuators now; ``left_1`` and ``left_2`` is what a fault leaves.
        """


@dataclass(frozen=True)
class Trace:
    """One value a tick, each of shape (ticks,)."""

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    """The plant's output y, before its sensor."""
    measured: FloatArray
    """y as the controller gets it: by the sensor, with bias and noise, on the grid of its frame."""
    command_1: FloatArray
    command_2: FloatArray
    fault_estimate: FloatArray
    fault_state: NDArray[np.int64]
    mode: NDArray[np.int64]
    evidence: FloatArray
    """The log-likelihood ratio of a loss, or of the return of a lost channel."""

    @property
    def error(self) -> FloatArray:
        """e = r - y (3.41)."""
        return self.reference - self.measurement


def simulate(
    table: Record,
    plant: SampledPlant | AnyPlant,
    reference: FloatArray,
    *,
    tick_s: float | None = None,
    effectiveness: FloatArray | None = None,
    noise: FloatArray | None = None,
    bias: FloatArray | None = None,
    arrives: BoolArray | None = None,
    hold_ticks: int = 0,
    limits: FloatArray = NO_LIMITS,
    resolution: float = 0.0,
    lsb: float = 0.0,
    maximum: float = np.inf,
) -> Trace:
    """Run the loop from rest, one tick for each reference sample.

    Args:
        table: from ``tables.build``, for the plant's tick; its latency is the loop's.
        plant: the car, which need not be the one the table was designed for.
        reference: (ticks,).
        tick_s: seconds; a ``SampledPlant`` knows it.
        effectiveness: (ticks, 2), what is left of each actuator; default all ones. A zero is the
            thesis's fault: the channel's input is gone, the plant and the lag keep their state.
        noise: (ticks,), added to what the controller measures; default none.
        bias: (ticks,), likewise, and first.
        arrives: (ticks, 2), whether the command of a tick reaches its actuator; default always.
        hold_ticks: how long an actuator holds its last command without one; then it applies zero.
        limits: (2, 2), the actuators' own, a row a channel: largest magnitude of a command, largest
            change in a tick.
        resolution: of the sensor; 0: none.
        lsb: grid of what the controller measures, in the measurement's unit; 0: none.
        maximum: where that saturates.
    """
    ticks = len(reference)
    inputs: Vectors = (
        np.asarray(reference, dtype=np.float64),
        np.zeros(ticks) if bias is None else bias,
        np.zeros(ticks) if noise is None else noise,
        np.ones((ticks, 2)) if effectiveness is None else effectiveness,
        np.ones((ticks, 2), dtype=np.bool_) if arrives is None else arrives,
    )
    grid = (float(resolution), float(lsb), float(maximum))
    signals, states = np.full((8, ticks), np.nan), np.zeros((2, ticks), dtype=np.int64)
    actuators = (np.zeros(2), np.zeros(2, dtype=np.int64), hold_ticks, np.zeros(2), limits)
    loop = (np.array([table], table.dtype), controller.init(table), inputs, grid, actuators)
    if isinstance(plant, SampledPlant):
        tick_s = plant.tick_s
        _run(*loop, signals, states, plant.constants, plant.memory)
    else:
        assert tick_s is not None
        y = read = 0.0
        for k in range(ticks):
            u1, u2 = tick(*loop, signals, states, k, y, read)
            y, read = plant.follow(u1, u2, *inputs[3][k].tolist())
    return Trace(
        time_s=tick_s * np.arange(ticks, dtype=np.float64),
        reference=inputs[0],
        measurement=signals[_OUTPUT],
        measured=signals[_MEASURED],
        command_1=signals[_COMMAND_1],
        command_2=signals[_COMMAND_2],
        fault_estimate=signals[_ESTIMATE],
        fault_state=states[0],
        mode=states[1],
        evidence=signals[_EVIDENCE],
    )


@firmware
def tick(
    tables: RecordArray,
    controllers: RecordArray,
    inputs: Any,
    grid: Any,
    actuators: Any,
    signals: Any,
    states: Any,
    k: int,
    y: float,
    read: float,
) -> tuple[float, float]:
    """Tick ``k`` of the loop but for the plant: its output → the commands that its actuators get.

    Args:
        tables: (1,), the constants of the controller; arrays of one record are the fastest way from
            interpreted code to compiled code.
        controllers: (1,), its state; changed in place.
        inputs: reference, bias, noise, effectiveness, arrives, as those of ``simulate``.
        grid: the sensor's resolution; step and end of the frame of what is measured.
        actuators: the last commands (2,), ticks without one (2,), ticks that they hold; what
            reached them last (2,), and their limits (2, 2).
        signals: (8, ticks), filled in for this tick, and read for what is still on its way.
        states: (2, ticks), likewise fault state and mode.
        k: the tick.
        y: the output of the plant.
        read: what its sensor reads of it.
    """
    table, state = tables[0], controllers[0]
    reference, bias, noise, _, arrives = inputs
    resolution, lsb, maximum = grid
    held, silent, hold_ticks, reached, limits = actuators
    measured = sensor_reading(read, bias[k], noise[k], resolution)
    if lsb > 0.0 and not math.isnan(measured):
        measured = min(max(np.rint(measured / lsb) * lsb, -maximum), maximum)
    controller.step(table, state, reference[k], measured)
    signals[_OUTPUT, k] = y
    signals[_MEASURED, k] = measured
    signals[_COMMAND_1, k] = state.command_1
    signals[_COMMAND_2, k] = state.command_2
    signals[_ESTIMATE, k] = state.fault_estimate
    signals[_EVIDENCE, k] = state.sequential_test.evidence
    states[0, k] = state.fault_state
    states[1, k] = state.mode
    for channel in range(2):
        if arrives[k, channel]:
            held[channel] = signals[_COMMAND_1 + channel, k]
            silent[channel] = 0
        else:
            silent[channel] += 1
            if silent[channel] > hold_ticks:
                held[channel] = 0.0
        signals[_ACTING_1 + channel, k] = held[channel]
    sent = k - table.estimator.latency_ticks
    for channel in range(2):
        acting = 0.0  # the first command is still on its way
        if sent >= 0:
            acting = signals[_ACTING_1 + channel, sent]
        reached[channel] = limited(acting, reached[channel], limits[channel, 0], limits[channel, 1])
    return reached[0], reached[1]


@firmware
def sensor_reading(read: float, bias: float, noise: float, resolution: float) -> float:
    """What the sensor says: with bias and noise, in whole steps of its ``resolution`` (0: none)."""
    reading = read + bias + noise
    if resolution > 0.0:
        reading = np.rint(reading / resolution) * resolution
    return reading


@firmware
def limited(command: float, previous: float, largest: float, slew: float) -> float:
    """``command`` within an actuator's magnitude, and within its slew of the ``previous`` one."""
    return min(max(command, -largest, previous - slew), largest, previous + slew)


@firmware
def _run(
    tables: RecordArray,
    controllers: RecordArray,
    inputs: Any,
    grid: Any,
    actuators: Any,
    signals: Any,
    states: Any,
    plant: Any,
    memory: Any,
) -> None:
    effectiveness = inputs[3]
    y = read = 0.0
    for k in range(signals.shape[1]):
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y, read)
        left_1, left_2 = effectiveness[k, 0], effectiveness[k, 1]
        y, read = follow(plant, memory, k, u1, u2, left_1, left_2)
