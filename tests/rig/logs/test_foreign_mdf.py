"""MDF files as other loggers write them: virtual channels, records of several groups, lists."""

import struct
from collections.abc import Callable

import asammdf
import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import EXTENDED, FD, REMOTE, SENT, concatenate
from can_rig.logs.reading import read_log
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.mdf_builder import (
    BYTES,
    DATA,
    FLOAT,
    RECORD,
    VARIABLE,
    VIRTUAL,
    Builder,
    Member,
    data_group,
    described_first,
    frames,
    group,
    members,
)

START_NS = 10**18


def virtual(builder: Builder) -> list[Member]:
    """Bus 3, extended, sent: equal for all records, so virtual channels."""
    return members(
        builder,
        Member(f"{DATA}.BusChannel", 0, 0, VIRTUAL, conversion=lambda b: b.linear(3, 0)),
        Member(f"{DATA}.IDE", 0, 0, VIRTUAL, conversion=lambda b: b.linear(1, 0)),
        Member(f"{DATA}.Dir", 0, 0, VIRTUAL, conversion=lambda b: b.words([], ["Tx"])),
    )


def expected(count: int, flags: int = 0, bus: str = "0") -> list[tuple]:
    return [
        (
            START_NS + at * 1_000_000 + 7,
            0x100 + at,
            flags,
            bus,
            8,
            bytes([at % 256] * 8).rstrip(b"\0"),
        )
        for at in range(count)
    ]


def test_virtual_channels_are_what_their_conversion_says(tmp_path):
    builder = Builder()
    first = group(builder, virtual(builder), RECORD.size, 300)
    data = data_group(builder, first, builder.put(b"DT", [], frames(300)))
    path = written(tmp_path, builder.file(data), "a.mf4")
    assert rows(whole(path, chunk_frames=77)) == expected(300, EXTENDED | SENT, "3")
    with asammdf.MDF(path, process_bus_logging=False) as file:  # reads the same file alike
        assert set(file.get(f"{DATA}.BusChannel").samples) == {3}
        assert file.get(f"{DATA}.ID", raw=True).samples.tolist() == [
            0x100 + at for at in range(300)
        ]


@pytest.mark.parametrize("layout", ["packed", "transposed", "list", "header list"])
def test_data_in_lists_and_compressed(tmp_path, layout):
    builder = Builder()
    first = group(builder, members(builder), RECORD.size, 50)
    content = frames(50)
    if layout == "packed":
        at = builder.packed(content)
    elif layout == "transposed":
        at = builder.packed(content, RECORD.size)
    else:
        parts = [builder.put(b"DT", [], content[:333]), builder.packed(content[333:700])]
        rest = builder.data_list([builder.put(b"DT", [], content[700:])])
        at = builder.data_list(parts, rest)
        if layout == "header list":
            at = builder.put(b"HL", [at], bytes(8))
    path = written(tmp_path, builder.file(data_group(builder, first, at)), "a.mf4")
    assert rows(whole(path)) == expected(50)


def among(count: int, id_bytes: int) -> bytes:
    """Records of three groups: 5 holds frames, 9 payloads, 2 unrelated data."""
    data, offset = b"", 0
    for at in range(count):
        content = bytes([at] * (at % 9))
        record = RECORD.pack(at * 1_000_000, 0x100 + at, 8, len(content), struct.pack("<Q", offset))
        value = struct.pack("<I", len(content)) + content
        offset += len(value)
        for number, one in ((2, b"\xff" * 8), (5, record), (9, value)):
            data += number.to_bytes(id_bytes, "little") + one
    return data


def groups_among(builder: Builder, count: int) -> int:
    """The descriptions of the three; the place of the first."""
    values = group(builder, [], 0, count, number=9, flags=1)
    payload = Member(f"{DATA}.DataBytes", 112, 64, VARIABLE, BYTES, data=values)
    own = group(
        builder, members(builder, payload=payload), RECORD.size, count, number=5, following=values
    )
    speed = Member("Speed", 0, 64, data_type=FLOAT)
    return group(builder, [speed], 8, count, number=2, following=own)


@pytest.mark.parametrize("id_bytes", [1, 2, 4, 8])
def test_records_of_several_groups_among_one_another(tmp_path, id_bytes):
    """With payloads of varying length: each is a record of a group of its own."""
    builder = Builder()
    data = among(40, id_bytes)
    first = groups_among(builder, 40)
    at = builder.data_list([builder.put(b"DT", [], data[:501]), builder.packed(data[501:])])
    path = written(tmp_path, builder.file(data_group(builder, first, at, id_bytes)), "a.mf4")
    found = rows(whole(path))
    assert [row[1] for row in found] == [0x100 + at for at in range(40)]
    assert [row[4:] for row in found] == [(at % 9, bytes([at] * (at % 9))) for at in range(40)]


def test_payloads_of_varying_length_in_a_block_of_their_own(tmp_path):
    builder = Builder()
    values = b"".join(struct.pack("<I", 4) + bytes([at] * 4) for at in range(1, 31))
    at = builder.put(b"SD", [], values)
    payload = Member(f"{DATA}.DataBytes", 112, 64, VARIABLE, BYTES, data=at)
    records = b"".join(RECORD.pack(n, n, 4, 4, struct.pack("<Q", 8 * n)) for n in range(30))
    first = group(builder, members(builder, payload=payload), RECORD.size, 30)
    path = written(
        tmp_path, builder.file(data_group(builder, first, builder.put(b"DT", [], records))), "a.mf4"
    )
    assert [row[5] for row in rows(whole(path, 7))] == [bytes([at] * 4) for at in range(1, 31)]


def test_a_file_that_its_logger_left_open(tmp_path):
    """Neither the number of records nor the length of the data is in it."""
    left_open = Builder(b"UnFinMF 4.11    test    ", flags=4 + 1)
    first = group(left_open, members(left_open), RECORD.size, 0)
    group_bytes, header_bytes = 24 + 4 * 8 + 8, 24
    data = data_group(left_open, first, 168 + len(left_open.body) + group_bytes)
    at = left_open.put(b"DT", [], b"")
    assert at + header_bytes == 168 + len(left_open.body)
    left_open.body += frames(20) + b"cut off"
    log = read_log(written(tmp_path, left_open.file(data), "a.mf4"))
    assert rows(concatenate(log)) == expected(20)
    assert log.notice is not None


@pytest.mark.parametrize("layout", ["plain", "packed", "transposed", "among", "apart"])
def test_cut_off_anywhere(tmp_path, layout):
    """A logger describes its records first, so that a cut log has the frames up to the cut."""
    start = b"UnFinMF 4.11" if layout == "among" else b"MDF     4.11"
    builder, behind = Builder(start), 168 + 4096
    if layout == "among":
        data, first = among(12, 1), groups_among(builder, 12)
    elif layout == "apart":
        data = b"".join(RECORD.pack(n, n, 8, 8, struct.pack("<Q", 12 * n)) for n in range(12))
        payload = Member(f"{DATA}.DataBytes", 112, 64, VARIABLE, BYTES, data=behind)
        first = group(builder, members(builder, payload=payload), RECORD.size, 12)
    else:
        data, first = frames(12), group(builder, members(builder), RECORD.size, 12)
    columns = RECORD.size if layout == "transposed" else 0
    is_packed = layout in ("packed", "transposed")

    def half(part: bytes) -> Callable[[Builder], int]:
        return lambda b: b.packed(part, columns) if is_packed else b.put(b"DT", [], part)

    halves = [half(data[: RECORD.size * 5]), half(data[RECORD.size * 5 :])]
    data_groups = described_first(builder, first, halves, int(layout == "among"))
    if layout == "apart":
        builder.body += bytes(behind - 168 - len(builder.body))
        values = b"".join(struct.pack("<I8s", 8, bytes([n] * 8)) for n in range(12))
        builder.put(b"SD", [], values)
    good = builder.file(data_groups)
    every = rows(whole(written(tmp_path, good, "a.mf4")))
    assert len(every) == 12
    most = 0
    for cut in (*range(len(good) - 1200, len(good) - 50, 17), *range(len(good) - 50, len(good))):
        log = read_log(written(tmp_path, good[:cut], "a.mf4"))
        try:
            found = rows(concatenate(log))
        except LogError as error:
            assert "MDF 4 file that is cut off" in str(error)
            assert most == 0
            continue
        assert found == every[: len(found)]
        assert len(found) >= most
        most = len(found)
        assert "is cut off" in (log.notice or "")
    assert most >= (5 if layout == "transposed" else 11)


@pytest.mark.parametrize("rest", [bytes(3), bytes(5000)])
def test_room_that_a_logger_did_not_use(tmp_path, rest):
    builder = Builder(b"UnFinMF 4.11    test    ", flags=4 + 1)
    first = groups_among(builder, 0)
    data = described_first(builder, first, [lambda b: b.put(b"DT", [], among(30, 1) + rest)], 1)
    log = read_log(written(tmp_path, builder.file(data), "a.mf4"))
    assert [row[1] for row in rows(concatenate(log))] == [0x100 + at for at in range(30)]
    assert "is cut off" in (log.notice or "")


def always(name: str) -> Member:
    return Member(f"{DATA}.{name}", 0, 0, VIRTUAL, conversion=lambda b: b.linear(1, 0))


def test_a_remote_frame_is_never_one_of_can_fd(tmp_path):
    for marks, flags in ((["EDL"], FD), (["EDL", "RTR"], REMOTE)):
        builder = Builder()
        first = group(builder, members(builder, *map(always, marks)), RECORD.size, 3)
        data = data_group(builder, first, builder.put(b"DT", [], frames(3)))
        found = rows(whole(written(tmp_path, builder.file(data), "a.mf4")))
        assert {row[2] for row in found} == {flags}


@pytest.mark.parametrize("seed", range(4))
def test_a_changed_byte_is_read_or_refused_in_one_line(tmp_path, seed):
    builder = Builder()
    first = group(builder, virtual(builder), RECORD.size, 20)
    data = data_group(builder, first, builder.packed(frames(20), RECORD.size))
    good = builder.file(data)
    for at in range(seed, len(good), 4):
        for value in (0, 255, good[at] ^ 1):
            path = written(tmp_path, good[:at] + bytes([value]) + good[at + 1 :], "a.mf4")
            try:
                assert len(whole(path)) <= 20
            except LogError as error:
                assert str(error).startswith(str(path))
                assert "\n" not in str(error)
