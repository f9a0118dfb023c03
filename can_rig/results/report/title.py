"""The words of ``report.png``: what was run, what was lost, and when."""

from __future__ import annotations

from pathlib import Path

from can_rig.drawing.names import Names, ticks_text, with_unit
from can_rig.results.signals import Signals
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import FaultSettings, Scenario


def page_title(scenario: Scenario, names: Names, signals: Signals) -> str:
    """The scenario and its fault; the car, the bus and the compensation; an early end."""
    tick = f"tick {scenario.tick_s * 1e3:g} ms, latency {ticks_text(scenario.latency_ticks)}"
    compensation = scenario.design.compensation.replace("-", " ")
    return (
        f"{scenario.name}: {_fault(scenario, names, _end_s(scenario, signals))}"
        f"\n{_car(scenario.plant)}; {tick}; compensation {compensation}"
        f"{_ended_early(scenario, signals)}"
    )


def loss_label(fault: FaultSettings, names: Names) -> str:
    """What is wrong while ``fault`` is active, in a few words."""
    name = names.lost_by(fault).name
    if not fault.loses_a_channel:
        return f"{name} biased"
    share = f"{100.0 * (1.0 - fault.left):g} % of " if fault.left else ""
    return f"{share}{name} lost"


def _fault(scenario: Scenario, names: Names, end_s: float) -> str:
    fault = scenario.fault
    if fault.kind == "none":
        return "no fault"
    when = f"at {fault.at_s:g} s"
    if fault.for_s is not None:
        when = f"from {fault.at_s:g} s to {fault.at_s + fault.for_s:g} s"
    if fault.at_s >= end_s:
        when += ", after the end of the run"
    if not fault.loses_a_channel:
        bias = with_unit(f"{fault.bias_mps2:g}", names.output.unit)
        return f"{names.output.name} biased by {bias} {when}"
    return f"{loss_label(fault, names)} {when} ({fault.kind.replace('-', ' ')})"


def _end_s(scenario: Scenario, signals: Signals) -> float:
    return float(signals.time_s[-1]) + scenario.tick_s if len(signals) else 0.0


def _ended_early(scenario: Scenario, signals: Signals) -> str:
    end_s = _end_s(scenario, signals)
    early = end_s < scenario.duration_s - 1.5 * scenario.tick_s
    return f"\nended at {end_s:.4g} s of {scenario.duration_s:g} s" if early else ""


def _car(plant: PlantSettings) -> str:
    if plant.is_own:
        return Path(plant.kind.partition(":")[2]).name
    return f"{plant.kind}, {plant.variant} model" if plant.is_car else plant.kind
