"""The rig from Python: runs, tables with units, pictures, and one line for what is wrong."""

import gc
import json
import pickle
import subprocess
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, assert_type

import nbclient
import nbformat
import numpy as np
import pandas as pd
import pytest

import can_rig
from can_rig import api, errors
from can_rig.assessment.stability import StabilityCheck
from can_rig.campaigns import rows
from can_rig.campaigns.statistics import Summary
from can_rig.decoding.decode import decode_log
from can_rig.replaying.replay import Comparison
from can_rig.results.run_folder import LOG, REPORT, SIGNALS, SUMMARY
from can_rig.views import recorded_run
from can_rig.views.diff import Difference
from can_rig.views.log_statistics import LogStatistics
from can_rig.views.recorded_run import RecordedRun
from tests.helpers import DBC, asked, record

SHORT = {"fault.at_s": 0.2, "duration_s": 0.4, "fault": {"kind": "actuator-dead"}}
WORDS = ("fault.at_s=0.2", "duration_s=0.4", "fault.kind=actuator-dead")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def run() -> RecordedRun:
    return can_rig.run("default", SHORT)


def test_the_log_is_that_of_both_nodes_byte_for_byte(run: RecordedRun, tmp_path: Path) -> None:
    log, _, scenario = record(tmp_path, *WORDS, name="default")
    assert (run.folder / LOG).read_bytes() == log.read_bytes()
    assert run.scenario == scenario
    assert repr(run) == "<run of default: 400 ticks, complete>"


def test_signals_are_the_table_of_the_folder_with_units(run: RecordedRun) -> None:
    written = pd.read_csv(run.folder / SIGNALS, index_col="time_s")
    pd.testing.assert_frame_equal(run.signals, written, check_dtype=False)
    units = run.signals.attrs["units"]
    assert (units["torque_nm"], units["dstar_mps2"], units["mode"]) == ("N m", "m/s²", "")
    assert run.signals.attrs["names"]["dstar_mps2"] == "D*"


def test_nothing_is_left_on_disk_until_it_is_saved(tmp_path: Path) -> None:
    made = can_rig.run("thesis-step", {"duration_s": 0.05})
    temporary = made.folder
    folder = made.save(tmp_path / "some" / "run")
    written = {file.name for file in folder.iterdir()}
    assert written == {LOG, "bus.plant.csv", SIGNALS, SUMMARY, REPORT}
    assert not (temporary / REPORT).exists()
    loaded = can_rig.load(folder)
    assert loaded.scenario == made.scenario
    assert loaded.metrics == made.metrics
    pd.testing.assert_frame_equal(loaded.signals, made.signals)
    with pytest.raises(errors.RunFolderError, match="there already"):
        made.save(folder)
    assert made.save(folder, force=True) == folder


def test_a_temporary_folder_goes_with_its_run() -> None:
    made = can_rig.run("thesis-step", {"duration_s": 0.01})
    folder = made.folder
    assert folder.is_dir()
    del made
    gc.collect()
    assert not folder.parent.exists()


def test_a_run_that_fails_says_why_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    monkeypatch.setattr(recorded_run, "mkdtemp", lambda prefix: made.append(mkdtemp()) or made[0])
    failing = {"plant.kind": "tests.rig.plant.failing:Failing", "plant.parameters.calls": 20}
    settings = {**failing, "duration_s": 0.05}
    with pytest.raises(errors.RigError, match="stuck"):
        can_rig.run("thesis-step", settings, allow_unstable=True)
    assert not Path(made[0]).exists()


def test_a_run_of_the_command_line_is_one_too(tmp_path: Path) -> None:
    settings = [word for setting in WORDS for word in ("--set", setting)]
    done = asked("run", "default", "--in-process", *settings, "--out", tmp_path / "r", "--json")
    said: dict[str, Any] = json.loads(done.stdout)
    loaded = can_rig.load(said["folder"])
    assert loaded.metrics == said["metrics"]
    assert (said["ticks"], said["outcome"]) == (400, "complete")


def test_the_picture_is_the_page_of_the_report(run: RecordedRun) -> None:
    figure = run.plot()
    assert figure.axes[0].get_ylabel().startswith("D*")
    markup = run._repr_html_()
    assert "data:image/png;base64," in markup
    assert "steering torque" in markup


def test_changes_are_keys_with_dots_or_tables_within_tables() -> None:
    car = can_rig.load_scenario("default", {"plant.speed_mps": np.float64(12.0), "seed": 7})
    assert (car.plant.speed_mps, car.seed) == (12.0, 7)
    again = can_rig.load_scenario(car, {"plant": {"mass_kg": 1500.0}})
    assert (again.plant.speed_mps, again.plant.mass_kg) == (12.0, 1500.0)
    assert again.model.mass_kg == 1500.0  # the controller believes what it believed: the plant's
    assert can_rig.load_scenario(car) is car
    assert (
        can_rig.load_scenario("default", {"design.compensation": "off"}).design.compensation
        == "off"
    )


def test_a_scenario_may_be_a_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    file.write_text("[plant]\nspeed_mps = 9.0\n")
    assert can_rig.load_scenario(file).plant.speed_mps == 9.0


def test_check_answers_as_the_command() -> None:
    check = can_rig.check("thesis-step")
    assert check.as_dict() == json.loads(asked("check", "thesis-step", "--json").stdout)
    assert repr(check) == f"<check of thesis-step: {check.verdict}>"


def test_tune_asks_the_search_of_the_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """The search itself takes a minute, and has tests of its own."""
    asked_for: list[Any] = []
    monkeypatch.setattr(api, "search", lambda *what: asked_for.append(what) or "found")
    speeds = {"plant.speed_mps": (9.0, 11.0)}
    found = can_rig.tune("default", {"tick_s": 0.002}, box=0.0, ranges=speeds, noise_limit_n=5.0)
    assert found == "found"
    scenario, cars, *limits = asked_for[0]
    assert scenario == can_rig.load_scenario("default", {"tick_s": 0.002})
    nominal = scenario.plant
    assert {
        (car.settings.speed_mps, round(car.settings.torque_actuator.lag_s, 6)) for car in cars
    } == {
        (nominal.speed_mps, 0.005),
        *product((9.0, 11.0), (0.0035, 0.0065)),  # budget.actuator_box of default
    }
    assert limits == [1, 5.0, None]


def test_decode_is_a_table_for_each_message(run: RecordedRun) -> None:
    tables = can_rig.decode(run.folder / LOG, DBC / "steer_by_wire.dbc")
    columns = decode_log(run.folder / LOG, DBC / "steer_by_wire.dbc")
    assert set(tables) == set(columns)
    feedback = tables["DSTAR_FEEDBACK"]
    np.testing.assert_array_equal(feedback["DStar"], columns["DSTAR_FEEDBACK"].signals["DStar"])
    assert feedback.attrs["units"]["DStar"] == "m/s^2"
    chosen = can_rig.decode(
        run.folder / LOG, DBC / "steer_by_wire.dbc", messages=["DSTAR_FEEDBACK"], signals=["DStar"]
    )
    assert {name: list(table) for name, table in chosen.items()} == {"DSTAR_FEEDBACK": ["DStar"]}
    part = can_rig.decode(run.folder / LOG, DBC / "steer_by_wire.dbc", from_s=0.01, to_s=0.02)
    assert {len(table) for table in part.values()} == {10}


def test_a_pickled_run_needs_no_folder() -> None:
    made = can_rig.run("thesis-step", {"duration_s": 0.05})
    kept, signals, metrics = pickle.dumps(made), made.signals.copy(), made.metrics
    del made
    gc.collect()
    again: RecordedRun = pickle.loads(kept)
    assert again.metrics == metrics
    pd.testing.assert_frame_equal(again.signals, signals)
    folder = again.folder
    del again
    gc.collect()
    assert not folder.parent.exists()


def test_a_metric_is_a_number(run: RecordedRun) -> None:
    assert assert_type(run.metric("torque_peak_nm"), float) == run.metrics["torque_peak_nm"]
    assert run.metrics["error_integral_after_fault_mps"] is not None
    healthy = can_rig.run("thesis-step", {"duration_s": 0.02, "fault.kind": "none"})
    assert np.isnan(healthy.metric("detection_delay_s"))


def test_two_runs_differ_as_the_command_says(run: RecordedRun, tmp_path: Path) -> None:
    other = can_rig.run(run.scenario, {"design.compensation": "off"})
    a, b = run.save(tmp_path / "a"), other.save(tmp_path / "b")
    found = assert_type(can_rig.diff(run, b), Difference)
    said = json.loads(asked("diff", a, b, "--json").stdout)
    assert not found.same
    assert json.loads(json.dumps(found.as_dict())) == {key: said[key] for key in found.as_dict()}
    assert can_rig.diff(run, run).same
    peak = float(np.abs(run.table.columns["torque_nm"] - other.table.columns["torque_nm"]).max())
    wide = can_rig.diff(run, other, tolerances={"torque_nm": peak})
    assert [each.beyond for each in wide.signals if each.signal == "torque_nm"] == [0]


def test_runs_are_drawn_over_one_another(run: RecordedRun) -> None:
    other = can_rig.run(run.scenario, {"design.compensation": "off"})
    figure = can_rig.plot({"with": run, "without": other}, ["dstar_mps2", "torque_nm"])
    dstar, torque = figure.axes
    assert [line.get_label() for line in dstar.get_lines()] == ["with", "without"]
    assert "N m" in torque.get_ylabel()
    drawn = torque.get_lines()[1].get_ydata()
    values = other.table.columns["torque_nm"]
    assert (np.nanmin(drawn), np.nanmax(drawn)) == (np.nanmin(values), np.nanmax(values))


def test_stats_count_the_lines_of_the_log(run: RecordedRun) -> None:
    found = assert_type(can_rig.stats(run.folder), LogStatistics)
    lines = (run.folder / LOG).read_text().splitlines()
    times = [float(line.split()[0].strip("()")) for line in lines]
    assert (found.frames, found.span_s) == (len(lines), pytest.approx(times[-1] - times[0]))
    identifiers = {line.split()[2].split("#")[0] for line in lines}
    assert {each.as_dict()["identifier"] for each in found.identifiers.values()} == identifiers


def test_a_campaign_is_a_table_of_runs(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(
        'sampling = "grid"\n[axes]\n"fault.left" = { values = [0.0, 0.5] }\n'
        '[requirements]\nsmall = "torque_peak_nm < 1"\n'
    )
    found = can_rig.campaign(tmp_path / "two.toml", SHORT, folder=tmp_path / "kept", workers=1)
    assert assert_type(found.summary, Summary).rates[0].failed == 2
    row = found.runs.set_index("fault.left").loc[0.5]
    alone = can_rig.run("default", {**SHORT, "fault.left": 0.5, "seed": row["seed"]})
    assert row["torque_peak_nm"] == alone.metric("torque_peak_nm")
    assert (tmp_path / "kept" / "report.html").is_file()
    with pytest.raises(errors.RunFolderError, match="there already"):
        can_rig.campaign(tmp_path / "two.toml", SHORT, folder=tmp_path / "kept")
    assert len(can_rig.campaign(tmp_path / "two.toml", SHORT, workers=2).runs) == 2


def test_a_campaign_that_is_interrupted_keeps_its_runs_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = iter(range(7))
    computed = rows.run_row

    def interrupted(*of: Any) -> Any:
        if next(left, None) is None:
            raise KeyboardInterrupt
        return computed(*of)

    monkeypatch.setattr(rows, "run_row", interrupted)
    some: Any = {"changes": SHORT, "runs": np.int64(16), "folder": tmp_path / "kept"}
    with pytest.raises(KeyboardInterrupt):
        can_rig.campaign("losses", **some)
    before = {file: file.read_bytes() for file in (tmp_path / "kept").rglob("*.parquet")}
    assert len(before) == 7
    monkeypatch.setattr(rows, "run_row", computed)
    found = can_rig.campaign("losses", **some, resume=True)
    whole = can_rig.campaign("losses", SHORT, runs=16)
    pd.testing.assert_frame_equal(found.runs, whole.runs)


def test_lost_workers_remind_of_what_a_script_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the line each worker runs the script again, and dies in its second campaign."""

    def lost(*_: Any) -> None:
        raise errors.WorkersLostError("the worker died 5 times; is there enough memory?")

    monkeypatch.setattr(api, "execute", lost)
    with pytest.raises(errors.WorkersLostError, match=r'memory.* script needs if __name__ == "__m'):
        can_rig.campaign("losses", runs=2, workers=2)


def test_numbers_of_numpy_and_lists_of_names_are_taken_as_such(run: RecordedRun) -> None:
    log, dbc = run.folder / LOG, STEERING
    some: Any = {"from_s": np.float32(0.2), "messages": (name for name in ["DSTAR_FEEDBACK"])}
    found = can_rig.decode(log, dbc, **some)
    assert {name: len(table) for name, table in found.items()} == {"DSTAR_FEEDBACK": 200}
    assert can_rig.diff(run, run, tolerances={"torque_nm": np.array(1)}).same  # type: ignore[dict-item]


def test_a_picture_of_controllers_replaces_no_file(tmp_path: Path) -> None:
    found = can_rig.compare(["pi"], changes=SHORT, cases={"lost": {}})
    found.draw(str(tmp_path / "a.png"))
    for path, line in (("a.png", "a.png: .*force=True to replace it"), ("a.nope", "FILE.png")):
        with pytest.raises(errors.LogError, match=line):
            found.draw(tmp_path / path)
    found.draw(tmp_path / "a.png", force=True)


def test_a_run_is_verified_by_the_controller_of_today(run: RecordedRun, tmp_path: Path) -> None:
    same = assert_type(can_rig.verify(run), Comparison)
    assert (same.identical, same.compared) == (True, 400)
    other = can_rig.verify(run.save(tmp_path / "run"), changes={"design.tau_s": 0.004})
    said = json.loads(
        asked("replay", tmp_path / "run", "--set", "design.tau_s=0.004", "--json").stdout
    )
    assert other.first_different_tick == said["first_different_tick"] is not None
    log = run.folder / LOG
    assert can_rig.verify(log, "default", SHORT).identical
    with pytest.raises(errors.ScenarioError, match="which scenario it is of; name it with name"):
        can_rig.verify(log)


def test_a_check_has_one_type() -> None:
    still = assert_type(can_rig.check("thesis-step"), StabilityCheck)
    drive = can_rig.check("thesis-step", {"drive.ramps": [[0.0, 9.0], [1.0, 11.0]]})
    fastest = can_rig.check("thesis-step", {"plant.speed_mps": 11.0})
    assert drive.healthy == fastest.healthy != still.healthy


STEERING = DBC / "steer_by_wire.dbc"
DRIVE = Path(__file__).parents[1] / "drives" / "ideal.log.gz"
SPEED = {"plant.speed_mps": 8.0}
ANY: Any = can_rig
"""Called with arguments of wrong types too."""
REFUSED: list[tuple[Callable[[], Any], type[errors.RigError], str]] = [
    (lambda: ANY.run("defualt"), errors.ScenarioError, "did you mean default"),
    (lambda: ANY.run("default", {"fault.att_s": 1.0}), errors.ScenarioError,
     "fault.att_s: unknown key; did you mean at_s"),
    (lambda: ANY.load_scenario("default", {"tick_s": -1}), errors.ScenarioError,
     "tick_s = -1: must be at least"),
    (lambda: ANY.load_scenario("default", {"fault.at_s": None}), errors.ScenarioError,
     "fault.at_s = None: must be a number"),
    (lambda: ANY.load_scenario("default", {"budget.box": [1.0, object()]}), errors.ScenarioError,
     "budget.box = <object.*must be a number"),
    (lambda: ANY.run("thesis-step", {"latency_ticks": 40}), errors.ScenarioError,
     "not calm.*, allow_unstable=True runs it as it is"),
    (lambda: ANY.load("."), errors.LogError, "not a finished run folder"),
    (lambda: ANY.decode("none.log", STEERING), errors.LogError, "none.log"),
    (lambda: ANY.decode("none.log", "none.dbc"), errors.DbcError, "none.dbc"),
    (lambda: ANY.check("default", "plant.speed_mps=20"), errors.ScenarioError,
     "changes = 'plant.speed_mps=20': must be a mapping of keys"),
    (lambda: ANY.run(SPEED), errors.ScenarioError, "must be a name, a path or a Scenario"),
    (lambda: ANY.tune("default", box="20 %"), errors.ScenarioError,
     "box = '20 %': must be a share"),
    (lambda: ANY.tune("default", spare_ticks="a"), errors.ScenarioError,
     "spare_ticks = 'a': must be a whole number of ticks"),
    (lambda: ANY.decode("a.log", ["a.dbc", "b.dbc"]), errors.RigError,
     r"dbc = \['a.dbc', 'b.dbc'\]: must be the path of one file"),
    (lambda: ANY.tune("default", ranges=SPEED), errors.ScenarioError,
     "ranges: plant.speed_mps = 8.0: must be a pair"),
    (lambda: ANY.tune("default", box=-1.0), errors.ScenarioError, "box"),
    (lambda: ANY.diff("none", "none"), errors.LogError, "none: there is no such file"),
    (lambda: ANY.stats("none.log"), errors.LogError, "none.log"),
    (lambda: ANY.stats("none.log", bitrate=0), errors.RigError, "bit rate"),
    (lambda: ANY.plot({}, ["dstar_mps2"]), errors.LogError, "one at least, and a list"),
    (lambda: ANY.plot([3], ["dstar_mps2"]), errors.LogError, "must have runs by their names"),
    (lambda: ANY.compare("pi"), errors.ScenarioError, "controllers = 'pi': must be a list"),
    (lambda: ANY.campaign("loses"), errors.ScenarioError, "did you mean losses"),
    (lambda: ANY.save_scenario("default", "x.toml"), errors.ScenarioError, "must be a Scenario"),
    (lambda: ANY.compare(["pi"], cases={}), errors.ScenarioError, "a controller and a case"),
    (lambda: ANY.stats(DRIVE).load("x"), errors.LogError, "bus = 'x': must be one of "),
    (lambda: ANY.compare(["pi"], cases=["a"]), errors.ScenarioError, "or changes by name"),
    (lambda: ANY.compare(["pi"], cases={"a": "b"}), errors.ScenarioError, "or changes by name"),
    (lambda: ANY.diff(".", ".", tolerances={"a": "b"}), errors.RigError, "a = 'b': must be a num"),
    (lambda: ANY.diff(".", ".", tolerances=["a"]), errors.RigError, "must be numbers by signal"),
    (lambda: ANY.campaign("losses", workers=0), errors.ScenarioError, "workers = 0: must be at"),
    (lambda: ANY.campaign("losses", workers="2"), errors.ScenarioError, "must be a whole number"),
    (lambda: ANY.campaign("losses", resume=True), errors.ScenarioError, "must come with folder"),
    (lambda: ANY.tune("default", noise_limit_n="a"), errors.ScenarioError, "must be a number"),
    (lambda: ANY.tune("default", ranges=["a"]), errors.ScenarioError, "must be pairs by key"),
    (lambda: ANY.stats(DRIVE, bitrate="x"), errors.RigError, "bitrate = 'x': must be a number"),
    (lambda: ANY.decode(DRIVE, STEERING, from_s="a"), errors.RigError, "from_s = 'a': must be"),
    (lambda: ANY.decode(DRIVE, STEERING, from_s=2, to_s=1), errors.LogError, "from_s 2 to_s 1:"),
    (lambda: ANY.decode(DRIVE, STEERING, signals="a"), errors.LogError, "must be a list of names"),
    (lambda: ANY.compare([3]), errors.ScenarioError, "controllers = 3: must be a text, a class"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "error", "message"), REFUSED)
def test_what_is_wrong_is_one_line(
    call: Callable[[], Any], error: type[errors.RigError], message: str
) -> None:
    with pytest.raises(error, match=message) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert "--" not in str(caught.value)  # as an option has it


def test_a_run_folder_without_its_scenario_is_refused(run: RecordedRun, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "run")
    (folder / SUMMARY).write_text("{}")
    with pytest.raises(errors.ScenarioError, match="no scenario that can be read"):
        can_rig.load(folder)


def test_the_package_alone_is_light_and_scenario_is_a_package_alone() -> None:
    code = (
        "import sys, can_rig; light = 'numpy' not in sys.modules; "
        "print(light, can_rig.load_scenario('default').name, type(can_rig.scenario).__name__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout == "True default module\n"
    with pytest.raises(AttributeError, match="no attribute 'runs'"):
        can_rig.runs


def test_public_names_are_offered_for_completion() -> None:
    assert {*can_rig.__all__, "__doc__"} <= {*dir(can_rig)}


def test_the_notebook_runs() -> None:
    notebook = nbformat.read(ROOT / "docs" / "rig.ipynb", as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells)  # they would grow old unseen
    nbclient.NotebookClient(notebook, timeout=200, kernel_name="python3").execute()
    first = next(cell for cell in notebook.cells if cell.cell_type == "code")
    assert "data:image/png" in first.outputs[-1]["data"]["text/html"]
