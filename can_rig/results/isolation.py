"""Whose fault it was: verdict and evidence of each tick, and in words."""

import math
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from can_rig.controllers.our_law import OurLaw
from can_rig.controllers.protocol import Inputs
from can_rig.drawing.names import Names, names_of
from can_rig.frames.frame_columns import quantised
from can_rig.frames.network import Network
from can_rig.logs.columns import EVIDENCE, VERDICT
from can_rig.results.signals import Signals
from can_rig.scenario.controls import controls
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.sensor_settings import LATERAL_ACCELERATION, USUAL, YAW_RATE
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.design.vehicle import dstar
from firmware_model.firmware import PYTHON_LAW
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

DECIMALS: Final = 3  # of the evidence, a natural logarithm
CERTAIN: Final = 1e12  # largest recorded evidence; at rest without noise it has no bound


class Reasoning:
    """The control law with the inputs of a run's controller, tick by tick.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(self, scenario: Scenario, network: Network) -> None:
        self._made = partial(OurLaw, scenario, network, PYTHON_LAW)
        self._begin()
        self._outages = scenario.outages
        self._speeds = _speeds(scenario, network)
        self.confirm: Final = float(controls(scenario, network).table.decision.confirm)
        """The evidence that confirms a loss."""

    def _begin(self) -> None:
        self._law = self._made()
        self._hypotheses = self._law.firmware.hypotheses
        self._evidence: FloatArray = self._hypotheses["evidence"][1:]

    def take(self, tick: int, inputs: Inputs) -> tuple[int, FloatArray]:
        """The verdict of this tick, and the evidence of each hypothesis in the order ``EVIDENCE``.

        In a tick without inputs the law waits. A controller without power has no verdict.
        """
        if any(tick in outage for outage in self._outages):
            return 0, np.zeros(len(EVIDENCE))
        for outage in self._outages:
            if tick == outage.stop:
                saved = self._law.saved()
                self._begin()
                if outage.state_survives:
                    self._law.restore(saved)
        if self._speeds is not None:
            inputs = inputs._replace(speed_mps=self._speeds[min(tick, len(self._speeds) - 1)])
        self._law.step(inputs)
        return int(self._hypotheses["verdict"]), self._evidence

    @property
    def commands(self) -> tuple[float, float]:
        """The commands of this tick."""
        return self._law.commands


def _with_made_output(scenario: Scenario, network: Network, signals: Signals) -> Signals:
    """``signals`` with the D* that the controller of a car without a sensor of D* makes."""
    if not scenario.plant.sensor.is_made:
        return signals
    lateral, turning = (
        signals.sensors[USUAL[each].column] for each in (LATERAL_ACCELERATION, YAW_RATE)
    )
    speed, heard = np.full(len(signals), scenario.plant.speed_mps), _speeds(scenario, network)
    if heard is not None:
        ticks = np.rint(signals.time_s / scenario.tick_s).astype(np.int64)
        speed = np.array(heard)[np.minimum(ticks, len(heard) - 1)]
    made = dstar(scenario.plant.lateral_weight, lateral, turning, speed)
    return replace(signals, dstar_mps2=made)


def _as_said(signals: Signals) -> Signals:
    """``signals`` with the verdicts of a controller of one's own, whose evidence is not known."""
    none = paged.column(len(signals), lambda rows: np.full(rows.stop - rows.start, np.nan))
    said = none if signals.verdict is None else signals.verdict
    return replace(signals, whose_fault={VERDICT: said, **dict.fromkeys(EVIDENCE, none)})


def with_verdict(scenario: Scenario, network: Network, signals: Signals) -> Signals:
    """``signals`` with the verdict of each tick and the evidence of each hypothesis.

    The status frame carries the verdict, without room for the evidence. The law answers the same
    inputs with the same bits, so a second run of the law gives the evidence, and the verdict where
    the frame lacks one. In a tick without inputs the law waits, and the verdict stays. The D* of a
    car without a sensor of D* is the controller's.

    Raises:
        ScenarioError: the design fails.
    """
    signals = _with_made_output(scenario, network, signals)
    if not scenario.controller.is_ours:
        return _as_said(signals)
    reasoning = Reasoning(scenario, network)
    columns = {name: paged.empty(len(signals)) for name in (VERDICT, *EVIDENCE)}
    told = [*signals.sensors.items(), *signals.sample_ages.items()]
    for rows in paged.blocks(len(signals)):
        ticks = np.rint(signals.time_s[rows] / scenario.tick_s).astype(np.int64).tolist()
        verdicts, evidence = np.zeros(len(ticks)), np.zeros((len(ticks), len(EVIDENCE)))
        inputs = signals.reference_mps2[rows].tolist(), signals.dstar_mps2[rows].tolist()
        for row, (tick, reference, measured) in enumerate(zip(ticks, *inputs, strict=True)):
            witnesses = {name: column.item(rows.start + row) for name, column in told}
            of_tick = Inputs(reference, measured, witnesses=witnesses)
            verdicts[row], evidence[row] = reasoning.take(tick, of_tick)
        said = np.clip(np.nan_to_num(evidence, nan=0.0), -CERTAIN, CERTAIN)
        for name, values in zip(EVIDENCE, np.round(said, DECIMALS).T + 0.0, strict=True):
            columns[name][rows] = values
        if signals.verdict is not None:
            heard = signals.verdict[rows]
            verdicts = np.where(np.isnan(heard), verdicts, heard)
        columns[VERDICT][rows] = verdicts
    return replace(signals, whose_fault=columns)


def _speeds(scenario: Scenario, network: Network) -> list[float] | None:
    """The received speed in each tick; None for a constant speed."""
    if network.speed is None:
        return None
    heard: list[float] = quantised(network.speed, speeds_at_ticks(scenario)).tolist()
    return heard


_WORDS: Final = {
    Verdict.NOTHING: "no fault",
    Verdict.TORQUE_LOST: "{command_1} lost",
    Verdict.TORQUE_OFFSET: "{command_1} off by a constant",
    Verdict.FORCE_LOST: "{command_2} lost",
    Verdict.SENSOR_WRONG: "{output} sensor wrong",
    Verdict.SENSOR_DRIFTING: "{output} sensor drifting",
    Verdict.SENSOR_FROZEN: "{output} sensor frozen",
    Verdict.ANOTHER_CAR: "no fault: another plant than the model, or wind or road",
    Verdict.BOTH_LOST: "{command_1} and {command_2} lost",
    Verdict.CANNOT_BE_TOLD: "cannot be told",
    Verdict.COMPENSATION_OFF: "monitor: the car swings, {command_2} taken away",
    Verdict.SWINGING: "monitor: the car swings, both commands taken away",
    Verdict.ASTRAY: "monitor: the commands drive the car astray, both taken away",
    Verdict.BAD_COMMAND: "monitor: a command beyond its actuator, both taken away",
}
NO_FAULT: Final = (Verdict.NOTHING, Verdict.ANOTHER_CAR)
"""Verdicts of a healthy car."""


def whose_fault(scenario: Scenario, signals: Signals) -> dict[str, dict[str, Any]]:
    """Each verdict of a fault by name, with begin and duration in s.

    The evidence of each hypothesis is from the first tick of the verdict; a controller of one's
    own says none.
    """
    codes = signals.whose_fault[VERDICT]
    found = {}
    for verdict in Verdict:
        rows = np.flatnonzero(codes == verdict)
        if len(rows) and verdict not in NO_FAULT:
            first = int(rows[0])
            found[verdict.name] = {
                "since_s": round(float(signals.time_s[first]), 9),
                "for_s": round(len(rows) * scenario.tick_s, 9),
                "evidence": {
                    name.removeprefix("evidence_"): value
                    for name in EVIDENCE
                    if not math.isnan(value := float(signals.whose_fault[name][first]))
                },
            }
    return found


def verdict_rows(scenario: Scenario, found: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    """The line of the closing table: the longest verdict."""
    if not found:
        return []
    name, longest = max(found.items(), key=lambda each: float(each[1]["for_s"]))
    said = in_words(Verdict[name], names_of(scenario.plant))
    return [("whose fault", f"{said}, from {longest['since_s']:.4g} s")]


def in_words(verdict: int, names: Names) -> str:
    """A verdict in words, with the names of the plant's signals."""
    own = {key: signal.name for key, signal in names._asdict().items()}
    return _WORDS[Verdict(verdict)].format(**own)
