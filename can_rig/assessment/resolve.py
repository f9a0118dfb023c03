"""The numbers that follow from the rest of a scenario, put in where a word stands for them.

``latency_ticks = "from-bus"`` is the worst case of the bus timing, ``fault_threshold_mps2 =
"from-budget"`` the threshold that the budget asks for. The budget comes second: it depends on the
latency.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from can_rig.assessment.bus_timing.timing import latency_ticks
from can_rig.assessment.threshold_budget import OnCar, threshold_budget
from can_rig.errors import RigError, ScenarioError
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import FROM_BUDGET, FROM_BUS, Draft, of_run, read
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import Scenario


def load(
    name: str, settings: Iterable[str] = (), on_car: OnCar = lambda done, of: None
) -> Scenario:
    """The scenario ``name`` with ``KEY=VALUE`` changes, ready to run; see ``loading.read``.

    ``on_car`` is told how far the threshold budget is, where it is asked for.

    Raises:
        ScenarioError: as ``loading.read`` and ``resolve``.
    """
    return resolve(read(name, settings), on_car)


def load_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Scenario:
    """The scenario of a ``run.json`` with changes, ready to run; see ``loading.of_run``.

    Raises:
        ScenarioError: as ``loading.of_run`` and ``resolve``.
    """
    return resolve(of_run(values, settings))


def resolve(draft: Draft, on_car: OnCar = lambda done, of: None) -> Scenario:
    """The scenario with a number in place of every word.

    Raises:
        ScenarioError: a number does not follow: the bus is too slow, or there is no design.
    """
    scenario = draft.scenario
    if FROM_BUS in draft.words:
        scenario = _with_latency_of_bus(scenario)
    if FROM_BUDGET in draft.words:
        scenario = _with_threshold_of_threshold_budget(scenario, on_car)
    return scenario


def _with_latency_of_bus(scenario: Scenario) -> Scenario:
    network, bus = network_of(scenario), scenario.bus
    key, word = FROM_BUS
    where = f'scenario {scenario.name}: {key} = "{word}"'
    try:
        ticks = latency_ticks(network, bus.bitrate, scenario.tick_s, bus.compute_s)
        return replace(scenario, latency_ticks=ticks)
    except ValidationError as error:  # more than a controller's table holds
        raise ScenarioError(f"{where}: {refusal(error, Scenario)}") from None
    except RigError as error:
        raise ScenarioError(f"{where}: {error}") from None


def _with_threshold_of_threshold_budget(scenario: Scenario, on_car: OnCar) -> Scenario:
    least = replace(scenario.design, fault_threshold_mps2=sys.float_info.min)
    found = threshold_budget(replace(scenario, design=least), network_of(scenario), on_car)
    chosen = replace(
        scenario.design,
        fault_threshold_mps2=found.threshold,
        fault_threshold_share=max(scenario.design.fault_threshold_share, found.share),
    )
    return replace(scenario, design=chosen)
