"""Each verdict of a run, since when and for how long, and what it is called."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from can_rig.drawing.names import Names, names_of
from can_rig.logs.columns import EVIDENCE, VERDICT
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from firmware_model.target.status import Verdict

_WORDS: Final = {
    Verdict.NOTHING: "no fault",
    Verdict.TORQUE_LOST: "{command_1} lost",
    Verdict.TORQUE_OFFSET: "{command_1} off by a constant",
    Verdict.FORCE_LOST: "{command_2} lost",
    Verdict.SENSOR_BIASED: "{output} sensor biased",
    Verdict.SENSOR_DRIFTING: "{output} sensor drifting",
    Verdict.SENSOR_FROZEN: "{output} sensor frozen",
    Verdict.ANOTHER_CAR: "no fault, another plant than the model",
    Verdict.BOTH_LOST: "{command_1} and {command_2} lost",
    Verdict.CANNOT_BE_TOLD: "cannot be told",
}
_NO_FAULT: Final = (Verdict.NOTHING, Verdict.ANOTHER_CAR)


def whose_fault(scenario: Scenario, signals: Signals) -> dict[str, dict[str, Any]]:
    """Each verdict that was a fault, by its name: since when, for how long, with what evidence.

    Times in s; the evidence of each hypothesis is that of the first tick of the verdict.
    """
    codes = signals.whose_fault[VERDICT]
    found = {}
    for verdict in Verdict:
        rows = np.flatnonzero(codes == verdict)
        if len(rows) and verdict not in _NO_FAULT:
            first = int(rows[0])
            found[verdict.name] = {
                "since_s": round(float(signals.time_s[first]), 9),
                "for_s": round(len(rows) * scenario.tick_s, 9),
                "evidence": {
                    name.removeprefix("evidence_"): float(signals.whose_fault[name][first])
                    for name in EVIDENCE
                },
            }
    return found


def verdict_rows(scenario: Scenario, found: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    """The line of the closing table: the verdict that stood longest."""
    if not found:
        return []
    name, longest = max(found.items(), key=lambda each: float(each[1]["for_s"]))
    said = in_words(Verdict[name], names_of(scenario.plant))
    return [("whose fault", f"{said}, from {longest['since_s']:.4g} s")]


def in_words(verdict: int, names: Names) -> str:
    """A verdict with the names that the plant's signals have."""
    own = {key: signal.name for key, signal in names._asdict().items()}
    return _WORDS[Verdict(verdict)].format(**own)
