"""The nodes by hand, in two terminals: who starts first, and how each ends."""

import os
import time

import pytest

from tests.helpers import record, refused, rig, start
from tests.processes import wait_for
from tests.rig.nodes.running import lines_of, one_line


@pytest.mark.parametrize("first", ["plant", "controller"])
def test_either_node_can_be_started_first(first, tmp_path):
    log = tmp_path / "bus.log"
    common = ["thesis-step", "--set", "duration_s=0.3", "--bus", f"local:{tmp_path / 'bus'}"]
    extra = {"plant": ["--log", log], "controller": []}
    second = "controller" if first == "plant" else "plant"
    early = start(first, *common, *extra[first])
    wait_for(lambda: (tmp_path / "bus").is_dir() and list((tmp_path / "bus").glob("*.node")))
    if first == "plant":
        wait_for(lambda: lines_of(log) or log.exists())
        time.sleep(0.3)  # it repeats its offer meanwhile
    late = start(second, *common, *extra[second])
    for process in (early, late):
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert "300 of 300 ticks" in errors
    assert log.read_bytes() == record(tmp_path, "duration_s=0.3")[0].read_bytes()


@pytest.mark.parametrize(("node", "other"), [("plant", "controller"), ("controller", "plant")])
def test_a_node_that_stays_alone_says_whom_it_waited_for(node, other, tmp_path):
    bus = f"local:{tmp_path / 'bus'}"
    done = rig(node, "thesis-step", "--bus", bus, "--wait", "0.3")
    assert done.returncode == 3
    assert f"no frame from the {other} node for 0.3 s" in one_line(done.stderr)


@pytest.mark.parametrize("command", ["plant", "controller", "panel", "inject pause"])
def test_a_bus_within_one_process_is_refused_where_the_other_node_is_another_process(command):
    line = refused(*command.split(), "--bus", "virtual:x")
    assert line.startswith("error: bus 'virtual:x': stays within one process")


def test_the_log_of_before_stands_until_there_is_a_new_one(tmp_path):
    """A plant without a partner records no replacement."""
    log, beside = tmp_path / "bus.log", tmp_path / "bus.plant.csv"
    notes = tmp_path / "notes.txt"
    notes.write_text("mine")
    common = ["thesis-step", "--set", "duration_s=0.2", "--bus", f"local:{tmp_path / 'bus'}"]
    beside.write_text("mine")
    refused = rig("plant", *common, "--log", log, "--wait", "0.1")
    assert (refused.returncode, beside.read_text()) == (2, "mine")
    assert f"{beside}: exists" in one_line(refused.stderr)
    log.write_text("old")
    assert rig("plant", *common, "--log", log, "--wait", "0.1", "--force").returncode == 3
    assert (log.read_text(), beside.read_text()) == ("old", "mine")
    nodes = [start("plant", *common, "--log", log, "--force"), start("controller", *common)]
    for each in nodes:
        assert each.communicate(timeout=60) and each.returncode == 0
    assert log.read_bytes() == record(tmp_path, "duration_s=0.2")[0].read_bytes()
    assert beside.read_text().startswith("tick,")
    assert notes.read_text() == "mine"
    assert not list(tmp_path.glob("*.unfinished"))


def test_a_plant_records_into_a_pipe_and_leaves_nothing_beside_it(tmp_path):
    pipe = tmp_path / "pipe.log"
    os.mkfifo(pipe)
    common = ["thesis-step", "--set", "duration_s=0.2", "--bus", f"local:{tmp_path / 'bus'}"]
    nodes = [start("plant", *common, "--log", pipe), start("controller", *common)]
    heard = pipe.read_bytes()
    for each in nodes:
        assert each.communicate(timeout=60) and each.returncode == 0
    assert {path.name for path in tmp_path.iterdir()} == {"bus", "pipe.log"}
    assert heard == record(tmp_path, "duration_s=0.2")[0].read_bytes()
