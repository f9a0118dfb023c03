"""Objects of Vector binary logs, put together byte by byte."""

import struct
import zlib
from pathlib import Path

import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import BITRATE_SWITCH, EXTENDED, FD, REMOTE, SENT, concatenate
from can_rig.logs.reading import read_log
from tests.rig.logs.candump_samples import rows, whole, written

_HEADER = struct.pack(
    "<4sL8BQQLL8H8H", b"LOGG", 144, *[0] * 8, 0, 0, 1, 0, 1970, 1, 4, 1, *[0] * 12
).ljust(144, b"\0")


def one(kind: int, body: bytes, stamp: int = 5, unit: int = 2, size: int | None = None) -> bytes:
    length = 32 + len(body) if size is None else size
    return struct.pack("<4sHHLLLHHQ", b"LOBJ", 32, 1, length, kind, unit, 0, 0, stamp) + body


def container(data: bytes, method: int = 2, size: int | None = None) -> bytes:
    packed = zlib.compress(data) if method == 2 else data
    length = 32 + len(packed)
    head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, length, 10)
    inner = struct.pack("<H6xL4x", method, len(data) if size is None else size)
    return head + inner + packed + bytes(length % 4)


def classic(identifier: int = 0x123, flags: int = 0, dlc: int = 2, bus: int = 1) -> bytes:
    return struct.pack("<HBBL8s", bus, flags, dlc, identifier, bytes(range(1, 9)))


def fd_64(identifier: int, dlc: int, valid: int, flags: int, data: bytes) -> bytes:
    head = (2, dlc, valid, 0, identifier, 0, flags, 0, 0, 0, 0, 0, 1, 0, 0)
    return struct.pack("<BBBBLLLLLLLHBBL", *head) + data


def blf(folder: Path, *containers: bytes) -> Path:
    return written(folder, _HEADER + b"".join(containers), "a.blf")


def test_objects_of_every_type(tmp_path):
    fd = struct.pack("<HBBLLBBB5x64s", 1, 1, 9, 0x80000123, 0, 0, 3, 12, bytes(range(64)))
    objects = [
        one(1, classic()), one(115, b"another type, which is passed over"),
        one(86, classic(0x81234567, flags=1), stamp=7, unit=1), one(1, classic(flags=0x80, dlc=9)),
        one(100, fd), one(101, fd_64(0x7FF, 15, 64, 0x1000, b"\x5a" * 60)),
        one(101, fd_64(0x7FF, 5, 0, 0x1010, b"")),
    ]  # fmt: skip
    found = rows(whole(blf(tmp_path, container(b"".join(objects)))))
    assert found == [
        (5, 0x123, 0, "0", 2, b"\1\2"),
        (70_000, 0x1234567, EXTENDED | SENT, "0", 2, b"\1\2"),
        (5, 0x123, REMOTE, "0", 8, b""),
        (5, 0x123, FD | BITRATE_SWITCH | SENT | EXTENDED, "0", 12, bytes(range(12))),
        (5, 0x7FF, FD | SENT, "1", 64, b"\x5a" * 60),  # as many bytes as there are
        (5, 0x7FF, REMOTE | SENT, "1", 5, b""),
    ]


@pytest.mark.parametrize("cut", [1, 15, 16, 31, 40, 48])
@pytest.mark.parametrize("method", [0, 2])
def test_an_object_may_go_on_in_the_next_container(tmp_path, cut, method):
    data = one(1, classic()) + one(1, classic(0x124))
    path = blf(tmp_path, container(data[:cut], method), container(data[cut:], method))
    assert [row[1] for row in rows(whole(path))] == [0x123, 0x124]


@pytest.mark.parametrize("zeros", [1, 7, 8, 9, 16, 100, 5000])
@pytest.mark.parametrize("method", [0, 2])
def test_zeros_at_the_end_of_a_container(tmp_path, zeros, method):
    """And behind it, where a recorder has more room than it needs."""
    parts = [container(one(1, classic(at)) + bytes(zeros), method) + bytes(zeros) for at in (1, 2)]
    log = read_log(blf(tmp_path, *parts))
    assert [row[1] for row in rows(concatenate(log))] == [1, 2]


def test_objects_outside_any_container(tmp_path):
    path = blf(tmp_path, one(1, classic()), container(one(1, classic(0x124))))
    assert [row[1] for row in rows(whole(path))] == [0x123, 0x124]


@pytest.mark.parametrize(
    ("content", "said"),
    [(one(1, classic(), size=0), "no whole object"),
     (one(1, classic(), size=16), "no whole object"), (one(1, classic()[:9]), "no whole object"),
     (one(1, classic(), stamp=(1 << 64) - 1), "after the year 2116"),
     (one(1, classic(), stamp=1 << 61, unit=1), "after the year 2116"),
     (b"x" * 40, "no whole object")],
)  # fmt: skip
def test_an_object_that_would_never_end_is_named(tmp_path, content, said):
    with pytest.raises(LogError, match=rf"a.blf: byte 144: does not follow the format: .*{said}"):
        whole(blf(tmp_path, container(content)))


@pytest.mark.parametrize(
    ("damaged", "said"),
    [(struct.pack("<4sHHLL", b"LOBJ", 16, 1, 0, 10) + bytes(300), "plausible size"),
     (struct.pack("<4sHHLL", b"LOBJ", 16, 1, 1 << 31, 10), "plausible size"),
     (b"JBOL" + bytes(40), "plausible size"), (container(b"x", method=7), "unknown compression 7"),
     (container(b"")[:32] + b"\xff" * 8, "header check")],
)  # fmt: skip
def test_a_damaged_container_is_named(tmp_path, damaged, said):
    path = blf(tmp_path, container(one(1, classic())), damaged)
    with pytest.raises(LogError, match=rf"a.blf: byte \d+: does not follow the format: .*{said}"):
        whole(path)


def test_a_container_holds_no_more_than_it_says(tmp_path):
    """Zeros by the gigabyte take a few kilobytes."""
    inside = one(1, classic())
    path = blf(tmp_path, container(inside + bytes(10_000_000), size=len(inside)))
    log = read_log(path)
    assert [len(chunk) for chunk in log] == [1]
