"""The threshold's budget: each part against another way to know it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from can_rig.assessment.resolve import load
from can_rig.assessment.threshold_budget import sigmas_for, threshold_budget
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_design, controller_table, network_of
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Answer, Firmware
from firmware_model.target.status import FaultState
from tests.rig.plant.linear import LinearPlant

STEP = ("duration_s=3.0", "fault.kind=none")


def parts(name: str, *settings: str) -> dict[str, float]:
    scenario = load(name, [*STEP, *settings])
    return vars(threshold_budget(scenario, network_of(scenario)))


def healthy(scenario: Scenario) -> Iterator[Answer]:
    """A healthy loop, tick by tick through the firmware, around ``scenario.plant``."""
    firmware = Firmware(controller_table(scenario, None))
    plant, y = LinearPlant(scenario.plant), 0.0
    on_the_way = [(0.0, 0.0)] * scenario.latency_ticks
    for wanted in reference(scenario):
        answer = firmware.step(float(wanted), y)
        yield answer
        on_the_way.append((answer.command_1, answer.command_2))
        y = plant.advance(scenario.tick_s, *on_the_way.pop(0))


def largest_estimate(scenario: Scenario) -> float:
    return max(abs(answer.fault_estimate) for answer in healthy(scenario))


@pytest.mark.parametrize("rule", ["tustin", "tustin-held", "zoh"])
def test_model_is_what_the_rule_leaves_on_the_reference(rule: str) -> None:
    """Trap 3: nothing for ZOH, some for Tustin of a held input, most for Tustin."""
    settings = (f"design.estimator={rule}", "design.tau_s=0.005", "design.tau_q_s=0.005")
    found = parts("thesis-step", *settings)["model"]
    assert found == pytest.approx(largest_estimate(load("thesis-step", [*STEP, *settings])))
    assert {"tustin": 1e-2, "tustin-held": 1e-6, "zoh": 0.0}[rule] <= found
    assert found <= {"tustin": 1.0, "tustin-held": 1e-2, "zoh": 1e-12}[rule]


def test_cars_is_the_largest_share_that_any_vertex_shows() -> None:
    """10 % less mass and less stiffness: at first the torque does some 20 % more."""
    assert parts("default", "budget.box=0")["cars"] == 0.0
    small, large = (parts("default", f"budget.box={box}")["cars"] for box in (0.03, 0.1))
    assert 0.2 < large < 0.4
    assert large > 2.0 * small > 0.0


def test_cars_leaves_d_of_every_vertex_below_its_share_of_what_the_torque_does() -> None:
    """By size alone, tick by tick: |d̂| against the largest torque's answer so far."""
    found = parts("default", "budget.box=0.1")
    other = ("plant.mass_kg=1540", "plant.rear_cornering_stiffness_n_per_rad=50580")
    model = ("model.mass_kg=1400", "model.rear_cornering_stiffness_n_per_rad=56200")
    quiet = "design.fault_threshold_mps2=1e9"  # nothing engages
    seen = largest_estimate(load("default", [*STEP, *other, *model, quiet]))
    assert 0.01 < seen < found["cars"] * 1.5  # D* stays below 1.5 m/s²


@pytest.mark.parametrize(("ticks", "per_hour"), [(1, 1e-3), (3, 1e-3), (3, 3600.0), (5, 1e-9)])
def test_sigmas_leave_as_many_false_alarms_as_asked(ticks: int, per_hour: float) -> None:
    z = sigmas_for(per_hour, 1e-3, ticks)
    assert 3.6e6 * (2.0 * stats.norm.sf(z)) ** ticks == pytest.approx(per_hour, rel=1e-6)


def test_false_alarms_come_as_often_as_the_budget_says() -> None:
    """A budget of one alarm in 0.05 s of driving, so that 40 000 ticks have hundreds of them."""
    per_hour, confirm = 72_000.0, 2
    z = sigmas_for(per_hour, 1e-3, confirm)
    sigma, ticks = 0.005, 40_000
    scenario = load("noisy")
    car = continuous_design(scenario).plant
    table = build(
        continuous_design(scenario),
        Target(1e-3, 1, "zoh", threshold=z * sigma, confirm_ticks=confirm, clear_ticks=1,
               clear_ratio=0.9),
    )  # fmt: skip
    noise = sigma * np.random.default_rng(1).standard_normal(ticks)
    over = np.abs(simulate(table, sample(car, 1e-3), np.zeros(ticks), noise=noise).fault_estimate)
    rows = (over[1:] > z * sigma) & (over[:-1] > z * sigma)
    expected = per_hour * ticks / 3.6e6
    assert rows.sum() == pytest.approx(expected, abs=4.0 * np.sqrt(expected))


def test_noise_is_that_of_d_times_the_sigmas() -> None:
    """d̂ takes over the noise as it is, whatever the loop makes of it."""
    found = parts("noisy")
    assert found["noise"] == pytest.approx(found["sigmas"] * 0.005, rel=1e-9)
    assert found["sigmas"] == sigmas_for(0.001, 1e-3, 3)


def test_a_scenario_takes_its_threshold_from_the_budget() -> None:
    scenario = load("noisy", [*STEP, "budget.box=0.05", "design.fault_threshold_mps2=from-budget"])
    expected = threshold_budget(scenario, network_of(scenario)).threshold
    assert scenario.design.fault_threshold_mps2 == expected
    least = replace(scenario.design, fault_threshold_mps2=1e-300)
    found = threshold_budget(replace(scenario, design=least), network_of(scenario))
    assert scenario.design.fault_threshold_share == found.share > 0.05
    # Changes of white noise are a little more than the noise itself; other cars cost no more.
    alone = threshold_budget(load("noisy"), network_of(scenario)).threshold
    assert alone < expected < 1.05 * alone


@pytest.mark.parametrize("vertex", [0.95, 1.05])
def test_no_healthy_car_of_the_box_raises_an_alarm(vertex: float) -> None:
    share = [f"plant.speed_mps={10.0 * vertex}", "model.speed_mps=10.0"]
    settings = [*STEP, *share, "budget.box=0.05", "design.fault_threshold_mps2=from-budget"]
    settings.append("design.fault_threshold_share=0")  # the budget's own is larger
    seen = {FaultState(answer.fault_state) for answer in healthy(load("default", settings))}
    assert seen <= {FaultState.CLEAR, FaultState.CANNOT_TELL}
    trusted = load("default", [*share, *STEP, "design.fault_threshold_share=0"])
    assert FaultState.CONFIRMED in {answer.fault_state for answer in healthy(trusted)}


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["budget.box=1.5"], "budget.box = 1.5: must be less than 1"),
        (
            ["budget.false_alarms_per_hour=0"],
            "false_alarms_per_hour = 0: must be greater than 0",
        ),
        (["budget.boxes=1"], "did you mean box?"),
        (["design.fault_threshold_mps2=budget"], "design.fault_threshold_mps2"),
    ],
)
def test_what_is_no_budget_is_refused(settings: list[str], expected: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        load("default", settings)
    assert expected in str(refused.value)
    assert "\n" not in str(refused.value)
