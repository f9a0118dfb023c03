"""Columns are what cantools says of every frame, to the bit; what is not decoded is counted."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

import cantools
import numpy as np
import pytest
from can import Message
from cantools.database.can import Database, Signal
from cantools.database.can import Message as DbcMessage
from cantools.database.conversion import BaseConversion
from cantools.database.errors import DecodeError
from hypothesis import example, given, settings
from hypothesis import strategies as st

from can_rig.decoding.decode import Decoder, load_database
from can_rig.decoding.message_columns import joined
from can_rig.errors import DbcError
from can_rig.frames.protection import Checker, CheckStatus, Protector
from can_rig.logs.frames import from_messages
from tests.helpers import DBC

RIG = DBC / "steer_by_wire.dbc"


def same(ours: object, theirs: object) -> bool:
    """Equal in type and in every bit."""
    if isinstance(theirs, float):
        if math.isnan(theirs):
            return isinstance(ours, float) and math.isnan(ours)
        return isinstance(ours, float) and struct.pack("d", ours) == struct.pack("d", theirs)
    return type(ours) is type(theirs) and ours == theirs


def frames_of(messages: list[Message]):
    return from_messages(messages)


def require_agreement(database: Database, payloads: list[tuple[DbcMessage, bytes]]) -> None:
    """Decode ``payloads`` both ways, ours in two chunks."""
    sent = [
        Message(
            timestamp=at / 1000,
            arbitration_id=message.frame_id,
            is_extended_id=message.is_extended_frame,
            is_fd=message.is_fd,
            data=payload,
            dlc=len(payload),
        )
        for at, (message, payload) in enumerate(payloads)
    ]
    decoder = Decoder(database)
    middle = len(sent) // 2
    chunks = [decoder.decode(frames_of(part)) for part in (sent[:middle], sent[middle:])]
    theirs: dict[str, list[tuple[int, dict]]] = {}
    refused: dict[str, int] = {}
    for at, (message, payload) in enumerate(payloads):
        try:
            values = message.decode(payload, decode_choices=False)
        except DecodeError:
            refused[message.name] = refused.get(message.name, 0) + 1
        else:
            theirs.setdefault(message.name, []).append((at, values))
    for message in database.messages:
        parts = [chunk[message.name] for chunk in chunks if message.name in chunk]
        expected = theirs.get(message.name, [])
        counts = decoder.counts[message.name]
        assert counts.decoded == len(expected)
        assert counts.too_short + counts.unknown_multiplexer == refused.get(message.name, 0)
        if not parts:
            continue
        columns = joined(parts)
        assert columns.row.tolist() == [at for at, _ in expected]
        assert columns.time_ns.tolist() == [at * 1_000_000 for at, _ in expected]
        listed = {name: column.tolist() for name, column in columns.signals.items()}
        masks = {name: np.ma.getmaskarray(column) for name, column in columns.signals.items()}
        for row, (_, values) in enumerate(expected):
            ours = {name: listed[name][row] for name in listed if not masks[name][row]}
            assert ours.keys() == values.keys()
            for name, value in values.items():
                assert same(ours[name], value), (name, ours[name], value)


# Random databases.


@dataclass
class Layout:
    """A message under construction, in which no two signals share a bit."""

    signals: list[Signal] = field(default_factory=list)
    taken: set[int] = field(default_factory=set)

    def add(self, name: str, place: tuple[int, int, bool], **options: object) -> str | None:
        """Put a signal there, if there is room."""
        start, length, motorola = place
        bits = bits_of(start, length, motorola)
        if bits & self.taken:
            return None
        self.taken |= bits
        order = "big_endian" if motorola else "little_endian"
        self.signals.append(Signal(name, start, length, order, **options))
        return name


def bits_of(start: int, length: int, motorola: bool) -> set[int]:
    """The DBC's numbers of the bits of a signal, by walking from one to the next."""
    bits = {start}
    bit = start
    for _ in range(length - 1):
        bit = (bit + 15 if bit % 8 == 0 else bit - 1) if motorola else bit + 1
        bits.add(bit)
    return bits


numbers = st.one_of(
    st.integers(-1000, 1000),
    st.sampled_from([1, 1.0, -1, 2**40, -(2**62), 0.1, 1e-8, 0.5, -0.25, 3.0, 1e300]),
    st.floats(-1e6, 1e6, allow_nan=False),
)


@st.composite
def conversions(draw, is_float: bool):
    scale = draw(numbers.filter(lambda x: x != 0))
    choices = draw(st.none() | st.just({0: "OFF", 1: "ON"})) if not is_float else None
    return BaseConversion.factory(scale, draw(numbers | st.just(0)), choices, is_float)


@st.composite
def places(draw, size: int, length: int):
    """Start, length, byte order of a signal in ``size`` bytes."""
    motorola = draw(st.booleans())
    first = draw(st.integers(0, size * 8 - length))  # in the order of its own bits
    start = first // 8 * 8 + 7 - first % 8 if motorola else first
    return start, length, motorola


@st.composite
def layouts(draw, size: int):
    """The signals of a message of ``size`` bytes, some of them multiplexed."""
    layout = Layout()
    mux = inner = None
    if draw(st.booleans()):
        length = draw(st.integers(1, 4))
        scaled = BaseConversion.factory(draw(st.sampled_from([1, 1, 2, 0.4, -0.5])), 0)
        place = draw(places(size, length))
        mux = layout.add("Mux", place, is_multiplexer=True, conversion=scaled)
    if mux and draw(st.booleans()):
        under = {"multiplexer_signal": "Mux", "multiplexer_ids": [1, 2]}
        place = draw(places(size, draw(st.integers(1, 3))))
        inner = layout.add("Inner", place, is_multiplexer=True, **under)
    for at in range(draw(st.integers(1, 6))):
        is_float = size > 1 and draw(st.integers(0, 4)) == 0
        longest = min(80 if size > 8 else 64, size * 8)
        lengths = st.sampled_from([n for n in (16, 32, 64) if n <= size * 8] or [0])
        length = draw(lengths if is_float else st.integers(1, longest))
        options = {}
        if mux and draw(st.booleans()):
            ids = draw(st.lists(st.integers(0, 4), min_size=1, unique=True))
            above = "Inner" if inner and draw(st.booleans()) else "Mux"
            options = {"multiplexer_signal": above, "multiplexer_ids": ids}
        layout.add(
            f"S{at}",
            draw(places(size, length)),
            is_signed=not is_float and draw(st.booleans()),
            conversion=draw(conversions(is_float)),
            **options,
        )
    return layout.signals


@st.composite
def databases(draw):
    messages = []
    for number in range(draw(st.integers(1, 3))):
        is_fd = draw(st.booleans())
        size = draw(st.sampled_from([8, 12, 48, 64]) if is_fd else st.integers(1, 8))
        extended = draw(st.booleans())
        messages.append(
            DbcMessage(
                0x100 + number,
                f"M{number}",
                size,
                draw(layouts(size)),
                is_extended_frame=extended,
                is_fd=is_fd,
            )
        )
    return Database(messages=messages)


@settings(max_examples=200, deadline=None)
@given(databases(), st.data())
def test_every_value_is_that_of_cantools(database: Database, data: st.DataObject) -> None:
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


@settings(max_examples=100, deadline=None)
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
def test_scaling_at_the_edges(length, motorola, signed, raw, scale, offset) -> None:
    start = 7 if motorola else 0
    conversion = BaseConversion.factory(scale, offset)
    order = "big_endian" if motorola else "little_endian"
    message = DbcMessage(
        1, "M", 8, [Signal("S", start, length, order, signed, conversion=conversion)]
    )
    raw %= 1 << length
    payload = (raw << 64 - length).to_bytes(8, "big") if motorola else raw.to_bytes(8, "little")
    require_agreement(Database([message]), [(message, payload)] * 2)


# What public DBCs have.

FEATURES = """VERSION ""
NS_ :
BS_:
BU_: ECU GW
BO_ 2364540158 EEC1: 8 ECU
 SG_ EngSpeed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" GW
 SG_ ActualEngPercTorque : 16|8@1+ (1,-125) [-125|125] "%" GW
BO_ 500 IO_DEBUG: 8 GW
 SG_ FLOAT_LE : 0|32@1- (1,0) [0|0] "V" ECU
 SG_ FLOAT_BE : 39|32@0- (0.5,1) [0|0] "A" ECU
BO_ 200 SENSOR_SONARS: 8 ECU
 SG_ MUX M : 0|4@1+ (1,0) [0|0] "" GW
 SG_ ERR : 4|12@1+ (1,0) [0|0] "" GW
 SG_ LEFT m0 : 16|12@1+ (0.1,0) [0|0] "cm" GW
 SG_ RIGHT m0 : 28|12@1- (0.1,-5) [0|0] "cm" GW
 SG_ NOFILT_LEFT m1 : 16|12@1+ (0.1,0) [0|0] "cm" GW
BO_ 201 NESTED: 8 ECU
 SG_ S0 M : 0|4@1+ (1,0) [0|0] "" GW
 SG_ S1 m0M : 4|4@1+ (1,0) [0|0] "" GW
 SG_ S2 m0 : 8|8@1+ (1,0) [0|0] "" GW
 SG_ S3 m0 : 16|16@1+ (1,0) [0|0] "" GW
 SG_ S4 m1 : 23|16@0+ (1,0) [0|0] "" GW
 SG_ LAST : 63|1@1+ (1,0) [0|0] "" GW
BO_ 1024 BIG: 8 ECU
 SG_ DoorOpen : 7|2@0+ (1,0) [0|3] "" GW
 SG_ Odometer : 5|30@0+ (0.001,0) [0|0] "km" GW
 SG_ Temp : 36|7@0- (1,-40) [0|0] "degC" GW
SIG_VALTYPE_ 500 FLOAT_LE : 1;
SIG_VALTYPE_ 500 FLOAT_BE : 1;
SG_MUL_VAL_ 201 S1 S0 0-0;
SG_MUL_VAL_ 201 S4 S0 1-1;
SG_MUL_VAL_ 201 S2 S1 0-1;
SG_MUL_VAL_ 201 S3 S1 2-2, 4-5;
VAL_ 1024 DoorOpen 0 "closed" 1 "open" 3 "not available" ;
"""


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.binary(min_size=8, max_size=8)), max_size=30))
def test_the_features_of_public_databases(draws: list[tuple[int, bytes]]) -> None:
    database = cantools.database.load_string(FEATURES, "dbc")
    require_agreement(database, [(database.messages[at], payload) for at, payload in draws])


@pytest.mark.parametrize(
    ("length", "signed", "scale", "kind"),
    [
        (63, False, 1, np.int64),
        (64, False, 1, np.uint64),
        (64, True, 1, np.int64),
        (63, False, 2, np.uint64),
        (64, True, 2, object),
        (8, False, 1.0, np.int64),
        (8, False, 0.5, np.float64),
    ],
)
def test_columns_are_as_narrow_as_what_can_occur(length, signed, scale, kind) -> None:
    signal = Signal("S", 0, length, is_signed=signed, conversion=BaseConversion.factory(scale))
    columns = Decoder(Database([DbcMessage(1, "M", 8, [signal])])).decode(
        frames_of([Message(arbitration_id=1, is_extended_id=False, data=bytes(8))])
    )
    assert columns["M"].signals["S"].dtype == kind


def test_units_words_and_pandas() -> None:
    database = cantools.database.load_string(FEATURES, "dbc")
    payloads = [b"\xc0" + bytes(7), b"\x40" + bytes(7), b"\x80" + bytes(7)]
    decoder = Decoder(database)
    door = [Message(arbitration_id=1024, is_extended_id=False, data=p) for p in payloads]
    sonar = [
        Message(arbitration_id=200, is_extended_id=False, data=bytes([mux, 0, 10, 0, 0, 0, 0, 0]))
        for mux in (0, 1)
    ]
    chunk = decoder.decode(frames_of([*door, *sonar]))
    columns = chunk["BIG"]
    assert columns.words("DoorOpen").tolist() == ["not available", "open", None]
    assert columns.layout["Odometer"].unit == "km"
    table = chunk["SENSOR_SONARS"].to_pandas()
    assert table["LEFT"].isna().tolist() == [False, True]
    assert table["NOFILT_LEFT"].isna().tolist() == [True, False]
    assert table.index.name == "time_s"
    nested = Message(arbitration_id=201, is_extended_id=False, data=bytes([1, 0, 1, 2, 0, 0, 0, 0]))
    table = decoder.decode(frames_of([nested]))["NESTED"].to_pandas()
    assert str(table["S4"].dtype) == "Int64"
    assert table["S4"].tolist() == [0x0102]
    assert table["S3"].isna().all()


# What is not decoded.


def protected(counters: list[int], data_id: int) -> list[bytes]:
    frames = []
    for counter in counters:
        data = bytearray(8)
        data[4] = counter
        protector = Protector(data_id)
        protector._counter = counter
        protector.protect(data)
        frames.append(bytes(data))
    return frames


@settings(max_examples=60, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 14), st.sampled_from(["good", "good", "good", "bad", "short"])),
        max_size=40,
    ),
    st.integers(0, 40),
)
def test_protected_frames_are_judged_as_the_receiver_judges_them(
    draws: list[tuple[int, str]], middle: int
) -> None:
    """By a `Checker` that tolerates every step, as a log has no ticks in which nothing came."""
    database = load_database(RIG)
    message = database.messages[0]
    data_id = message.dbc.attributes["E2EDataId"].value
    checker = Checker(data_id, max_delta_counter=14)
    frames, statuses = [], []
    for (_, fate), sent in zip(
        draws, protected([counter for counter, _ in draws], data_id), strict=True
    ):
        damaged = {
            "good": sent,
            "bad": sent[:5] + bytes([sent[5] ^ 1]) + sent[6:],
            "short": sent[:7],
        }
        data = damaged[fate]
        frames.append(Message(arbitration_id=message.frame_id, is_extended_id=False, data=data))
        statuses.append(checker.check(bytearray(data)))
    decoder = Decoder(database)
    chunks = [decoder.decode(frames_of(part)) for part in (frames[:middle], frames[middle:])]
    counts = decoder.counts[message.name]
    usable = [
        s in (CheckStatus.OK, CheckStatus.INITIAL, CheckStatus.OK_SOME_LOST) for s in statuses
    ]
    rows = [r for chunk in chunks for c in chunk.values() for r in c.row.tolist()]
    assert rows == [row for row, fit in enumerate(usable) if fit]
    assert counts.frames == len(frames)
    assert counts.wrong_crc == statuses.count(CheckStatus.WRONG_CRC)
    assert counts.too_short == statuses.count(CheckStatus.WRONG_LENGTH)
    assert counts.repeated == statuses.count(CheckStatus.REPEATED)
    assert counts.gaps == statuses.count(CheckStatus.OK_SOME_LOST)


def test_lost_frames_are_those_that_were_taken_out() -> None:
    database = load_database(RIG)
    message = database.messages[1]
    data_id = message.dbc.attributes["E2EDataId"].value
    kept = [n for n in range(100) if n not in {5, 20, 21, 22, 99}]
    data = protected([n % 15 for n in kept], data_id)
    frames = [Message(arbitration_id=message.frame_id, is_extended_id=False, data=d) for d in data]
    decoder = Decoder(database)
    decoder.decode(frames_of(frames))
    counts = decoder.counts[message.name]
    assert (counts.gaps, counts.lost, counts.decoded) == (2, 4, 95)


def test_every_frame_is_accounted_for() -> None:
    database = load_database(RIG)
    same_number = {"arbitration_id": 0x100, "data": bytes(8)}
    frames = [
        Message(arbitration_id=0x100, is_extended_id=False, data=bytes(8)),
        Message(**same_number),  # extended: another frame
        Message(arbitration_id=0x100, is_extended_id=False, is_remote_frame=True, dlc=8),
        Message(arbitration_id=0x7FF, is_extended_id=False),
        Message(arbitration_id=0x100, is_extended_id=False, is_error_frame=True),
    ]
    decoder = Decoder(database)
    assert len(decoder.decode(frames_of(frames))["DSTAR_REFERENCE"]) == 0
    counts = decoder.counts["DSTAR_REFERENCE"]
    assert (counts.frames, counts.wrong_crc, counts.remote) == (2, 1, 1)
    assert dict(decoder.unknown) == {"00000100": 1, "7FF": 1}
    assert (decoder.frames, decoder.error_frames) == (5, 1)


def test_channels_are_told_apart() -> None:
    database = cantools.database.load_string(FEATURES, "dbc")
    frames = [
        Message(arbitration_id=1024, is_extended_id=False, data=bytes(8), channel=name)
        for name in ("can0", "can1", "can1")
    ]
    decoder = Decoder(database, channel="can1")
    assert len(decoder.decode(frames_of(frames))["BIG"]) == 2
    assert (decoder.not_wanted, decoder.nothing_on_channel) == (1, None)
    decoder = Decoder(database, channel="can7")
    assert decoder.decode(frames_of(frames)) == {}
    assert "can0, can1" in decoder.nothing_on_channel


def test_only_what_is_wanted() -> None:
    database = cantools.database.load_string(FEATURES, "dbc")
    frames = [
        Message(arbitration_id=1024, is_extended_id=False, data=bytes(8)),
        Message(arbitration_id=200, is_extended_id=False, data=bytes(8)),
    ]
    chunk = Decoder(database, signals=["BIG.Temp", "LEFT"]).decode(frames_of(frames))
    assert {name: list(columns.signals) for name, columns in chunk.items()} == {
        "SENSOR_SONARS": ["LEFT"],
        "BIG": ["Temp"],
    }
    decoder = Decoder(database, messages=["BIG"])
    assert list(decoder.decode(frames_of(frames))) == ["BIG"]
    assert decoder.not_wanted == 1
    with pytest.raises(DbcError, match=r"no signal Tmp in the database; it has .*Temp"):
        Decoder(database, signals=["Tmp"])
    with pytest.raises(DbcError, match="no message BIGG"):
        Decoder(database, messages=["BIGG"])


def test_a_signal_that_does_not_fit_is_refused() -> None:
    text = FEATURES.replace("Temp : 36|7@0-", "Temp : 60|16@0-")
    database = cantools.database.load_string(text, "dbc", strict=False)
    with pytest.raises(DbcError, match="message BIG: signal Temp ends behind its 8 bytes"):
        Decoder(database)
