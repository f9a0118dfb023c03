"""The compiled ticks of the loop: the controller, and the links between controller and plant."""

from __future__ import annotations

from typing import Any

from firmware_model.analysis import hardware
from firmware_model.analysis.changing_plant import follow_changing
from firmware_model.analysis.sampled_plant import follow
from firmware_model.analysis.witnesses import VALID, acting_before, read_witnesses, sense
from firmware_model.compiled import firmware, firmware_run
from firmware_model.law import controller
from firmware_model.law.layout import State, Table
from firmware_model.law.structs import Records
from firmware_model.law.supervision.further_sensors import hear

OUTPUT, MEASURED, COMMAND_1, COMMAND_2, ESTIMATE, EVIDENCE = range(6)
ACTING_1, REACHED_1, READING, ROWS = 6, 8, 10, 11  # rows of a tick; two of the first two


@firmware
def tick(
    tables: Records[Table],
    controllers: Records[State],
    inputs: Any,
    grid: Any,
    actuators: Any,
    signals: Any,
    states: Any,
    k: int,
    y: float,
    read: float,
) -> tuple[float, float]:
    """Tick ``k`` of the loop without the plant: output of the plant → commands at the actuators.

    Args:
        tables: (1,), the constants of the controller; arrays of one record are the fastest way from
            interpreted code to compiled code.
        controllers: (1,), state of the controller; changed in place.
        inputs: reference, bias, noise, effectiveness, arrives, as in ``Simulation``.
        grid: the sensor's resolution, and the frames (3, ``GRID``).
        actuators: the last commands (2,), ticks without command (2,), ticks of hold; last values at
            the actuators and last reading (3,); limits of the actuators (2, 2), faults.
        signals: (ROWS, ticks), filled in for this tick; read for delayed values.
        states: (3, ticks), fault state, mode and verdict, filled in for this tick.
        k: the tick.
        y: the output of the plant.
        read: the sensor's reading of the plant.
    """
    table, state = tables[0], controllers[0]
    measured = measure(inputs, grid, actuators, signals, k, y, read)
    controller.step(table, state, inputs[0][k], measured)
    signals[COMMAND_1, k], signals[COMMAND_2, k] = state.command_1, state.command_2
    signals[ESTIMATE, k] = state.fault_estimate
    signals[EVIDENCE, k] = state.supervision.sequential_test.candidate.predicted
    states[0, k], states[1, k] = state.fault_state, state.mode
    states[2, k] = state.supervision.hypotheses.verdict
    return carry(table.estimator.latency_ticks, inputs, grid, actuators, signals, k)


@firmware
def measure(
    inputs: Any, grid: Any, actuators: Any, signals: Any, k: int, y: float, read: float
) -> float:
    """What the controller gets in tick ``k`` of the plant's output; see ``tick``."""
    _, bias, noise, _, _ = inputs
    resolution, frames = grid
    _, _, _, reached, _, faults = actuators
    measured = hardware.sensor_reading(read, bias[k], noise[k], resolution)
    if len(faults) > 0:
        signals[READING, k] = measured
        fault, last = faults[k, hardware.SENSOR], reached[hardware.SENSOR]
        at = k - int(fault[hardware.LATE])
        measured = hardware.distorted(signals[READING, at] if at >= 0 else 0.0, last, fault)
        reached[hardware.SENSOR] = measured
    measured = hardware.carried(measured, frames[hardware.SENSOR])
    if len(faults) > 0 and faults[k, hardware.SENSOR, hardware.REPLACED] != 0.0:
        measured = faults[k, hardware.SENSOR, hardware.BY]
    signals[OUTPUT, k] = y
    signals[MEASURED, k] = measured
    return measured


@firmware
def carry(
    latency_ticks: int, inputs: Any, grid: Any, actuators: Any, signals: Any, k: int
) -> tuple[float, float]:
    """What reaches the actuators in tick ``k``, whose commands ``signals`` has; see ``tick``."""
    _, _, _, _, arrives = inputs
    _, frames = grid
    held, silent, hold_ticks, reached, limits, faults = actuators
    for channel in range(2):
        command = signals[COMMAND_1 + channel, k]
        signals[COMMAND_1 + channel, k] = hardware.carried(command, frames[channel])
        if arrives[k, channel]:
            held[channel] = signals[COMMAND_1 + channel, k]
            if len(faults) > 0 and faults[k, channel, hardware.REPLACED] != 0.0:
                held[channel] = faults[k, channel, hardware.BY]
            silent[channel] = 0
        else:
            silent[channel] += 1
            if silent[channel] > hold_ticks:
                held[channel] = 0.0
        signals[ACTING_1 + channel, k] = held[channel]
    sent = k - latency_ticks
    for channel in range(2):
        acting = 0.0  # the first command is still on its way
        at = sent if len(faults) == 0 else sent - int(faults[k, channel, hardware.LATE])
        if at >= 0:
            acting = signals[ACTING_1 + channel, at]
        if len(faults) > 0:
            acting = hardware.distorted(acting, reached[channel], faults[k, channel])
        largest, slew = limits[channel, 0], limits[channel, 1]
        reached[channel] = hardware.limited(acting, reached[channel], largest, slew)
        signals[REACHED_1 + channel, k] = reached[channel]
    return reached[0], reached[1]


@firmware_run
def run_ticks(
    loop: Any, begin: int, end: int, y: float, read: float, plant: Any, memory: Any,
    plant_states: Any,
) -> tuple[float, float]:  # fmt: skip
    """Ticks from ``begin`` to ``end`` of a loop with a ``SampledPlant``.

    The other arguments are those of ``run_changing`` and of ``follow``. ``plant_states`` (ticks, n)
    is filled in, unless it is empty.
    """
    tables, controllers, inputs, grid, actuators, signals, states = loop
    left = inputs[3]
    for k in range(begin, end):
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y, read)
        if len(plant_states) > 0:
            for i in range(plant_states.shape[1]):
                plant_states[k, i] = memory[0][i]
        y, read = follow(plant, memory, k, u1, u2, left[k, 0], left[k, 1])
    return y, read


@firmware_run
def run_hearing(
    loop: Any, begin: int, end: int, y: float, read: float, plant: Any, memory: Any, readings: Any,
    sensors: Any,
) -> tuple[float, float]:  # fmt: skip
    """``run_ticks`` of a plant whose further sensors the law hears.

    ``readings`` has the constants of ``read_witnesses``; for ``sensors`` see
    ``HearsAll.samples_of`` in ``simulation``.
    """
    tables, controllers, inputs, grid, actuators, signals, states = loop
    left = inputs[3]
    fixed, now, first, bias, noise, faults = sensors
    heard, channels, wraps, constants = fixed
    of_sensors, truth, told, values, samples, sent = now
    for k in range(begin, end):
        at = k - begin
        before = k - 1 - tables[0].estimator.latency_ticks
        for each in range(len(truth)):
            told[each] = signals[ACTING_1 + channels[each], before] if before >= 0 else 0.0
        sense(
            first + at, truth, told, bias[at], noise[at], faults[min(at, len(faults) - 1)],
            constants, of_sensors, values, samples, sent,
        )  # fmt: skip
        for each in range(len(heard)):
            sensor, number = heard[each]
            if sent[sensor] == VALID:
                age = (first + at - samples[sensor]) % wraps[sensor]
                hear(tables[0], controllers[0], float(number), values[sensor], float(age))
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y, read)
        y, read = follow(plant, memory, k, u1, u2, left[k, 0], left[k, 1])
        acted_1 = acting_before(plant, memory, k, u1, left[k, 0], 0)
        acted_2 = acting_before(plant, memory, k, u2, left[k, 1], 1)
        read_witnesses(readings, memory[0], acted_1, acted_2, truth)
    return y, read


@firmware_run
def run_changing(
    loop: Any, begin: int, end: int, y: float, read: float, plant: Any, memory: Any, ahead: int,
    world: Any, work: Any, speeds: Any,
) -> tuple[float, float]:  # fmt: skip
    """Ticks from ``begin`` to ``end`` of a loop with a ``ChangingPlant``.

    Args:
        loop: the first seven arguments of ``tick``.
        begin: the first tick of the loop.
        end: the tick after the last tick.
        y: the output of the plant at ``begin``.
        read: the sensor's reading at ``begin``.
        plant: the constants of ``follow_changing``.
        memory: of the plant; changed in place.
        ahead: number of the plant's ticks before the first tick of the loop.
        world: (end - begin + 1, ``WORLD_ROW``), or ``NO_WORLD``.
        work: see ``follow_changing``.
        speeds: see ``follow_changing``, for every tick from ``begin`` to ``end``.
    """
    tables, controllers, inputs, grid, actuators, signals, states = loop
    left = inputs[3]
    for k in range(begin, end):
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y, read)
        at = k - begin
        y, read = follow_changing(
            plant, memory, work, speeds[at], k + ahead, u1, u2, left[k, 0], left[k, 1],
            world[at : at + 2],
        )  # fmt: skip
    return y, read
