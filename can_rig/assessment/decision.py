"""Figures of the decision on d̂ in a scenario: the time to find a loss, and losses never found.

The evidence for a loss grows with the square of the lost torque's effect, over the variance of the
unknown: noise, rounding, and cars of ``budget.box`` (the firmware's ``fault_decision``). The
evidence's mean, equal to a drive without noise, gives the usual time of confirmation: with noise,
half of the losses take longer, one in a hundred about a fifth longer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from can_rig.drawing.names import names_of, with_unit
from can_rig.frames.network import Network
from can_rig.scenario.build import continuous_plant, controller_table, slowness
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.target.status import FaultState

AFTER_S = 5.0  # time limit for finding the loss; multiplied by ``slowness`` of a plant


@dataclass(frozen=True)
class DecisionFigures:
    """Figures of the decision with the modelled car.

    Attributes:
        expected_delay_s: from this scenario's loss of the torque to its confirmation; None: later
            than ``AFTER_S``, or after the end of the run.
        noise_mps2: rms of D* outside every model: noise and rounding.
        least_torque_nm: steady |torque| whose loss shows within a second; d̂ is N1 u1 then, or
            the part of N1 u1 that the scenario's fault takes away.
    """

    expected_delay_s: float | None
    noise_mps2: float
    least_torque_nm: float

    def describe(self, scenario: Scenario) -> Iterator[str]:
        """A line on the loss, and a line on the plants beside the model."""
        budget, (output, lost, _) = scenario.budget, names_of(scenario.plant)
        delay, left = self.expected_delay_s, _left(scenario)
        part = f"{1.0 - left:.0%} of " if left > 0.0 else ""
        found = "is not found" if delay is None else f"is confirmed after {_for_people(delay)}"
        yield (
            f"decision: the loss of {part}{lost.said} in this drive {found} on average "
            f"(noise and rounding {with_unit(f'{self.noise_mps2:.2g}', output.unit)} rms, at most "
            f"{budget.false_alarms_per_hour:g} false alarms an hour); a steady |{lost.short}| "
            f"below {with_unit(f'{self.least_torque_nm:.2g}', lost.unit)} cannot be told"
        )
        others = f"other {scenario.plant.noun}s"
        if budget.box > 0.0:
            yield f"{others}: within ±{budget.box:.0%} of the model are not taken for a loss"
        else:
            yield (
                f"{others}: none (budget.box = 0): one that is not the model may be taken for a "
                "loss, and for its end, again and again"
            )


def _for_people(time_s: float) -> str:
    return f"{time_s:.3g} s" if time_s >= 1.0 else f"{time_s * 1e3:.3g} ms"


def decision_figures(scenario: Scenario, network: Network) -> DecisionFigures:
    """Compute the figures of ``scenario`` from a single drive without noise.

    Raises:
        ScenarioError: a design that cannot be made.
    """
    table, plant = controller_table(scenario, network), continuous_plant(scenario.model)
    n1, _ = plant.coprime(scenario.design.tau_q_s).numerators
    lost = round(scenario.loss.at_s / scenario.tick_s)
    ticks = min(scenario.ticks, lost + round(AFTER_S * slowness(scenario) / scenario.tick_s))
    left = np.ones((ticks, 2))
    left[lost:, 0] = _left(scenario)
    drive = reference(replace(scenario, duration_s=max(ticks, 1) * scenario.tick_s))[:ticks]
    run = simulate(table, sample(plant, scenario.tick_s), drive, effectiveness=left)
    confirmed = run.fault_state[lost:] == FaultState.CONFIRMED
    found = np.flatnonzero(confirmed & ~confirmed[:1])  # none that stands from before
    variance = float(table.mismatch.noise) / (1.0 - float(table.mismatch.colour) ** 2)
    shows = math.sqrt(float(table.decision.confirm / table.decision.horizon * table.mismatch.noise))
    return DecisionFigures(
        expected_delay_s=float(found[0]) * scenario.tick_s if len(found) else None,
        noise_mps2=math.sqrt(variance),
        least_torque_nm=shows / abs(n1.dc_gain) / (1.0 - _left(scenario)),
    )


def _left(scenario: Scenario) -> float:
    """The remaining share of the torque after the scenario's fault; 0 for another kind of fault."""
    its = scenario.loss.kind == "actuator-dead" and scenario.loss.place == CHANNELS[0]
    return scenario.loss.left if its else 0.0
