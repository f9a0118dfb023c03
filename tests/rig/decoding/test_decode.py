"""Columns are what cantools says of every frame, to the bit."""

import cantools
import numpy as np
import pytest
from can import Message
from cantools.database.can import Database, Message as DbcMessage, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import example, given, settings, strategies as st

from can_rig.decoding.decode import Decoder
from tests.rig.decoding.databases import FEATURES, databases, numbers, require_agreement
from tests.rig.logs.messages import from_messages


@settings(max_examples=200)
@given(databases(), st.data())
def test_every_value_is_that_of_cantools(database, data):
    payloads = []
    for message in database.messages:
        sizes = st.one_of(st.just(message.length), st.integers(0, 64 if message.is_fd else 8))
        random = st.randoms(use_true_random=False)
        for _ in range(data.draw(st.integers(0, 6))):
            size = data.draw(sizes)
            fill = data.draw(st.sampled_from([None, 0x00, 0xFF, 0x80, 0x7F]))
            source = data.draw(random)
            payload = bytes(source.getrandbits(8) if fill is None else fill for _ in range(size))
            payloads.append((message, payload))
    order = data.draw(st.permutations(range(len(payloads))))
    require_agreement(database, [payloads[at] for at in order])


@settings(max_examples=100)
@given(
    st.integers(1, 64),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**64 - 1),
    numbers.filter(lambda x: x != 0),
    numbers,
)
@example(64, False, False, 2**64 - 1, 1, 0)
@example(64, False, True, 2**63, 1, 0)
@example(64, False, False, 2**64 - 1, 3, -1)
@example(64, False, False, 2**64 - 1025, 0.1, 0)  # half-way between two floats
@example(54, True, False, 2**53 + 1, 3, 0.5)  # the product is exact before the sum is not
@example(64, True, True, 2**63 + 1, 2**40, 0)
def test_scaling_at_the_edges(length, motorola, signed, raw, scale, offset):
    start = 7 if motorola else 0
    conversion = BaseConversion.factory(scale, offset)
    order = "big_endian" if motorola else "little_endian"
    message = DbcMessage(
        1, "M", 8, [Signal("S", start, length, order, signed, conversion=conversion)]
    )
    raw %= 1 << length
    payload = (raw << 64 - length).to_bytes(8, "big") if motorola else raw.to_bytes(8, "little")
    require_agreement(Database([message]), [(message, payload)] * 2)


@pytest.mark.parametrize(
    ("length", "signed", "scale", "kind"),
    [(63, False, 1, np.int64), (64, False, 1, np.uint64), (64, True, 1, np.int64),
     (63, False, 2, np.uint64), (64, True, 2, object), (8, False, 1.0, np.int64),
     (8, False, 0.5, np.float64)],
)  # fmt: skip
def test_columns_are_as_narrow_as_what_can_occur(length, signed, scale, kind):
    signal = Signal("S", 0, length, is_signed=signed, conversion=BaseConversion.factory(scale))
    columns = Decoder(Database([DbcMessage(1, "M", 8, [signal])])).decode(
        from_messages([Message(arbitration_id=1, is_extended_id=False, data=bytes(8))])
    )
    assert columns["M"].signals["S"].dtype == kind


def test_units_words_and_pandas():
    database = cantools.database.load_string(FEATURES, "dbc")
    payloads = [b"\xc0" + bytes(7), b"\x40" + bytes(7), b"\x80" + bytes(7)]
    decoder = Decoder(database)
    door = [Message(arbitration_id=1024, is_extended_id=False, data=p) for p in payloads]
    sonar = [
        Message(arbitration_id=200, is_extended_id=False, data=bytes([mux, 0, 10, 0, 0, 0, 0, 0]))
        for mux in (0, 1)
    ]
    chunk = decoder.decode(from_messages([*door, *sonar]))
    columns = chunk["BIG"]
    assert columns.words("DoorOpen").tolist() == ["not available", "open", None]
    assert columns.layout["Odometer"].unit == "km"
    table = chunk["SENSOR_SONARS"].to_pandas()
    assert table["LEFT"].isna().tolist() == [False, True]
    assert table["NOFILT_LEFT"].isna().tolist() == [True, False]
    assert table.index.name == "time_s"
    nested = Message(arbitration_id=201, is_extended_id=False, data=bytes([1, 0, 1, 2, 0, 0, 0, 0]))
    table = decoder.decode(from_messages([nested]))["NESTED"].to_pandas()
    assert str(table["S4"].dtype) == "Int64"
    assert table["S4"].tolist() == [0x0102]
    assert table["S3"].isna().all()
