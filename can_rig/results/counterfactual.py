"""Runs beside the recorded one: the same ticks without the fault, the noise or compensation."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from can_rig.errors import RigError
from can_rig.plant.faults import CHANNELS
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.signals import Signals
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import NoiseSettings, Scenario
from firmware_model.firmware import Firmware
from firmware_model.target.structs import FloatArray


class Beside(NamedTuple):
    """Each of shape (ticks,), as many as the recorded run has."""

    dstar_mps2: FloatArray
    force_difference_n: FloatArray


def fault_free(scenario: Scenario, signals: Signals) -> Beside:
    """The same run without its fault: same plant, table, command frames and noise.

    D* itself is not rounded to the grid of its frame, which keeps the two apart by a few of its
    LSBs. Not a number from where on a plant of one's own fails without the fault too.
    """
    return _beside(scenario.healthy, signals)


def noise_free(scenario: Scenario, signals: Signals) -> Beside:
    """The same run without its fault and without the sensor's noise."""
    return _beside(replace(scenario.healthy, noise=NoiseSettings()), signals)


def uncompensated(scenario: Scenario, signals: Signals) -> Beside:
    """The same run, fault and noise included, by a controller that does not compensate."""
    design = replace(scenario.design, compensation="off")
    return _beside(replace(scenario, design=design), signals)


def _beside(scenario: Scenario, signals: Signals) -> Beside:
    if not len(signals):
        return Beside(np.empty(0), np.empty(0))
    first = round(float(signals.time_s[0]) / scenario.tick_s)
    ticks = first + len(signals)
    healthy = replace(scenario, duration_s=max(scenario.duration_s, ticks * scenario.tick_s))
    plant, wanted = SimulatedPlant(healthy), reference(healthy)[:ticks].tolist()
    firmware = Firmware(controller_table(healthy, network_of(healthy)))
    measured, force = np.full((2, ticks), np.nan)
    lost = (
        CHANNELS.index(healthy.fault.channel) if healthy.fault.kind.startswith("frames-") else None
    )
    with suppress(RigError):
        for tick in range(ticks):
            measured[tick] = plant.measure()
            answer = firmware.step(wanted[tick], measured[tick])
            force[tick] = answer.command_2
            heard: list[float | None] = [answer.command_1, answer.command_2]
            if lost is not None and healthy.fault.active(tick * healthy.tick_ns):
                heard[lost] = None
            plant.advance(tick, *heard)
    return Beside(measured[first:], force[first:])
