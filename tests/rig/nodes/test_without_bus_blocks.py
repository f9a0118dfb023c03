"""A run without a bus, block after block: files, columns and counts are those of both nodes."""

import csv
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from can_rig.controllers.our_law import PYTHON
from can_rig.nodes import ticks
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.nodes.ticks import NodeSummary
from can_rig.nodes.without_bus import RunWithoutBus, run_without_bus
from can_rig.plant import in_windows
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from tests.clock import TurnedClock

BLOCK = 10
RUN = [
    "duration_s=0.035", "fault.at_s=0.008", "fault.for_s=0.016", "reference.kind=sine",
    "reference.frequency_rad_per_s=20",
]  # fmt: skip
LAG = [
    "plant.torque_actuator.lag_s=0.005",
    "plant.torque_actuator.dead_time_s=0.0015",
    "plant.force_difference_actuator.dead_time_s=0.0025",
]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(in_windows, "BLOCK_TICKS", BLOCK)
    monkeypatch.setattr(in_windows, "WINDOW_TICKS", BLOCK)


def stopped_at(last: int) -> tuple[StopRequest, Callable[[int], None]]:
    stop = StopRequest()

    def on_tick(tick: int) -> None:
        stop.wanted = tick >= last

    return stop, on_tick


def both(scenario: Scenario, folder: Path, last: int) -> list[NodeSummary]:
    """Without a bus and on one; the files are compared."""
    ours = run_without_bus(scenario, folder / "ours.log", *stopped_at(last))
    theirs = run_in_process(
        scenario, "virtual:blocks", folder / "theirs.log", *stopped_at(last), PYTHON
    )
    for suffix in (".log", ".plant.csv"):
        left, right = ((folder / f"{name}{suffix}").read_bytes() for name in ("ours", "theirs"))
        assert left == right, suffix
        assert left.count(b"\n") >= ours.ticks
    return [ours, theirs]


@pytest.mark.parametrize("kind", ["frames-missing", "frames-corrupted"])
def test_a_stop_ends_it_after_the_block(kind, tmp_path):
    """Frames that would have been lost or damaged later are not counted."""
    scenario = load("default", [*RUN, *LAG, f"fault.kind={kind}"])
    ours, theirs = both(scenario, tmp_path, 2 * BLOCK)
    assert ours.ticks == theirs.ticks == 2 * BLOCK
    assert ours.rejected_frames == theirs.rejected_frames
    assert max(ours.rejected_frames["STEER_TORQUE_CMD"].values()) == 12
    assert len((tmp_path / "ours.log").read_text().splitlines()) in {5 * 20, 5 * 20 - 12}


def test_it_says_after_each_block_how_far_it_is_and_how_long_it_took(tmp_path, monkeypatch):
    clock, done = TurnedClock(7_000_000_000), []
    monkeypatch.setattr(ticks, "SYSTEM_CLOCK", clock)

    def on_tick(tick: int) -> None:
        done.append(tick)
        clock.pass_s(0.5)

    scenario = load("default", [*RUN, "fault.kind=none"])
    summary = run_without_bus(scenario, tmp_path / "a.log", StopRequest(), on_tick)
    assert done == [10, 20, 30, 35]
    assert (summary.wall_s, summary.ticks_per_s) == (2.0, 17.5)


def test_its_columns_are_what_is_in_the_file_of_the_plant(tmp_path):
    scenario = load("default", [*RUN, "fault.kind=actuator-dead", *LAG])
    columns = run_without_bus(scenario, tmp_path / "a.log", *stopped_at(20)).columns
    assert columns is not None
    assert columns.plant is not None
    with (tmp_path / "a.plant.csv").open() as file:
        names, *rows = csv.reader(file)
    found = np.array(rows, dtype=float).T
    assert names == ["tick", *columns.plant]
    np.testing.assert_array_equal(found[0], np.arange(20))
    for row, values in zip(found[1:], columns.plant.values(), strict=True):
        np.testing.assert_array_equal(row, values)
    assert all(len(values) == 20 for values in columns.frames.values())


def test_a_plant_of_one_s_own_has_no_columns_but_its_file(tmp_path):
    scenario = load("default", [*RUN, "plant.kind=tests.rig.plant.linear:LinearPlant"])
    columns = run_without_bus(scenario, tmp_path / "a.log", *stopped_at(20)).columns
    assert columns is not None
    assert columns.plant is None


def test_both_files_are_closed_at_the_end(tmp_path):
    with RunWithoutBus(load("default", RUN), tmp_path / "a.log") as run:
        assert len(open_files(tmp_path)) == 2
        run.carry()
    assert open_files(tmp_path) == []


def open_files(folder: Path) -> list[Path]:
    opened = []
    for number in os.listdir("/proc/self/fd"):  # noqa: PTH208
        with suppress(OSError):  # that of the list itself
            opened.append(Path(f"/proc/self/fd/{number}").readlink())
    return [path for path in opened if path.parent == folder]
