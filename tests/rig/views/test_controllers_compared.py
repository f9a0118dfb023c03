"""Controllers through the same cases: figures worked out again from a run with frames."""

import json

import numpy as np
import pytest

import can_rig
from can_rig.errors import ScenarioError
from can_rig.nodes.bus_access import StopRequest
from can_rig.results.execution import Options, execute
from can_rig.scenario.loading import as_settings, load
from can_rig.views.controllers_compared import CASES
from tests.helpers import asked, refused, succeeded

LOST = {"fault.kind": "actuator-dead", "fault.at_s": 0.8}
SHORT = {"duration_s": 1.2}


def test_the_figures_are_those_of_a_run_with_frames(tmp_path):
    found = can_rig.compare(["ours", "pi"], changes=SHORT, cases={"lost": LOST, "none": {
        "fault.kind": "none", "plant.mass_kg*": np.int64(2), "model.mass_kg*": 2.0}})  # fmt: skip
    assert [(row.case, row.controller) for row in found.rows] == [
        (case, controller) for case in ("lost", "none") for controller in ("ours", "pi")
    ]
    for row in found.rows[:2]:
        settings = [*as_settings(SHORT | LOST), f"controller.kind={row.controller}"]
        where = tmp_path / row.controller
        execute(load("default", settings), where, StopRequest(),
                Options(report=False, bus="virtual:compared"))  # fmt: skip
        names, *lines = (where / "signals.csv").read_text().splitlines()
        table = np.genfromtxt(lines, delimiter=",")
        column = {name: table[:, at] for at, name in enumerate(names.split(","))}
        size = np.abs(column["reference_mps2"] - column["true_dstar_mps2"])
        after = column["time_s"] >= 0.8
        assert row.error_peak_mps2 == pytest.approx(size[after].max(), rel=1e-6)
        assert row.error_rms_mps2 == pytest.approx(np.sqrt(np.mean(size[after] ** 2)), rel=1e-6)
        assert row.torque_peak_nm == pytest.approx(np.nanmax(np.abs(column["torque_nm"])), rel=1e-6)
    ours, pi = found.rows[:2]
    assert ours.error_peak_mps2 < 0.1
    assert pi.error_peak_mps2 > 0.5
    assert (ours.false_alarm, pi.false_alarm) == (False, None)
    assert list(found.table["controller"]) == ["ours", "pi", "ours", "pi"]
    found.draw(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes()[:4] == b"\x89PNG"


CRIES = """
from can_rig.controllers.protocol import Answer

class Cries:
    def __init__(self, setup):
        self.ticks = 0

    def reset(self, reference):
        self.ticks = 0

    def step(self, inputs):
        self.ticks += 1
        confirmed = 2 if self.ticks > 1000 else 0
        return Answer(40.0 * inputs.reference, 0.0, fault_state=confirmed)
"""


@pytest.mark.filterwarnings("error")
def test_a_confirmation_counts_for_the_loss_in_which_it_begins_alone(tmp_path, monkeypatch):
    """Whatever happens, this controller confirms a loss of the torque at 1 s."""
    (tmp_path / "cries.py").write_text(CRIES)
    monkeypatch.chdir(tmp_path)
    biased = {"fault.kind": "sensor-biased", "fault.at_s": 0.8}
    cases = {"in time": LOST, "before": LOST | {"fault.at_s": 1.1}, "of the sensor": biased}
    found = can_rig.compare(["cries:Cries"], changes=SHORT, cases=cases)
    assert [(row.confirmed_after_s, row.false_alarm) for row in found.rows] == [
        (0.2, False), (None, True), (None, True),
    ]  # fmt: skip


@pytest.mark.parametrize("group", CASES)
def test_every_shipped_case_loads(group):
    for changes in CASES[group].values():
        plain = {key: value for key, value in changes.items() if not key.endswith("*")}
        assert load("default", as_settings(plain))


def test_a_factor_is_of_the_scenarios_number_on_the_command_line_too():
    words = ["compare", "pi", "--set", "duration_s=0.5", "--set", "model.mass_kg=1200", "--json"]
    factors = "x:plant.mass_kg*=1.2,model.mass_kg*=1.5,plant.sensor.noise_mps2*=2,seed*=3"
    numbers = "x:plant.mass_kg=1680,model.mass_kg=1800,plant.sensor.noise_mps2=0.01,seed=3"
    one, other = (
        json.loads(succeeded(*words, "--set", "seed=1", "--case", case).stdout)
        for case in (factors, numbers)
    )
    assert one == pytest.approx(other)


def test_a_shipped_case_has_its_own_faults_and_weather_alone(tmp_path):
    scenario = tmp_path / "two.toml"
    scenario.write_text(
        "duration_s = 11.0\n"
        "[[fault]]\nkind = 'actuator-dead'\nleft = 0.9\nat_s = 10.0\nfor_s = 0.5\n"
        "[[fault]]\nkind = 'sensor-biased'\nbias_mps2 = 0.3\nat_s = 1.0\n"
        "[[disturbance]]\nkind = 'gust'\nforce_n = 400.0\nat_s = 1.0\n"
        "[[disturbance]]\nkind = 'bank'\nbank_percent = 4.0\nat_s = 2.0\n"
    )
    calm = {"fault": [{"kind": "none"}], "disturbance": [{"kind": "none"}]}
    lost = {"fault": [{"kind": "actuator-dead", "at_s": 10.0}]}
    bank = calm | {"disturbance": [{"kind": "bank", "at_s": 10.0, "bank_percent": 4.0}]}
    for name, own in (("torque lost", lost), ("bank", bank)):
        (group,) = (group for group, cases in CASES.items() if name in cases)
        (row,) = can_rig.compare(["pi"], scenario, cases={name: CASES[group][name]}).rows
        (alone,) = can_rig.compare(["pi"], scenario, cases={name: own}).rows
        assert row == alone
        assert row.error_peak_mps2 > 0.05


def test_the_error_of_a_loop_that_diverges_is_whole():
    done = succeeded("compare", "pi", "--scenario", "pendulum", "--case", "healthy:fault.kind=none",
                     "--set", "duration_s=6")  # fmt: skip
    cells = done.stdout.splitlines()[1].split()
    assert float(cells[2]) > 1e6
    assert len(cells[2]) < 10


def test_a_run_that_fails_is_null_in_json():
    done = asked(
        "compare", "no_such_module:C", "--set", "duration_s=0.2", "--case", "a:seed=1", "--json"
    )
    figures = json.loads(done.stdout, parse_constant=pytest.fail)
    assert figures["error_peak_mps2"] is None


def test_a_run_that_fails_is_a_line_and_the_others_go_on():
    done = asked(
        "compare", "pi", "no_such_module:C", "--set", "duration_s=0.2", "--case", "a:seed=1"
    )
    assert done.returncode == 1
    assert "failed" in done.stdout
    assert "no_such_module:C: controller.kind = 'no_such_module:C': no module" in " ".join(
        done.stdout.split()
    )


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--cases", "holidays"], "--cases holidays: must be faults, weather, cars"),
        (["--case", "x"], "--case x: must be NAME:KEY=VALUE,KEY=VALUE"),
        (["--case", "x:seed=1", "--case", "x:seed=2"], "x:seed=2: must have another name than"),
        (["--case", "x:seed=1", "--cases", "cars"], "--cases cars: must not stand beside --case"),
        (["empty.toml"], "empty.toml: must have a table [controller]; no other counts"),
        (["--case", "x:nonsense=1"], "nonsense: unknown key"),
        (["--case", "x:fault.kind*=2"], "must be a factor of a number; fault.kind is 'actuator-"),
        (["--case", "x:plant.mass_kg*=x"], "must be a factor of a number; plant.mass_kg is 1400"),
    ],
)
def test_a_bad_case_is_one_line(words, line, tmp_path):
    (tmp_path / "empty.toml").write_text("duration_s = 3.0\n")
    assert line in refused("compare", "pi", "--set", "duration_s=0.1", *words)


def test_python_names_its_own_argument():
    with pytest.raises(ScenarioError, match=r"cases = 'holidays': must be faults, weather, cars"):
        can_rig.compare(["pi"], cases="holidays")


def test_a_fault_after_the_end_of_the_run_is_said_and_small_commands_have_digits(tmp_path):
    (tmp_path / "small.py").write_text("def small(inputs):\n    return 0.25, -0.5\n")
    late = "late:fault.kind=actuator-dead,fault.at_s=10"
    done = asked(
        "compare", f"{tmp_path}/small:small", "--set", "duration_s=0.2", "--case", late,
        "--case", "none:fault.kind=none",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    said = "note: late: the fault (actuator-dead at 10 s) never occurs: the run ends at 0.2 s"
    assert done.stderr.splitlines() == [said]
    tiny = asked(
        "compare", f"{tmp_path}/small:small", "--set", "duration_s=0.2", "--case",
        "none:fault.kind=none,reference.amplitude_mps2=0",
        "--set", "limits.torque_nm=0.001", "--set", "limits.force_difference_n=0.001",
    )  # fmt: skip
    row = tiny.stdout.splitlines()[1].split()
    assert 0.0 < float(row[2]) < 1e-4
    assert [line.split()[-2:] for line in done.stdout.splitlines()[1:3]] == [["0.25", "0.5"]] * 2
