"""The metrics of a run of which nothing is recorded: those that its run folder would have."""

from __future__ import annotations

from dataclasses import replace

from can_rig.plant.behind import LinearBehind, plant_behind
from can_rig.plant.columns import TRUE_OUTPUT
from can_rig.plant.frameless import inputs_of, simulation
from can_rig.results.metrics import Metrics, metrics
from can_rig.results.signals import Signals, signals_of_trace
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import on_the_bus
from can_rig.scenario.settings import Scenario


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
    network = network_of(scenario)
    on_the_bus(scenario, network)
    plant, inputs = plant_behind(scenario.plant, scenario.tick_s), inputs_of(scenario, network)
    loop = simulation(
        scenario,
        network,
        plant.sampled if isinstance(plant, LinearBehind) else plant,
        controller_table(scenario, network),
        inputs,
    )
    loop.run()
    signals = signals_of_trace(loop.trace, inputs.delivery, loop.ticks, network)
    return replace(signals, plant={TRUE_OUTPUT: loop.trace.measurement})
