"""What the tests of the export share."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

import pytest

from can_rig.assessment.resolve import load
from can_rig.controllers.our_law import PYTHON
from can_rig.controllers.protocol import Supplied
from can_rig.export.boards import COMPILER, EMULATOR
from can_rig.export.compiler import WARNINGS
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from firmware_model.law.structs import Precision

PRECISIONS: tuple[Precision, ...] = get_args(Precision)
EMULATED = pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
STRICT = ["-std=c99", "-Werror", *WARNINGS, "-Wstrict-prototypes", "-Wcast-qual", "-Wundef"]


def run(*command: str | Path, **options: object) -> str:
    """The standard output of a program that succeeds."""
    done = subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, **options
    )  # type: ignore[call-overload]
    assert done.returncode == 0, done.stderr
    return str(done.stdout)


def log_of(name: str, settings: Sequence[str], controller: Supplied = PYTHON) -> bytes:
    """The log of a run with both nodes in this process."""
    scenario, ended = load(name, settings), StopRequest()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "bus.log"
        run_in_process(scenario, "virtual:export", log, ended, lambda tick: None, controller)
        return log.read_bytes()
