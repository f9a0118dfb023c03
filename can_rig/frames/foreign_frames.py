"""The frames of a tick in a foreign database, by the signal of each role.

cantools reads the database in any format, and packs and unpacks the frames. Each role needs a
separate message and a representable 0; the layout is free.

A signal counts steps k of its factor's size from the value 0, so that a record has the same meaning
for every offset and sign: k = ±(raw + offset/factor), value = k · |factor|. For a float, k is the
value.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

from cantools.database.can import Database, Message, Signal

from can_rig.errors import DbcError, did_you_mean
from can_rig.frames.codec import ROLES, Coding, MessageCodec, Unpacked
from can_rig.frames.databases import load_for
from can_rig.frames.network import Network, require_distinct_data_ids, words_of
from firmware_model.law.status import Verdict

FD_LENGTHS: Final[tuple[int, ...]] = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Data lengths of CAN FD frames [bytes], by DLC."""
FLOATS: Final = {16: "<e", 32: "<f", 64: "<d"}
ON_GRID: Final = 1e-6  # of a step
CODES: Final = {"mode": 3, "fault_state": 3, "verdict": max(Verdict)}
"""The largest of each."""
TICK_BITS: Final = 16


@dataclass(frozen=True)
class Places:
    """The signals of a message with a meaning for the rig."""

    value: Signal
    tick: Signal | None = None
    mode: Signal | None = None
    fault_state: Signal | None = None
    verdict: Signal | None = None

    @property
    def fields(self) -> dict[str, Signal]:
        """The signals that the message has, by their names here."""
        return {name: signal for name, signal in vars(self).items() if signal is not None}

    @property
    def codes(self) -> Iterator[tuple[str, Signal]]:
        """The code signals, with each code's name."""
        return ((name, signal) for name, signal in self.fields.items() if name in CODES)


@dataclass(frozen=True)
class Where:
    """The place of an error.

    Attributes:
        message: its file and its name.
        keys: of a scenario, by signal name.
    """

    message: str
    keys: Mapping[str, str]

    def of(self, signal: Signal) -> str:
        """The begin of a line about ``signal``."""
        key = self.keys.get(signal.name)
        return f"{self.message}: signal {signal.name}" + (f" ({key})" if key else "")


class AnyLayout:
    """The layout of one message in a database.

    Args:
        message: of the database.
        places: the message's mapped signals; all other signals send their initial value, or raw 0.
        where: begins the line of a refusal.
        mirrored: whether the value has the other sign.

    Raises:
        DbcError: a message too long for a frame, a signal unusable for the rig.
    """

    def __init__(
        self, message: Message, places: Places, where: Where, mirrored: bool = False
    ) -> None:
        self._message, self._places = message, places
        self.has_tick: Final = places.tick is not None
        self.length: Final = _frame_length(message, where)
        for signal in places.fields.values():
            if signal.multiplexer_ids:
                raise DbcError(f"{where.of(signal)} is multiplexed: must be in every frame")
        self.coding: Final = Coding(
            -1 if (places.value.scale < 0) != mirrored else 1,
            0 if is_float(places.value) else _steps_to_zero(places.value, where),
            bool(places.value.is_signed),
        )
        self._rest: dict[str, int | float] = {s.name: _initial(message, s) for s in message.signals}
        if places.tick is not None:
            _require_counter(places.tick, where)
            self._tick_mask = (1 << places.tick.length) - 1
        for name, code in places.codes:
            if not _holds(code, CODES[name]):
                bits = CODES[name].bit_length()
                raise DbcError(
                    f"{where.of(code)}: must be an integer of at least {bits} bits, factor 1, "
                    "offset 0"
                )
        self.places: Final = {name: bits_of(each) for name, each in places.fields.items()}

    def share(self, other: AnyLayout) -> None:
        """Pack a frame together with ``other``, of the same message: each sends both values."""
        self._rest = other._rest

    def pack(self, k: float, tick: int, mode: int, fault_state: int, verdict: int) -> bytearray:
        """The bytes of a frame, including the initial values of unmapped signals."""
        places, raw = self._places, self._rest
        if is_float(places.value):
            raw[places.value.name] = k
        else:
            sign, from_zero, _ = self.coding
            raw[places.value.name] = sign * int(k) - from_zero
        if places.tick is not None:
            raw[places.tick.name] = tick & 0xFFFF & self._tick_mask
        said = {"mode": mode, "fault_state": fault_state, "verdict": verdict}
        for name, signal in places.codes:
            raw[signal.name] = min(max(said[name], 0), CODES[name])
        data = bytearray(self._message.encode(raw, scaling=False, strict=False))
        data.extend(bytes(self.length - len(data)))
        return data

    def unpack(self, data: bytes | bytearray) -> Unpacked:
        """The content of a frame of the right length."""
        raw: Any = self._message.decode(bytes(data), decode_choices=False, scaling=False)
        places, (sign, from_zero, _) = self._places, self.coding
        k = raw[places.value.name]
        return (
            k if is_float(places.value) else sign * (k + from_zero),
            0 if places.tick is None else int(raw[places.tick.name]) & 0xFFFF,
            0 if places.mode is None else raw[places.mode.name],
            0 if places.fault_state is None else raw[places.fault_state.name],
            0 if places.verdict is None else raw[places.verdict.name],
        )

    def tick(self, data: bytes | bytearray) -> int | None:
        """A frame's tick, modulo 65536; None for a frame without a tick."""
        if not self.has_tick:
            return None
        return self.unpack(data)[1] if len(data) == self.length else 0


@dataclass(frozen=True)
class Scale:
    """A signal's steps, in the fields of ``MessageCodec``."""

    lsb: float
    raw_maximum: int | float
    not_available: int | float
    """Raw value for not-a-number."""
    float_format: str = ""


def scale_of(signal: Signal, where: Where) -> Scale:
    """The steps of ``signal``, in a range symmetric about 0.

    Raises:
        DbcError: a range with a single sign, a factor of 0.
    """
    low, high = signal.minimum, signal.maximum
    if is_float(signal):
        if (signal.scale, signal.offset) != (1, 0):
            raise DbcError(f"{where.of(signal)} is a float: must have factor 1, offset 0")
        form = FLOATS[signal.length]
        largest = _largest(form)
        reach = min(-(low or -largest), high or largest, largest)
        if not reach > 0.0:
            raise DbcError(_one_sign(signal, f"{low}..{high}", where))
        return Scale(0.0, reach, math.nan, form)
    offset, lsb = _steps_to_zero(signal, where), abs(float(signal.scale))
    bits = signal.length
    lowest = (-(1 << (bits - 1)) if signal.is_signed else 0) + offset
    highest = lowest + (1 << bits) - 1
    if signal.scale < 0:
        lowest, highest = -highest, -lowest
    first = lowest if low is None else max(lowest, math.ceil(low / lsb - ON_GRID))
    last = highest if high is None else min(highest, math.floor(high / lsb + ON_GRID))
    reach = min(last, -first)
    if reach < 1:
        raise DbcError(_one_sign(signal, f"{first * lsb:g}..{last * lsb:g}", where))
    # 2^n is even, the count from -reach to reach odd: one raw value remains
    return Scale(lsb, reach, lowest if lowest < -reach else highest)


def is_float(signal: Signal) -> bool:
    """Whether the signal is an IEEE 754 number."""
    return bool(signal.is_float)


def _one_sign(signal: Signal, carries: str, where: Where) -> str:
    return f"{where.of(signal)} carries {carries}: must reach below 0 and above 0"


def _steps_to_zero(signal: Signal, where: Where) -> int:
    """Steps of the factor from raw 0 to the value 0, negative: the addend of a raw value."""
    if not signal.scale:
        raise DbcError(f"{where.of(signal)}: factor {signal.scale}: must not be 0")
    steps = float(signal.offset) / float(signal.scale)
    if abs(steps - round(steps)) > ON_GRID * max(1.0, abs(steps)):
        raise DbcError(
            f"{where.of(signal)}: offset {signal.offset}: must be a multiple of the "
            f"factor {signal.scale}, so that 0 can be sent"
        )
    return round(steps)


def _largest(form: str) -> float:
    """The largest finite float of a format."""
    ones = {"<e": "ff7b", "<f": "ffff7f7f", "<d": "ffffffffffffef7f"}[form]
    return float(struct.unpack(form, bytes.fromhex(ones))[0])


def _frame_length(message: Message, where: Where) -> int:
    longest, own = FD_LENGTHS[-1] if message.is_fd else 8, int(message.length)
    if not 0 < own <= longest:
        raise DbcError(
            f"{where.message}: {own} bytes: must be 1 to 8, or to 64 if the database marks the "
            "frame as CAN FD"
        )
    return min(length for length in FD_LENGTHS if length >= own)


def _holds(signal: Signal, largest: int) -> bool:
    bits = int(signal.length) - bool(signal.is_signed)
    plain = not is_float(signal) and (signal.scale, signal.offset) == (1, 0)
    return bool(plain and largest >> bits == 0)


def _require_counter(signal: Signal, where: Where) -> None:
    if signal.is_signed or not _holds(signal, (1 << TICK_BITS) - 1):
        raise DbcError(
            f"{where.of(signal)}: must be an unsigned integer of at least "
            f"{TICK_BITS} bits, factor 1, offset 0, to count the ticks"
        )


def _initial(message: Message, signal: Signal) -> int | float:
    """The sent value of an unmapped signal."""
    if signal.is_multiplexer:
        for other in message.signals:
            if other.multiplexer_signal == signal.name and other.multiplexer_ids:
                return int(other.multiplexer_ids[0])
    initial: float = signal.raw_initial or 0
    return initial


STATUS = "fault_estimate"  # the key of the status message's value
WORDS = {
    "mode": {0: "STANDBY", 1: "RUN", 2: "BLIND", 3: "SAFE_STOP"},
    "fault_state": {0: "CLEAR", 1: "SUSPECTED", 2: "CONFIRMED", 3: "CANNOT_TELL"},
    "verdict": {int(verdict): verdict.name for verdict in Verdict},
}


@dataclass(frozen=True)
class Roles:
    """The signal of each role.

    Attributes:
        signals: ``Message.Signal`` of reference, feedback, command_1, command_2, fault_estimate
            and, if present, mode, fault_state and verdict.
        tick: the name of the tick-counting signal in every message; "": no tick signal.
            Alternatively the names by role.
        data_ids: E2E data identifier of each protected message, by role.
    """

    signals: Mapping[str, str]
    tick: str | Mapping[str, str] = ""
    data_ids: Mapping[str, int] = field(default_factory=dict)
    sensors: Mapping[str, tuple[str, Callable[[str], float]]] = field(default_factory=dict)
    """By role of a further sensor ``Message.Signal``, and the factor for a unit of the database."""


def map_network(path: str | Path, mapping: Roles) -> Network:
    """The frames named by ``mapping`` in the database at ``path``.

    Raises:
        DbcError: an unknown database, message or signal, two roles for one message or signal, a
            signal too small for its role.
    """
    signals = {**mapping.signals, **{role: name for role, (name, _) in mapping.sensors.items()}}
    database = load_for(path, {name.partition(".")[0] for name in signals.values()})
    found = {key: _signal(database, path, key, name) for key, name in signals.items() if name}
    codecs: list[MessageCodec] = []
    by_id: dict[int, str] = {}
    layouts: dict[int, AnyLayout] = {}
    for role in (*ROLES, *mapping.sensors):
        key = STATUS if role == "status" else role
        message, value = found[key]
        codes = {code: found[code][1] for code in CODES if role == "status" and code in found}
        for code in codes:
            if found[code][0] is not message:
                raise DbcError(
                    f"network.signals.{code} = {mapping.signals[code]!r}: must be in message "
                    f"{message.name}, with the fault estimate"
                )
        other = by_id.setdefault(message.frame_id, role)
        if other != role and not {role, other} <= mapping.sensors.keys():
            raise DbcError(
                f"network.signals: {other} and {role} both have identifier "
                f"0x{message.frame_id:X} ({message.name}): each must have a message of its own"
            )
        factor = 1.0
        if role in mapping.sensors:
            tick = next((each for each in message.signals if each.name == mapping.tick), None)
            factor = mapping.sensors[role][1](value.unit or "")
        else:
            tick = _tick(message, role, mapping.tick, path)
        tick_key = "tick" if isinstance(mapping.tick, str) else f"ticks.{role}"
        played = {f"network.signals.{each}": found[each][1] for each in (key, *codes)}
        played |= {} if tick is None else {f"network.{tick_key}": tick}
        where = Where(f"{path}: message {message.name}", _keys_by_signal(message, played))
        layout = AnyLayout(message, Places(value, tick, **codes), where, factor < 0.0)
        layout.share(layouts.setdefault(message.frame_id, layout))
        if other != role:
            _keys_by_signal(message, {**played, f"network.signals.{other}": found[other][1]})
        data_id = mapping.data_ids.get(role)
        if data_id != mapping.data_ids.get(other):
            raise DbcError(
                f"network.data_ids.{role}: must be that of {other}, which {message.name} has too"
            )
        if data_id is not None:
            _require_room(message, (value, tick, *codes.values()), where)
        scale = scale_of(value, where)
        if factor != 1.0 and scale.float_format:
            raise DbcError(f"{where.of(value)} is a float: must have the unit of its role")
        lsb = scale.lsb * abs(factor)
        words = {code: words_of(signal) or WORDS[code] for code, signal in codes.items()}
        codecs.append(
            MessageCodec(
                role=role,
                name=message.name,
                frame_id=message.frame_id,
                data_id=data_id,
                signal_name=value.name,
                unit=value.unit or "",
                lsb=lsb,
                raw_minimum=-scale.raw_maximum,
                raw_maximum=scale.raw_maximum,
                minimum=-scale.raw_maximum * (lsb or 1.0),
                maximum=scale.raw_maximum * (lsb or 1.0),
                modes=words.get("mode", {}),
                fault_states=words.get("fault_state", {}),
                verdicts=words.get("verdict", {}),
                layout=layout,
                extended=message.is_extended_frame,
                fd=message.is_fd,
                not_available=scale.not_available,
                float_format=scale.float_format,
            )
        )
    ours = {codec.name for codec in codecs}
    collisions = tuple(
        f"{message.name} has identifier 0x{message.frame_id:X} of {by_id[message.frame_id]} too"
        for message in database.messages
        if message.frame_id in by_id and message.name not in ours
    )
    reference, feedback, command_1, command_2, status, *witnesses = codecs
    network = Network(
        reference, feedback, command_1, command_2, status, collisions, witnesses=tuple(witnesses)
    )
    require_distinct_data_ids(network, path)
    return network


def _signal(database: Database, path: str | Path, key: str, name: str) -> tuple[Message, Signal]:
    where = f"network.signals.{key} = {name!r}"
    of, _, signal = name.partition(".")
    messages = {message.name: message for message in database.messages}
    if of not in messages:
        raise DbcError(f"{where}: {path} has no message {of}; {nearest(of, messages)}")
    signals = {each.name: each for each in messages[of].signals}
    if signal not in signals:
        raise DbcError(f"{where}: message {of} has no signal {signal}; {nearest(signal, signals)}")
    return messages[of], signals[signal]


def _keys_by_signal(message: Message, played: Mapping[str, Signal]) -> dict[str, str]:
    """Map each signal with a role in ``message`` to its key."""
    keys: dict[str, str] = {}
    for key, signal in played.items():
        other = keys.setdefault(signal.name, key)
        if other != key:
            raise DbcError(
                f"{other} and {key} are both {message.name}.{signal.name}: each must have a signal "
                "of its own"
            )
    return keys


def _tick(
    message: Message, role: str, names: str | Mapping[str, str], path: str | Path
) -> Signal | None:
    """The tick-counting signal of ``message``, the message of ``role``."""
    if not names:
        return None
    signals = {signal.name: signal for signal in message.signals}
    if isinstance(names, str):
        if names not in signals:
            raise DbcError(
                f"network.tick = {names!r}: {path}: message {message.name} has no such signal: "
                "every message of network.signals must have it, or network.ticks name one in each"
            )
        return signals[names]
    if names[role] not in signals:
        raise DbcError(
            f"network.ticks.{role} = {names[role]!r}: {path}: message {message.name} has no such "
            f"signal; {nearest(names[role], signals)}"
        )
    return signals[names[role]]


def _require_room(message: Message, signals: tuple[Signal | None, ...], where: Where) -> None:
    """Refuse a protected message with signals at the place of profile 1's CRC and counter."""
    taken = range(12)  # byte 0 and the low nibble of byte 1
    for signal in signals:
        if signal is not None and not {*taken}.isdisjoint(bits_of(signal)):
            raise DbcError(
                f"{where.of(signal)} lies in byte 0 or the low half of byte 1: must "
                "leave them to the CRC and the counter of E2E profile 1"
            )
    if message.length < 2:
        raise DbcError(f"{where.message}: must have at least 2 bytes for E2E profile 1")


def bits_of(signal: Signal) -> tuple[int, ...]:
    """The frame bits of a signal from its lowest on, bit 0 the lowest of byte 0."""
    start, length = int(signal.start), int(signal.length)
    if signal.byte_order == "little_endian":
        return tuple(range(start, start + length))
    first = start // 8 * 8 + 7 - start % 8  # counted from the highest bit of byte 0
    return tuple(at // 8 * 8 + 7 - at % 8 for at in range(first + length - 1, first - 1, -1))


def nearest(name: str, known: Iterable[str]) -> str:
    """The hint to the nearest of the ``known`` messages or signals, or to the first ones."""
    first = ", ".join(islice(known, 8)) or "none"
    return did_you_mean(name, known, f"it has {first}")
