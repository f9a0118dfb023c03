"""Runs beside the recorded run: without its fault, noise or compensation; the applied commands."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import RigError
from can_rig.logs.columns import APPLIED, TRUE_OUTPUT
from can_rig.plant.actuators import Actuator
from can_rig.plant.changing_car import linear_plant, plant_of
from can_rig.plant.faults.plant_faults import DISTORTING, PlantFaults
from can_rig.plant.frameless import frameless_loop, inputs_of, law_of, simulation, with_files
from can_rig.plant.in_windows import blocks_of
from can_rig.results.signals import Signals, signals_of_trace
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import SENSOR
from can_rig.scenario.reference import refuse_saturation
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.analysis.hardware import LATE, distorted
from firmware_model.analysis.simulation import Simulation
from firmware_model.law.structs import FloatArray


class Counterfactual(NamedTuple):
    """Signals at the ticks of the recorded run, (ticks,) each."""

    dstar_mps2: FloatArray
    """Measured D*; nan after the failure of a user's plant."""
    force_difference_n: FloatArray
    car_mps2: FloatArray
    """D* of the car without the errors of a faulty sensor; see ``car_output``."""
    output_mps2: FloatArray
    """D* of the car before its sensor."""


def fault_free(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run without faults: same plant, table, frames and noise."""
    return _instead(scenario.healthy, signals, len(signals))


def without_fault(scenario: Scenario, at: int, signals: Signals) -> Counterfactual:
    """The same run without the fault number ``at``."""
    others = scenario.faults[:at] + scenario.faults[at + 1 :]
    return _instead(replace(scenario, fault=others), signals, len(signals))


def noise_free(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    """The same run without faults and without the sensor's noise; nan after the first ``rows``."""
    return _instead(scenario.undisturbed, signals, rows)


def uncompensated(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run with faults and without compensation; nan for a controller of one's own."""
    if not scenario.controller.is_ours:
        return _unknown(signals)
    off = replace(scenario.design, compensation="off")
    return _instead(replace(scenario, design=off), signals, len(signals))


def undisturbed(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run without faults, disturbances and our law's compensation; with the same noise."""
    calm = replace(scenario.healthy, disturbance=())
    if scenario.controller.is_ours:
        calm = replace(calm, design=replace(scenario.design, compensation="off"))
    return _instead(calm, signals, len(signals))


def _unknown(signals: Signals) -> Counterfactual:
    return Counterfactual(*np.full((len(Counterfactual._fields), len(signals)), np.nan))


def _instead(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    if not len(signals):
        return _unknown(signals)
    first = round(float(signals.time_s[0]) / scenario.tick_s)
    ticks = first + len(signals)
    if ticks < scenario.ticks and not scenario.controller.is_ours:
        return _unknown(signals)  # what ended the run, perhaps for ever, would end this run too
    if ticks > scenario.ticks:
        scenario = replace(scenario, duration_s=ticks * scenario.tick_s)
    try:
        if scenario.ticks > paged.PAGED_ROWS:
            return Counterfactual(*(values[first:] for values in _long(scenario, ticks)))
        loop = loop_of(scenario)
        loop.run(first + rows)
    except RigError:  # of a controller of one's own
        return _unknown(signals)
    return _of_loop(scenario, loop, slice(first, ticks), first)


def _of_loop(scenario: Scenario, loop: Simulation, rows: slice, first: int) -> Counterfactual:
    """The signals of some rows of a loop, which begin with the tick ``first``."""
    measured, output = measured_in(scenario, loop)[rows], loop.trace.measurement[rows]
    force = np.where(np.isnan(measured), np.nan, loop.trace.command_2[rows])
    return Counterfactual(measured, force, car_output(scenario, measured, output, first), output)


@remembered(4, by=lambda scenario, ticks: (*with_files(scenario), ticks))
def _long(scenario: Scenario, ticks: int) -> Counterfactual:
    """The first ``ticks`` of a long run, which was perhaps stopped then; its loop is dropped."""
    columns = Counterfactual(*(paged.empty(ticks) for _ in Counterfactual._fields))
    for its, loop, rows in blocks_of(scenario):
        found = _of_loop(scenario, loop, rows, its.start)
        for column, values in zip(columns, found, strict=True):
            column[its.start : its.stop] = values[: ticks - its.start]
        if its.stop >= ticks:
            break
    return columns


@remembered(6, by=with_files)
def loop_of(scenario: Scenario) -> Simulation:
    """A shared loop, advanced as far as any caller needs."""
    return frameless_loop(scenario, network_of(scenario))


def measured_in(scenario: Scenario, loop: Simulation) -> FloatArray:
    """(ticks,), D* as measured; of a car without a sensor of D* the car's own."""
    return loop.trace.measurement if scenario.plant.sensor.is_made else loop.trace.measured


def car_output(
    scenario: Scenario, measured: FloatArray, true_output: FloatArray | None, first: int = 0
) -> FloatArray:
    """(ticks,), ``measured`` D* without the errors of a faulty sensor, m/s².

    A bias is subtracted. A fault beyond a bias hides the measurement: there the result is the car's
    true output, without noise and resolution; nan if unknown.

    Args:
        scenario: the run.
        measured: (ticks,), D* as received by the controller.
        true_output: (ticks,), the car's true output; None: unknown.
        first: the first tick.
    """
    if scenario.plant.sensor.is_made:
        return np.full(len(measured), math.nan) if true_output is None else true_output
    ticks = range(first, first + len(measured))
    output = measured - PlantFaults(scenario).bias(ticks)
    hidden: NDArray[np.bool_] = np.zeros(len(measured), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.place == SENSOR and (fault.acts_on_frames or fault.kind in DISTORTING):
            its = fault.ticks(scenario.tick_ns, ticks)
            hidden[np.array(its, dtype=np.int64) - first] = True
    return np.where(hidden, np.nan if true_output is None else true_output, output)


def output_of_car(scenario: Scenario, signals: Signals) -> FloatArray:
    """(ticks,), D* of the car without the errors of a faulty sensor; see ``car_output``."""
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    return car_output(scenario, signals.dstar_mps2, signals.plant.get(TRUE_OUTPUT), first)


def deviation_from(scenario: Scenario, signals: Signals, other: Counterfactual) -> FloatArray:
    """(ticks,), |D* of the car minus D* of the other run's car|."""

    def part(rows: slice) -> FloatArray:
        return np.abs(output_of_car(scenario, signals[rows]) - other.car_mps2[rows])

    with np.errstate(invalid="ignore", over="ignore"):  # a loop that diverges
        return paged.column(len(signals), part)


def applied_commands(scenario: Scenario, signals: Signals) -> tuple[FloatArray, FloatArray]:
    """Both inputs of the plant from each tick to the next, (ticks,) each, in the commands' units.

    The plant's report, if any. For a log without reports, and for actuators without lag: a command
    acts ``latency_ticks`` after its tick; an actuator without commands holds the last command for
    ``actuator.hold_s``, then applies zero; a dead actuator keeps the share ``fault.left``. nan at
    the start of a log with a late begin, before its first command acts.
    """
    if all(name in signals.plant for name in APPLIED):
        torque_nm, force_difference_n = (signals.plant[name] for name in APPLIED)
        return torque_nm, force_difference_n
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    hold_ticks = round(scenario.actuator.hold_s / scenario.tick_s)
    faults, ticks = PlantFaults(scenario), range(first, first + len(signals))
    left, rows = faults.left(ticks), faults.rows(ticks)
    before = np.full(scenario.latency_ticks, 0.0 if first == 0 else math.nan)
    commands = signals.torque_nm, signals.force_difference_n
    one, two = (
        left[:, channel]
        * _reached(np.concatenate([before, _held(command, hold_ticks)]), ticks, rows[:, channel])
        for channel, command in enumerate(commands)
    )
    return one, two


def _reached(acting: FloatArray, ticks: range, faults: FloatArray) -> FloatArray:
    """The commands at an actuator, with ``faults`` (ticks, ...)."""
    reached = acting[: len(ticks)].copy()
    previous = 0.0
    for k, fault in enumerate(faults):
        late = k - int(fault[LATE])
        reached[k] = previous = distorted(acting[late] if late >= 0 else 0.0, previous, fault)
    return reached


def _held(command: FloatArray, hold_ticks: int) -> FloatArray:
    actuator = Actuator(hold_ticks)
    heard = (None if math.isnan(value) else value for value in command.tolist())
    return np.array([actuator.hear(value) for value in heard], dtype=np.float64)


def signals_without_log(scenario: Scenario) -> Signals:
    """The signals of a run without records, with the plant's output.

    Raises:
        RigError: an impossible run, or an end before the last tick.
    """
    network = network_of(scenario)
    refuse_saturation(scenario, network)
    of, inputs, linear = (
        law_of(scenario, network),
        inputs_of(scenario, network),
        linear_plant(scenario),
    )
    loop = simulation(scenario, network, linear or plant_of(scenario), of, inputs)
    shares = linear is not None and of is not None and not scenario.heard
    if shares and scenario.faults and not len(inputs.faults):
        _begin_without_fault(loop, scenario)
    loop.run()
    signals = signals_of_trace(loop.trace, inputs.delivery, loop.ticks, network)
    return replace(signals, plant={TRUE_OUTPUT: loop.trace.measurement})


def _begin_without_fault(loop: Simulation, scenario: Scenario) -> None:
    """Copy the fault-free run up to the first difference; the metrics need that run anyway.

    Impossible for a fault that looks back before its start.
    """
    healthy = loop_of(scenario.healthy)
    first = min([loop.ticks, *(outage.start for outage in scenario.outages)])
    for own, its in zip(loop.inputs, healthy.inputs, strict=True):
        differs = np.flatnonzero((own != its).reshape(loop.ticks, -1).any(axis=1))
        first = min([first, *differs[:1].tolist()])
    if healthy.done <= first:
        healthy.run(first)
        loop.go_on_from(healthy)
