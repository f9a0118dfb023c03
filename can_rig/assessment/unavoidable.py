"""The least deviation of D* after a loss, for any controller.

No controller can react before the loss shows. The loss reduces D* by

    δ(k+1) = Φ δ(k) + Γ (left - 1) u(k)

and is known after the first tick on a sensor without noise. With noise, the best test decides: when
the expected log-likelihood ratio Σ δ²/(2 σ²) has reached the threshold of the allowed false alarms
(Basseville and Nikiforov 1993, 8.2; the moment of the loss is taken as known, which favours no
controller). The reaction acts n + 1 ticks later. The least deviation is therefore the largest |δ|
until then, with the sent commands u: a controller with a larger command after the loss makes the
loss show sooner.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from can_rig.scenario.build import continuous_plant, target
from can_rig.scenario.fault_settings import CHANNELS, FaultSettings
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import SampledPlant, sample
from firmware_model.compiled import compiled
from firmware_model.target.structs import FloatArray


@dataclass(frozen=True)
class Unavoidable:
    """What no controller can avoid.

    Attributes:
        detection_ticks: from the loss to the earliest knowledge.
        deviation_mps2: largest |deviation| of D* until detection and the commands' delay.
    """

    detection_ticks: int
    deviation_mps2: float


def unavoidable(
    scenario: Scenario, commands: FloatArray, fault: FaultSettings | None = None
) -> Unavoidable | None:
    """For a dead actuator, None: the scenario's loss. None where it never shows.

    ``commands`` reach the lost channel from the loss on, shape (ticks,). For a plant class, whose Φ
    is unknown, the linear car with equal parameters supplies Φ.
    """
    tick_s, fault = scenario.tick_s, fault or scenario.loss
    plant = _immediate(scenario.plant, tick_s)
    gamma = plant.gamma[:, CHANNELS.index(fault.place)] * (fault.left - 1.0)
    pole, needed = _needed(scenario)
    found, largest = _found(
        plant.phi, gamma, plant.c, np.nan_to_num(commands), pole, needed, scenario.latency_ticks
    )
    return Unavoidable(found, largest) if found else None


def can_be_told(scenario: Scenario, deviation_mps2: FloatArray) -> bool:
    """Whether the best test expects to tell this deviation, shape (ticks,), from noise."""
    pole, needed = _needed(scenario)
    shown = np.nan_to_num(deviation_mps2)
    return bool(((shown - pole * np.append(0.0, shown[:-1])) ** 2).sum() > needed)


def _needed(scenario: Scenario) -> tuple[float, float]:
    """The pole of the noise, and the sum of squares, whitened, that confirms a loss."""
    place = target(scenario, None)
    per_tick = 2.0 * (
        place.noise_rms * place.noise_rms * (1.0 - place.noise_pole**2)
        + place.resolution * place.resolution / 12.0
    )
    return place.noise_pole, place.evidence(place.false_alarms_per_hour) * per_tick


@remembered(4)
def _immediate(settings: PlantSettings, tick_s: float) -> SampledPlant:
    """The plant without dead times; a loss follows its actuator's dead time."""
    torque, force = settings.torque_actuator, settings.force_difference_actuator
    without = replace(
        settings,
        torque_actuator=replace(torque, dead_time_s=0.0),
        force_difference_actuator=replace(force, dead_time_s=0.0),
        sensor=replace(settings.sensor, dead_time_s=0.0),
    )
    return sample(continuous_plant(without), tick_s)


@compiled
def _found(
    phi: Any, gamma: Any, c: Any, commands: Any, pole: float, needed: float, latency: int
) -> tuple[int, float]:
    """The tick of detection, 0: never; the largest |δ| until the reaction."""
    missing, after = np.zeros(len(phi)), np.zeros(len(phi))
    found, largest, shown, before = 0, 0.0, 0.0, 0.0
    for k in range(len(commands)):
        for i in range(len(phi)):
            after[i] = gamma[i] * commands[k]
            for j in range(len(phi)):
                after[i] += phi[i, j] * missing[j]
        missing[:] = after
        now = 0.0
        for i in range(len(phi)):
            now += c[i] * missing[i]
        now = abs(now)
        largest = max(largest, now)
        shown += (now - pole * before) ** 2
        before = now
        if found == 0 and shown > needed:
            found = k + 1
        if found > 0 and k + 1 >= found + latency:
            return found, largest
    return 0, largest
