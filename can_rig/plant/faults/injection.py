"""Injecting and clearing faults and disturbances during a run."""

from dataclasses import replace
from typing import Final

from pydantic import ValidationError

from can_rig.errors import RigError, ScenarioError
from can_rig.frames.operator_frames import (
    ALL,
    LONGEST_S,
    OF_FAULTS,
    SHORTEST_S,
    WORLD,
    Command,
    kinds,
    places,
    value_limits,
)
from can_rig.plant.protocol import require_world
from can_rig.scenario.disturbance_settings import NEEDED, DisturbanceSettings
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
"""The actions of a command to inject or to clear."""

BESIDE: Final = {"gust": {"arm_m": 0.3}, "turbulence": {"arm_m": 0.3, "length_m": 50.0}}
"""The other sizes of an injected disturbance, which has one number only."""


def injected(
    command: Command, tick: int, tick_ns: int
) -> FaultSettings | DisturbanceSettings | None:
    """What ``command`` injects, from ``tick`` on; None: something unknown or impossible."""
    make = _disturbance if command.place == WORLD else _fault
    try:
        return make(command, tick * tick_ns / 1e9)
    except ValidationError:
        return None


def require_possible(command: Command) -> None:
    """Refuse a fault that plant nodes reject or that the frame cannot represent.

    Raises:
        RigError: the impossible part, and the allowed values.
    """
    value, (step, most) = command.value, value_limits()
    if value is not None and not abs(value) <= most:
        raise RigError(f"value {value:g}: must be {-most:.7g} to {most:.7g}")
    if value and abs(value) < step:
        raise RigError(f"value {value:g}: must be 0 or at least {step:g}, the step of the frame")
    for_s = command.duration_s
    if for_s is not None and not SHORTEST_S <= for_s <= LONGEST_S:
        raise RigError(f"for {for_s:g} s: must be {SHORTEST_S:g} to {LONGEST_S:g} s, or left out")
    if for_s is not None and abs(for_s / SHORTEST_S - round(for_s / SHORTEST_S)) > 1e-6:
        raise RigError(f"for {for_s:g} s: must be a multiple of {SHORTEST_S:g} s, as the frame has")
    if command.action == "STEP" and (value is None or value < 1 or value != round(value)):
        raise RigError(f"step {value:g}: must be a whole number of ticks, 1 at least")
    if command.action == "PACE" and (value is None or value < 0):
        raise RigError(f"pace {value:g}: must be above 0, or 0 for as fast as it can")
    if command.action == "INJECT":
        _require_injectable(command)


def _require_injectable(command: Command) -> None:
    kind = str(command.kind)
    if command.place == WORLD:
        if command.value is None:
            raise RigError(f"{kind}: must have a value, its {sizes_of(kind)[0]}")
        try:
            _disturbance(command, 0.0)
        except ValidationError as error:
            raise RigError(f"{kind}: {refusal(error, DisturbanceSettings)}") from None
        return
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
    """The kinds of fault that ``place`` can have; of ``WORLD`` the kinds of disturbances."""
    faults = tuple(each for each in kinds() if each.startswith(OF_FAULTS))
    if place == WORLD:
        return tuple(each for each in kinds() if each not in faults)
    if place in CHANNELS:
        return tuple(each for each in faults if not each.startswith("sensor-"))
    never = () if place in ECHOES else OF_ECHOES if place in MEASURED else OF_FURTHER_SENSORS
    return tuple(each for each in faults if not each.startswith("actuator-") and each not in never)


def sizes_of(kind: str) -> tuple[str, ...]:
    """The keys of a disturbance that take the one number of a command."""
    return tuple(key for key in NEEDED[kind] if key not in BESIDE.get(kind, {}))


def _disturbance(command: Command, at_s: float) -> DisturbanceSettings:
    """The disturbance that ``command`` requests.

    Raises:
        ValidationError: no size, or a size out of bounds.
    """
    kind = command.kind or ""
    sizes = dict.fromkeys(sizes_of(kind), command.value) | BESIDE.get(kind, {})
    return DisturbanceSettings(kind, at_s, command.duration_s, **sizes)  # type: ignore[arg-type]


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
    """A scenario whose faults and disturbances commands add or end during the run."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        """With everything so far; no change touches the past ticks."""

    def obey(self, command: Command, tick: int) -> bool:
        """Carry out one of ``FAULT_ACTIONS`` from ``tick`` on; return whether that succeeded."""
        if command.action == "INJECT":
            return self.inject(command, tick)
        self.clear(command.place, tick)
        return True

    def inject(self, command: Command, tick: int) -> bool:
        """Add what ``command`` injects from ``tick`` on; return whether that is possible."""
        made, scenario = injected(command, tick, self.scenario.tick_ns), self.scenario
        if made is None:
            return False
        try:
            if isinstance(made, DisturbanceSettings):
                require_world(scenario.plant, (made,))
                self.scenario = replace(scenario, disturbance=(*scenario.disturbance, made))
                return True
            faults = (*scenario.faults, made)
            late = sum(each.late_ticks for each in faults if each.kind.endswith("-late"))
            if late > MAX_LATE_TICKS:
                return False
            self.scenario = replace(scenario, fault=faults)
        except (ScenarioError, ValidationError):  # a plant or a sensor that the scenario lacks
            return False
        return True

    def clear(self, place: str, tick: int) -> None:
        """End what acts or will act at ``place`` from ``tick`` on; a disturbance then falls."""
        if place in (ALL, WORLD):
            now_s = tick * self.scenario.tick_ns / 1e9
            calmed = tuple(_falling(each, now_s) for each in self.scenario.disturbance)
            self.scenario = replace(self.scenario, disturbance=calmed)
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


def _falling(disturbance: DisturbanceSettings, now_s: float) -> DisturbanceSettings:
    """``disturbance``, which begins to fall now, or as soon as it has risen."""
    if disturbance.at_s >= now_s:
        return DisturbanceSettings("none")  # keeps the numbers of the others
    ramp_s = disturbance.ramp
    for_s = max(now_s - disturbance.at_s, ramp_s) + ramp_s
    if disturbance.for_s is not None:
        for_s = min(for_s, disturbance.for_s)
    return replace(disturbance, ramp_s=ramp_s, for_s=for_s or None)
