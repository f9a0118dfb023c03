"""Where there is no vcan0 its tests are skipped, and every test has a folder of its own."""

import os
from pathlib import Path

import pytest

# Assertions in helpers tell their values too.
pytest.register_assert_rewrite("tests.helpers", "tests.vcan", "tests.firmware", "tests.rig")


def pytest_collection_modifyitems(items):
    """Where there is no vcan0 its tests say how to have them run; where it must be, they fail."""
    if Path("/sys/class/net/vcan0").exists() or os.environ.get("CAN_RIG_VCAN") == "required":
        return
    reason = "NOT TESTED: no vcan0 here; tools/vcan_guest .venv/bin/pytest -m vcan tests/rig"
    for item in items:
        if item.get_closest_marker("vcan"):
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(autouse=True)
def no_run_folder_in_the_checkout(monkeypatch, tmp_path):
    """Whatever a test forgets to name lands in its own folder."""
    monkeypatch.chdir(tmp_path)
