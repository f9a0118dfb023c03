"""Logs of other formats, read whole; ``test_changes`` has logs written and read again."""

import gzip
import json
import os
import re

import can
import numpy as np
import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import Window, concatenate
from can_rig.logs.reading import read_log
from can_rig.logs.writing import write_log
from tests.helpers import asked, refused
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.messages import from_messages
from tests.rig.logs.samples import (
    CANOE,
    GVRET,
    LOG2ASC,
    PEAK,
    busmaster,
    by_python_can,
    content,
    kinds,
    plain,
    relative_ns,
)
from tests.rig.logs.test_carbus_microchip import CARBUS, MICROCHIP_LOG


@pytest.mark.parametrize("suffix", [".blf", ".mf4"])
def test_a_binary_log_from_a_pipe_is_refused(tmp_path, suffix):
    os.mkfifo(tmp_path / f"a{suffix}")
    with pytest.raises(LogError, match=rf"a{suffix}: is a pipe; must be a file"):
        concatenate(read_log(tmp_path / f"a{suffix}"))


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".trc", ".mf4"])
def test_what_python_can_wrote(tmp_path, suffix):
    messages = plain(300)
    log = read_log(by_python_can(tmp_path / f"a{suffix}", messages), chunk_frames=64)
    frames, sent = concatenate(log), from_messages(messages)
    assert content(frames) == content(sent)
    assert abs(relative_ns(frames) - relative_ns(sent)).max() <= 1000
    assert abs(frames.time_ns - sent.time_ns).max() <= 1_000_000  # ASC's header: milliseconds
    assert 0 <= frames.time_ns[0] - log.start_ns <= 1_000_000  # an MF4 says when it was written
    numbers = np.array([int(name) for name in frames.channels])[frames.channel]
    bus = np.array([message.channel for message in messages])
    assert (numbers - bus == numbers[0] - bus[0]).all()  # PEAK counts them from 1
    assert log.notice is None
    assert log.fraction == 1.0


@pytest.mark.parametrize("suffix", [".asc", ".blf", ".mf4"])
def test_every_kind_of_frame(tmp_path, suffix):
    log = read_log(by_python_can(tmp_path / f"a{suffix}", kinds()))
    assert content(concatenate(log)) == content(from_messages(kinds()))


@pytest.mark.parametrize("suffix", [".asc", ".trc", ".csv"])
def test_compressed_text(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    write_log(read_log(by_python_can(tmp_path / "a.log", plain(50))), path)
    compressed = written(tmp_path, gzip.compress(path.read_bytes()), f"a{suffix}.gz")
    unpacked, packed = read_log(path), read_log(compressed)
    assert content(concatenate(packed)) == content(concatenate(unpacked))
    assert packed.start_ns == unpacked.start_ns > 0


def test_a_peak_log_tells_its_own_name(tmp_path):
    by_python_can(tmp_path / "a.log", plain(2))
    write_log(read_log(tmp_path / "a.log"), tmp_path / "b.trc")
    assert f";   {tmp_path / 'b.trc'}" in (tmp_path / "b.trc").read_text("ascii").splitlines()


TEXTS = {
    "CARBUS": CARBUS.format(version=3, first="1", second="2"),
    "Microchip": MICROCHIP_LOG,
    "SavvyCAN": GVRET,
    "BUSMASTER": busmaster(),
}


FRAME = re.compile(rb"(?<=[\r\n])(?:\d+,[\dt]|\d+;[RT]X|\d\d:\d\d:)")
"""The begin of a frame in ``TEXTS``."""


@pytest.mark.parametrize("kind", [".asc", ".blf", ".trc", *TEXTS])
def test_cut_off_at_every_byte(tmp_path, kind):
    """All frames up to the cut and a notice, or one line where not even the header is left."""
    if kind in TEXTS:
        path = written(tmp_path, TEXTS[kind], "a.csv" if kind == "SavvyCAN" else "a.log")
    else:
        path = by_python_can(tmp_path / f"a{kind}", plain(6))
    data = path.read_bytes()
    every = rows(whole(path))
    begins = [match.start() for match in re.finditer(FRAME, data)]
    most = 0
    for cut in range(1, len(data)):
        path.write_bytes(data[:cut])
        log = read_log(path)
        try:
            found = rows(concatenate(log))
        except LogError as error:
            assert str(error).startswith(str(path))
            assert "\n" not in str(error)
            assert most == 0
            continue
        assert found == every[: len(found)]
        begun = sum(at < cut for at in begins)
        assert len(found) >= (begun - 1 if begins else most)  # all but the last are there
        most = len(found)
        between_lines = kind != ".blf" and not re.split(b"[\r\n]", data[:cut])[-1].strip()
        between_lines |= data[cut:].lstrip(b" ")[:1] in b"\r\n"  # all bytes of a frame are there
        if log.notice is None:
            assert between_lines or not data[cut:].strip() or len(found) == begun
        else:
            assert "\n" not in log.notice
    assert most >= (0 if kind == ".blf" else len(every) - 1)  # the only container is cut


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".mf4"])
@pytest.mark.parametrize(
    "junk", [b"this is\nno log\nat all\n", bytes(500), np.random.default_rng(2).bytes(3000)]
)
def test_something_else_is_refused_in_one_line(tmp_path, suffix, junk):
    path = written(tmp_path, junk, f"a{suffix}")
    with pytest.raises(LogError) as error:
        concatenate(read_log(path))
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ("MDF     4.10    " + "\0" * 1000, "an MDF 4 file that is cut off or damaged"),
        ("MDF     3.30" + "\0" * 88, "not an MDF 4 file"),
    ],
)
def test_an_mdf_file_without_groups_is_refused(tmp_path, head, said):
    path = written(tmp_path, head, "a.mf4")
    with pytest.raises(LogError, match=f"^{path}: {said}"):
        concatenate(read_log(path))


def test_a_binary_log_that_was_never_finished(tmp_path):
    path = tmp_path / "a.blf"
    with can.BLFWriter(path) as writer:
        for message in plain(50):
            writer.on_message_received(message)
        writer._flush()  # a killed recorder leaves what this put on disk
        writer.file.flush()
        log = read_log(path)
        assert len(concatenate(log)) == 50
        assert log.notice is not None
    log = read_log(path)
    assert len(concatenate(log)) == 50
    assert log.notice is None


LOG = "".join(f"({at // 10}.{at % 10}00000) can{at % 2} 123#{at:02X}\n" for at in range(100))


def test_a_part_of_the_recording(tmp_path):
    path = written(tmp_path, LOG.replace("(", "(17"))
    window = Window(2_000_000_000, 3_500_000_000)
    found = rows(concatenate(read_log(path, 7, window)))
    assert [row[5] for row in found] == [bytes([at]) for at in range(20, 35)]
    out = tmp_path / "b.log"
    arguments = ("convert", path, out, "--from", 2, "--to", "3.5", "--channel", "can1", "--json")
    done = asked(*arguments)
    assert json.loads(done.stdout)["frames"] == 7
    assert [row[5][0] for row in rows(whole(out))] == list(range(21, 35, 2))
    for bounds in (("--from", "3", "--to", "2"), ("--from", "nan"), ("--to", "1e300")):
        assert asked("convert", path, tmp_path / "c.log", *bounds).returncode == 2
    said = refused("convert", path, tmp_path / "c.log", "--from", 9.95)
    assert said.endswith("has no frame after --from, the last is at 9.9 s")


@pytest.mark.parametrize(
    ("text", "kind"),
    [(LOG, ".log"), (LOG2ASC, ".asc"), (CANOE, ".asc"), (PEAK, ".trc"), (GVRET, ".csv"),
     (busmaster(), "BUSMASTER")],
)  # fmt: skip
@pytest.mark.parametrize("name", ["a.log", "a.mf4", "a.txt", "a"])
def test_a_log_is_known_by_what_is_in_it(tmp_path, text, kind, name):
    path = written(tmp_path, text, name)
    assert read_log(path).format.key == kind
    assert len(whole(path)) > 1


def test_binary_logs_by_another_name(tmp_path):
    for suffix in (".blf", ".mf4"):
        path = by_python_can(tmp_path / f"a{suffix}", plain(20))
        other = path.rename(tmp_path / "a.asc")
        assert read_log(other).format.key == suffix
        assert len(whole(other)) == 20
        packed = written(tmp_path, gzip.compress(other.read_bytes()), f"b{suffix}.gz")
        with pytest.raises(LogError, match="must be unpacked before"):
            read_log(packed)
    with pytest.raises(LogError, match="unknown log format"):
        read_log(written(tmp_path, "nothing known", "a.txt"))


def test_what_is_in_a_log(tmp_path):
    """A cycle of 10 ms with one frame missing, at 500 kbit/s, beside another bus."""
    lines = [(at * 0.01, "can0 123#0102030405060708") for at in range(200) if at != 50]
    lines += [(at * 0.1 + 0.0005, "can1 12345678#") for at in range(20)]
    text = "".join(f"({time:.6f}) {frame}\n" for time, frame in sorted(lines))
    path = written(tmp_path, text)
    done = asked("stats", path, "--json", "--out", tmp_path / "load.svg")
    found = json.loads(done.stdout)
    one, other = found["identifiers"]
    assert (one["bus"], one["identifier"], one["frames"], one["bytes"]) == (
        "can0",
        "123",
        199,
        [8, 8],
    )
    assert (one["cycle_ms"], one["least_ms"], one["most_ms"], one["gaps"]) == (10, 10, 20, 1)
    assert one["jitter_ms"] == pytest.approx((10**2 * 197 / 198**2) ** 0.5)
    assert (other["identifier"], other["cycle_ms"], other["gaps"]) == ("12345678", 100, 0)
    # 111 bits and 24 stuff bits at most (Davis et al. 2007, Table 1: 135 bits of 8 bytes).
    assert found["load"]["can0"]["most"] == pytest.approx(100 * 135 / 500_000)
    assert "<svg" in (tmp_path / "load.svg").read_text()
    said = asked("stats", path).stdout
    assert "can1  12345678" in said and "load of can0 at 500 kbit/s: at most" in said
    line = "the log has no bit rate, and the load follows from it: --bitrate gives another"
    assert found["bitrate_assumed"] and line in said.splitlines()
    assert line not in asked("stats", path, "--bitrate", 250000).stdout
    assert asked("stats", path, "--bitrate", 0).returncode == 2


def test_the_load_of_a_short_log_is_that_of_its_time(tmp_path):
    """A clock that is set back by 50 ms: what is before its first frame counts too."""
    times = [1.0 + 0.002 * at - (0.05 if at >= 20 else 0.0) for at in range(40)]
    path = written(tmp_path, "".join(f"({t:.6f}) can0 123#0102030405060708\n" for t in times))
    found = json.loads(asked("stats", path, "--json").stdout)
    span_s = max(times) - min(times)
    assert found["span_s"] == pytest.approx(span_s)
    expected = pytest.approx(40 * 135 / 500_000 / span_s)
    assert found["load"]["can0"] == {"mean": expected, "most": expected}
    assert found["identifiers"][0]["per_s"] == pytest.approx(40 / span_s)
