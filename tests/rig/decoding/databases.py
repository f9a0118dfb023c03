"""Databases to decode with, random and of features of public DBCs, and cantools' answer."""

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cantools
import numpy as np
from can import Message
from cantools.database.can import Database, Message as DbcMessage, Signal
from cantools.database.conversion import BaseConversion
from cantools.database.errors import DecodeError
from hypothesis import strategies as st

from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_decoder import joined
from tests.rig.logs.messages import from_messages


def same(ours: object, theirs: object) -> bool:
    """Equal in type and in every bit."""
    if isinstance(theirs, float):
        if math.isnan(theirs):
            return isinstance(ours, float) and math.isnan(ours)
        return isinstance(ours, float) and struct.pack("d", ours) == struct.pack("d", theirs)
    return type(ours) is type(theirs) and ours == theirs


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
    chunks = [decoder.decode(from_messages(part)) for part in (sent[:middle], sent[middle:])]
    theirs: dict[str, list[tuple[int, dict]]] = {}
    refused: dict[str, int] = {}
    for at, (message, payload) in enumerate(payloads):
        try:
            values = message.decode(payload, decode_choices=False, allow_truncated=True)
        except DecodeError:
            values = {}
        if values or (not message.signals and len(payload) >= message.length):
            theirs.setdefault(message.name, []).append((at, values))
        else:
            refused[message.name] = refused.get(message.name, 0) + 1
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


@dataclass
class Layout:
    """A message under construction, in which no two signals share a bit."""

    signals: list[Signal] = field(default_factory=list)
    taken: set[int] = field(default_factory=set)

    def add(self, name: str, place: tuple[int, int, bool], **options: object) -> str | None:
        """Add a signal at this place, if the place is free."""
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


def by_cantools(log: Path) -> Iterator[tuple[int, DbcMessage, dict[str, float]]]:
    """Time stamp [ns], message and values of each frame."""
    database = cantools.database.load_file(log.with_suffix(".dbc"))
    for line in log.read_text("ascii").splitlines():
        stamp, _, frame = line.split()
        identifier, _, payload = frame.partition("#")
        message = database.get_message_by_frame_id(int(identifier, 16))
        values = message.decode(bytes.fromhex(payload), decode_choices=False)
        yield int(stamp.strip("()").replace(".", "")) * 1000, message, values
