"""Runs that might have been: the recorded one without its fault, its noise, its compensation."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from can_rig import paged
from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.plant.changing_car import plant_of
from can_rig.plant.faults.plant_faults import DISTORTING, PlantFaults
from can_rig.plant.frameless import UntilItFails, common, with_files
from can_rig.plant.in_windows import blocks_of
from can_rig.results.signals import Signals
from can_rig.scenario.fault_settings import SENSOR
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Simulation
from firmware_model.target.structs import FloatArray


class Counterfactual(NamedTuple):
    """Each of shape (ticks,), at the ticks of the recorded run."""

    dstar_mps2: FloatArray
    """As measured; not a number from where on a plant of one's own fails in this run too."""
    force_difference_n: FloatArray
    car_mps2: FloatArray
    """D* of the car, without what a faulty sensor makes of it; see ``car_output``."""


def fault_free(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run without its fault: same plant, table, frames and noise."""
    return _instead(scenario.healthy, signals, len(signals))


def without_fault(scenario: Scenario, at: int, signals: Signals) -> Counterfactual:
    """The same run without one of its faults, by its number."""
    others = scenario.faults[:at] + scenario.faults[at + 1 :]
    return _instead(replace(scenario, fault=others), signals, len(signals))


def noise_free(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    """The same run without its fault and without the sensor's noise.

    Its first ``rows`` rows at least; not a number where nobody has asked for more.
    """
    return _instead(scenario.undisturbed, signals, rows)


def uncompensated(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run with its fault and no compensation of it."""
    off = replace(scenario.design, compensation="off")
    return _instead(replace(scenario, design=off), signals, len(signals))


def _instead(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    if not len(signals):
        return Counterfactual(np.empty(0), np.empty(0), np.empty(0))
    first = round(float(signals.time_s[0]) / scenario.tick_s)
    ticks = first + len(signals)
    if ticks > scenario.ticks:
        scenario = replace(scenario, duration_s=ticks * scenario.tick_s)
    if ticks > paged.PAGED_ROWS:
        return Counterfactual(*(values[first:ticks] for values in _long(scenario)))
    loop = loop_of(scenario)
    loop.run(first + rows)
    trace = loop.trace
    force = np.where(np.isnan(trace.measured), np.nan, trace.command_2)
    car = car_output(scenario, trace.measured, trace.measurement)
    return Counterfactual(*(values[first:ticks] for values in (trace.measured, force, car)))


@remembered(4, by=with_files)
def _long(scenario: Scenario) -> Counterfactual:
    """A whole run, whose loop is not kept."""
    columns = Counterfactual(*(paged.empty(scenario.ticks) for _ in Counterfactual._fields))
    for ticks, loop, rows in blocks_of(scenario):
        trace, some = loop.trace, slice(ticks.start, ticks.stop)
        measured = trace.measured[rows]
        columns.dstar_mps2[some] = measured
        columns.force_difference_n[some] = np.where(
            np.isnan(measured), np.nan, trace.command_2[rows]
        )
        output = trace.measurement[rows]
        columns.car_mps2[some] = car_output(scenario, measured, output, ticks.start)
    return columns


@remembered(4, by=with_files)
def loop_of(scenario: Scenario) -> Simulation:
    """A run that somebody may have begun, and that goes on as far as it is asked for."""
    shared = common(scenario)
    plant = shared.plant or UntilItFails(plant_of(scenario))
    return shared.loop(scenario, shared.inputs_of(scenario), plant)


def car_output(
    scenario: Scenario, measured: FloatArray, true_output: FloatArray | None, first: int = 0
) -> FloatArray:
    """(ticks,), ``measured`` D* without what a faulty sensor makes of it, m/s².

    What is added to it is taken off. Where a fault does more, it is the car's own output, without
    noise and resolution; nan where that is not known.

    Args:
        scenario: the run.
        measured: (ticks,), D* as the controller got it.
        true_output: (ticks,), the car's own; None: not known.
        first: the first of these ticks.
    """
    ticks = range(first, first + len(measured))
    output = measured - PlantFaults(scenario).bias(ticks)
    hidden: NDArray[np.bool_] = np.zeros(len(measured), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.place == SENSOR and (fault.acts_on_frames or fault.kind in DISTORTING):
            its = fault.ticks(scenario.tick_ns, ticks)
            hidden[np.array(its, dtype=np.int64) - first] = True
    return np.where(hidden, np.nan if true_output is None else true_output, output)


def output_of_car(scenario: Scenario, signals: Signals) -> FloatArray:
    """(ticks,), D* of the car, without what a faulty sensor makes of it; see ``car_output``."""
    first = round(float(signals.time_s[0]) / scenario.tick_s) if len(signals) else 0
    return car_output(scenario, signals.dstar_mps2, signals.plant.get(TRUE_OUTPUT), first)


def deviation_from(scenario: Scenario, signals: Signals, other: Counterfactual) -> FloatArray:
    """(ticks,), |D* of the car less that of another run|."""

    def part(rows: slice) -> FloatArray:
        return np.abs(output_of_car(scenario, signals[rows]) - other.car_mps2[rows])

    with np.errstate(invalid="ignore", over="ignore"):  # a loop that diverges
        return paged.column(len(signals), part)
