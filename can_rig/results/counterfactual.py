"""Runs that might have been: the recorded one without its fault, its noise, its compensation."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from can_rig.plant.frameless import frameless_loop
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Simulation
from firmware_model.target.structs import FloatArray


class Counterfactual(NamedTuple):
    """Each of shape (ticks,), at the ticks of the recorded run."""

    dstar_mps2: FloatArray
    """As measured; not a number from where on a plant of one's own fails in this run too."""
    force_difference_n: FloatArray


def fault_free(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run without its fault: same plant, table, frames and noise."""
    return _instead(scenario.healthy, signals, len(signals))


def noise_free(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    """The same run without its fault and without the sensor's noise.

    Its first ``rows`` rows at least; not a number where nobody has asked for more.
    """
    silent = replace(scenario.healthy.noise_free, seed=0)  # of which nothing is drawn
    return _instead(silent, signals, rows)


def uncompensated(scenario: Scenario, signals: Signals) -> Counterfactual:
    """The same run with its fault and no compensation of it."""
    off = replace(scenario.design, compensation="off")
    return _instead(replace(scenario, design=off), signals, len(signals))


def _instead(scenario: Scenario, signals: Signals, rows: int) -> Counterfactual:
    if not len(signals):
        return Counterfactual(np.empty(0), np.empty(0))
    first = round(float(signals.time_s[0]) / scenario.tick_s)
    ticks = first + len(signals)
    if ticks > scenario.ticks:
        scenario = replace(scenario, duration_s=ticks * scenario.tick_s)
    loop = loop_of(scenario)
    loop.run(first + rows)
    measured, force = loop.trace.measured[first:ticks], loop.trace.command_2[first:ticks]
    return Counterfactual(measured, np.where(np.isnan(measured), np.nan, force))


@remembered(2)
def loop_of(scenario: Scenario) -> Simulation:
    """A run that somebody may have begun, and that goes on as far as it is asked for."""
    return frameless_loop(scenario, network_of(scenario))
