"""The words of ``report.png``: what was run, what was lost, and when."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from can_rig.drawing.fault_words import disturbance_in_words, fault_in_words
from can_rig.drawing.names import Names, ticks_text
from can_rig.results.signals import Signals
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario

MOST_LINES: Final = 6
"""For faults, and for disturbances."""


def page_title(scenario: Scenario, names: Names, signals: Signals) -> str:
    """The scenario, its faults and disturbances; car, bus and compensation; an early end."""
    tick = f"tick {scenario.tick_s * 1e3:g} ms, latency {ticks_text(scenario.latency_ticks)}"
    compensation = scenario.design.compensation.replace("-", " ")
    return (
        f"{scenario.name}: {_faults(scenario, names, _end_s(scenario, signals))}"
        f"{_disturbances(scenario, _end_s(scenario, signals))}"
        f"\n{_car(scenario.plant)}; {tick}; compensation {compensation}"
        f"{_ended_early(scenario, signals)}"
    )


def _faults(scenario: Scenario, names: Names, end_s: float) -> str:
    """The fault in words; several, numbered, a line each."""
    words = [fault_in_words(fault, names, end_s) for fault in scenario.faults]
    if len(words) <= 1:
        return "".join(words) or "no fault"
    lines = [f"{number}: {text}" for number, text in enumerate(words[:MOST_LINES], 1)]
    if len(words) > MOST_LINES:
        lines.append(f"and {len(words) - MOST_LINES} more")
    return "\n".join((f"{len(words)} faults", *lines))


def _disturbances(scenario: Scenario, end_s: float) -> str:
    """The disturbances in words, a line each."""
    lines = [disturbance_in_words(each, end_s) for each in scenario.disturbances[:MOST_LINES]]
    more = len(scenario.disturbances) - len(lines)
    return "".join(f"\n{line}" for line in (*lines, *([f"and {more} more"] if more else [])))


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
