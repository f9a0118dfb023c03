"""What happened in a run, moment by moment: what begins and ends, and what the controller says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from can_rig import paged
from can_rig.drawing.fault_words import disturbance_label, fault_label
from can_rig.drawing.names import names_of
from can_rig.frames.network import Network
from can_rig.logs.columns import VERDICT
from can_rig.results.isolation.words import in_words
from can_rig.results.signals import Signals
from can_rig.scenario.disturbance_settings import DisturbanceSettings
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.target.status import Verdict
from firmware_model.target.structs import FloatArray


class Event(NamedTuple):
    """One moment."""

    time_s: float
    text: str


def events(scenario: Scenario, network: Network, signals: Signals) -> list[Event]:
    """All of them, in the order of time."""
    names = names_of(scenario.plant)
    end_s = float(signals.time_s[-1]) + scenario.tick_s if len(signals) else 0.0
    found: list[Event] = []
    from_outside: list[tuple[str, FaultSettings | DisturbanceSettings, str]] = [
        *(("fault", each, fault_label(each, names)) for each in scenario.faults),
        *(("disturbance", each, disturbance_label(each)) for each in scenario.disturbances),
    ]
    for noun, each, label in from_outside:
        if each.at_s < end_s:
            found.append(Event(each.at_s, f"{noun} begins: {label}"))
        if each.for_s is not None and each.at_s + each.for_s < end_s:
            found.append(Event(each.at_s + each.for_s, f"{noun} ends: {label}"))
    found += _changes("mode", signals.time_s, signals.mode, network.status.modes)
    states = network.status.fault_states
    found += _changes("fault state", signals.time_s, signals.fault_state, states)
    if VERDICT in signals.whose_fault:
        words = {int(verdict): in_words(verdict, names) for verdict in Verdict}
        found += _changes("whose fault", signals.time_s, signals.whose_fault[VERDICT], words)
    return sorted(found, key=lambda event: event.time_s)


def _changes(
    name: str, time_s: FloatArray, codes: FloatArray, words: Mapping[int, str]
) -> Iterator[Event]:
    last = np.nan
    for rows in paged.blocks(len(codes)):
        known = rows.start + np.flatnonzero(np.isfinite(codes[rows]))
        changed = np.flatnonzero(np.diff(codes[known], prepend=last) != 0.0)
        for row in known[changed].tolist():
            code = int(codes[row])
            yield Event(float(time_s[row]), f"{name}: {words.get(code, code)}")
        last = codes[known[-1]] if len(known) else last
