"""Exported controllers, built once a session."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers import succeeded
from tests.rig.export.shared import STRICT, run
from tests.session import once

Built = Callable[[str], Path]
SCENARIOS = {
    "float64": ["noisy"],
    "float32": ["noisy", "--precision", "float32"],
    "drive": ["drive-cycle", "--set", "design.speeds_mps=[8.0, 8.9, 10.0]",
              "--precision", "float32"],
}  # fmt: skip


@pytest.fixture(scope="session")
def built(tmp_path_factory):
    """The folder of an export after make, by a key of ``SCENARIOS``: gcc has warned of nothing."""

    def make(kind: str, folder: Path) -> None:
        done = succeeded("export", *SCENARIOS[kind], "--out", folder)
        said = done.stdout.replace("\n", "")
        assert re.fullmatch(r".*: \d+ files, \d+ lines of C", said)
        run("make", "-s", "-C", folder, f"CFLAGS={' '.join(STRICT)} -O2", "example", "bench")

    return lambda kind: once(tmp_path_factory, kind, lambda folder: make(kind, folder))


@pytest.fixture(params=["float64", "float32"])
def folder(request, built):
    """An export in either precision, for one speed."""
    return built(request.param)
