"""Whose fault it is, by the control law itself, from what was on the bus.

The status frame has the verdict, and no room for the evidence of every hypothesis. But the law
answers the same inputs with the same bits, so it goes through those of the run once more, and says
what it thought.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np

from can_rig import paged
from can_rig.frames.frame_columns import quantised
from can_rig.frames.network import Network
from can_rig.logs.columns import EVIDENCE, VERDICT
from can_rig.results.signals import Signals
from can_rig.scenario.driving import controls, speeds_at_ticks
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from firmware_model.target.structs import FloatArray

DECIMALS: Final = 3  # of the evidence, a natural logarithm
CERTAIN: Final = 1e12  # the most that is said of it; without noise, and at rest, it has no bound


class Reasoning:
    """The control law on what a run's controller got, tick by tick.

    Args:
        scenario: the run.
        network: its frames.

    Raises:
        ScenarioError: a design that cannot be made.
    """

    def __init__(self, scenario: Scenario, network: Network) -> None:
        of = controls(scenario, network)
        self._made = partial(Firmware, of.table, speeds=of.schedule)
        self._firmware = self._made()
        self._outages = scenario.outages
        self._speeds = _speeds(scenario, network)
        self.confirm: Final = float(of.table.decision.confirm)
        """The evidence that confirms a loss."""

    def take(self, tick: int, reference: float, measured: float) -> tuple[int, FloatArray]:
        """The verdict of this tick, and the evidence of each hypothesis, as ``EVIDENCE`` has them.

        In a tick without inputs the law waits, and so do they. Without power nothing is said.
        """
        if any(tick in outage for outage in self._outages):
            return 0, np.zeros(len(EVIDENCE))
        if any(tick == outage.stop for outage in self._outages):
            self._firmware = self._made()
        if self._speeds is not None:
            self._firmware.change_speed(self._speeds[min(tick, len(self._speeds) - 1)])
        self._firmware.step(reference, measured)
        said = self._firmware.hypotheses
        return int(said["verdict"]), said["evidence"][1:]

    @property
    def commands(self) -> tuple[float, float]:
        """Those of this tick."""
        return self._firmware.commands


def with_verdict(scenario: Scenario, network: Network, signals: Signals) -> Signals:
    """``signals`` with the verdict of each tick and the evidence of each hypothesis.

    The verdict is that of the status frame, where it says one. In a tick without inputs the law
    waits, and so does the verdict.

    Raises:
        ScenarioError: a design that cannot be made.
    """
    reasoning = Reasoning(scenario, network)
    columns = {name: paged.empty(len(signals)) for name in (VERDICT, *EVIDENCE)}
    for rows in paged.blocks(len(signals)):
        ticks = np.rint(signals.time_s[rows] / scenario.tick_s).astype(np.int64).tolist()
        verdicts, evidence = np.zeros(len(ticks)), np.zeros((len(ticks), len(EVIDENCE)))
        inputs = signals.reference_mps2[rows].tolist(), signals.dstar_mps2[rows].tolist()
        for row, (tick, reference, measured) in enumerate(zip(ticks, *inputs, strict=True)):
            verdicts[row], evidence[row] = reasoning.take(tick, reference, measured)
        said = np.clip(np.nan_to_num(evidence, nan=0.0), -CERTAIN, CERTAIN)
        for name, values in zip(EVIDENCE, np.round(said, DECIMALS).T + 0.0, strict=True):
            columns[name][rows] = values
        if signals.verdict is not None:
            heard = signals.verdict[rows]
            verdicts = np.where(np.isnan(heard), verdicts, heard)
        columns[VERDICT][rows] = verdicts
    return replace(signals, whose_fault=columns)


def _speeds(scenario: Scenario, network: Network) -> list[float] | None:
    """What the controller hears of the speed in each tick, where it changes."""
    if network.speed is None:
        return None
    heard: list[float] = quantised(network.speed, speeds_at_ticks(scenario)).tolist()
    return heard
