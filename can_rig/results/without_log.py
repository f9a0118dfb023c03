"""The metrics of a run of which nothing is recorded: those that its run folder would have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.plant.changing_car import plant_of
from can_rig.plant.frameless import common
from can_rig.results.counterfactual import loop_of
from can_rig.results.metrics import Metrics, metrics
from can_rig.results.signals import Signals, signals_of_trace
from can_rig.scenario.build import network_of
from can_rig.scenario.reference import refuse_saturation
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.simulation import Simulation


def metrics_of(scenario: Scenario) -> Metrics:
    """What the run achieves.

    Raises:
        RigError: it cannot run, or ends before its last tick.
    """
    return metrics(scenario, signals_without_log(scenario))


def signals_without_log(scenario: Scenario) -> Signals:
    """The signals that its frames would carry, and of what the plant reports its output.

    Raises:
        RigError: as ``metrics_of``.
    """
    refuse_saturation(scenario, network_of(scenario))
    shared = common(scenario)
    inputs = shared.inputs_of(scenario)
    loop = shared.loop(scenario, inputs, shared.plant or plant_of(scenario))
    if shared.plant is not None and scenario.faults and not len(inputs.faults):
        _begin_without_fault(loop, scenario)
    loop.run()
    signals = signals_of_trace(loop.trace, inputs.delivery, loop.ticks, shared.network)
    return replace(signals, plant={TRUE_OUTPUT: loop.trace.measurement})


def _begin_without_fault(loop: Simulation, scenario: Scenario) -> None:
    """Up to its fault a run is the run without it, which the metrics ask for anyway.

    Not where a fault looks back on what was before it.
    """
    healthy = loop_of(scenario.healthy)
    first = min([loop.ticks, *(outage.start for outage in scenario.outages)])
    for own, its in zip(loop.inputs, healthy.inputs, strict=True):
        if own is not its:
            differs = np.flatnonzero((own != its).reshape(loop.ticks, -1).any(axis=1))
            first = min([first, *differs[:1].tolist()])
    if healthy.done <= first:
        healthy.run(first)
        loop.go_on_from(healthy)
