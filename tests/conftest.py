"""What holds for every test: a folder of its own, and no process of it is left behind."""

import gc
import os
import signal
from collections import Counter
from pathlib import Path

import hypothesis
import pytest

from tests.processes import end_all
from tests.times import LONG

pytest_plugins = ["tests.browser"]

# Assertions in helpers tell their values too.
pytest.register_assert_rewrite("tests.helpers", "tests.vcan", "tests.firmware", "tests.rig")

# Before NumPy is imported: matrices are small, and threads only get in each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Seconds; a busy machine takes 30 for the longest test, and one that waits for ever fails. As a key
# of pyproject.toml pytest would refuse it where pytest-timeout is not installed: after ./tools/run.
os.environ.setdefault("PYTEST_TIMEOUT", "300")

# No deadline and no complaint of slow data: the time that an example takes depends on the machine.
# In CI the examples are the same every time, so that a failure comes from the change and not from
# the draw; by hand the examples are new, and a failing example is printed for a rerun.
hypothesis.settings.register_profile(
    "tests",
    deadline=None,
    derandomize="CI" in os.environ,
    print_blob=True,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.load_profile("tests")


def pytest_configure():
    """Processes that tests start hear Ctrl-C and the like, even where this one must not.

    ``nohup ./tools/test &`` starts it with SIGINT and SIGHUP ignored, and a child inherits that; of
    a handler it inherits nothing.
    """
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, lambda *_: None)


def file_of(test):
    return test.partition("::")[0]


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items):
    """Mark the costliest tests; skip tests of vcan0 where vcan0 is missing and may be missing."""
    costly = set(LONG.read_text("utf-8").splitlines())
    files = Counter(map(file_of, costly))
    items.sort(key=lambda item: -files[file_of(item.nodeid)])  # no long file begins last
    for item in items:
        if item.nodeid in costly:
            item.add_marker(pytest.mark.long)
    if Path("/sys/class/net/vcan0").exists() or os.environ.get("CAN_RIG_VCAN") == "required":
        return
    reason = "NOT TESTED: no vcan0 here; tools/vcan_guest .venv/bin/pytest -m vcan tests/rig"
    for item in items:
        if item.get_closest_marker("vcan"):
            item.add_marker(pytest.mark.skip(reason=reason))


def pytest_collection_finish():
    """Modules and tests stay: to search them for garbage takes longer than many a test."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)  # before the fixtures of a module
def pytest_runtest_setup(item):
    """Reports take longer than a short run, and few tests look at one."""
    if item.get_closest_marker("reports"):
        os.environ.pop("CAN_RIG_NO_REPORT", None)
    else:
        os.environ["CAN_RIG_NO_REPORT"] = "1"


@pytest.fixture(autouse=True)
def no_run_folder_in_the_checkout(monkeypatch, tmp_path):
    """Whatever a test forgets to name lands in its own folder."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(autouse=True)
def no_process_left_behind():
    """Also when a test fails half-way."""
    yield
    end_all()
