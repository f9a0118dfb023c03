"""Objects of Python as values of keys: each evaluated beside what the scenario makes of it."""

import subprocess
import sys
from typing import Any

import control
import numpy as np
import pandas as pd
import pytest
from scipy import signal

import can_rig
from can_rig.controllers.filters_law import filter_of
from can_rig.controllers.making import peer_of
from can_rig.controllers.protocol import Inputs
from can_rig.errors import RigError, ScenarioError
from can_rig.scenario import shipped
from can_rig.scenario.loading import load
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from firmware_model import Filter

S = 1j * np.array([0.1, 3.0, 40.0])
G = 20.0 * (S + 4.0) / (S**2 + 12.0 * S + 61.0)  # poles -6 ± 5j
NUM, DEN = [20.0, 80.0], [1.0, 12.0, 61.0]
CONTINUOUS = {
    "tf": control.tf(NUM, DEN),
    "ss": control.ss(control.tf(NUM, DEN)),
    "scipy tf": signal.lti(NUM, DEN),
    "scipy zpk": signal.ZerosPolesGain([-4.0], [-6 + 5j, -6 - 5j], 20.0),
    "scipy ss": signal.lti(NUM, DEN).to_ss(),
}
BY_NUMBERS = {"plant.kind": "transfer-functions", "plant.g2": control.tf([5.0], [1.0, 3.0])}
AT_Z = np.exp(1j * np.array([0.01, 0.3, 2.0]))
BUTTER = signal.butter(3, 60.0, fs=1000.0)
SAMPLED = {
    "dlti": signal.dlti(*BUTTER, dt=0.001),
    "no tick": signal.dlti(*BUTTER),
    "zpk": signal.dlti(*signal.butter(3, 60.0, fs=1000.0, output="zpk"), dt=0.001),
    "control": control.tf(*BUTTER, 0.001),
    "filter": Filter.from_ba(*BUTTER, tick_s=0.001),
}
SHORT = {"fault.at_s": 0.1, "duration_s": 0.2}


@pytest.mark.parametrize("form", CONTINUOUS)
def test_a_continuous_system_is_the_plants_transfer_function(form):
    made = can_rig.load_scenario("default", {**BY_NUMBERS, "plant.g1": CONTINUOUS[form]})
    np.testing.assert_allclose(made.plant.g1.factored(S), G, rtol=1e-9)
    assert made.model.g1 == made.plant.g1


def test_a_system_replaces_the_form_that_was_there():
    factored = {"plant.g1": CONTINUOUS["scipy zpk"]}
    before = can_rig.load_scenario("default", {**BY_NUMBERS, **factored})
    after = can_rig.load_scenario(before, {"plant.g1": CONTINUOUS["tf"]})
    assert (after.plant.g1.num, after.plant.g1.zeros) == (tuple(NUM), None)


@pytest.mark.filterwarnings("ignore:the matrix subclass:PendingDeprecationWarning")
def test_a_system_of_two_inputs_is_the_plant():
    a, b = np.array([[-1.0, 2.0], [0.0, -3.0]]), np.array([[0.0, 1.0], [1.0, 0.5]])
    by_state = control.ss(a, b, [[1.0, 0.0]], [[0.0, 0.0]])
    made = can_rig.load_scenario("default", {"plant": by_state}).plant
    assert made.kind == "state-space"
    np.testing.assert_array_equal(made.a, a)
    np.testing.assert_array_equal(made.b, b)
    numbers = zip("abc", (by_state.A, by_state.B, by_state.C), strict=True)
    by_key = {"plant.kind": "state-space", **{f"plant.{key}": np.matrix(m) for key, m in numbers}}
    assert can_rig.load_scenario("default", by_key).plant == made
    again = can_rig.load_scenario(
        can_rig.load_scenario("default", {"plant": by_state}),
        {"plant": control.tf([[NUM, [5.0]]], [[DEN, [1.0, 3.0]]])},
    ).plant
    assert again.kind == "transfer-functions"
    np.testing.assert_allclose(again.g1.factored(S), G, rtol=1e-9)
    np.testing.assert_allclose(again.g2.factored(S), 5.0 / (S + 3.0), rtol=1e-9)


@pytest.mark.parametrize("form", SAMPLED)
def test_a_sampled_system_is_a_filter_in_z(form):
    changes = {"controller.kind": "filters", "controller.c": SAMPLED[form]}
    given = can_rig.load_scenario("default", changes).controller.c
    b, a = BUTTER
    right = np.polyval(b, AT_Z) / np.polyval(a, AT_Z)
    made = filter_of("c", given, 0.001).frequency_response(np.angle(AT_Z) / 0.001)
    np.testing.assert_allclose(made, right, rtol=1e-7)
    if form != "no tick":
        with pytest.raises(ScenarioError, match=r"c.tick_s = 0.001: must be tick_s = 0.002"):
            can_rig.load_scenario("default", {**changes, "tick_s": 0.002})


@pytest.mark.parametrize("kind", [np.array, list, tuple, pd.Series])
def test_an_array_is_the_reference_tick_by_tick(kind):
    values = np.sin(np.arange(150) * 0.02)
    scenario = can_rig.load_scenario("default", {**SHORT, "reference": kind(values)})
    np.testing.assert_array_equal(reference(scenario)[:150], values)
    assert set(reference(scenario)[150:]) == {values[-1]}


class Gain:
    """Proportional control."""

    def __init__(self, setup: object) -> None:
        pass

    def reset(self, reference: float) -> None:
        pass

    def step(self, inputs: Inputs) -> tuple[float, float]:
        return 30.0 * (inputs.reference - inputs.measurement), 0.0


def gain(inputs: Inputs) -> tuple[float, float]:
    return 30.0 * (inputs.reference - inputs.measurement), 0.0


def static(dt_s: float, command_1: float, command_2: float) -> float:
    return 0.01 * command_1


def test_classes_and_functions_are_controllers_and_plants():
    logs = []
    for part in (Gain, gain, f"{__name__}:Gain"):
        made = can_rig.run("ideal", {**SHORT, "controller.kind": part})
        logs.append((made.folder / "bus.log").read_bytes())
    assert logs[0] == logs[1] == logs[2]
    changes = {**SHORT, "plant.kind": static, "controller.kind": gain, "fault.kind": "none"}
    run = can_rig.run("ideal", changes, allow_unstable=True).table.columns
    applied, output = run["torque_nm"][:-2], run["true_dstar_mps2"][2:]  # latency, sample
    np.testing.assert_allclose(output, 0.01 * applied, atol=1e-5)


SCRIPT = """
import os
import can_rig

class Gain:
    def __init__(self, setup): pass
    def reset(self, reference): pass
    def step(self, inputs): return 30.0 * inputs.reference, 0.0

if __name__ == "__main__":
    made = can_rig.load_scenario("ideal", {"controller.kind": Gain})
    can_rig.run(made, {"duration_s": 0.01, "fault.kind": "none"}, allow_unstable=True)
    for folder in (".", "scripts"):
        os.chdir(folder)
        can_rig.save_scenario(made, "saved.toml")
        print(can_rig.load_scenario("saved.toml").controller.kind)
"""


def test_a_class_of_a_script_is_found_by_the_script_and_by_others(tmp_path, monkeypatch):
    """In the folder of the script, and in another."""
    folder = tmp_path / "scripts"
    folder.mkdir()
    (folder / "script.py").write_text(SCRIPT)
    said = subprocess.run(
        [sys.executable, str(folder / "script.py")], check=True, capture_output=True, text=True
    )
    assert said.stdout.split() == 2 * [f"{folder / 'script'}:Gain"]
    monkeypatch.setattr(sys, "path", [*sys.path])
    for here in (tmp_path, folder):
        made = load(str(here / "saved.toml"))
        assert peer_of(made).step(Inputs(1.0, 0.0)).command_1 == 30.0


@pytest.mark.parametrize("name", ["default", "pendulum", "two-masses"])
def test_a_whole_scenario_takes_a_plant_of_ones_own_as_its_name_does(name):
    changes = {"plant.kind": static}
    by_name = can_rig.load_scenario(name, changes)
    whole = can_rig.load_scenario(can_rig.load_scenario(name), changes)
    assert whole == by_name
    assert whole.model == can_rig.load_scenario(name).model


def test_a_part_of_a_scenario_is_a_table():
    soft = can_rig.load_scenario("default", {"plant.mass_kg": 1400.0})
    made = can_rig.load_scenario("ideal", {"plant": soft.plant, "limits": soft.limits})
    assert (made.plant, made.limits) == (soft.plant, soft.limits)


class Home:
    class Inner:
        pass


REFUSED: list[tuple[dict[Any, Any], str]] = [
    ({"controller.kind": Home.Inner}, "controller.kind = Home.Inner: must be at the top level"),
    ({"reference": np.zeros((3, 2))}, r"reference: an array of shape \(3, 2\): must be \(ticks,\)"),
    ({"reference": []}, "samples_mps2: must have a value"),
    ({"reference": [2e6]}, r"samples_mps2.0 = 2000000.0: must be at most"),
    ({"plant.g1": control.tf([[NUM, NUM]], [[DEN, DEN]])}, r"plant.g1: .*2 input"),
    ({"plant": control.tf(NUM, DEN)}, r"plant: 1 input\(s\) and 1 output\(s\): must be two"),
    ({"plant": control.tf([[NUM, NUM]], [[DEN, DEN]], 0.1)}, "plant: .*sampled already"),
    ({"plant": control.ss([[-1.0]], [[1.0]], [[1.0]], 0.0)}, "plant: a state space with B"),
    ({"plant.g1": SAMPLED["dlti"]}, "plant.g1: a system sampled already"),
    ({"plant.g1": object()}, "plant.g1 = <object"),
    ({"controller.kind": Home()}, "controller.kind = <.*: must be a text, a class or a function"),
    ({"plant.g1.poles": np.array([-1 - 2j, -3])}, "must have the conjugate of each root"),
    ({"plant.a": np.array([[-1.0, 1j], [0.0, -2.0]])}, "plant.a = .*must be a number"),
    ({"controller.c": control.tf(NUM, DEN)}, "kind = 'ours'; kind = 'filters' has it"),
]  # fmt: skip


@pytest.mark.parametrize(("changes", "message"), REFUSED)
def test_a_value_that_no_key_has_is_one_line(changes, message):
    with pytest.raises(RigError, match=message) as caught:
        can_rig.load_scenario("default", changes)
    assert "\n" not in str(caught.value)


OWN = [
    {"fault": [{"kind": "actuator-dead", "at_s": 5.0}, {"kind": "actuator-late", "late_ticks": 3}]},
    {"model.mass_kg": 1300.0, "plant.torque_actuator.lag_s": 0.02,
     "sensor": [{"measures": "yaw-rate"}]},
    {"plant": control.tf([[NUM, [5.0]]], [[DEN, [1.0, 3.0]]]), "seed": 3},
    {"controller": {"kind": "filters", "c": SAMPLED["dlti"]}, "reference": [0.0, 1.0, 0.5]},
    {"controller": {"kind": "pi", "parameters": {"kp": 3}}, "fault.kind": "none"},
]  # fmt: skip


@pytest.mark.parametrize("case", [*shipped(), *range(len(OWN))])
def test_a_saved_scenario_is_the_same(case, tmp_path):
    if isinstance(case, str):
        scenario = can_rig.load_scenario(case)
    else:
        scenario = can_rig.load_scenario("default", OWN[case])
    path = can_rig.save_scenario(scenario, tmp_path / f"{scenario.name}.toml")
    assert can_rig.load_scenario(path) == _resolved(scenario)
    with pytest.raises(RigError, match="exists; choose another name"):
        can_rig.save_scenario(scenario, path)


def _resolved(scenario: Scenario) -> Scenario:
    """With the absolute path of the drive's recording."""
    from dataclasses import replace
    from pathlib import Path

    file = scenario.drive.file
    drive = replace(scenario.drive, file=str(Path(file).resolve()) if file else "")
    return replace(scenario, drive=drive)


def test_a_lag_that_no_file_unsets_is_refused(tmp_path):
    both = {"plant.torque_actuator.natural_frequency_rad_per_s": 50.0}
    second = can_rig.load_scenario("ideal", both)
    ideal = can_rig.load_scenario("ideal", {"model": second.model})
    with pytest.raises(ScenarioError, match="no file can unset"):
        can_rig.save_scenario(
            can_rig.load_scenario(second, {"model": can_rig.load_scenario("ideal").model}),
            tmp_path / "x.toml",
        )
    assert ideal.model == second.model


def test_a_car_that_is_not_the_model_is_a_note():
    same = can_rig.load_scenario("default", {"plant.speed_mps": 30.0})
    other = can_rig.load_scenario("default", {"plant.speed_mps": 30.0, "model.speed_mps": 10.0})
    heavy = can_rig.load_scenario("default", {"plant.mass_kg": 1600.0, "model.mass_kg": 1500.0})
    assert not same.notes
    assert other.notes == ["note: designed for 10 m/s, driven at 30 m/s"]
    assert heavy.notes == ["note: designed for mass_kg = 1500, driven with 1600"]
