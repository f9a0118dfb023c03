"""The command line: help, exit statuses, and one line for whatever was wrong."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import asked, refused, rig, start, succeeded

RUN = ["run", "thesis-step", "--in-process", "--set", "duration_s=0.05"]


def test_help_and_version_of_the_whole():
    text = rig("-h").stdout
    for word in ("run", "plant", "controller", "scenarios", "Exit status", "130"):
        assert word in text
    from importlib.metadata import version

    assert rig("--version").stdout.strip().endswith(version("fault-tolerant-steering"))


WRONG = {
    "a typo in a table": (["--set", "fualt.at_s=1"], "did you mean fault?"),
    "no such scenario": (["thesis-stp"], "did you mean thesis-step?"),
    "no CSV": (["--set", "reference.kind=csv", "--set", "reference.file=no.csv"], "No such file"),
    "unknown bus": (["--bus", "socketcn:vcan0"], "did you mean socketcan"),
    "no bus name": (["--bus", ":"], "unknown bus interface"),
    "bus without a value": (["--bus", "local:x?fd"], "key=value"),
    "no such interface": (["--bus", "socketcan:nosuch0"], "nosuch0|no CAN support"),
    "a bus nowhere": (["--bus", "local:/no/such/folder"], "local"),
    "out below a file": (["--out", "file/run"], "file: is a file; must be a folder"),
    "out is a file": (["--out", "file"], "is a file; must be a folder"),
    "a forced file": (["--out", "file", "--force"], "is a file; must be a folder"),
    "out in /proc": (["--out", "/proc/run"], "cannot be made"),
}  # fmt: skip


@pytest.mark.parametrize(("arguments", "reason"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_is_one_line_with_exit_status_2(arguments, reason, tmp_path):
    (tmp_path / "file").write_text("")
    before = sorted(os.listdir(tmp_path))  # noqa: PTH208
    words = arguments if arguments[0].startswith("thesis") else ["thesis-step", *arguments]
    assert re.search(reason, refused("run", "--in-process", *words))
    left = sorted(set(os.listdir(tmp_path)) - {"runs"})  # noqa: PTH208
    assert left == before
    assert not list(tmp_path.glob("runs/*"))  # a refused run leaves no folder


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [(["--bus", "nosuch"], "unknown bus interface"), (["--set", "tick_s=-1"], "tick_s"),
     (["--silence", "0"], "above 0"), (["--silence", "nan"], "above 0"),
     (["--wait", "-1"], "above 0"), (["--wait", "soon"], "not a valid float")],
)  # fmt: skip
@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_node_refuses_as_clearly(node, arguments, reason):
    assert reason in refused(node, "thesis-step", *arguments)


def test_a_log_that_cannot_be_written_is_one_line(tmp_path):
    assert "bus.log" in refused(
        "plant", "--log", tmp_path / "no" / "bus.log", "--bus", f"local:{tmp_path / 'b'}"
    )


def test_a_mistake_in_two_processes_is_one_line_and_leaves_no_folder(tmp_path):
    done = asked("run", "thesis-step", "--bus", "local:/no/such/folder", "--out", tmp_path / "run")
    assert done.returncode == 2
    (line,) = [line for line in done.stderr.splitlines() if "error:" in line]
    assert line.startswith("error: cannot open bus 'local:/no/such/folder'")
    assert not (tmp_path / "run").exists()


ODD = {
    "a narrow terminal that can do nothing, the C locale": {
        "TERM": "dumb", "COLUMNS": "40", "LC_ALL": "C", "LANG": "C",
    },
    "no home": {"HOME": None},
    "no compiler": {"NUMBA_DISABLE_JIT": "1"},
}  # fmt: skip


@pytest.mark.parametrize("change", ODD.values(), ids=ODD.keys())
def test_it_runs_in_odd_surroundings(change, tmp_path):
    environment = {k: v for k, v in (os.environ | change).items() if v is not None}
    # --allow-unstable: without a compiler the drives of check would take a minute.
    done = rig(*RUN, "--allow-unstable", "--out", tmp_path / "run", env=environment)
    assert done.returncode == 0, done.stderr
    assert f"run folder  {tmp_path / 'run'}" in done.stdout  # never cut short


@pytest.mark.reports
def test_a_reader_that_goes_away_costs_nothing_but_the_table(tmp_path):
    read, write = os.pipe()
    os.close(read)
    process = start(*RUN, "--out", tmp_path / "run", stdout=write)
    os.close(write)
    _, errors = process.communicate(timeout=60)
    assert "Traceback" not in errors
    assert "Exception ignored" not in errors
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == [
        "bus.log", "bus.plant.csv", "report.html", "report.png", "run.json", "signals.csv",
    ]  # fmt: skip


@pytest.mark.reports
@pytest.mark.parametrize("said", ["by option", "by environment", None])
def test_reports_are_drawn_unless_they_are_not_wanted(said, tmp_path, monkeypatch):
    if said == "by environment":
        monkeypatch.setenv("CAN_RIG_NO_REPORT", "1")
    asked_for = ["--no-report"] if said == "by option" else []
    succeeded(*RUN, *asked_for, "--out", tmp_path / "run")
    drawn = {"report.html", "report.png"} & {path.name for path in (tmp_path / "run").iterdir()}
    assert drawn == (set() if said else {"report.html", "report.png"})


def test_a_path_too_long_for_a_socket_is_one_line(tmp_path):
    long = tmp_path / ("x" * 120)
    long.mkdir()
    environment = os.environ | {"TMPDIR": str(long), "XDG_RUNTIME_DIR": ""}
    done = rig("run", "--out", tmp_path / "run", env=environment)
    assert done.returncode == 2
    assert "too long" in done.stderr
    assert "Traceback" not in done.stderr


def test_ctrl_c_says_130_even_before_anything_runs():
    """A node that waits for its partner."""
    process = start("controller", "thesis-step", "--json", "--bus", f"local:ctrl-c-{os.getpid()}")
    assert process.stdout.readline() == '{"ready": true}\n'
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert "Traceback" not in errors


PRESS = """
import os, signal, sys
class Press:
    @staticmethod
    def find_spec(name, path, target=None):
        if name == os.environ["PRESS_AT"]:
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Press)
"""


def pressed_at(module: str, folder: Path, *arguments: str, **options: object) -> tuple[int, str]:
    """Exit status and standard error of ``can-rig``, with Ctrl-C when it imports ``module``."""
    (folder / "sitecustomize.py").write_text(PRESS)
    paths = [str(folder), str(Path(__file__).parents[3])]
    environment = os.environ | {"PRESS_AT": module, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run(
        [sys.executable, *arguments],
        env=environment, capture_output=True, text=True, timeout=300, check=False, **options,
    )  # fmt: skip
    return done.returncode, done.stderr


MODULES = ["click", "numpy", "can_rig.assessment.stability"]


@pytest.mark.parametrize("module", MODULES)
def test_while_it_imports(module, tmp_path):
    assert pressed_at(module, tmp_path, "-m", "can_rig", "check") == (130, "")


def test_where_it_is_ignored_it_stays_ignored(tmp_path):
    def ignore() -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)

    words = ("-m", "can_rig", "scenarios")
    assert pressed_at("click", tmp_path, *words, preexec_fn=ignore) == (0, "")


def test_a_command_that_has_started_tidies_up(tmp_path):
    """Once the command is there, Ctrl-C is an exception: what was half written goes away."""
    log, out = tmp_path / "a.log", tmp_path / "a.csv"
    log.write_text("(0.000000) can0 101#00\n")
    words = ("-m", "can_rig", "decode", str(log), "--out", str(out))
    assert pressed_at("can_rig.decoding.tables", tmp_path, *words)[0] == 130
    assert sorted(path.name for path in tmp_path.glob("*a.*")) == ["a.log"]
