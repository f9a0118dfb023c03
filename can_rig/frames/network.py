"""The frames of a tick, found in a DBC by their roles.

The DBC is the only source for frames: names, identifiers, units, scaling and ranges. The attribute
`RigRole` identifies a frame; the frame must have the layout of `codec`. The layout is checked once,
while the DBC is loaded, so that the loop packs and unpacks a whole frame with one `Struct`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cantools.database.can import Message, Signal

from can_rig.errors import DbcError
from can_rig.frames.codec import (
    FRAME_BYTES,
    NO_DECISION,
    NO_VERDICT,
    ROLES,
    SAMPLE_BITS,
    SPEED,
    VALID_SHIFT,
    VERDICT_BITS,
    MessageCodec,
    Protector,
    RigLayout,
)
from can_rig.frames.databases import attribute, load_dbc
from firmware_model.law.status import Verdict

EXTENDED_FLAG, FD_FLAG = 1 << 31, 1 << 30
_IDENTIFIER: Final = (1 << 29) - 1

_HEADER: Final = {"Checksum": (0, 8), "AliveCounter": (8, 4), "Tick": (16, 16)}  # start, length
_STATUS: Final = ("Mode", "FaultState")
_STATUS_STARTS: Final = (12, 14)  # two bits each, in either order
_VERDICT: Final = (32, VERDICT_BITS)
_WORDED: Final = {
    **dict.fromkeys(_STATUS, (set(range(4)), "0, 1, 2 and 3")),
    "Verdict": (
        {*map(int, Verdict), NO_DECISION, NO_VERDICT},
        f"0 to {max(Verdict)}, {NO_DECISION} and {NO_VERDICT}",
    ),
}
"""The numbers that must have words, by signal."""
_VALUE: Final = (32, 32)
_VALUE_OVER_VERDICT: Final = (36, 28)
_VALID: Final = (8 + VALID_SHIFT, 1)
_SAMPLE_TICK: Final = (32, SAMPLE_BITS)
_VALUE_OVER_SAMPLE_TICK: Final = (32 + SAMPLE_BITS, 32 - SAMPLE_BITS)
_GRID_TOLERANCE: Final = 1e-3  # of an LSB; float64 resolves 5e-7 LSB at the end of 32 bits


def flagged(frame_id: int, extended: bool, fd: bool) -> int:
    """An identifier with what else tells kinds of frames apart."""
    return frame_id | extended * EXTENDED_FLAG | fd * FD_FLAG


def unflagged(number: int) -> tuple[int, bool, bool]:
    """The arguments of ``flagged``."""
    return number & _IDENTIFIER, bool(number & EXTENDED_FLAG), bool(number & FD_FLAG)


@dataclass(frozen=True, slots=True)
class Network:
    """The frames of a tick: five, preceded by those of the speed and of further sensors."""

    reference: MessageCodec
    feedback: MessageCodec
    command_1: MessageCodec
    command_2: MessageCodec
    status: MessageCodec
    collisions: tuple[str, ...] = ()
    """Other messages of the database with the identifier of a rig frame."""
    speed: MessageCodec | None = None
    witnesses: tuple[MessageCodec, ...] = ()
    """Frames of the further sensors, in the order of the scenario's ``sensors``."""
    periods: tuple[int, ...] = ()
    """Their periods, ticks."""

    def __iter__(self) -> Iterator[MessageCodec]:
        """The five frames of every tick in the order of `ROLES`."""
        return (getattr(self, role) for role in ROLES)

    @property
    def by_role(self) -> tuple[MessageCodec, ...]:
        """The frames of every tick: the five of `ROLES`, the speed."""
        return (*self, self.speed) if self.speed else tuple(self)

    @property
    def on_the_bus(self) -> tuple[MessageCodec, ...]:
        """All frames in bus order."""
        return ((self.speed,) if self.speed else ()) + self.witnesses + tuple(self)

    @property
    def inputs(self) -> tuple[MessageCodec, ...]:
        """The plant node's frames of every tick, in bus order."""
        return (*((self.speed,) if self.speed else ()), self.reference, self.feedback)

    @property
    def can_fail(self) -> tuple[MessageCodec, ...]:
        """The frames that faults change, by place; see ``Scenario.places``."""
        return (self.command_1, self.command_2, self.feedback, *self.witnesses)

    @property
    def senders(self) -> tuple[int, ...]:
        """For each of ``can_fail``, the number of the last that has the same message."""
        last = {codec.frame_id: at for at, codec in enumerate(self.can_fail)}
        return tuple(last[codec.frame_id] for codec in self.can_fail)

    @property
    def offered(self) -> int:
        """How many frames the plant node sends in every tick, before the controller's."""
        return len(self.inputs)

    @property
    def has_ticks(self) -> bool:
        """Whether every frame carries its tick, a requirement of lockstep."""
        return all(codec.layout.has_tick for codec in self.by_role)

    @property
    def is_the_rigs(self) -> bool:
        """Whether all frames have the rig's layout."""
        return all(isinstance(codec.layout, RigLayout) for codec in self)

    @property
    def unprotected(self) -> tuple[str, ...]:
        """Messages without end-to-end protection."""
        return tuple(codec.name for codec in self if not codec.protected)

    @property
    def fd(self) -> bool:
        """Whether a frame is CAN FD."""
        return any(codec.fd for codec in self)

    @property
    def identifiers(self) -> tuple[int, ...]:
        """CAN identifiers in bus order; with bit 31 set for 29 bits."""
        frames = self.on_the_bus
        return tuple(
            dict.fromkeys(codec.frame_id | codec.extended * EXTENDED_FLAG for codec in frames)
        )


def load_network(
    path: str | Path, says_speed: bool = False, sensors: tuple[str, ...] = ()
) -> Network:
    """The rig's frames in the DBC at ``path``.

    Args:
        path: the file.
        says_speed: includes the frame of the speed.
        sensors: roles of the included frames of further sensors.

    Raises:
        DbcError: an invalid DBC, a missing or repeated role, a layout other than the rig's, an
            `E2EDataId` that is missing or shares its CRC with another.
    """
    by_role: dict[int | str, Message] = {}
    wanted = (*ROLES, *((SPEED,) if says_speed else ()), *sensors)
    for message in load_dbc(path).messages:
        role = attribute(message, "RigRole")
        if role is None or role not in wanted:
            continue
        other = by_role.setdefault(role, message)
        if other is not message:
            raise DbcError(
                f"{path}: messages {other.name} and {message.name} both have RigRole {role}; "
                "exactly one must"
            )
    for role in wanted:
        if role not in by_role:
            raise DbcError(f"{path}: no message has RigRole {role}; exactly one must")
    first, second, third, fourth, last = (_codec(by_role[role], role, path) for role in ROLES)
    speed = _codec(by_role[SPEED], SPEED, path) if says_speed else None
    witnesses = tuple(_codec(by_role[role], role, path, True) for role in sensors)
    network = Network(first, second, third, fourth, last, speed=speed, witnesses=witnesses)
    require_distinct_data_ids(network, path)
    return network


def _codec(message: Message, role: str, path: str | Path, is_witness: bool = False) -> MessageCodec:
    where = f"{path}: message {message.name}"
    require_layout(message, role, where, is_witness)
    data_id = attribute(message, "E2EDataId")
    if not isinstance(data_id, int) or not 0 < data_id <= 0xFFFF:
        raise DbcError(f"{where}: E2EDataId is {data_id}; it must be 1..65535")
    value = value_signal(message)
    lsb = float(value.scale)
    raw_minimum, raw_maximum = (round((end or 0) / lsb) for end in (value.minimum, value.maximum))
    signals = {signal.name: signal for signal in message.signals}
    mode, fault_state = signals.get("Mode"), signals.get("FaultState")
    return MessageCodec(
        role=role,
        name=message.name,
        frame_id=message.frame_id,
        data_id=data_id,
        signal_name=value.name,
        unit=value.unit or "",
        lsb=lsb,
        raw_minimum=raw_minimum,
        raw_maximum=raw_maximum,
        minimum=raw_minimum * lsb,
        maximum=raw_maximum * lsb,
        modes=words_of(signals.get("Valid") if is_witness else mode),
        fault_states=words_of(fault_state),
        verdicts=words_of(signals.get("Verdict")),
        layout=RigLayout((VALID_SHIFT, VALID_SHIFT), SAMPLE_BITS, (1, 0))
        if is_witness
        else RigLayout(
            (mode.start - 8, fault_state.start - 8) if mode and fault_state else None,
            VERDICT_BITS * says_verdict(message),
        ),  # within byte 1
        not_available=not_available(value.length),
    )


def words_of(signal: Signal | None) -> dict[int, str]:
    """The value table of a signal, with words as text."""
    choices = signal.choices if signal and signal.choices else {}
    return {int(number): str(word) for number, word in choices.items()}


def require_distinct_data_ids(network: Network, path: str | Path) -> None:
    """Refuse two 16-bit data identifiers with equal 8-bit CRCs.

    Raises:
        DbcError: names both messages.
    """
    by_crc: dict[int, MessageCodec] = {}
    for codec in network.on_the_bus:
        if codec.data_id is None:
            continue
        frame = bytearray(FRAME_BYTES)
        Protector(codec.data_id).protect(frame)
        other = by_crc.setdefault(frame[0], codec)
        if other.frame_id != codec.frame_id:
            raise DbcError(
                f"{path}: messages {other.name} and {codec.name}: E2EDataId {other.data_id} and "
                f"{codec.data_id} give the same CRC, so that either passes as the other; change one"
            )


def value_signal(message: Message) -> Signal:
    """The scaled signal of a message accepted by `require_layout`."""
    places = (_VALUE, _VALUE_OVER_VERDICT, _VALUE_OVER_SAMPLE_TICK)
    return next(s for s in message.signals if (s.start, s.length) in places)


def says_verdict(message: Message) -> bool:
    """Whether ``message`` is a status message with a verdict."""
    return any(signal.name == "Verdict" for signal in message.signals)


def not_available(length: int) -> int:
    """Raw value of a missing value in ``length`` bits: the value without a positive counterpart."""
    return -(1 << (length - 1))


def require_layout(message: Message, role: str, where: str, is_witness: bool = False) -> None:
    """Check ``message`` against the layout of the frame with this role.

    ``is_witness`` says that a further sensor sends the frame.

    Raises:
        DbcError: another layout; ``where`` (file and message) begins the line.
    """
    if message.is_extended_frame or message.is_fd or message.length != FRAME_BYTES:
        kind = (
            "n extended" if message.is_extended_frame else "n FD" if message.is_fd else " classic"
        )
        raise DbcError(
            f"{where}: a{kind} frame of {message.length} bytes; "
            f"it must be a classic one of {FRAME_BYTES}, with an 11-bit identifier"
        )
    if len(message.senders) != 1:
        raise DbcError(f"{where}: {len(message.senders)} senders; it must have one")
    signals = {signal.name: signal for signal in message.signals}
    plain, place = dict(_HEADER), _VALUE
    if role == "status":
        for name in _STATUS:
            start = signals[name].start if name in signals else 0
            plain[name] = (start if start in _STATUS_STARTS else _STATUS_STARTS[0], 2)
        if says_verdict(message):
            plain["Verdict"], place = _VERDICT, _VALUE_OVER_VERDICT
    if is_witness:
        plain |= {"Valid": _VALID, "SampleTick": _SAMPLE_TICK}
        place = _VALUE_OVER_SAMPLE_TICK
    for name, its in plain.items():
        _require_plain(signals.pop(name, None), name, its, where)
    if role == "status" and plain["Mode"] == plain["FaultState"]:
        raise DbcError(f"{where}: Mode and FaultState overlap; they must be at bits 12 and 14")
    if len(signals) != 1:
        raise DbcError(
            f"{where}: signals {sorted(signals)} in addition to the header; "
            f"there must be exactly one, the value, at bit {place[0]}"
        )
    _require_value(signals.popitem()[1], place, where)


def _require_plain(signal: Signal | None, name: str, place: tuple[int, int], where: str) -> None:
    """Require an unsigned, unscaled signal at its place, with its words."""
    wanted = f"it must be unsigned Intel, {place[1]} bits at bit {place[0]}, factor 1, offset 0"
    if signal is None:
        raise DbcError(f"{where}: no signal {name}; {wanted}")
    if (
        (signal.start, signal.length) != place
        or signal.is_signed
        or signal.byte_order != "little_endian"
        or (signal.scale, signal.offset) != (1, 0)
    ):
        raise DbcError(f"{where}: signal {name} is {_describe(signal)}; {wanted}")
    values, said = _WORDED.get(name, (None, ""))
    if values is not None and set(signal.choices or ()) != values:
        raise DbcError(f"{where}: signal {name} must have a value table of {said}")


def _require_value(signal: Signal, place: tuple[int, int], where: str) -> None:
    """Check the scaled signal's place and offset, and the position of its range on the raw grid."""
    if (
        (signal.start, signal.length) != place
        or not signal.is_signed
        or signal.is_float
        or signal.byte_order != "little_endian"
        or signal.offset != 0
        or not signal.scale > 0
    ):
        raise DbcError(
            f"{where}: signal {signal.name} is {_describe(signal)}; it must be signed Intel, "
            f"{place[1]} bits at bit {place[0]}, factor above 0, offset 0"
        )
    low, high, most = signal.minimum, signal.maximum, -not_available(place[1]) - 1
    if low is None or high is None or not low < 0 < high:
        raise DbcError(f"{where}: signal {signal.name} has range {low}..{high}; it must include 0")
    for end in (low / signal.scale, high / signal.scale):
        if abs(end - round(end)) > _GRID_TOLERANCE or abs(round(end)) > most:
            raise DbcError(
                f"{where}: signal {signal.name} has range {low}..{high}; its ends must be "
                f"multiples of {signal.scale}, at most {most} of them from 0"
            )


def _describe(signal: Signal) -> str:
    sign = "a float" if signal.is_float else "signed" if signal.is_signed else "unsigned"
    order = "Intel" if signal.byte_order == "little_endian" else "Motorola"
    return (
        f"{sign} {order}, {signal.length} bits at bit {signal.start}, "
        f"factor {signal.scale}, offset {signal.offset}"
    )
