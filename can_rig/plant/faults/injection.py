"""Injecting and clearing faults during a run."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from pydantic import ValidationError

from can_rig.errors import RigError
from can_rig.frames.operator_frames import (
    ALL,
    LONGEST_S,
    SHORTEST_S,
    Command,
    kinds,
    places,
    value_limits,
)
from can_rig.scenario.fault_settings import (
    CHANNELS,
    MAX_LATE_TICKS,
    OF_ECHOES,
    OF_FURTHER_SENSORS,
    SENSOR,
    SWAPPED,
    FaultSettings,
    key_of,
)
from can_rig.scenario.refusal import refusal
from can_rig.scenario.sensor_settings import ECHOES, MEASURED
from can_rig.scenario.settings import Scenario

FAULT_ACTIONS: Final = ("INJECT", "CLEAR")
"""The actions of a fault command."""


def injected(command: Command, tick: int, tick_ns: int) -> FaultSettings | None:
    """The fault of ``command``, from ``tick`` on; None: an unknown or impossible fault."""
    try:
        return _fault(command, tick * tick_ns / 1e9)
    except ValidationError:
        return None


def require_possible(command: Command) -> None:
    """Refuse a fault that plant nodes reject or that the frame cannot represent.

    Raises:
        RigError: the impossible part, and the allowed values.
    """
    value, (step, most) = command.value, value_limits()
    if value is not None and not abs(value) <= most:
        raise RigError(f"value {value:g}: must be {-most:g} to {most:g}")
    if value and abs(value) < step:
        raise RigError(f"value {value:g}: must be 0 or at least {step:g}, the step of the frame")
    for_s = command.duration_s
    if for_s is not None and not SHORTEST_S <= for_s <= LONGEST_S:
        raise RigError(f"for {for_s:g} s: must be {SHORTEST_S:g} to {LONGEST_S:g} s, or left out")
    if command.action == "STEP" and (value is None or value < 1 or value != round(value)):
        raise RigError(f"step {value:g}: must be a whole number of ticks, 1 at least")
    if command.action == "PACE" and (value is None or value < 0):
        raise RigError(f"pace {value:g}: must be above 0, or 0 for as fast as it can")
    if command.action == "INJECT":
        _require_fault(command)


def _require_fault(command: Command) -> None:
    kind = str(command.kind)
    key = key_of(kind, command.place)
    if command.value is not None and not key:
        raise RigError(f"{kind}: has no value; it must be left out")
    if key == "late_ticks" and command.value is not None and command.value != round(command.value):
        raise RigError(f"{kind}: value {command.value:g}: must be a whole number of ticks")
    try:
        _fault(command, 0.0)
    except ValidationError as error:
        said = refusal(error, FaultSettings)
        its = f"its value is {key}; " if key else ""
        raise RigError(f"{kind}: {its}{said}") from None


def kinds_of(place: str) -> tuple[str, ...]:
    """The kinds of fault that ``place`` can have."""
    if place in CHANNELS:
        return tuple(each for each in kinds() if not each.startswith("sensor-"))
    never = () if place in ECHOES else OF_ECHOES if place in MEASURED else OF_FURTHER_SENSORS
    return tuple(each for each in kinds() if not each.startswith("actuator-") and each not in never)


def _fault(command: Command, at_s: float) -> FaultSettings:
    """The fault that ``command`` requests.

    Raises:
        ValidationError: a number out of bounds, or the place never fails in this way.
    """
    kind, place, value = command.kind or "", command.place, command.value
    values: dict[str, object] = {"kind": kind, "at_s": at_s}
    if place != SENSOR or not kind.startswith("sensor-"):
        values["channel"] = place
    key = key_of(kind, place)
    if value is not None and kind == SWAPPED:
        values[key] = dict(enumerate(places())).get(int(value))
    elif value is not None and key:
        values[key] = round(value) if key == "late_ticks" else value
    if command.duration_s is not None:
        values["for_s"] = command.duration_s
    return FaultSettings(**values)  # type: ignore[arg-type]


class Injection:
    """A scenario whose faults commands add or end during the run."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        """With all faults so far; no change touches the past ticks."""

    def obey(self, command: Command, tick: int) -> bool:
        """Carry out one of ``FAULT_ACTIONS`` from ``tick`` on; return whether that succeeded."""
        if command.action == "INJECT":
            return self.inject(command, tick)
        self.clear(command.place, tick)
        return True

    def inject(self, command: Command, tick: int) -> bool:
        """Add a fault from ``tick`` on; return False for an invalid fault or too many faults."""
        fault = injected(command, tick, self.scenario.tick_ns)
        if fault is None:
            return False
        faults = (*self.scenario.faults, fault)
        late = sum(each.late_ticks for each in faults if each.kind.endswith("-late"))
        if late > MAX_LATE_TICKS:
            return False
        try:
            self.scenario = replace(self.scenario, fault=faults)
        except ValidationError:  # of a sensor that the scenario lacks
            return False
        return True

    def clear(self, place: str, tick: int) -> None:
        """End every present and future fault at ``place`` (empty: everywhere) from ``tick`` on."""
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
