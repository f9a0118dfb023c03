"""The one loop without frames: ``step``, what lies between it and a plant, and the plant.

What a bus does to the loop is an input of it: which commands arrive, what the sensor adds, on which
grid D* is. So it gives the signals of a run on a bus, bit for bit, in a fraction of the time. A
linear plant runs compiled as a whole; for any other the same ``tick`` alternates with the plant's
own ``advance``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_model.analysis.sampled_plant import SampledPlant, follow_plant, measure_plant
from firmware_model.compiled import firmware
from firmware_model.target import controller
from firmware_model.target.structs import FloatArray, Record, RecordArray

BoolArray = NDArray[np.bool_]
Vectors = tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]

# Rows of the signals of a tick.
_OUTPUT, _MEASURED, _COMMAND_1, _COMMAND_2, _ESTIMATE, _EVIDENCE, _ACTING_1, _ACTING_2 = range(8)


class AnyPlant(Protocol):
    """A plant between two ticks, at rest when it is given to ``simulate``."""

    def advance(self, dt_s: float, command_1: float, command_2: float) -> float:
        """The output ``dt_s`` seconds later, both commands held until then."""


@dataclass(frozen=True)
class Trace:
    """One value a tick, each of shape (ticks,)."""

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    """The plant's output y."""
    measured: FloatArray
    """y as the controller gets it: with bias and noise, on the grid of its frame."""
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
            thesis's fault: the channel's input is gone, the plant keeps its state.
        noise: (ticks,), added to what the controller measures; default none.
        bias: (ticks,), likewise, and first.
        arrives: (ticks, 2), whether the command of a tick reaches its actuator; default always.
        hold_ticks: how long an actuator holds its last command without one; then it applies zero.
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
    grid = (float(lsb), float(maximum))
    signals, states = np.full((8, ticks), np.nan), np.zeros((2, ticks), dtype=np.int64)
    actuators = (np.zeros(2), np.zeros(2, dtype=np.int64), hold_ticks)
    loop = (np.array([table], table.dtype), controller.init(table), inputs, grid, actuators)
    if isinstance(plant, SampledPlant):
        tick_s = plant.tick_s
        linear = (plant.phi, plant.gamma, plant.c, plant.rest)
        _run(*loop, signals, states, linear)
    else:
        assert tick_s is not None
        y = 0.0
        for k in range(ticks):
            u1, u2 = tick(*loop, signals, states, k, y)
            y = plant.advance(tick_s, u1, u2)
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
) -> tuple[float, float]:
    """Tick ``k`` of the loop but for the plant: its output ``y`` → what acts on it until the next.

    Args:
        tables: (1,), the constants of the controller; arrays of one record are the fastest way from
            interpreted code to compiled code.
        controllers: (1,), its state; changed in place.
        inputs: reference, bias, noise, effectiveness, arrives, as those of ``simulate``.
        grid: step and end of what is measured.
        actuators: the last commands (2,), ticks without one (2,), ticks that they hold.
        signals: (8, ticks), filled in for this tick, and read for what is still on its way.
        states: (2, ticks), likewise fault state and mode.
        k: the tick.
        y: the output of the plant.
    """
    table, state = tables[0], controllers[0]
    reference, bias, noise, effectiveness, arrives = inputs
    lsb, maximum = grid
    held, silent, hold_ticks = actuators
    measured = y + bias[k] + noise[k]
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
    if sent < 0:  # the first command is still on its way
        return 0.0, 0.0
    return (
        effectiveness[k, 0] * signals[_ACTING_1, sent],
        effectiveness[k, 1] * signals[_ACTING_2, sent],
    )


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
) -> None:
    phi, gamma, c, x = plant
    y = measure_plant(c, x)
    for k in range(signals.shape[1]):
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y)
        y = follow_plant(phi, gamma, c, x, u1, u2)
