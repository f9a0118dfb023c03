"""The controller node with the law in C: the same bytes on the bus as with the law in Python."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.export.controllers import PYTHON, Controller, controller_of
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.scenario.loading import shipped


def log_of(name: str, settings: list[str], controller: Controller, folder: Path) -> bytes:
    folder.mkdir()
    scenario = load(name, settings)
    bus = f"local:{os.getpid()}-{folder.name}"  # nobody else's, as two runs at a time are
    run_in_process(scenario, bus, folder / "bus.log", StopRequest(), lambda tick: None, controller)
    return (folder / "bus.log").read_bytes()


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("name", sorted(shipped()))
def test_the_log_is_the_same(name: str, precision: str, tmp_path: Path) -> None:
    tick_s = load(name, []).tick_s
    settings = [f'design.precision="{precision}"', f"duration_s={800 * tick_s}"]
    if load(name, []).loss.kind != "none":
        settings.append(f"fault.at_s={320 * tick_s}")
    law = controller_of("c", load(name, settings))
    python = log_of(name, settings, PYTHON, tmp_path / "python")
    c = log_of(name, settings, law, tmp_path / "c")
    pairs = zip(python.splitlines(), c.splitlines(), strict=True)
    assert next((pair for pair in pairs if pair[0] != pair[1]), None) is None
    assert len(python) > 100_000


def test_the_log_of_a_safe_stop_is_the_same(tmp_path: Path) -> None:
    settings = [
        "reference.kind=lane-change", "reference.frequency_rad_per_s=1.34", "duration_s=5",
        "fault.0.kind=actuator-dead", "fault.0.at_s=3.5", "fault.1.kind=actuator-dead",
        "fault.1.channel=force-difference", "fault.1.at_s=4.4", "design.safe_stop_s=0.2",
    ]  # fmt: skip
    law = controller_of("c", load("default", settings))
    python = log_of("default", settings, PYTHON, tmp_path / "python")
    assert log_of("default", settings, law, tmp_path / "c") == python
    assert log_of("default", settings[:-1], PYTHON, tmp_path / "without") != python


def test_the_precision_is_the_scenario_s(tmp_path: Path) -> None:
    single, double = (
        log_of("default", [f'design.precision="{precision}"', "duration_s=1"], PYTHON,
               tmp_path / precision)
        for precision in ("float32", "float64")
    )  # fmt: skip
    assert single != double


def test_two_processes_run_the_c(tmp_path: Path) -> None:
    logs = []
    for controller in ("python", "c"):
        folder = tmp_path / controller
        command = ["run", "default", "--set", "duration_s=1", "--controller", controller]
        done = CliRunner().invoke(main, [*command, "--out", str(folder)])
        assert done.exit_code == 0, done.output
        logs.append((folder / "bus.log").read_bytes())
    assert logs[0] == logs[1]


def test_no_compiler_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler --flag")
    command = ["run", "default", "--controller", "c", "--out", str(tmp_path / "run")]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert "no-such-compiler: there is no such C compiler" in line
    assert not (tmp_path / "run").exists()


PARTS_OF_FAST_MATH = [
    "-ffast-math", "-ffinite-math-only", "-funsafe-math-optimizations", "-freciprocal-math",
    "-fno-signed-zeros",
]  # fmt: skip
REFUSED = {
    **{f"gcc {flag}": "IEEE 754 arithmetic: compile without" for flag in PARTS_OF_FAST_MATH},
    "true": "true: must be a C compiler: it has compiled nothing",
    'cc "': "CC = 'cc \"': must be a command: No closing quotation",
}


@pytest.mark.parametrize(("compiler", "said"), REFUSED.items(), ids=REFUSED)
def test_a_compiler_that_refuses_is_one_line(
    compiler: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    command = ["run", "default", "--controller", "c", "--out", str(tmp_path / "run")]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert said in line
