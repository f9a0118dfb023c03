"""A run folder is whole or not there, the one that it replaces stands until then, and no way of
failing loses what was recorded."""

import errno
import json
import os
import shutil
from collections import Counter
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from can_rig.cli.run import closing_table
from can_rig.errors import INTERRUPTED, LogError, RigError, RunFolderError, SilentNodeError
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.ticks import NodeSummary
from can_rig.nodes.without_bus import run_without_bus
from can_rig.results import execution
from can_rig.results.execution import Options, execute
from can_rig.results.run_folder import (
    LOG,
    REPORT,
    SIGNALS,
    SUMMARY,
    Outcome,
    finish,
    recorded_scenario,
)
from can_rig.results.signals import Signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import asked, record, refused, succeeded
from tests.rig.plant.failing import FAILING

FILES = {"bus.log", "bus.plant.csv", "report.html", "report.png", "run.json", "signals.csv"}
SHORT = ["duration_s=0.02"]
SCENARIO = load("thesis-step", SHORT)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "demo"
    assert execute(SCENARIO, folder, StopRequest()) is not None
    return folder


@pytest.fixture
def there(made, tmp_path):
    """A run folder that is to be replaced."""
    return shutil.copytree(made, tmp_path / "demo")


def full(*_: Any, **__: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def summary_of(folder: Path) -> dict[str, Any]:
    summary: dict[str, Any] = json.loads((folder / "run.json").read_text())
    return summary


def recorded(folder: Path, lines: int, summary: NodeSummary | RigError) -> execution.Runner:
    """A runner that records the first lines of a real log and then ends so."""
    folder.mkdir()
    source = record(folder, *SHORT, bus="virtual:source")[0].read_text().splitlines(keepends=True)

    def run(_scenario: object, log: Path, *_: object) -> NodeSummary:
        if lines:
            log.write_text("".join(source[:lines]))
        if isinstance(summary, RigError):
            raise summary
        return summary

    return run


def test_the_old_run_stands_until_the_new_one_is_whole(there, tmp_path):
    before = contents(there)
    seen: list[dict[str, bytes]] = []

    def on_tick(_tick: int) -> None:
        seen.append(contents(there))

    stop = StopRequest()
    done = execute(
        SCENARIO, there, stop, Options(force=True, progress=lambda: nullcontext(on_tick))
    )
    assert done is not None
    assert (done.folder, done.exit_status) == (there, 0)
    assert seen[-1] == before
    assert set(contents(there)) == FILES
    assert summary_of(there)["outcome"] == "complete"
    assert [path.name for path in tmp_path.iterdir()] == ["demo"]


def test_where_the_closing_files_cannot_be_written_both_runs_are_kept(there, tmp_path, monkeypatch):
    before = contents(there)
    with monkeypatch.context() as patch:
        patch.setattr(Figure, "savefig", full)
        with pytest.raises(RunFolderError, match="No space left on device") as caught:
            execute(SCENARIO, there, StopRequest(), Options(force=True))
    unfinished = tmp_path / "demo.unfinished"
    assert f"what was recorded is in {unfinished / 'bus.log'}" in str(caught.value)
    assert contents(there) == before
    assert (unfinished / "bus.log").read_bytes() == before["bus.log"]  # of the same scenario
    assert {path.name for path in tmp_path.iterdir()} == {"demo", "demo.unfinished"}
    with pytest.raises(RunFolderError, match=r"demo\.unfinished: holds what an earlier command"):
        execute(SCENARIO, there, StopRequest(), Options(force=True))
    shutil.rmtree(unfinished)
    assert execute(SCENARIO, there, StopRequest(), Options(force=True)) is not None


def test_a_disk_that_fills_during_the_run_is_one_line_that_says_where_the_frames_are(
    tmp_path, monkeypatch
):
    out, log = tmp_path / "out", tmp_path / "out" / "bus.log"
    runner = recorded(tmp_path / "source", 32, LogError(f"{log}: cannot be written: full"))
    monkeypatch.setattr(Signals, "write_csv", full)
    with pytest.raises(LogError) as caught:
        execute(SCENARIO, out, StopRequest(), Options(runner=runner))
    assert str(caught.value) == f"{log}: cannot be written: full; what was recorded is in {log}"
    assert {path.name for path in out.iterdir()} == {"bus.log", "run.json"}


@pytest.mark.parametrize("force", [False, True])
def test_a_run_that_fails_keeps_what_it_recorded(force, there, tmp_path):
    out = there if force else tmp_path / "other"
    runner = recorded(tmp_path / "source", 32, SilentNodeError("the plant node was ended"))
    done = execute(SCENARIO, out, StopRequest(), Options(force=force, runner=runner))
    assert done is not None
    assert done.exit_status == SilentNodeError.exit_status
    assert str(done.failure) == "the plant node was ended"
    assert set(contents(out)) == FILES - {"bus.plant.csv"}  # of which there was no plant
    assert summary_of(out)["outcome"] == "the plant node was ended"
    assert len((out / "bus.log").read_text().splitlines()) == 32
    assert {path.name for path in tmp_path.iterdir()} == {"demo", "source", out.name}


@pytest.mark.parametrize("ending", [RigError("refused"), NodeSummary(0, 0.0, {}, {})], ids=str)
def test_a_run_that_records_nothing_replaces_nothing(ending, there, tmp_path):
    before = contents(there)
    runner = recorded(tmp_path / "source", 0, ending)
    for out, force in ((there, True), (tmp_path / "new", False)):
        if isinstance(ending, RigError):
            with pytest.raises(RigError, match="refused"):
                execute(SCENARIO, out, StopRequest(), Options(force=force, runner=runner))
        else:
            assert (
                execute(SCENARIO, out, StopRequest(), Options(force=force, runner=runner)) is None
            )
    assert contents(there) == before
    assert {path.name for path in tmp_path.iterdir()} == {"demo", "source"}


def test_what_the_nodes_say_is_in_the_summary(tmp_path):
    events, rejected = {"plant": {"no buffer space": 3}}, {"DSTAR_FEEDBACK": {"wrong_crc": 1}}
    said = NodeSummary(20, 0.5, rejected, events)
    done = execute(
        SCENARIO,
        tmp_path / "r",
        StopRequest(),
        Options(runner=recorded(tmp_path / "source", 100, said)),
    )
    assert done is not None
    assert done.exit_status == 0
    summary = summary_of(tmp_path / "r")
    assert (summary["bus_events"], summary["rejected_frames"]) == (events, rejected)
    assert (summary["ticks"], summary["wall_s"], summary["ticks_per_s"]) == (20, 0.5, 40.0)


def test_a_stopped_run_says_so(tmp_path):
    stop = StopRequest()
    runner = recorded(tmp_path / "source", 25, NodeSummary(5, 0.1, {}, {}))
    done = execute(SCENARIO, tmp_path / "r", stop, Options(runner=runner))
    assert done is not None
    assert (done.exit_status, summary_of(tmp_path / "r")["outcome"]) == (INTERRUPTED, "interrupted")


# --- what if -------------------------------------------------------------------------------------


def what_if(log: Path, out: Path, *words: object) -> Any:
    return asked("replay", log, "--what-if", "--scenario", "thesis-step", "--out", out, *words)


def test_a_what_if_whose_plant_fails_leaves_a_complete_folder(there, tmp_path):
    log = tmp_path / "source.log"
    shutil.copy(there / "bus.log", log)
    failing = ["--set", FAILING, "--set", "plant.parameters.calls=12", "--allow-unstable"]
    done = what_if(log, there, "--force", *failing)
    assert done.returncode == 2
    assert "advance failed at 0.012 s" in done.stderr
    assert "Traceback" not in done.stderr
    assert set(contents(there)) == {*FILES, "reference.csv", "what-if.png"}
    assert "stuck" in summary_of(there)["outcome"]
    assert Counter(path.name.partition(".")[0] for path in tmp_path.iterdir())["demo"] == 1


def test_a_what_if_has_its_bus_events_and_a_reference_that_can_be_read_again(
    there, tmp_path, monkeypatch
):
    run = run_without_bus

    def eventful(*arguments: Any) -> NodeSummary:
        summary = run(*arguments)
        summary.bus_events = {"plant": {"no buffer space": 2}}
        return summary

    monkeypatch.setattr(execution, "run_without_bus", eventful)
    log = tmp_path / "source.log"
    shutil.copy(there / "bus.log", log)
    done = what_if(log, there, "--force")
    assert done.returncode == 0, done.stderr
    assert summary_of(there)["bus_events"] == {"plant": {"no buffer space": 2}}
    assert summary_of(there)["scenario"]["reference"]["file"] == "reference.csv"
    assert (there / "bus.log").read_bytes() == log.read_bytes()
    succeeded("replay", there, "--json")  # by the scenario of the folder
    moved = there.rename(tmp_path / "moved")
    (values, _) = recorded_scenario(moved)
    assert values["reference"]["file"] == str(moved / "reference.csv")


def test_the_same_what_if_twice_gives_the_same_bytes_but_for_the_times(there, tmp_path):
    answers = []
    for out in (tmp_path / "one", tmp_path / "another" / "folder"):
        succeeded("replay", there, "--what-if", "--set", "plant.mass_kg=1500", "--out", out)
        files = contents(out)
        summary = json.loads(files.pop("run.json"))
        for measured in ("wall_s", "ticks_per_s", "real_time_factor"):
            assert summary.pop(measured) > 0.0
        answers.append((files, json.dumps(summary)))
    assert answers[0] == answers[1]
    assert set(answers[0][0]) == {*FILES, "reference.csv", "what-if.png"} - {"run.json"}


@pytest.mark.parametrize(
    ("writer", "name", "there"),
    [((Path, "write_text"), SUMMARY, set()), ((Signals, "write_csv"), SIGNALS, {SUMMARY}),
     ((Figure, "savefig"), REPORT, {SUMMARY, SIGNALS})],
)  # fmt: skip
def test_a_full_disk_is_one_line_and_nothing_recorded_is_lost(
    writer, name, there, tmp_path, monkeypatch
):
    log, _, scenario = record(tmp_path, "duration_s=0.02", bus="virtual:full")
    folder = tmp_path / "r"
    folder.mkdir()
    shutil.copy(log, folder / LOG)
    monkeypatch.setattr(*writer, full)
    with pytest.raises(RunFolderError) as caught:
        finish(folder, scenario, network_of(scenario), Outcome("virtual:full"))
    assert str(caught.value) == (
        f"{folder / name}: cannot be written: No space left on device; "
        f"what was recorded is in {folder / LOG}"
    )
    assert {path.name for path in folder.iterdir()} == {LOG, *there}
    assert (folder / LOG).read_bytes() == log.read_bytes()


def test_a_bus_within_one_process_is_refused_for_two(tmp_path):
    line = refused("run", "thesis-step", "--bus", "virtual:x", "--out", tmp_path / "r")
    assert line.startswith("error: bus 'virtual:x': stays within one process")
    assert "--in-process" in line
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(("lines", "has_table"), [(0, False), (2, False), (5, True)])
def test_without_a_whole_tick_there_are_no_metrics(lines, has_table, tmp_path, capsys):
    """The offer of tick 0 that nobody answered is none."""
    log, _, scenario = record(tmp_path, "duration_s=0.02", bus="virtual:short")
    folder, outcome, network = tmp_path / "r", Outcome("virtual:short"), network_of(scenario)
    folder.mkdir()
    (folder / LOG).write_text("".join(log.read_text().splitlines(keepends=True)[:lines]))
    values = finish(folder, scenario, network, outcome)
    closing_table(scenario, values, outcome, folder)
    shown = capsys.readouterr().out
    assert ("false alarms" in shown) == has_table
    assert ("ticks/s" in shown) == has_table
    assert f"run folder  {folder}" in shown.replace("\n", "")
