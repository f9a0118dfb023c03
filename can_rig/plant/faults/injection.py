"""Faults that are injected and cleared while a run goes on."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from pydantic import ValidationError

from can_rig.frames.beside.control import ALL, Command
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.fault import (
    CHANNELS,
    MAX_LATE_TICKS,
    NUMBER,
    SENSOR,
    FaultSettings,
)

FAULT_ACTIONS: Final = ("INJECT", "CLEAR")
"""What of a command concerns faults."""


def injected(command: Command, tick: int, tick_ns: int) -> FaultSettings | None:
    """The fault that ``command`` asks for, from ``tick`` on; None if there is none such."""
    kind = command.kind or ""
    values: dict[str, object] = {"kind": kind, "at_s": tick * tick_ns / 1e9}
    if command.place in CHANNELS or (command.place == SENSOR and kind.startswith("frames-")):
        values["channel"] = command.place
    elif not kind.startswith("sensor-"):
        return None
    key = NUMBER.get(kind)
    if command.value is not None and key is not None:
        values[key] = round(command.value) if key == "late_ticks" else command.value
    if command.duration_s is not None:
        values["for_s"] = command.duration_s
    try:
        fault = FaultSettings(**values)  # type: ignore[arg-type]
    except ValidationError:
        return None
    return fault


class Injection:
    """A scenario to whose faults some are added, and some of them ended, as the run goes on."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        """With all faults until now; its ticks until now are not touched by any change."""

    def obey(self, command: Command, tick: int) -> bool:
        """Do what one of ``FAULT_ACTIONS`` asks for, from ``tick`` on; whether it can be done."""
        if command.action == "INJECT":
            return self.inject(command, tick)
        self.clear(command.place, tick)
        return True

    def inject(self, command: Command, tick: int) -> bool:
        """Add a fault from ``tick`` on; whether there is such a one, and room for it."""
        fault = injected(command, tick, self.scenario.tick_ns)
        if fault is None:
            return False
        faults = (*self.scenario.faults, fault)
        late = sum(each.late_ticks for each in faults if each.kind.endswith("-late"))
        if late > MAX_LATE_TICKS:
            return False
        self.scenario = replace(self.scenario, fault=faults)
        return True

    def clear(self, place: str, tick: int) -> None:
        """End the faults at ``place`` (or at all) that are there, or still to come, at ``tick``."""
        scenario = self.scenario
        now_ns = tick * scenario.tick_ns
        faults = []
        for fault in scenario.faults:
            begin_ns, end_ns = fault.span_ns
            if place not in (ALL, fault.place) or end_ns <= now_ns:
                faults.append(fault)
            elif begin_ns < now_ns:
                faults.append(replace(fault, for_s=(now_ns - begin_ns) / 1e9))
        self.scenario = replace(scenario, fault=tuple(faults))
