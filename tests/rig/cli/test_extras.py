"""Without the packages of an extra: one line that names it, before any work is done."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

WITHOUT = """
import importlib.metadata, json, sys
missing = json.loads(sys.argv[1])
sys.modules.update(dict.fromkeys(missing))
version = importlib.metadata.version
def version_of_what_is_there(name):
    if name in missing:
        raise importlib.metadata.PackageNotFoundError(name)
    return version(name)
importlib.metadata.version = version_of_what_is_there
sys.argv = ["can-rig", *json.loads(sys.argv[2])]
from can_rig.__main__ import main
main()
"""
LOGS = ["asammdf", "pandas", "pyarrow"]
FMU = [
    *("--set", "plant.kind=fmu:a.fmu", "--set", "plant.variables.input_1=u"),
    *("--set", "plant.variables.input_2=v", "--set", "plant.variables.output=y"),
]
SHORT = ["thesis-step", "--in-process", "--set", "duration_s=0.01"]


def rig_without(packages: list[str], *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", WITHOUT, json.dumps(packages), json.dumps(words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.parametrize(
    ("packages", "words", "line"),
    [
        (LOGS, ["run", *SHORT, "--log", "x.mf4"], "asammdf is not installed"),
        (LOGS, ["decode", "a.log", "--out", "x.csv"], "pyarrow is not installed"),
        (LOGS, ["decode", "a.log", "--out", "x"], "pyarrow is not installed"),
        (LOGS, ["decode", "a.log", "--out", "x.mf4"], "asammdf is not installed"),
        (LOGS, ["convert", "a.log", "x.mf4"], "asammdf is not installed"),
        (["mcap"], ["decode", "a.log", "--out", "x.mcap"], "mcap is not installed"),
        (["control"], ["figures"], "control is not installed"),
        (["fmpy"], ["run", *SHORT, *FMU], "fmpy is not installed"),
    ],
)  # fmt: skip
def test_one_line_names_the_extra(
    packages: list[str], words: list[str], line: str, tmp_path: Path
) -> None:
    (tmp_path / "a.log").write_text("(0.000000) can0 101#0011223344556677\n")
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    ")
    extra = {"control": "figures", "mcap": "mcap", "fmpy": "fmu"}.get(packages[0], "logs")
    done = rig_without(packages, *words)
    assert done.returncode == 2
    install = f"{sys.executable} -m pip install 'fault-tolerant-steering[{extra}]'"
    assert done.stderr == f"error: {line}: {install}\n"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.log", "a.mf4"]


def test_a_run_and_a_decode_without_outputs_need_no_extra(tmp_path: Path) -> None:
    none = [*LOGS, "control"]
    done = rig_without(none, "run", *SHORT, "--out", str(tmp_path / "r"), "--log", "x.blf")
    assert done.returncode == 0, done.stderr
    assert rig_without(none, "decode", str(tmp_path / "r")).returncode == 0
    versions = json.loads((tmp_path / "r" / "run.json").read_text("utf-8"))["versions"]
    assert {"numpy", "python-can", "fault-tolerant-steering"} <= set(versions)
    assert "control" not in versions
