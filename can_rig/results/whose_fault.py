"""Whose fault it is, by the control law itself, from what was on the bus.

The status frame has no room for the evidence of every hypothesis. But the law answers the same
inputs with the same bits, so it goes through those of the run once more, and says what it thought.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from can_rig.drawing.names import Names, names_of
from can_rig.frames.frame_columns import quantised
from can_rig.frames.network import Network
from can_rig.plant.columns import EVIDENCE, VERDICT
from can_rig.results.signals import Signals
from can_rig.scenario.driving.schedule import controls
from can_rig.scenario.driving.speed import speeds_at_ticks
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from firmware_model.target.status import Verdict
from firmware_model.target.structs import FloatArray

DECIMALS: Final = 3  # of the evidence, a natural logarithm

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


def with_verdict(scenario: Scenario, network: Network, signals: Signals) -> Signals:
    """``signals`` with the verdict of each tick and the evidence of each hypothesis.

    In a tick without inputs the law waits, and so does the verdict.

    Raises:
        ScenarioError: a design that cannot be made.
    """
    of = controls(scenario, network)
    firmware = Firmware(of.table, speeds=of.schedule)
    speeds = _speeds(scenario, network, signals)
    verdicts, evidence = np.zeros(len(signals)), np.zeros((len(signals), len(EVIDENCE)))
    hypotheses = firmware.hypotheses
    inputs = zip(signals.reference_mps2.tolist(), signals.dstar_mps2.tolist(), strict=True)
    for row, (reference, measured) in enumerate(inputs):
        if speeds is not None:
            firmware.change_speed(speeds[row])
        firmware.step(reference, measured)
        verdicts[row] = hypotheses["verdict"]
        evidence[row] = hypotheses["evidence"][1:]
    columns = dict(zip(EVIDENCE, np.round(evidence, DECIMALS).T + 0.0, strict=True))
    return replace(signals, whose_fault={VERDICT: verdicts, **columns})


def _speeds(scenario: Scenario, network: Network, signals: Signals) -> list[float] | None:
    """What the controller hears of the speed in each row, where it changes."""
    if network.speed is None:
        return None
    heard: FloatArray = quantised(network.speed, speeds_at_ticks(scenario))
    ticks = np.rint(signals.time_s / scenario.tick_s).astype(np.int64)
    speeds: list[float] = heard[np.minimum(ticks, len(heard) - 1)].tolist()
    return speeds


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
