"""What the channels of an MDF file mean: conversions of every type."""

from pathlib import Path

import asammdf
import pytest

from can_rig.errors import LogError
from can_rig.logs.frames import SENT
from tests.rig.logs.candump_samples import rows, whole, written
from tests.rig.logs.mdf_builder import (
    DATA,
    FIXED,
    FORMULA,
    INTERPOLATED,
    LINEAR,
    NEAREST,
    RANGES,
    RATIONAL,
    RECORD,
    TEXT,
    TEXT_TO_TEXT,
    TEXT_TO_VALUE,
    UNSIGNED,
    WORDS,
    Builder,
    Member,
    data_group,
    frames,
    group,
    members,
)

DLC_TO_BYTES = [9, 12, 10, 16, 11, 20, 12, 24, 13, 32, 14, 48, 15, 64]


def converted(tmp_path: Path, name: str, data_type: int, kind: int, *tables: list) -> Path:
    """80 frames; a channel of theirs is the last byte of the identifier, 0 to 79, converted."""
    builder = Builder()
    place = Member(f"{DATA}.{name}", 64, 8, FIXED, data_type, lambda b: b.conversion(kind, *tables))
    first = group(builder, members(builder, place), RECORD.size, 80)
    data = data_group(builder, first, builder.put(b"DT", [], frames(80)))
    return written(tmp_path, builder.file(data), "a.mf4")


@pytest.mark.parametrize(
    ("data_type", "kind", "tables"),
    [(UNSIGNED, RATIONAL, [[0, 2, 1, 0, 0, 1]]), (UNSIGNED, RATIONAL, [[1, 0, 1, 0, 0, 64]]),
     (UNSIGNED, FORMULA, [[], ["abs(X1 - 40) + 2*X"]]),
     (UNSIGNED, INTERPOLATED, [[0, 0, 10, 100, 70, 130]]),
     (UNSIGNED, NEAREST, [[2, 1, 7, 2, 20, 3, 21, 4]]), (UNSIGNED, NEAREST, [DLC_TO_BYTES]),
     (UNSIGNED, RANGES, [[3, 5, 1, 9, 9, 2, 20, 40, 3, 7]]),
     (TEXT, TEXT_TO_VALUE, [[1, 2, 5], ["A", "B"]])],
)  # fmt: skip
def test_a_number_is_what_asammdf_makes_of_it(tmp_path, data_type, kind, tables):
    path = converted(tmp_path, "BusChannel", data_type, kind, *tables)
    with asammdf.MDF(path, process_bus_logging=False) as file:
        theirs = file.get(f"{DATA}.BusChannel").samples
    assert [int(row[3]) for row in rows(whole(path, 33))] == theirs.astype(int).tolist()
    assert len(set(theirs.tolist())) > 2


def test_words_say_who_sent_a_frame(tmp_path):
    nested = [[7, 8], ["Rx", lambda b: b.linear(0, 0), lambda b: b.linear(0, 1)]]
    for data_type, kind, tables, sent in (
        (TEXT, TEXT_TO_TEXT, [[], ["A", "Tx", "B", "Rx", "Rx"]], {ord("A")}),
        (TEXT, 0, [[]], {ord("1")}),
        (TEXT, LINEAR, [[0, 1]], {ord("1")}),
        (TEXT, WORDS, [[0, 1], ["no", "Tx"]], {ord("1")}),
        (UNSIGNED, WORDS, [[0, 1], ["no", "Tx"]], set(range(1, 80))),  # codes, whatever they mean
        (UNSIGNED, WORDS, nested, set(range(1, 80)) - {8}),
    ):
        path = converted(tmp_path, "Dir", data_type, kind, *tables)
        assert {row[1] - 0x100 for row in rows(whole(path)) if row[2] & SENT} == sent


@pytest.mark.parametrize("name", ["ID", "DataLength", "BusChannel"])
@pytest.mark.parametrize(("kind", "tables"), [(0, [[]]), (WORDS, [[0], ["Tx"]])])
def test_a_number_that_is_a_word_is_refused(tmp_path, name, kind, tables):
    with pytest.raises(LogError, match=f"{name} must hold numbers, not text"):
        whole(converted(tmp_path, name, TEXT, kind, *tables))


@pytest.mark.parametrize(
    ("kind", "tables", "said"),
    [(FORMULA, [[], ["__import__('os').abort()"]], "a formula that is not read"),
     (FORMULA, [[], ["9**9**9**9"]], "a formula that is not read"), (99, [[]], "BusChannel"),
     (1, [[-1, 0]], "must be between 0 and 4294967295"),
     (1, [[float("nan"), 0]], "must be between 0 and 4294967295")],
)  # fmt: skip
def test_a_conversion_to_no_number_is_refused(tmp_path, kind, tables, said):
    with pytest.raises(LogError, match=said):
        whole(converted(tmp_path, "BusChannel", UNSIGNED, kind, *tables))
