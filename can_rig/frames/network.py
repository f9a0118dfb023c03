"""The frames of a tick, found in a DBC by their roles.

The DBC is the only truth about frames: names, identifiers, units, scaling and ranges come from it.
A frame is found by its attribute `RigRole`, and its layout must be that of `layout`.
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
    """The frames of a tick: five, and before them the speed, where the network has it."""

    reference: MessageCodec
    feedback: MessageCodec
    command_1: MessageCodec
    command_2: MessageCodec
    status: MessageCodec
    collisions: tuple[str, ...] = ()
    """Messages of the database with the identifier of one of them."""
    speed: MessageCodec | None = None

    def __iter__(self) -> Iterator[MessageCodec]:
        """The five of every tick in the order of `ROLES`."""
        return (getattr(self, role) for role in ROLES)

    @property
    def by_role(self) -> tuple[MessageCodec, ...]:
        """All of them, the five of `ROLES` first."""
        return (*self, self.speed) if self.speed else tuple(self)

    @property
    def on_the_bus(self) -> tuple[MessageCodec, ...]:
        """All of them in their order on the bus."""
        return (self.speed, *self) if self.speed else tuple(self)

    @property
    def offered(self) -> int:
        """How many of them the plant node sends at the start of a tick, the first on the bus."""
        return 2 if self.speed is None else 3

    @property
    def has_ticks(self) -> bool:
        """Whether every frame says the tick that it belongs to, which lockstep needs."""
        return all(codec.layout.has_tick for codec in self.by_role)

    @property
    def is_the_rigs(self) -> bool:
        """Whether all frames have the layout of the rig's own."""
        return all(isinstance(codec.layout, RigLayout) for codec in self)

    @property
    def unprotected(self) -> tuple[str, ...]:
        """Messages without end-to-end protection."""
        return tuple(codec.name for codec in self if not codec.protected)

    @property
    def fd(self) -> bool:
        """Whether one of them is a CAN FD frame."""
        return any(codec.fd for codec in self)

    @property
    def identifiers(self) -> tuple[int, ...]:
        """Their CAN identifiers, in their order on the bus; with bit 31 set if of 29 bits."""
        return tuple(codec.frame_id | codec.extended * EXTENDED_FLAG for codec in self.on_the_bus)


def load_network(path: str | Path, says_speed: bool = False) -> Network:
    """The frames of the rig in the DBC at ``path``; that of the speed where ``says_speed``.

    Raises:
        DbcError: it is not a DBC, a role is missing or given twice, the layout of a
            frame is not that of the rig, or an `E2EDataId` is missing or gives the same CRC as
            another.
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
    """Refuse two 16-bit data identifiers that give the same 8-bit CRC.

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
