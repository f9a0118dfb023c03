"""The frames of a tick, found in a DBC by their roles.

The DBC is the only source for frames: names, identifiers, units, scaling and ranges. The attribute
`RigRole` identifies a frame; the frame must have the layout of `layout`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cantools.database.can import Message as DbcMessage
from cantools.database.can import Signal

from can_rig.errors import DbcError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.dbc import attribute, load_dbc
from can_rig.frames.layout import (
    ROLES,
    SPEED,
    RigLayout,
    not_available,
    require_layout,
    says_verdict,
    value_signal,
)
from can_rig.frames.protection import FRAME_BYTES, Protector

EXTENDED_FLAG = 1 << 31


@dataclass(frozen=True, slots=True)
class Network:
    """The frames of a tick: five frames, preceded by an optional speed frame."""

    reference: MessageCodec
    feedback: MessageCodec
    command_1: MessageCodec
    command_2: MessageCodec
    status: MessageCodec
    collisions: tuple[str, ...] = ()
    """Other messages of the database with the identifier of a rig frame."""
    speed: MessageCodec | None = None

    def __iter__(self) -> Iterator[MessageCodec]:
        """The five frames of every tick in the order of `ROLES`."""
        return (getattr(self, role) for role in ROLES)

    @property
    def by_role(self) -> tuple[MessageCodec, ...]:
        """All frames, beginning with the five of `ROLES`."""
        return (*self, self.speed) if self.speed else tuple(self)

    @property
    def on_the_bus(self) -> tuple[MessageCodec, ...]:
        """All frames in bus order."""
        return (self.speed, *self) if self.speed else tuple(self)

    @property
    def offered(self) -> int:
        """How many frames the plant node sends at the start of a tick, before all other frames."""
        return 2 if self.speed is None else 3

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
        return tuple(codec.frame_id | codec.extended * EXTENDED_FLAG for codec in self.on_the_bus)


def load_network(path: str | Path, says_speed: bool = False) -> Network:
    """The rig's frames in the DBC at ``path``; includes the speed frame if ``says_speed``.

    Raises:
        DbcError: an invalid DBC, a missing or repeated role, a layout other than the rig's, an
            `E2EDataId` that is missing or shares its CRC with another.
    """
    by_role: dict[int | str, DbcMessage] = {}
    for message in load_dbc(path).messages:
        role = attribute(message, "RigRole")
        if role is None or role == "none" or (role == SPEED and not says_speed):
            continue
        other = by_role.setdefault(role, message)
        if other is not message:
            raise DbcError(
                f"{path}: messages {other.name} and {message.name} both have RigRole {role}; "
                "exactly one must"
            )
    for role in (*ROLES, SPEED) if says_speed else ROLES:
        if role not in by_role:
            raise DbcError(f"{path}: no message has RigRole {role}; exactly one must")
    first, second, third, fourth, last = (_codec(by_role[role], role, path) for role in ROLES)
    speed = _codec(by_role[SPEED], SPEED, path) if says_speed else None
    network = Network(first, second, third, fourth, last, speed=speed)
    require_distinct_data_ids(network, path)
    return network


def _codec(message: DbcMessage, role: str, path: str | Path) -> MessageCodec:
    where = f"{path}: message {message.name}"
    require_layout(message, role, where)
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
        sender=message.senders[0],
        data_id=data_id,
        cycle_time_ms=message.cycle_time,
        signal_name=value.name,
        unit=value.unit or "",
        lsb=lsb,
        raw_minimum=raw_minimum,
        raw_maximum=raw_maximum,
        minimum=raw_minimum * lsb,
        maximum=raw_maximum * lsb,
        modes=words_of(mode),
        fault_states=words_of(fault_state),
        verdicts=words_of(signals.get("Verdict")),
        layout=RigLayout(
            (mode.start - 8, fault_state.start - 8) if mode and fault_state else None,
            says_verdict(message),
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
    for codec in network.by_role:
        if codec.data_id is None:
            continue
        frame = bytearray(FRAME_BYTES)
        Protector(codec.data_id).protect(frame)
        other = by_crc.setdefault(frame[0], codec)
        if other is not codec:
            raise DbcError(
                f"{path}: messages {other.name} and {codec.name}: E2EDataId {other.data_id} and "
                f"{codec.data_id} give the same CRC, so that either passes as the other; change one"
            )
