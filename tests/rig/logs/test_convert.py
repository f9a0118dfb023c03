"""``can-rig convert`` and ``can-rig stats``: a log in another format, in part, and its contents."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import Window, concatenate
from can_rig.logs.reading import read_log
from tests.helpers import asked
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.samples import (
    CANOE,
    GVRET,
    LOG2ASC,
    PEAK,
    busmaster,
    by_python_can,
    plain,
)

LOG = "".join(f"({at // 10}.{at % 10}00000) can{at % 2} 123#{at:02X}\n" for at in range(100))


def test_a_part_of_the_recording(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        (LOG, ".log"),
        (LOG2ASC, ".asc"),
        (CANOE, ".asc"),
        (PEAK, ".trc"),
        (GVRET, ".csv"),
        (busmaster(), "BUSMASTER"),
    ],
)
@pytest.mark.parametrize("name", ["a.log", "a.mf4", "a.txt", "a"])
def test_a_log_is_known_by_what_is_in_it(tmp_path: Path, text: str, kind: str, name: str) -> None:
    path = written(tmp_path, text, name)
    assert read_log(path).format.key == kind
    assert len(whole(path)) > 1


def test_binary_logs_by_another_name(tmp_path: Path) -> None:
    for suffix in (".blf", ".mf4"):
        path = by_python_can(tmp_path / f"a{suffix}", plain(20))
        other = path.rename(tmp_path / "a.asc")
        assert read_log(other).format.key == suffix
        assert len(whole(other)) == 20
    with pytest.raises(LogError, match="unknown log format"):
        read_log(written(tmp_path, "nothing known", "a.txt"))


def test_what_is_in_a_log(tmp_path: Path) -> None:
    """A cycle of 10 ms with one frame missing, at 500 kbit/s, beside another bus."""
    lines = [(at * 0.01, "can0 123#0102030405060708") for at in range(200) if at != 50]
    lines += [(at * 0.1 + 0.0005, "can1 12345678#") for at in range(20)]
    text = "".join(f"({time:.6f}) {frame}\n" for time, frame in sorted(lines))
    path = written(tmp_path, text)
    done = asked("stats", path, "--json", "--out", tmp_path / "load.png")
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
    assert (tmp_path / "load.png").stat().st_size > 10_000
    said = asked("stats", path).stdout
    assert "can1  12345678" in said and "load of can0 at 500 kbit/s: at most" in said
    line = "the log has no bit rate, and the load follows from it: --bitrate gives another"
    assert found["bitrate_assumed"] and line in said.splitlines()
    assert line not in asked("stats", path, "--bitrate", 250000).stdout
    assert asked("stats", path, "--bitrate", 0).returncode == 2
