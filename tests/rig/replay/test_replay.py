"""Open loop: nothing differs where nothing has changed, and what is wrong with a log is named."""

from __future__ import annotations

import json
import math
import random
from collections import Counter
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from can import Message
from hypothesis import given, settings
from hypothesis import strategies as st

from can_rig.assessment.resolve import load, load_run
from can_rig.errors import LogError
from can_rig.frames.endpoints import Transmitter
from can_rig.logs.frames import from_messages
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from can_rig.replay.gaps import Gap
from can_rig.replay.replay import OpenLoop
from can_rig.results.signals import plain_frames
from can_rig.scenario.build import controller_table, network_of
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from firmware_model.target.status import Mode
from tests.helpers import NAMES, asked, record, rig

TICKS = 400
SETTINGS = (f"duration_s={TICKS / 1000}", "fault.at_s=0.2")
ALL = 5  # frames of a tick


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log, _, _ = record(tmp_path_factory.mktemp("drive"), *SETTINGS)
    return log


@pytest.fixture(scope="module")
def frames(drive: Path) -> list[Message]:
    return list(plain_frames(drive))


SCENARIO = load("thesis-step", SETTINGS)
NETWORK = network_of(SCENARIO)


def replay(
    frames: list[Message], scenario: Scenario = SCENARIO, chunk: int = 300
) -> tuple[OpenLoop, list[Gap]]:
    gaps: list[Gap] = []
    loop = OpenLoop(scenario, network_of(scenario), gaps.append)
    loop.run(from_messages(frames[at : at + chunk]) for at in range(0, len(frames), chunk))
    return loop, gaps


def listed(gaps: list[Gap]) -> Counter[tuple[int, str, str]]:
    """Every tick of every gap."""
    return Counter(
        (tick, gap.message, gap.what)
        for gap in gaps
        for tick in range(gap.tick, gap.tick + gap.ticks)
    )


def raw(message: Message) -> int:
    """The value on the wire, read without the codec."""
    return int.from_bytes(message.data[4:8], "little", signed=True)


def answers(
    frames: list[Message], scenario: Scenario, deaf: set[int] = frozenset()
) -> list[tuple[int, int, int, int, int]]:
    """What a bare ``Firmware`` sends for the frames of a whole log; ``deaf``: ticks it is given
    nothing. Raw commands and d̂, mode, fault state."""
    firmware = Firmware(controller_table(scenario, NETWORK))
    firmware.reset(0.0)
    sent = []
    for tick in range(len(frames) // ALL):
        r, y = (
            raw(frames[ALL * tick + at]) * codec.lsb for at, codec in enumerate(NETWORK) if at < 2
        )
        one, two, estimate, mode, fault = firmware.step(
            *((math.nan, math.nan) if tick in deaf else (r, y))
        )
        values = zip((one, two, estimate), list(NETWORK)[2:], strict=True)
        sent.append((*(codec.to_raw(value) for value, codec in values), mode, fault))
    return sent


def logged(frames: list[Message]) -> list[tuple[int, int, int, int, int]]:
    """The same, as a log has it."""
    rows = []
    for tick in range(len(frames) // ALL):
        one, two, status = frames[ALL * tick + 2 : ALL * tick + ALL]
        bits = status.data[1]
        rows.append((raw(one), raw(two), raw(status), bits >> 4 & 3, bits >> 6 & 3))
    return rows


SIGNALS = ("SteerTorque", "ForceDifference", "FaultEstimate", "Mode", "FaultState")


def test_a_run_folder_replays_bit_for_bit(tmp_path: Path) -> None:
    for name, settings_ in (("default", ()), ("noisy", ("fault.kind=sensor-biased",))):
        run = rig(
            "run",
            name,
            "--in-process",
            "--out",
            name,
            "--set",
            "duration_s=0.3",
            "--set",
            "fault.at_s=0.2",
            *(a for s in settings_ for a in ("--set", s)),
        )
        assert run.returncode == 0, run.stderr
        done = asked("replay", name, "--json")
        assert (done.returncode, done.stderr) == (0, "")
        result = json.loads(done.stdout)
        assert result["identical"]
        assert result["compared_ticks"] == result["ticks"] == 300
        assert result["frames_of_the_same_bytes"] == 900
        assert result["gaps"] == {}


@pytest.mark.parametrize(
    "change", ["design.tau_s=0.0011", "design.tau_q_s=0.002", "design.confirm_s=0.02"]
)
def test_one_changed_key_names_the_first_tick_and_the_largest_difference(
    frames: list[Message], change: str
) -> None:
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
def test_the_last_bit_of_one_answer_is_found(frames: list[Message], role: int) -> None:
    tick = 211
    changed = list(frames)
    codec = list(NETWORK)[role]
    sender = Transmitter(codec)
    at = ALL * tick + role
    record_ = codec.decode(frames[at].data)
    for _ in range(tick):  # so that its alive counter is right
        sender.frame(0.0, 0)
    near = sender.frame(record_.value + codec.lsb, tick, record_.mode, record_.fault_state)
    assert near.data[2:4] == frames[at].data[2:4]
    near.timestamp = frames[at].timestamp
    changed[at] = near
    loop, gaps = replay(changed)
    assert not gaps
    (signal,) = (signal for signal in loop.comparison.signals if signal.different)
    assert (signal.message, signal.different, signal.first.tick) == (NAMES[role], 1, tick)
    assert signal.largest == pytest.approx(codec.lsb)


def mangled(
    frames: list[Message], seed: int
) -> tuple[list[Message], Counter[tuple[int, str, str]]]:
    """1 % of the frames dropped, doubled or swapped with the next, and what is wrong then."""
    chance = random.Random(seed)
    every = range(ALL, len(frames) - 2 * ALL)
    chosen: dict[int, str] = {}
    for at in chance.sample(every, len(frames) // 100 + 2):
        if not {at - 1, at, at + 1} & set(chosen):
            chosen[at] = chance.choice(["drop", "double", "swap"])
    out: list[Message] = []
    wrong: Counter[tuple[int, str, str]] = Counter()
    held: Message | None = None
    for at, frame in enumerate(frames):
        tick, role = divmod(at, ALL)
        what = chosen.get(at)
        if what == "drop":
            wrong[tick, NAMES[role], "missing"] += 1
        elif what == "swap":
            held = frame
            wrong[tick, NAMES[role], "late" if role == ALL - 1 else "out of order"] += 1
        else:
            out += [frame, frame] if what == "double" else [frame]
            if what == "double":
                wrong[tick, NAMES[role], "repeated"] += 1
            if held is not None:
                out.append(held)
                held = None
    return out, wrong


@settings(max_examples=25)
@given(st.integers(0, 10**6), st.integers(1, 700))
def test_dropped_doubled_and_swapped_frames_are_all_listed_and_nothing_else(
    frames: list[Message], seed: int, chunk: int
) -> None:
    log, wrong = mangled(frames, seed)
    loop, gaps = replay(log, chunk=chunk)
    assert listed(gaps) == wrong
    comparison = loop.comparison
    missing = {key for key in wrong if key[2] == "missing"}
    deaf = {tick for tick, name, _ in missing if name in NAMES[:2]}
    assert comparison.ticks == TICKS
    assert comparison.without_input == len(deaf)
    for role in (2, 3, 4):
        number = sum(name == NAMES[role] and tick not in deaf for tick, name, _ in missing)
        assert comparison.without_answer[NAMES[role]] == number
    harmful = {
        tick
        for tick, name, what in wrong
        if name in NAMES[:2] and what != "repeated" and (name, what) != (NAMES[1], "out of order")
    }
    assert loop.account.first_input_gap == (min(harmful) if harmful else None)
    first = comparison.first_different_tick
    assert first is None or first >= min(harmful)


def test_a_tick_without_feedback_is_held_and_the_next_goes_on(frames: list[Message]) -> None:
    deaf = {50, 51, 52, 300}
    log = [f for at, f in enumerate(frames) if not (at % ALL == 1 and at // ALL in deaf)]
    loop, gaps = replay(log)
    assert listed(gaps) == Counter({(tick, NAMES[1], "missing"): 1 for tick in deaf})
    expected, theirs = answers(frames, SCENARIO, deaf), logged(frames)
    assert all(expected[tick][3] == Mode.HOLD for tick in deaf)
    for at, signal in enumerate(loop.comparison.signals):
        apart = [
            tick
            for tick in range(TICKS)
            if tick not in deaf and expected[tick][at] != theirs[tick][at]
        ]
        assert signal.different == len(apart)
        assert (signal.first.tick if signal.first else None) == (apart[0] if apart else None)
        assert signal.compared == TICKS - len(deaf)


@pytest.mark.parametrize("deaf", [{50}, {50, 51, 52}])
def test_lost_references_cost_their_own_ticks_only(frames: list[Message], deaf: set[int]) -> None:
    log = [f for at, f in enumerate(frames) if at % ALL or at // ALL not in deaf]
    loop, _ = replay(log)
    expected, theirs = answers(frames, SCENARIO, deaf), logged(frames)
    for at, signal in enumerate(loop.comparison.signals):
        apart = [t for t in range(TICKS) if t not in deaf and expected[t][at] != theirs[t][at]]
        assert signal.different == len(apart)


def test_a_hole_in_the_log_is_no_clock_step(frames: list[Message]) -> None:
    loop, gaps = replay(frames[: ALL * 100] + frames[ALL * 300 :])
    assert sorted(gap[:1] + gap[2:5] for gap in gaps) == sorted(
        (100, name, "missing", 200) for name in NAMES
    )
    assert loop.comparison.ticks == TICKS
    assert loop.comparison.without_input == 200


def test_answers_lost_on_the_way_to_the_recorder_do_not_fail_silently(
    frames: list[Message],
) -> None:
    log = [f for at, f in enumerate(frames) if not (at % ALL == 2 and 100 <= at // ALL < 350)]
    loop, gaps = replay(log)
    assert loop.comparison.identical
    assert loop.comparison.compared == TICKS - 250
    assert loop.comparison.without_answer[NAMES[2]] == 250
    assert (loop.account.first_input_gap, loop.account.first_answer_gap) == (None, 100)
    assert loop.comparison.signals[0].compared == TICKS - 250
    (gap,) = gaps
    assert gap[:1] + gap[2:5] == (100, NAMES[2], "missing", 250)


def test_a_frame_made_up_does_not_move_time(frames: list[Message]) -> None:
    sender = Transmitter(NETWORK.feedback)
    for wire_tick in (120, 5000, 40_000):
        stray = sender.frame(1.0, wire_tick)
        stray.timestamp = frames[ALL * 100].timestamp
        loop, gaps = replay([*frames[: ALL * 100], stray, stray, *frames[ALL * 100 :]])
        assert loop.comparison.identical
        assert loop.comparison.compared == TICKS
        assert loop.rejected()[NAMES[1]] == {"wrong_tick": 2}
        assert [(gap.tick, gap.what, gap.detail) for gap in gaps] == [
            (100, "stray tick", f"the frame says {wire_tick}")
        ] * 2


def test_damage_is_named(frames: list[Message]) -> None:
    log = deepcopy(frames)
    log[ALL * 20 + 2].data[5] ^= 4
    log[ALL * 30 + 1].data[5] ^= 4
    log[ALL * 40 + 4] = Message(
        log[ALL * 40 + 4].timestamp, 0x120, is_extended_id=False, data=b"\1\2\3"
    )
    loop, gaps = replay(log)
    assert listed(gaps) == Counter(
        {
            (20, NAMES[2], "wrong CRC"): 1,
            (30, NAMES[1], "wrong CRC"): 1,
            (40, NAMES[4], "wrong length"): 1,
        }
    )
    assert loop.comparison.without_input == 1
    assert loop.account.first_input_gap == 30
    assert loop.rejected()[NAMES[1]]["wrong_crc"] == 1


@pytest.mark.parametrize("step_s", [0.5, -0.25, 3600.0, -3600.0])
def test_a_clock_that_steps_changes_nothing_and_is_named(
    frames: list[Message], step_s: float
) -> None:
    log = deepcopy(frames)
    for frame in log[ALL * 150 :]:
        frame.timestamp += step_s + 7200.0
    for frame in log[: ALL * 150]:
        frame.timestamp += 7200.0
    loop, gaps = replay(log)
    (gap,) = gaps
    assert (gap.tick, gap.what) == (150, "clock step")
    assert float(gap.detail.split()[0]) == pytest.approx(step_s + 0.000996, abs=1e-6)
    assert loop.comparison.identical


def test_time_stamps_of_another_pace_are_no_clock_steps(frames: list[Message]) -> None:
    log = deepcopy(frames)
    for frame in log:
        frame.timestamp = 1.7e9 + frame.timestamp / 12.0  # lockstep, recorded by candump
    _, gaps = replay(log)
    assert gaps == []


def test_a_log_that_begins_late_says_so(frames: list[Message]) -> None:
    loop, gaps = replay(frames[ALL * 120 + 3 :])
    assert (loop.first_tick, loop.comparison.ticks) == (121, TICKS - 121)
    assert loop.before_start == 2
    assert gaps == []


def test_the_wire_tick_goes_round(frames: list[Message]) -> None:
    """65536 ticks are 16 bits; a drive across the end goes on counting."""
    shifted = []
    senders = [Transmitter(codec) for codec in NETWORK]
    for at, frame in enumerate(frames):
        tick, role = divmod(at, ALL)
        codec = list(NETWORK)[role]
        said = codec.decode(frame.data)
        one = senders[role].frame(said.value, tick + 65_400, said.mode, said.fault_state)
        one.timestamp = frame.timestamp + 65.4
        shifted.append(one)
    loop, gaps = replay(shifted)
    assert gaps == []
    assert loop.first_tick == 65_400
    assert loop.comparison.identical
    assert loop.comparison.compared == TICKS


def test_a_log_cut_off_within_a_tick(frames: list[Message]) -> None:
    loop, gaps = replay(frames[: ALL * 300 + 1])
    assert loop.comparison.ticks == 300
    assert listed(gaps) == Counter({(300, name, "missing"): 1 for name in NAMES[1:]})


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4", ".trc", ".log.gz"])
def test_other_formats_replay_alike(drive: Path, tmp_path: Path, suffix: str) -> None:
    copy = tmp_path / f"drive{suffix}"
    write_log(read_log(drive), copy)
    gaps: list[Gap] = []
    loop = OpenLoop(SCENARIO, NETWORK, gaps.append)
    loop.run(read_log(copy))
    assert gaps == []
    assert loop.comparison.same_bytes == 3 * TICKS


def test_a_log_without_the_rig_is_refused(frames: list[Message]) -> None:
    for log in ([], frames[2:5], [frame for at, frame in enumerate(frames) if at % ALL != 1]):
        with pytest.raises(LogError, match="no DSTAR_REFERENCE and DSTAR_FEEDBACK"):
            replay(log)


def test_the_command_line_says_what_differs(drive: Path, frames: list[Message]) -> None:
    log, wrong = mangled(frames, 7)
    write_log_of(log, Path("mangled.log"))
    done = rig(
        "replay",
        "mangled.log",
        "--scenario",
        "thesis-step",
        "--set",
        "duration_s=0.4",
        "--set",
        "fault.at_s=0.2",
        "--gaps",
        "gaps.csv",
    )
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
        ((drive, "--scenario", "default", "--gaps", "gaps.csv"), "there already"),
    ):
        refused = asked("replay", *arguments)
        assert refused.returncode == 2
        assert words in refused.stderr
        assert refused.stderr.count("\n") == 1


def write_log_of(frames: list[Message], path: Path) -> None:
    lines = [
        f"({f.timestamp:.6f}) vcan0 {f.arbitration_id:03X}#{f.data.hex().upper()}\n" for f in frames
    ]
    path.write_text("".join(lines))


def test_a_run_brings_its_scenario_and_the_model_follows_the_car() -> None:
    recorded = load("default", ["model.mass_kg=1500"])
    assert load_run(recorded.as_dict()) == recorded
    changed = load_run(recorded.as_dict(), ["plant.mass_kg=1600", "plant.speed_mps=12"])
    assert (changed.model.mass_kg, changed.model.speed_mps) == (1500.0, 12.0)


def test_numbers_of_frames_add_up(frames: list[Message]) -> None:
    assert len(frames) == ALL * TICKS
    np.testing.assert_array_equal(answers(frames, SCENARIO), logged(frames))
