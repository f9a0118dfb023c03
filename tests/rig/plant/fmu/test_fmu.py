"""A plant that is an FMU moves as its equations do, whatever its type, and as the class of them."""

import math
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from can_rig.errors import RigError
from can_rig.fmu.file import CO_SIMULATION, MODEL_EXCHANGE
from can_rig.plant.changing_car import plant_of
from can_rig.plant.protocol import GuardedPlant, load_plant
from can_rig.scenario.build import continuous_car
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import PlantSettings
from tests.helpers import asked, record
from tests.rig.plant.fmu.building import build

VARIABLES = {"input_1": "u1", "input_2": "u2", "output": "y"}
TYPES = list(product((2, 3), (CO_SIMULATION, MODEL_EXCHANGE)))
BOUNDS = {CO_SIMULATION: 1e-11, MODEL_EXCHANGE: 2e-6}  # of the test's Runge-Kutta, of CVODE


def settings(path: Path, fmi_type: str | None = None, **keys) -> PlantSettings:
    variables = VARIABLES | keys.pop("variables", {})
    return PlantSettings(kind=f"fmu:{path}", variables=variables, fmi_type=fmi_type, **keys)


def loaded(chosen: PlantSettings):
    return load_plant(chosen.kind, chosen)


def keys_of(path: Path, *more: str) -> list[str]:
    variables = [f"plant.variables.{key}={name}" for key, name in VARIABLES.items()]
    return [f"plant.kind=fmu:{path}", *variables, *more]


# --- its equations -------------------------------------------------------------------------------


@pytest.mark.parametrize(("version", "fmi_type"), TYPES)
def test_it_moves_as_the_matrix_exponential_says(version, fmi_type, cars):
    car, dt_s = continuous_car(PlantSettings()), 0.002
    both = np.zeros((6, 6))
    both[:4, :4], both[:4, 4:] = car.a, car.b
    step = expm(both * dt_s)
    signals = {"yaw_rate_rad_per_s": "x[1]", "bounces": "bounces", "switched_on": "on"}
    plant = loaded(settings(cars[version], fmi_type, variables=signals))
    random, x = np.random.default_rng(7), np.zeros(4)
    for _ in range(100):
        torque_nm, force_n = random.normal(size=2) * (20.0, 500.0)
        x = step[:4, :4] @ x + step[:4, 4:] @ (torque_nm, force_n)
        reached = plant.advance(dt_s, torque_nm, force_n)
        assert reached == pytest.approx(float(np.ravel(car.c) @ x), abs=BOUNDS[fmi_type])
    reported = plant.signals()
    assert reported["yaw_rate_rad_per_s"] == pytest.approx(x[1], abs=BOUNDS[fmi_type])
    assert (reported["bounces"], reported["switched_on"]) == (0.0, 1.0)


@pytest.mark.parametrize(("version", "fmi_type"), TYPES)
def test_events_between_ticks_happen_where_they_are(version, fmi_type, tmp_path):
    """x' = -x + g u with u = 1; at 0.205 s g becomes 2; where x reaches 1/2 it becomes -1/4."""
    path = build(tmp_path / "one.fmu", version, [[-1.0]], [[1.0, 0.0]], [1.0])
    given = {"switch_s": 0.205, "wall": {"at": 0.5}}
    chosen = settings(path, fmi_type, variables={"bounces": "bounces"}, parameters=given)
    plant = loaded(chosen)
    switched = 1.0 - math.exp(-0.205)
    first = 0.205 + math.log((2.0 - switched) / 1.5)
    second = first + math.log(2.25 / 1.5)
    for tick in range(1, 101):
        time_s, y = tick * 0.01, plant.advance(0.01, 1.0, 0.0)
        if time_s < 0.205:
            exact = 1.0 - math.exp(-time_s)
        elif time_s < first:
            exact = 2.0 - (2.0 - switched) * math.exp(0.205 - time_s)
        else:
            since = second if time_s >= second else first
            exact = 2.0 - 2.25 * math.exp(since - time_s)
        assert y == pytest.approx(exact, abs=1e-8)
        assert plant.signals()["bounces"] == (time_s >= first) + (time_s >= second)


@pytest.mark.parametrize(("version", "fmi_type"), TYPES)
def test_reset_is_back_to_rest_and_two_know_nothing_of_each_other(version, fmi_type, cars):
    chosen = settings(cars[version], fmi_type, parameters={"gain": 2.0})
    one, other = loaded(chosen), loaded(settings(cars[version], fmi_type))
    once = [one.advance(0.001, 10.0, 0.0) for _ in range(5)]
    assert other.advance(0.001, 5.0, 0.0) == pytest.approx(0.25 * once[0], abs=1e-8)
    one.reset()
    assert [one.advance(0.001, 10.0, 0.0) for _ in range(5)] == once


def test_co_simulation_is_chosen_where_nothing_is_said(cars):
    calls = [loaded(settings(cars[2], each)).advance(0.1, 1.0, 1.0) for each in (None, *BOUNDS)]
    assert calls[0] == calls[1] != calls[2]


# --- in a run ------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [2, 3])
def test_the_car_as_an_fmu_writes_the_log_of_the_built_in_one(version, cars, tmp_path):
    short = ["duration_s=0.1", "fault.at_s=0.05", "plant.sensor.noise_mps2=0.001"]
    built_in = record(tmp_path, *short)[0].read_bytes()
    assert record(tmp_path, *short, *keys_of(cars[version]))[0].read_bytes() == built_in


def test_between_ticks_it_gets_what_the_actuators_make_of_the_commands(cars):
    lags = ["plant.torque_actuator.lag_s=0.01", "plant.sensor.corner_hz=50"]
    tuned = ["design.alpha=3", "design.alpha_q=3", "design.tau_q_s=0.05"]
    fmu, linear = (
        plant_of(load("thesis-step", [*lags, *tuned, *more])) for more in (keys_of(cars[3]), [])
    )
    for tick in range(50):
        commands = 10.0 * math.sin(tick / 9.0), 100.0 * math.cos(tick / 7.0)
        assert fmu.follow(*commands, 1.0, 0.5) == pytest.approx(
            linear.follow(*commands, 1.0, 0.5), abs=2e-6
        )


@pytest.mark.parametrize(("version", "fmi_type"), TYPES)
def test_one_that_fails_in_mid_run_is_one_line_with_its_own_words(version, fmi_type, cars):
    chosen = settings(cars[version], fmi_type, parameters={"fail_s": 0.02})
    plant = GuardedPlant(chosen.kind, loaded(chosen))
    name = "DoStep" if fmi_type == CO_SIMULATION else r"Get\w*Derivatives"
    line = (
        rf"^plant\.kind = 'fmu:.*car{version}\.fmu': advance failed at 0\.0\d+ s: FmuError: "
        rf"fmi{version}{name} failed with status 3 \(error\); the FMU says: the belt is torn$"
    )
    with pytest.raises(RigError, match=line):
        for _ in range(100):
            plant.advance(0.001, 1.0, 0.0)


def test_one_that_ends_its_simulation_is_one_line(cars):
    chosen = settings(cars[3], parameters={"on": False})
    plant = GuardedPlant(chosen.kind, loaded(chosen))
    with pytest.raises(RigError, match=r"at 0\.0\d+ s: FmuError: the FMU ends the simulation$"):
        for _ in range(100):
            plant.advance(0.001, 1.0, 0.0)


def test_a_file_beside_the_scenario_and_a_linear_plant_that_stands_for_it(tmp_path):
    folder = tmp_path / "mine"
    folder.mkdir()
    a, b, c = [[-1.0, 0.98], [-4.0, -1.2]], [[-0.05, 0.02], [-3.5, 1.5]], [0.0, 1.0]
    build(folder / "two.fmu", 3, a, b, c)
    scenario = folder / "two.toml"
    scenario.write_text(
        f"tick_s = 0.01\nduration_s = 1\n[plant]\nkind = 'fmu:two.fmu'\na = {a}\nb = {b}\nc = {c}\n"
        f"variables = {{ input_1 = 'u1', input_2 = 'u2', output = 'y' }}\n"
        "input_1 = { name = 'force' }\n[design]\ntau_s = 0.05\ntau_q_s = 0.1\nalpha_q = 2\n"
        "[fault]\nkind = 'actuator-dead'\nat_s = 0.5\n"
    )
    chosen = load("mine/two.toml")
    assert (chosen.model.kind, chosen.model.a, chosen.model.variables) == (
        "state-space",
        ((-1.0, 0.98), (-4.0, -1.2)),
        {},
    )
    by_numbers = ["plant.kind=state-space", "plant.variables={}"]
    logs = [
        record(tmp_path, *more, name="mine/two.toml")[0].read_bytes() for more in ([], by_numbers)
    ]
    assert logs[0] == logs[1]
    checked = asked("check", "mine/two.toml", "--set", "budget.box=0")
    assert "margins: of the linear plant by numbers, not of fmu:mine/two.fmu" in " ".join(
        checked.stdout.split()
    )


# --- as another tool builds it -------------------------------------------------------------------

LAG = """
from {package} import {base}, {base_of}Causality, {base_of}Variability, {real}

class Lag({base}):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.torque = self.force = self.dstar = 0.0
        self.lag_s = 0.1
        Causality, Variability = {base_of}Causality, {base_of}Variability
        for name in ("torque", "force"):
            self.register_variable({real}(name, causality=Causality.input))
        self.register_variable({real}("dstar", causality=Causality.output))
        self.register_variable(
            {real}("lag_s", causality=Causality.parameter, variability=Variability.tunable)
        )

    def do_step(self, current_time, step_size):
        target = 0.02 * self.torque + 3e-4 * self.force
        self.dstar += (target - self.dstar) * min(1.0, step_size / self.lag_s)
        return True
"""
CLASS = """
class Lag:
    def __init__(self, settings):
        self.lag_s = settings.parameters["lag_s"]
        self.reset()
    def reset(self):
        self.dstar = 0.0
    def advance(self, dt_s, torque, force):
        target = 0.02 * torque + 3e-4 * force
        self.dstar += (target - self.dstar) * min(1.0, dt_s / self.lag_s)
        return self.dstar
"""
TOOLS = {
    "pythonfmu": {"base": "Fmi2Slave", "base_of": "Fmi2", "real": "Real"},
    "pythonfmu3": {"base": "Fmi3Slave", "base_of": "Fmi3", "real": "Float64"},
}


@pytest.mark.parametrize("package", TOOLS)
def test_an_fmu_of_pythonfmu_writes_the_log_of_the_class_of_the_same_equations(package, tmp_path):
    module = f"lag_of_{package}.py"  # this process imports both modules
    (tmp_path / module).write_text(LAG.format(package=package, **TOOLS[package]))
    command = [sys.executable, "-m", package, "build", "-f", module]
    subprocess.run(command, check=True, capture_output=True, timeout=100)
    (tmp_path / "mylag.py").write_text(CLASS)
    names = {"input_1": "torque", "input_2": "force", "output": "dstar"}
    same = ["duration_s=0.1", "fault.at_s=0.05", "plant.parameters.lag_s=0.2"]
    kinds = (
        ["plant.kind=fmu:Lag.fmu", *(f"plant.variables.{k}={v}" for k, v in names.items())],
        ["plant.kind=mylag:Lag"],
    )
    (tmp_path / "logs").mkdir()
    fmu, own = (record(tmp_path / "logs", *same, *kind)[0].read_bytes() for kind in kinds)
    assert fmu == own
