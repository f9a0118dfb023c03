"""Databases with many signals: a table for each message, and one CSV table of all."""

import csv
from collections.abc import Iterator
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest

from can_rig.decoding.decode import Decoder
from can_rig.decoding.files import decode_to_files
from can_rig.frames.databases import load_database
from can_rig.logs.frames import Frames, Log
from can_rig.logs.reading import read_log
from tests.rig.decoding.databases import by_cantools

MESSAGES, SIGNALS, ROWS = 40, 16, 25
DATE_S = 1_700_000_000


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    """A log beside a database of 40 messages with 16 signals, some of them of awkward names."""
    folder = tmp_path_factory.mktemp("wide")
    lines = ['VERSION ""', "BU_: A"]
    for message in range(MESSAGES):
        lines.append(f"BO_ {256 + message} M{message:02d}: 8 A")
        for at in range(SIGNALS):
            factor = 0.25 if at % 2 else 1
            name = "time" if at == 3 and message == 7 else f"S{at}"
            lines.append(f' SG_ {name} : {at * 4}|4@1+ ({factor},0) [0|0] "" A')
    lines.append('VAL_ 256 S0 1 "say ""now"", or" 2 "two words" ;'.replace('""', '\\"'))
    (folder / "car.dbc").write_text("\n".join(lines) + "\n", "ascii")
    frames = [
        f"({DATE_S}.{row * MESSAGES + at:06d}) can0 {256 + at:X}#{row * 0x0123456789AB + at:016X}\n"
        for row in range(ROWS)
        for at in range(MESSAGES)
        if at != 5  # which does not occur
    ]
    (folder / "car.log").write_text("".join(frames), "ascii")
    return folder / "car.log"


def in_pieces(log: Log, _what: str) -> Iterator[Frames]:
    return iter(log)


def decoded(wide: Path, out: Path, names: bool = False) -> Path:
    """Decoded into ``out``, in chunks of 64 frames."""
    log = read_log(wide, chunk_frames=64)
    database = load_database(wide.with_suffix(".dbc"))
    decode_to_files(log, lambda: Decoder(database), [out], in_pieces, names=names)
    return out


def test_parquet_is_a_file_for_each_message(wide, tmp_path):
    folder = decoded(wide, tmp_path / "a.parquet")
    wanted: dict[str, list[dict[str, float]]] = {}
    for time_ns, message, values in by_cantools(wide):
        wanted.setdefault(message.name, []).append({"at": time_ns, **values})
    assert {path.stem for path in folder.glob("*.parquet")} == set(wanted)
    for name, rows in wanted.items():
        table = pd.read_parquet(folder / f"{name}.parquet")
        table.insert(0, "at", table.pop("time").astype("int64"))
        # A signal with the name of the time has its message's before it.
        assert table.rename(columns={"M07.time": "time"}).to_dict("records") == rows


def test_rows_are_held_until_a_row_group_is_long(wide, tmp_path):
    """A row group a chunk would make a footer that grows with the log, which stays in memory."""
    folder = decoded(wide, tmp_path / "a.parquet")
    for path in folder.glob("*.parquet"):
        assert (pq.ParquetFile(path).num_row_groups, pq.read_metadata(path).num_rows) == (1, ROWS)


def test_what_is_held_is_bounded(wide, tmp_path, monkeypatch):
    from can_rig.decoding import tables

    monkeypatch.setattr(tables, "_CELLS", 20 * (SIGNALS + 1))
    folder = decoded(wide, tmp_path / "a.parquet")
    assert max(pq.ParquetFile(path).num_row_groups for path in folder.glob("*.parquet")) > 5
    whole = decoded(wide, tmp_path / "b")
    monkeypatch.undo()
    same = decoded(wide, tmp_path / "c")
    assert {f.name: f.read_bytes() for f in whole.iterdir()} == {
        f.name: f.read_bytes() for f in same.iterdir()
    }


@pytest.mark.parametrize("batch", [None, 300])
def test_one_csv_table_has_every_frame_in_its_place(wide, tmp_path, monkeypatch, batch):
    from can_rig.decoding import tables

    if batch is not None:  # fewer bytes than a row has commas
        monkeypatch.setattr(tables, "_COMMAS", batch)
    path = decoded(wide, tmp_path / "a.csv", names=True)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found = list(by_cantools(wide))
    assert len(rows) == len(found) == ROWS * (MESSAGES - 1)
    assert len(rows[0]) == 2 + SIGNALS * (MESSAGES - 1)
    words = {1: 'say "now", or', 2: "two words"}
    for row, (time_ns, message, values) in zip(rows, found, strict=True):
        name = message.name
        given = {key.partition(".")[2]: text for key, text in row.items() if "." in key and text}
        assert (row["time_s"], row["message"]) == (f"{time_ns / 1e9:.6f}000", name)
        assert all(row[f"{name}.{signal}"] for signal in values)
        assert len(given) == len(values)
        if name == "M00":
            assert given.pop("S0") == words.get(values["S0"], str(values.pop("S0")))
            values.pop("S0", None)
        assert {signal: float(text) for signal, text in given.items()} == values
