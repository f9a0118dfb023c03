"""A scenario without frames: what both nodes and a bus make of it, in one loop of arithmetic.

Bit for bit the signals of the run on a lockstep bus; thousands of times faster for a linear plant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from can_rig.errors import RigError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.frames.network import Network
from can_rig.plant.actuators import actuator_limits
from can_rig.plant.behind import LinearBehind, PlantBehind, plant_behind
from can_rig.plant.faults import ActuatorFault, FrameFault, SensorFault
from can_rig.plant.sensor import noise
from can_rig.scenario.build import controller_table
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import SampledPlant
from firmware_model.analysis.simulation import AnyPlant, BoolArray, Trace, simulate
from firmware_model.target.structs import FloatArray, Record


@dataclass(frozen=True)
class Inputs:
    """What happens to the loop from outside, tick by tick; see ``simulate``."""

    reference: FloatArray
    effectiveness: FloatArray
    noise: FloatArray
    bias: FloatArray
    arrives: BoolArray


def inputs_of(scenario: Scenario, network: Network) -> Inputs:
    """The inputs of ``scenario``, which do not depend on its car."""
    ticks = scenario.ticks
    actuator, sensor = ActuatorFault(scenario), SensorFault(scenario)
    return Inputs(
        reference=quantised(network.reference, reference(scenario)),
        effectiveness=np.array([actuator.effectiveness(tick) for tick in range(ticks)]),
        noise=noise(scenario),
        bias=np.array([sensor.bias(tick) for tick in range(ticks)]),
        arrives=arrivals(scenario, network),
    )


def frameless(
    scenario: Scenario,
    network: Network,
    table: Record | None = None,
    inputs: Inputs | None = None,
) -> Trace:
    """Run ``scenario`` without a bus; every signal as its frame on ``network`` would have it.

    A plant of one's own may fail in mid-run: what is measured is not a number from there on.
    ``table`` is that of the scenario's controller and ``inputs`` are its own, for whoever has them.

    Raises:
        ScenarioError: a scenario that cannot run.
    """
    inputs = inputs_of(scenario, network) if inputs is None else inputs
    return simulate(
        controller_table(scenario, network) if table is None else table,
        _plant(scenario),
        inputs.reference,
        tick_s=scenario.tick_s,
        effectiveness=inputs.effectiveness,
        noise=inputs.noise,
        bias=inputs.bias,
        arrives=inputs.arrives,
        hold_ticks=round(scenario.actuator.hold_s / scenario.tick_s),
        limits=actuator_limits(scenario.plant, scenario.tick_s),
        resolution=scenario.plant.sensor.resolution_mps2,
        lsb=network.feedback.lsb,
        maximum=network.feedback.maximum,
    )


def quantised(codec: MessageCodec, values: FloatArray) -> FloatArray:
    """``values`` as their frame carries them: on its grid, within its range."""
    if codec.lsb == 0.0:  # a float
        return np.array([codec.quantise(value) for value in values.tolist()])
    on_the_grid = np.rint(values / codec.lsb) * codec.lsb
    return np.clip(on_the_grid, codec.minimum, codec.maximum)


def arrivals(scenario: Scenario, network: Network) -> BoolArray:
    """Whether the plant's receivers use the command frames of each tick, (ticks, 2).

    Not what they say but that they were sent and when decides it: the receivers themselves are
    asked, for the alive counter has its say when frames come again.
    """
    arrives = np.ones((scenario.ticks, 2), dtype=np.bool_)
    fault = FrameFault(scenario)
    for channel, codec in enumerate((network.command_1, network.command_2)):
        if not fault.concerns(channel):
            continue
        transmitter, receiver = Transmitter(codec), Receiver(codec)
        for tick in range(scenario.ticks):
            frame = fault.on_the_wire(transmitter.frame(0.0, tick), channel, tick)
            used = frame is not None and receiver.accept(frame, tick) is not None
            arrives[tick, channel] = used
            receiver.end_tick()
    return arrives


def _plant(scenario: Scenario) -> SampledPlant | AnyPlant:
    plant = plant_behind(scenario.plant, scenario.tick_s)
    return plant.sampled if isinstance(plant, LinearBehind) else _UntilItFails(plant)


class _UntilItFails:
    """A plant whose output is not a number from its first error on."""

    def __init__(self, plant: PlantBehind) -> None:
        self._plant = plant
        self._failed = False

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``PlantBehind``."""
        if not self._failed:
            try:
                return self._plant.follow(command_1, command_2, left_1, left_2)
            except RigError:
                self._failed = True
        return np.nan, np.nan
