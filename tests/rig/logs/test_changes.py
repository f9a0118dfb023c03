"""What a conversion says that it changes, beside what is different when its file is read again."""

import json
import re
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from can import Message
from hypothesis import given, settings, strategies as st

from can_rig.errors import LogError
from can_rig.logs.formats.candump import CANDUMP
from can_rig.logs.frames import ERROR, REMOTE, SENT, Log, concatenate
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from tests.drawn_frames import any_bytes, frames
from tests.helpers import asked
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.messages import from_messages

FORMATS = [".log", ".asc", ".blf", ".trc", ".mf4", ".csv"]
LACKS = {".trc": {"is_error_frame"}, ".csv": {"is_error_frame", "is_remote_frame", "is_fd"}}
ERRORS_OF_LINUX = (8, 64, 0x88)


BUSES = ("can0", "vcan0", "canA", "canB", "can1", "0", "can999")
STARTS_NS = [0, 5_500_000_000, 1_700_000_000_007_000_000, 1_700_000_000_123_456_789]


@st.composite
def one_frame(draw: st.DrawFn) -> Message:
    """Its time stamp is the time since the last frame."""
    message = draw(frames(["data", "data", "remote", "error", "fd"]))
    message.timestamp = draw(st.sampled_from([1e-3, 1e-6, 1.234567e-3, 1e-9]))
    message.channel, message.is_rx = draw(st.sampled_from(BUSES)), draw(st.booleans())
    if message.is_error_frame:
        message.arbitration_id = draw(st.sampled_from(ERRORS_OF_LINUX))
        message.is_extended_id, message.dlc, message.data = False, 8, draw(any_bytes(8))
    return message


def logged(
    folder: Path, messages: list[Message], start_ns: int, first_ns: int, chunk: int = 1 << 18
) -> Log:
    """A log of these frames; the first comes ``first_ns`` after its start."""
    columns = from_messages(messages)
    columns.time_ns[0] = start_ns + first_ns
    columns = replace(columns, time_ns=np.cumsum(columns.time_ns))

    def reader(log: Log):
        log.start_ns = start_ns
        yield from (columns[at : at + chunk] for at in range(0, len(columns), chunk))

    path = folder / "a"
    path.touch()
    return Log(path, replace(CANDUMP, read=reader), chunk)


def differences(before: list[tuple], start_ns: int, log: Log) -> dict[str, object]:
    """What is different in ``log``, in the words of the command."""
    after = rows(concatenate(log))
    assert len(after) == len(before)
    found: dict[str, object] = {}
    of_kind = {kind(row): iter([one for one in after if kind(one) == kind(row)]) for row in before}
    in_order, after = after, [next(of_kind[kind(row)]) for row in before]
    found["places"] = in_order != after
    if log.start_ns != start_ns:
        found["start"] = log.start_ns - start_ns
    moved = [abs(new[0] - old[0]) for old, new in zip(before, after, strict=True)]
    assert max(moved) <= 500
    found["rounded"] = sum(map(bool, moved))
    pairs = list(zip(before, after, strict=True))
    errors = [(old, new) for old, new in pairs if old[2] & ERROR]
    found["identifiers"] = sum(old[1] != new[1] for old, new in errors)
    found["payloads"] = sum(old[4:] != new[4:] for old, new in errors)
    found["directions"] = sum(old[2] != new[2] for old, new in errors)
    for old, new in pairs:
        assert old[2] & ~SENT == new[2] & ~SENT
        if not old[2] & ERROR:
            assert (old[1], old[2], *old[4:]) == (new[1], new[2], *new[4:])
    names = {(old[3], new[3]) for old, new in pairs}
    assert len(names) == len({old for old, _ in names}) == len({new for _, new in names})
    if any(old != new for old, new in names):
        found["buses"] = names
    return {what: value for what, value in found.items() if value}


def kind(row: tuple) -> tuple[int, bool]:
    """What MDF holds apart."""
    return row[2] & (ERROR | REMOTE), row[4] > 8


def said(lines: list[str]) -> dict[str, object]:
    """The same out of the lines that the command prints."""
    found: dict[str, object] = {}
    for line in lines:
        if match := re.search(r"starts (\d+)\.(\d{9}) s (later|earlier)", line):
            sign = 1 if match[3] == "later" else -1
            found["start"] = sign * int(match[1] + match[2])
        elif match := re.search(r"(\d+) time stamps? rounded", line):
            found["rounded"] = int(match[1])
        elif match := re.search(r"keep the (\w+) of (\d+) error frame", line):
            found[match[1]] = int(match[2])
        elif "numbers for buses: " in line:
            of_each = line.partition("numbers for buses: ")[2].split(", ")
            found["buses"] = {tuple(each.split(" is ")) for each in of_each}
        else:
            assert "may change places" in line
            found["places"] = True
    return found


def agree(lines: list[str], before: list[tuple], start_ns: int, log: Log) -> bool:
    """Whether the lines say what is different; frames that may change places need not."""
    told, seen = said(lines), differences(before, start_ns, log)
    return {"places": True, **seen} == {"places": True, **told} and (
        "places" in told or "places" not in seen
    )


@pytest.mark.parametrize("suffix", FORMATS)
@settings(max_examples=30, deadline=None)
@given(
    messages=st.lists(one_frame(), min_size=1, max_size=8),
    start_ns=st.sampled_from(STARTS_NS),
    first_ns=st.sampled_from([0, 1, 1_000_000, 7_000_345]),
    chunk=st.sampled_from([2, 100]),
)
def test_it_says_what_is_different(suffix, messages, start_ns, first_ns, chunk):
    lacks = LACKS.get(suffix, set())
    messages = [message for message in messages if not any(getattr(message, a) for a in lacks)]
    if not messages:
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        log = logged(folder, messages, start_ns, first_ns, chunk)
        before = rows(concatenate(log))
        changes = write_log(log, folder / f"b{suffix}")
        again = read_log(folder / f"b{suffix}")
        assert agree(changes.lines(), before, start_ns, again)


@pytest.mark.parametrize("first", FORMATS)
@pytest.mark.parametrize("second", FORMATS)
@settings(max_examples=8, deadline=None)
@given(messages=st.lists(one_frame(), min_size=1, max_size=6), start_ns=st.sampled_from(STARTS_NS))
def test_every_pair_of_formats(first, second, messages, start_ns):
    """From the first format to the second and back, twice: the second loss is none."""
    lacks = LACKS.get(first, set()) | LACKS.get(second, set())
    messages = [message for message in messages if not any(getattr(message, a) for a in lacks)]
    if not messages:
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = [
            folder / f"{at}{suffix}" for at, suffix in enumerate([first, second, first, second])
        ]
        write_log(logged(folder, messages, start_ns, 7_000_345), paths[0])
        for source, out in pairwise(paths):
            log = read_log(source)
            before = rows(concatenate(log))
            changes = write_log(log, out)
            assert agree(changes.lines(), before, log.start_ns, read_log(out))
        assert sorted(rows(whole(paths[3]))) == sorted(rows(whole(paths[1])))
        assert not said(changes.lines()).keys() - {"start", "places"}


def test_buses_are_told_apart_and_the_command_says_how(tmp_path):
    buses = ["can0", "vcan0", "canA", "canB", "can1"]
    lines = [f"(1700000000.00{at}000) {bus} 123#0{at}\n" for at, bus in enumerate(buses)]
    source = written(tmp_path, "".join(lines))
    done = asked("convert", source, tmp_path / "b.blf")
    assert (
        "note: a Vector binary log has numbers for buses: "
        "can0 is 0, vcan0 is 1, canA is 2, canB is 3, can1 is 4\n" in done.stderr
    )
    assert [row[3] for row in rows(whole(tmp_path / "b.blf"))] == ["0", "1", "2", "3", "4"]
    found = json.loads(asked("convert", source, tmp_path / "c.mf4", "--json").stdout)
    assert found["buses"] == {"can0": 0, "vcan0": 1, "canA": 2, "canB": 3, "can1": 4}
    assert len(found["changes"]) == 1
    same = asked("convert", source, tmp_path / "d.log.gz")
    assert (same.returncode, same.stderr) == (0, "")


@pytest.mark.parametrize("suffix", [".trc", ".csv"])
def test_what_is_refused_is_counted_in_the_whole_log(tmp_path, suffix):
    frame = Message(0.001, 1, channel="can0", data=b"1")
    error = Message(0.001, 8, channel="can0", is_error_frame=True, data=bytes(8))
    log = logged(tmp_path, [frame, error] * 134, 0, 0, chunk=4)
    with pytest.raises(LogError, match=r"b\.\w+: .* and .*a has 134 error frames; the format must"):
        write_log(log, tmp_path / f"b{suffix}")
    assert not (tmp_path / f"b{suffix}").exists()


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc"])
def test_a_clock_that_goes_back(tmp_path, suffix):
    """Before the start of a file that says one, its formats have no times."""
    times_s = ["1700000000.007000", "1700000000.005000", "1699999999.500000"]
    lines = [f"({time_s}) can0 123#0{at}\n" for at, time_s in enumerate(times_s)]
    source = read_log(written(tmp_path, "".join(lines)))
    changes = write_log(source, tmp_path / f"b{suffix}")
    stamps = whole(tmp_path / "a.log").time_ns.tolist()
    assert whole(tmp_path / f"b{suffix}").time_ns.tolist() == stamps
    assert "no frames from before its start: the recording starts 0.507" in changes.lines()[-1]
    late = read_log(tmp_path / "a.log", chunk_frames=2)
    with pytest.raises(LogError, match=r"goes back to there; the format must be \.log, \.mf4 or"):
        write_log(late, tmp_path / f"c{suffix}")
