"""The loop without frames against its parts, one call after another."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.errors import RigError
from can_rig.plant.faults.delivery import delivery
from can_rig.plant.frameless import frameless, inputs_of
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.firmware import Firmware
from tests.rig.plant.linear import LinearPlant

LINEAR = "plant.kind=tests.rig.plant.linear:LinearPlant"
FAILING = "plant.kind=tests.rig.plant.test_frameless_loop:Failing"
SHORT = ["duration_s=0.04", "fault.at_s=0.015", "fault.for_s=0.015", "reference.kind=sine",
         "reference.frequency_rad_per_s=60"]  # fmt: skip
CASES = {
    "dead": ["fault.kind=actuator-dead", "fault.left=0.25", "latency_ticks=2"],
    "held": ["fault.kind=frames-missing", "actuator.hold_s=0.0069999999"],
    "not held": ["fault.kind=frames-missing", "fault.channel=force-difference",
                 "actuator.hold_s=0"],
    "sensor": ["fault.kind=sensor-biased", "fault.bias_mps2=0.3", "plant.sensor.noise_mps2=0.01",
               "plant.sensor.resolution_mps2=0.02", "seed=9"],
    "limits": ["fault.kind=none", "plant.torque_actuator.limit_nm=3",
               "plant.force_difference_actuator.rate_n_per_s=900"],
    "the end of the frame": ["fault.kind=sensor-biased", "fault.bias_mps2=30"],
    "a class": ["fault.kind=actuator-dead", LINEAR],
}  # fmt: skip


class Failing(LinearPlant):
    """A plant that fails once, and would go on."""

    def __init__(self, settings: Any) -> None:
        super().__init__(settings)
        self._left = 20

    def advance(self, *arguments: float) -> float:
        self._left -= 1
        if self._left == 0:
            raise ValueError("stuck")
        return super().advance(*arguments)


def one_by_one(scenario: Scenario) -> Mapping[str, Any]:
    """What the nodes do, without the bus between them."""
    network = network_of(scenario)
    plant = SimulatedPlant(scenario)
    firmware = Firmware(controller_table(scenario, network))
    used = delivery(scenario, network).used.tolist()
    rows = []
    for tick, value in enumerate(reference(scenario).tolist()):
        measured = network.feedback.quantise(plant.measure())
        wanted = network.reference.quantise(value)
        answer = firmware.step(wanted, measured)
        rows.append((wanted, measured, *answer[:2], *answer[3:5]))
        sent = network.command_1.quantise(answer[0]), network.command_2.quantise(answer[1])
        plant.advance(
            tick, *(s if there else None for s, there in zip(sent, used[tick], strict=True))
        )
    names = ("reference", "measured", "command_1", "command_2", "mode", "fault_state")
    return dict(zip(names, np.array(rows).T, strict=True))


@pytest.mark.parametrize("case", CASES)
def test_it_is_its_parts_one_after_another(case: str) -> None:
    scenario = load("thesis-step", [*SHORT, *CASES[case]])
    trace = frameless(scenario, network_of(scenario))
    for name, expected in one_by_one(scenario).items():
        np.testing.assert_array_equal(getattr(trace, name), expected, err_msg=name)
    assert np.ptp(trace.measured) > 1e-3


def test_a_table_and_inputs_of_one_s_own_are_used() -> None:
    scenario = load("thesis-step", [*SHORT, "fault.kind=none"])
    network = network_of(scenario)
    inputs = inputs_of(scenario, network)
    zero = dataclasses.replace(inputs, reference=0.0 * inputs.reference)
    assert not frameless(scenario, network, inputs=zero).command_1.any()
    other = load("thesis-step", [*SHORT, "fault.kind=none", "design.tau_s=0.02"])
    slower = frameless(scenario, network, Scheduled(None, controller_table(other, network)))
    assert slower.command_1.tolist() == frameless(other, network).command_1.tolist()
    assert slower.command_1.tolist() != frameless(scenario, network).command_1.tolist()


def test_a_plant_that_has_failed_says_nothing_any_more() -> None:
    """Not even where its next call would have answered."""
    scenario = load("thesis-step", [*SHORT, "fault.kind=none", FAILING])
    with pytest.raises(RigError, match="stuck"):
        one_by_one(scenario)
    measured = frameless(scenario, network_of(scenario)).measured
    # One of the twenty calls is made before the run, and taken back by the reset.
    assert np.isfinite(measured).tolist() == [True] * 19 + [False] * 21
