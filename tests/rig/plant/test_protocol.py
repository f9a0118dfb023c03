"""Anybody's plant: found by name, refused in one line, and run as the built-in ones are."""

import dataclasses
import re
import sys
import textwrap
from pathlib import Path

import pytest

from can_rig.errors import RigError, ScenarioError
from can_rig.plant import protocol as plant_protocol
from can_rig.plant.protocol import PlantProtocol, load_plant
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import PlantSettings
from tests.helpers import record, refused, succeeded

SETTINGS = PlantSettings(mass_kg=1500.0)
LAG = plant_protocol.__doc__.partition("``mycar.py`` beside a scenario defines a plant:")[2]
GOOD = """
    class Car:
        made = []
        def __init__(self, settings):
            self.settings, self.calls = settings, []
            Car.made.append(self)
        def reset(self): self.calls.append("reset")
        def advance(self, dt_s, torque_nm, force_difference_n):
            self.calls.append((dt_s, torque_nm, force_difference_n))
            return 0.5
"""


@pytest.fixture(autouse=True)
def own_modules(monkeypatch):
    """Whatever a test makes importable is gone after it."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith("mycar"):
            del sys.modules[name]


def write(source, name="mycar.py"):
    """A module in the current directory, which is the test's own."""
    path = Path(name)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(source))


def refusal(kind="mycar:Car"):
    with pytest.raises(ScenarioError) as caught:
        load_plant(kind, SETTINGS)
    message = str(caught.value)
    assert message.startswith(f"plant.kind = {kind!r}: ")
    assert "\n" not in message
    return message


# --- found ---------------------------------------------------------------------------------------


def test_the_plant_of_the_documentation_is_one():
    write(LAG)
    plant = load_plant("mycar:Lag", SETTINGS)
    assert isinstance(plant, PlantProtocol)
    assert plant.advance(0.05, 100.0, 1000.0) == pytest.approx(0.5 * (2.0 + 0.3))
    plant.reset()
    assert plant.advance(0.05, 0.0, 0.0) == 0.0


def test_it_is_constructed_with_the_settings_of_the_scenario_and_is_not_the_one_of_the_trial():
    write(GOOD)
    plant = load_plant("mycar:Car", SETTINGS)
    tried, made = sys.modules["mycar"].Car.made
    assert made == plant
    assert made.settings is SETTINGS
    assert made.calls == []
    assert tried.calls == ["reset", (plant_protocol.TRIAL_S, 0.0, 0.0)]


def test_a_package_in_the_current_directory_is_found_but_hides_nothing_installed():
    write("", "mycars/__init__.py")
    write(GOOD, "mycars/small.py")
    assert type(load_plant("mycars.small:Car", SETTINGS)).__name__ == "Car"
    write("raise AssertionError('imported')", "colorsys.py")
    assert "no class or function Car in" in refusal("colorsys:Car")  # the standard library's own


NUMBERS = {
    "an int": "0",
    "of no dimension": "numpy.array(0.0)",
    "NumPy's": "numpy.float64(0.0)",
    "NumPy's small": "numpy.float32(0.0)",
}


@pytest.mark.parametrize("number", NUMBERS.values(), ids=NUMBERS.keys())
def test_any_finite_number_is_an_output(number):
    write("import numpy\n" + textwrap.dedent(GOOD).replace("0.5", number))
    load_plant("mycar:Car", SETTINGS)


# --- refused -------------------------------------------------------------------------------------

INIT, ADVANCE = "__init__(self, settings)", "advance(self, dt_s, torque_nm, force_difference_n)"
EMPTY = "class Car:\n    def __init__(self, settings): pass\nclass Cat:"
REFUSED = {
    "no method": (("def advance", "def move"), r"advance; must have reset\(\) and advance\("),
    "no methods": (("class Car:", EMPTY), "no method reset and no method advance;"),
    "no function": (("def reset(self):", "reset = 5; x = lambda self:"), "no method reset;"),
    "too few": (("dt_s, torque_nm, ", "dt_s, "), r"\(dt_s, force_\w+\): must be advance\(dt_s, "),
    "too many": ((ADVANCE, ADVANCE.replace(")", ", more)")), r"advance\(.*, more\): must be adv"),
    "reset wants more": (("reset(self)", "reset(self, state)"), r"\(state\): must be reset\(\)$"),
    "no settings": ((INIT, INIT.replace(")", ", x)")), r"settings, x\): must be Car\(settings\)$"),
    "a world that must be": ((ADVANCE, ADVANCE.replace(")", ", world)")), r"be .*, world=None\)"),
    "nan": (("return 0.5", "return float('nan')"), r"advance\(0.001, 0, 0\) at rest gives nan"),
    "infinity": (("return 0.5", "return 1e999"), r"gives inf: D\* must be a finite float"),
    "text": (("return 0.5", "return '0.5'"), "gives '0.5': "),
    "nothing": (("return 0.5", "pass"), "gives None: "),
    "fails to advance": (("return 0.5", "return 1 / dt_s / 0"), r"0, 0\) at rest failed: ZeroDivi"),
    "fails to reset": (("append(\"reset\")", "nothing()"), r"reset\(\) failed: AttributeError: "),
    "fails to start": (("settings, []", "settings.sped"), r"Car\(settings\) failed: AttributeErr"),
    "many lines": (("return 0.5", "raise ValueError('a\\n b')"), r"Error: a b \(.*, line \d+\)$"),
    "array": (("return 0.5", "return __import__('numpy').eye(2)"), r"array\(\[\[1., 0.\], \[0., 1"),
    "huge": (("return 0.5", "return 10**400"), r"gives 10+: D\* must be a finite float"),
    "exits": (("return 0.5", "raise SystemExit(3)"), r"failed: SystemExit: 3 \(.*, line \d+\)$"),
    "exits at once": (("settings, []", "exit(), []"), r"Car\(settings\) failed: SystemExit"),
    "exits to reset": (("self.calls.append(\"reset\")", "exit()"), r"reset\(\) failed: SystemE"),
    "exits as a module": (("class Car", "exit()\nclass Car"), "cannot be imported: SystemExit"),
    "no words": (("return 0.5", "raise ValueError"), r"failed: ValueError \(.*, line \d+\)$"),
    "other class": (("class Car", "class Cat"), "no class or function Car in .*mycar.py$"),
    "no class": (("class Car:", "Car = 5\nclass Cat:"), "no class or function Car in .*mycar.py$"),
    "no Python": (("class Car:", "class Car"), "mycar cannot be imported: SyntaxError: "),
    "needs another": (("class Car", "import mycar_x\nclass Car"), "imported: ModuleNotFoundError"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "reason"), REFUSED.values(), ids=REFUSED.keys())
def test_a_class_that_is_no_plant_is_refused_in_one_line(change, reason):
    source = textwrap.dedent(GOOD)
    assert change[0] in source
    write(source.replace(*change))
    assert re.search(reason, refusal())


def test_no_such_module():
    assert refusal("mycar:Car").endswith(f"no module mycar, neither installed nor in {Path.cwd()}")
    assert "no module numpy.mycar," in refusal("numpy.mycar:Car")
    write("", "mycars/__init__.py")
    assert "no module mycars.small," in refusal("mycars.small:Car")


NO_CLASS = ("boat", "a:", ":B", "a:b:c", "a b:C", "a..b:C", "a/.py:C", "a:B.C")


@pytest.mark.parametrize("kind", NO_CLASS)
def test_what_does_not_read_like_a_class_names_the_key(kind):
    with pytest.raises(
        ScenarioError, match=r"^scenario thesis-step: plant\.kind = .*: must be .*Class$"
    ):
        load("thesis-step", [f"plant.kind='{kind}'"])


def test_the_model_is_linear_and_has_the_parameters_of_the_plant():
    scenario = load("thesis-step", ["plant.kind=a.b:C", "plant.mass_kg=1500"])
    assert scenario.plant.is_class
    assert scenario.model == dataclasses.replace(scenario.plant, kind="steer-by-wire")
    assert scenario.dbc == "steer_by_wire.dbc"
    other = load("thesis-step", ["plant.kind=a.b:C", "model.mass_kg=1400"])
    assert (other.model.kind, other.model.mass_kg) == ("steer-by-wire", 1400.0)
    with pytest.raises(ScenarioError, match=r"model\.kind = 'a:B': must be linear"):
        load("thesis-step", ["model.kind=a:B"])


# --- run -----------------------------------------------------------------------------------------


def test_the_linear_plant_through_the_protocol_writes_the_log_of_the_built_in_one(tmp_path):
    short = ["duration_s=0.1", "fault.at_s=0.05", "plant.sensor.noise_mps2=0.001"]
    built_in = record(tmp_path, *short)[0].read_bytes()
    own = record(tmp_path, *short, "plant.kind=tests.rig.plant.linear:LinearPlant")[0].read_bytes()
    assert own == built_in


def test_a_run_starts_from_rest_and_asks_tick_by_tick():
    write(GOOD)
    plant = SimulatedPlant(load("thesis-step", ["plant.kind=mycar:Car", "fault.at_s=0.002"]))
    assert plant.measure() == 0.0
    for tick in range(3):
        plant.advance(tick, 10.0 + tick, 20.0 + tick)
        assert plant.measure() == 0.5
    calls = sys.modules["mycar"].Car.made[-1].calls
    assert calls[calls.index("reset") + 1 :] == [
        (0.001, 10.0, 20.0),
        (0.001, 11.0, 21.0),
        (0.001, 0.0, 22.0),  # the torque is lost
    ]


FAILS = {
    "an exception": ("1 / 0", r"ZeroDivisionError: division by zero \(.*, line \d+\)$"),
    "no number": ("None", r"gives None: D\* must be a finite float$"),
    "infinity": ("-1e999", "gives -inf: "),
    "the end": ("exit(3)", r"SystemExit: 3 \(.*, line \d+\)$"),
}


@pytest.mark.parametrize(("answer", "reason"), FAILS.values(), ids=FAILS.keys())
def test_a_plant_that_fails_in_mid_run_is_one_line_that_says_when(answer, reason, tmp_path):
    write(GOOD.replace("return 0.5", f"return 0.0 if len(self.calls) < 42 else {answer}"))
    where = r"^plant\.kind = 'mycar:Car': advance (failed )?at 0\.0\d+ s:? "
    with pytest.raises(RigError, match=f"{where}.*{reason}"):
        record(tmp_path, "plant.kind=mycar:Car", "duration_s=0.1")


def test_a_plant_that_fails_to_reset_later_is_one_line():
    write(GOOD.replace('self.calls.append("reset")', "self.calls and exit(3)"))
    with pytest.raises(RigError, match=r"^plant\.kind = 'mycar:Car': reset\(\) failed: SystemEx"):
        SimulatedPlant(load("thesis-step", ["plant.kind=mycar:Car"]))


def test_ctrl_c_in_a_plant_stays_one():
    write(GOOD.replace("return 0.5", "raise KeyboardInterrupt"))
    with pytest.raises(KeyboardInterrupt):
        load_plant("mycar:Car", SETTINGS)


@pytest.mark.reports
def test_from_the_command_line_a_file_beside_the_scenario_is_a_plant(tmp_path):
    write(LAG)
    write("[plant]\nkind = 'mycar:Lag'\n[fault]\nkind = 'actuator-dead'\nat_s = 0.1", "drive.toml")
    run = ["run", "drive.toml", "--in-process", "--set", "duration_s=0.2", "--out", "run", "--set"]
    tame = ["design.tau_q_s=0.02", "--set", "design.tau_s=0.02"]
    succeeded(*run, *tame)
    assert (tmp_path / "run" / "report.png").is_file()
    assert '"deviation_peak_after_fault_mps2": null' not in (tmp_path / "run/run.json").read_text()
    assert "plant.kind = 'mycar:Nope': no class or function Nope in" in refused(
        *run, "plant.kind=mycar:Nope", "--force"
    )
