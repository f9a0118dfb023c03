"""A run in one process has the log of the nodes on a bus, in single precision too."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from can_rig.cli.main import main


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_the_log_is_that_of_a_bus(precision: str, tmp_path: Path) -> None:
    settings = ["--set", "duration_s=1", "--set", f'design.precision="{precision}"']
    logs = []
    for name, options in (("alone", []), ("bus", ["--bus", f"local:{tmp_path.name}"])):
        folder = tmp_path / name
        command = ["run", "default", *settings, "--in-process", *options, "--out", str(folder)]
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 0, done.output
        logs.append((folder / "bus.log").read_bytes())
    assert logs[0] == logs[1]
