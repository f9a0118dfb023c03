"""Open loop: an unchanged log shows no difference, and a single change is found."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from can_rig.controllers.making import PEER
from can_rig.errors import LogError
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from can_rig.replaying.replay import OpenLoop
from can_rig.replaying.rig_frames import Recorded, recorded
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_run
from tests.helpers import NAMES, asked, record, refused, sets, succeeded
from tests.rig.nodes.world import World, hold_up, scenario_of
from tests.rig.replay.drive import (
    ALL,
    NETWORK,
    SCENARIO,
    SETTINGS,
    TICKS,
    answers,
    listed,
    logged,
    mangled,
    off_by_one_bit,
    replay,
    write_log_of,
)

SIGNALS = ("SteerTorque", "ForceDifference", "FaultEstimate", "Mode", "FaultState", "Verdict")


def test_a_run_folder_replays_bit_for_bit(tmp_path):
    for name, settings_ in (
        ("default", ()),
        ("noisy", ("fault.kind=sensor-biased",)),
        ("cluster", ("controller.kind=pi",)),
    ):
        changes = sets("duration_s=0.3", "fault.at_s=0.2", *settings_)
        succeeded("run", name, "--in-process", "--out", name, *changes)
        done = asked("replay", name, "--json")
        assert (done.returncode, done.stderr) == (0, "")
        result = json.loads(done.stdout)
        assert result["identical"]
        assert result["compared_ticks"] == result["ticks"] == 300
        assert result["frames_of_the_same_bytes"] == 900
        assert result["gaps"] == {}


@pytest.mark.parametrize(
    "change", ["design.tau_s=0.0011", "design.tau_q_s=0.002", "design.alpha_q=3"]
)
def test_one_changed_key_names_the_first_tick_and_the_largest_difference(frames, change):
    other = load("thesis-step", [*SETTINGS, change])
    loop, gaps = replay(frames, other)
    ours, theirs = answers(frames, other), logged(frames)
    assert not gaps
    assert not loop.comparison.identical
    first = []
    for at, signal in enumerate(loop.comparison.signals):
        assert signal.signal == SIGNALS[at]
        apart = [abs(a[at] - b[at]) for a, b in zip(ours, theirs, strict=True)]
        assert signal.different == sum(map(bool, apart))
        assert signal.compared == TICKS
        if not signal.different:
            assert signal.first is None
            continue
        tick = next(tick for tick, size in enumerate(apart) if size)
        first.append(tick)
        assert (signal.first.tick, signal.first.time_s) == (tick, frames[ALL * tick].timestamp)
        if at < 3:
            codec = list(NETWORK)[2 + at]
            assert signal.largest == pytest.approx(max(apart) * codec.lsb, rel=1e-12)
            assert apart[signal.largest_at.tick] == max(apart)
            assert signal.first.logged == pytest.approx(theirs[tick][at] * codec.lsb, rel=1e-12)
            assert signal.first.replayed == pytest.approx(ours[tick][at] * codec.lsb, rel=1e-12)
    assert loop.comparison.first_different_tick == min(first)


@pytest.mark.parametrize("role", [2, 3, 4])
def test_the_last_bit_of_one_answer_is_found(frames, role):
    tick = 211
    loop, gaps = replay(off_by_one_bit(frames, tick, role))
    assert not gaps
    (signal,) = (signal for signal in loop.comparison.signals if signal.different)
    assert (signal.message, signal.different, signal.first.tick) == (NAMES[role], 1, tick)
    assert signal.largest == pytest.approx(list(NETWORK)[role].lsb)


def test_a_log_cut_off_within_a_tick(frames):
    loop, gaps = replay(frames[: ALL * 300 + 1])
    assert loop.comparison.ticks == 300
    assert listed(gaps) == Counter({(300, name, "missing"): 1 for name in NAMES[1:]})


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4", ".trc", ".csv", ".log.gz"])
def test_other_formats_replay_alike(drive, tmp_path, suffix):
    copy = tmp_path / f"drive{suffix}"
    write_log(read_log(drive), copy)
    loop = OpenLoop(SCENARIO, NETWORK)
    loop.run(read_log(copy))
    assert loop.account.gaps == []
    assert loop.comparison.same_bytes == 3 * TICKS


def test_a_log_without_the_rig_is_refused(frames):
    for log in ([], frames[2:5], [frame for at, frame in enumerate(frames) if at % ALL != 1]):
        with pytest.raises(LogError, match="no DSTAR_REFERENCE and DSTAR_FEEDBACK"):
            replay(log)


def test_the_command_line_says_what_differs(drive, frames):
    log, wrong = mangled(frames, 7)
    write_log_of(log, Path("mangled.log"))
    own = ("--scenario", "thesis-step", *sets(*SETTINGS))
    done = asked("replay", "mangled.log", *own, "--gaps", "gaps.csv")
    assert done.returncode in (0, 1)
    lines = Path("gaps.csv").read_text().splitlines()[1:]
    found: Counter[tuple[int, str, str]] = Counter()
    for line in lines:
        tick, _, name, what, ticks, _ = line.split(",")
        for later in range(int(ticks)):
            found[int(tick) + later, name, what] += 1
    assert found == wrong
    ticks = [int(line.split(",")[0]) for line in lines]
    assert ticks == sorted(ticks)
    different = asked("replay", drive, "--scenario", "thesis-step", "--set", "design.tau_s=0.0011")
    assert different.returncode == 1
    assert "different from tick 0 on" in different.stdout
    for arguments, words in (
        ((drive,), "name it with --scenario NAME"),
        (("nothing.log", "--scenario", "default"), "there is no such file"),
        ((".", "--scenario", "default"), "not a run folder"),
        ((drive, "--scenario", "default", "--channel", "can7"), "the log has vcan0"),
        ((drive, "--scenario", "default", "--gaps", "gaps.csv"), "gaps.csv: exists"),
    ):
        assert words in refused("replay", *arguments)


def test_a_run_brings_its_scenario_and_the_model_follows_the_car():
    recorded = load("default", ["model.mass_kg=1500"])
    assert load_run(recorded.as_dict()) == recorded
    changed = load_run(recorded.as_dict(), ["plant.mass_kg=1600", "plant.speed_mps=12"])
    assert (changed.model.mass_kg, changed.model.speed_mps) == (1500.0, 12.0)


def test_numbers_of_frames_add_up(frames):
    assert len(frames) == ALL * TICKS
    np.testing.assert_array_equal(answers(frames, SCENARIO), logged(frames))


def test_a_controller_that_hears_further_sensors_gets_their_logged_frames(tmp_path):
    hears = ["controller.kind=tests.rig.nodes.hearing:Hearing", "duration_s=0.3", "fault.at_s=0.1"]
    log, _, scenario = record(tmp_path, *hears, name="cluster")
    network = network_of(scenario)
    loop = OpenLoop(scenario, network, PEER)
    loop.run(read_log(log))
    assert loop.comparison.identical
    assert loop.comparison.compared == scenario.ticks
    assert not loop.account.gaps
    deaf = OpenLoop(scenario, replace(network, witnesses=()), PEER)
    deaf.run(read_log(log))
    assert not deaf.comparison.identical


LATE = range(120, 126)


@pytest.fixture(params=["never answered", "sent too late", "in time"])
def run(request, tmp_path):
    """A run on a clock that the test turns."""
    scenario = scenario_of("latency_ticks=1", "reference.kind=step", "duration_s=0.3")
    answers = lambda tick: None if tick in LATE else 200_000  # noqa: E731
    world = World(scenario, answers) if request.param == "never answered" else World(scenario)
    if request.param == "sent too late":
        hold_up(world, dict.fromkeys(LATE, 1_100_000))
    log = tmp_path / "bus.log"
    world.run(log)
    return world, log, request.param


def replayed(world: World, log: Path, answers: Recorded | None) -> OpenLoop:
    loop = OpenLoop(world.scenario, world.network, recorded=answers)
    loop.run(read_log(log))
    return loop


def test_the_replay_of_a_run_in_real_time_is_that_run(run):
    world, log, what = run
    answers = recorded(read_log(log), world.network, world.scenario)
    loop = replayed(world, log, answers)
    assert loop.comparison.identical
    assert loop.comparison.compared >= 290
    unanswered = {tick for tick in range(300) if answers.answered.get(tick, 0) < 2}
    if what == "never answered":
        assert unanswered >= set(LATE)
    if what in {"never answered", "sent too late"}:
        assert unanswered | answers.late >= set(LATE)
        assert not replayed(world, log, None).comparison.identical
    if what == "in time":
        assert not unanswered | answers.late
        assert replayed(world, log, None).comparison.identical
