"""What pushes a plant by numbers, and an FMU, against scipy alone."""

import numpy as np
import pytest
from scipy import linalg, signal

from can_rig.plant.changing_car import plant_of
from can_rig.plant.disturbances import Disturbances
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray
from tests.rig.plant.fmu.building import COMPILER, build

TICKS = 400
PUSH = (
    "disturbance=[{kind='push', size=0.7, at_s=0.05, for_s=0.2, ramp_s=0.03}, "
    "{kind='push', size=-0.3, at_s=0.1, shape='one-minus-cosine'}]"
)
A = [[-1.0, 2.0, 0.5], [-2.0, -1.5, 0.0], [0.3, 0.0, -4.0]]
B = [[1.0, 0.5], [0.0, 1.0], [2.0, -1.0]]
C = [0.4, -1.0, 0.7]
E = [0.3, -2.0, 1.0]
STATE_SPACE = (f"plant.a={A}", f"plant.b={B}", f"plant.c={C}")


def pushed(scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The push at each tick; output and reading of the plant without commands."""
    plant, push = plant_of(scenario), Disturbances(scenario).at(range(TICKS + 1))[:, 0]
    found = [(0.0, 0.0)]
    for tick in range(TICKS):
        assert plant.report(0.0, 0.0, 1.0, 1.0)["push"] == push[tick]
        found.append(plant.follow(0.0, 0.0, 1.0, 1.0))
    assert np.abs(push).max() > 0.3
    output, reading = np.array(found).T
    return push, output, reading


def test_a_push_passes_the_sensor_s_filter():
    settings = [PUSH, "fault.kind=none", *STATE_SPACE, f"plant.e={E}", "plant.sensor.corner_hz=30"]
    scenario = load("two-masses", [*settings, "design.alpha=3", "design.alpha_q=3"])
    push, _, reading = pushed(scenario)
    corner = 2 * np.pi * 30
    filtered = np.block([[np.array(A), np.zeros((3, 1))], [corner * np.array([C]), -corner]])
    system = signal.lti(filtered, np.c_[[*E, 0.0]], [[0.0, 0.0, 0.0, 1.0]], [[0.0]])
    time_s = scenario.tick_s * np.arange(TICKS + 1)
    right = signal.lsim(system, push, time_s, interp=True)[1]
    assert np.abs(reading - right).max() <= 1e-9 * np.abs(right).max()


@pytest.mark.skipif(COMPILER is None, reason="no C compiler")
@pytest.mark.parametrize("fmi_type", ["co-simulation", "model-exchange"])
def test_an_fmu_is_pushed_through_an_input_with_the_mean_of_each_tick(tmp_path, fmi_type):
    fmu = build(tmp_path / "pushed.fmu", 3, A, B, C, e=E)
    names = {"input_1": "u1", "input_2": "u2", "output": "y", "push": "w"}
    scenario = load(
        "chapter-2",
        [
            PUSH, "fault.kind=none", f"plant.kind='fmu:{fmu}'", f"plant.fmi_type={fmi_type}",
            *(f"plant.variables.{key}={name}" for key, name in names.items()),
        ],
    )  # fmt: skip
    push, output, _ = pushed(scenario)
    both = np.zeros((4, 4))
    both[:3, :3], both[:3, 3] = A, E
    step, x, right = linalg.expm(scenario.tick_s * both), np.zeros(4), [0.0]
    for held in 0.5 * (push[1:] + push[:-1]):
        x[3] = held
        x = step @ x
        right.append(float(x[:3] @ C))
    assert np.abs(output - right).max() <= 1e-6 * np.abs(right).max()
