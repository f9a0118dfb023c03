"""``--from`` and ``--to`` of replay, in each of its ways, and of diff."""

import json
from pathlib import Path
from typing import Any

import pytest

from can_rig.replaying.what_if import question
from can_rig.results.source import Source
from tests.helpers import asked, refused, sets, succeeded
from tests.rig.replay.drive import SETTINGS, off_by_one_bit, write_log_of

DURATION = sets("duration_s=0.3", "fault.at_s=0.2")
PART = ("--from", "0.1", "--to", "0.15")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("part") / "run"
    succeeded("run", "thesis-sine", *DURATION, "--in-process", "--out", folder)
    return folder


def test_a_what_if_reads_its_log_once(run, monkeypatch):
    read: list[Path] = []
    frames = Source.frames

    def counted(source: Source, *reading: Any) -> Any:
        read.append(source.log.path)
        return frames(source, *reading)

    monkeypatch.setattr(Source, "frames", counted)
    asked_of = question(run, None, ())
    assert read == [run / "bus.log"] and len(asked_of.logged) == 300 and asked_of.told == ()


def test_from_chooses_the_second_run_of_a_log(run, tmp_path):
    log = tmp_path / "two.log"
    first = (run / "bus.log").read_text("ascii")
    log.write_text(first + first.replace("(0.", "(9."), "ascii")
    scenario = ("--scenario", "thesis-sine", *DURATION)
    assert "300 of 600 ticks" in asked("replay", log, *scenario).stdout
    second = asked("replay", log, *scenario, "--from", 8)
    assert (second.returncode, second.stderr) == (0, "")
    assert "300 of 300 ticks compared" in second.stdout


def test_the_load_is_that_of_the_scenarios_bit_rate(run):
    said = asked("stats", run).stdout
    assert "at 1000 kbit/s: at most" in said and "--bitrate" not in said
    assert (
        json.loads(asked("stats", run, "--bitrate", 250000, "--json").stdout)["bitrate"] == 250000
    )


def test_what_is_before_is_replayed_but_not_compared(run, frames, tmp_path):
    for part, ticks in ((PART, 50), (("--from", "0.1"), 200), (("--to", "0.1"), 100)):
        done = asked("replay", run, *part, "--json")
        result = json.loads(done.stdout)
        assert (done.returncode, result["identical"]) == (0, True)
        assert result["compared_ticks"] == ticks
        assert result["first_tick"] == 0
    for tick, status in ((99, 0), (100, 1), (149, 1), (150, 0)):
        write_log_of(off_by_one_bit(frames, tick, 2), tmp_path / "drive.log")
        own = (tmp_path / "drive.log", "--scenario", "thesis-step", *sets(*SETTINGS))
        done = asked("replay", *own, *PART)
        assert done.returncode == status, tick
    assert "could be compared" in refused("replay", run, "--from", "5")


def test_of_a_log_with_two_runs_every_tick_counts(frames, tmp_path):
    log = tmp_path / "two.log"
    write_log_of(frames, log)
    log.write_bytes(2 * log.read_bytes())
    done = succeeded("replay", log, "--scenario", "thesis-step", *sets(*SETTINGS))
    assert "identical, bit for bit: 400 of 800 ticks" in done.stdout


def test_a_part_onto_a_bus(run):
    done = asked("replay", run, "--bus", "virtual:part", "--speed", "max", *PART, "--json")
    assert json.loads(done.stdout)["sent"] == 250


def test_a_part_of_the_reference_through_another_scenario(run, tmp_path):
    done = asked("replay", run, "--what-if", *PART, "--out", tmp_path / "other", "--json")
    assert json.loads(done.stdout)["rows"] == 50
    head, first, *_ = (tmp_path / "other" / "reference.csv").read_text("ascii").splitlines()
    assert head == "time_s,reference_mps2"
    assert first.startswith("0.1,")


def test_a_part_of_two_runs_beside_each_other(run):
    for other in (run, run / "bus.log", run / "signals.csv"):
        done = asked("diff", run, other, *PART, "--scenario", "thesis-sine", "--json")
        assert (done.returncode, json.loads(done.stdout)["rows"]) == (0, 50)
    assert "has no row of that part, the last is at 0.299 s" in refused(
        "diff", run, run, "--from", "9"
    )
