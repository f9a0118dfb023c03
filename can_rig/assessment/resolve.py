"""Replacing words in a scenario by numbers that follow from the rest of the scenario.

``latency_ticks = "from-bus"`` is the worst case of the bus timing.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from pydantic import ValidationError

from can_rig.assessment.bus_timing import latency_ticks
from can_rig.errors import RigError, ScenarioError
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import FROM_BUS, LATENCY, Draft, of_run, read
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import Scenario


def load(name: str, settings: Iterable[str] = ()) -> Scenario:
    """The scenario ``name`` with ``KEY=VALUE`` changes, ready to run; see ``loading.read``.

    Raises:
        ScenarioError: as ``loading.read`` and ``resolve``.
    """
    return resolve(read(name, settings))


def load_run(values: Mapping[str, Any], settings: Iterable[str] = ()) -> Scenario:
    """The scenario of a ``run.json`` with changes, ready to run; see ``loading.of_run``.

    Raises:
        ScenarioError: as ``loading.of_run`` and ``resolve``.
    """
    return resolve(of_run(values, settings))


def resolve(draft: Draft) -> Scenario:
    """The scenario with a number in place of every word.

    Raises:
        ScenarioError: no number follows, because the bus is too slow or the design fails.
    """
    scenario = draft.scenario
    if draft.latency_from_bus:
        scenario = _with_latency_of_bus(scenario)
    return scenario


def _with_latency_of_bus(scenario: Scenario) -> Scenario:
    network, bus = network_of(scenario), scenario.bus
    where = f'scenario {scenario.name}: {LATENCY} = "{FROM_BUS}"'
    try:
        ticks = latency_ticks(network, bus.bitrate, scenario.tick_s, bus.compute_s)
        return replace(scenario, latency_ticks=ticks)
    except ValidationError as error:  # more than a controller's table holds
        raise ScenarioError(f"{where}: {refusal(error, Scenario)}") from None
    except RigError as error:
        raise ScenarioError(f"{where}: {error}") from None
