"""The five frames of a tick, found in a DBC by their roles.

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
from can_rig.frames.layout import ROLES, require_layout, value_signal
from can_rig.frames.protection import FRAME_BYTES, Protector


@dataclass(frozen=True, slots=True)
class Network:
    """The five frames of a tick."""

    reference: MessageCodec
    feedback: MessageCodec
    command_1: MessageCodec
    command_2: MessageCodec
    status: MessageCodec

    def __iter__(self) -> Iterator[MessageCodec]:
        """The frames in the order of `ROLES`."""
        return (getattr(self, role) for role in ROLES)

    @property
    def identifiers(self) -> tuple[int, ...]:
        """Their CAN identifiers, in the order of `ROLES`."""
        return tuple(codec.frame_id for codec in self)


def load_network(path: str | Path) -> Network:
    """The frames of the rig in the DBC at ``path``.

    Raises:
        DbcError: it is not a DBC, a role is missing or given twice, the layout of a frame is not
            that of the rig, or an `E2EDataId` is missing or gives the same CRC as another.
    """
    by_role: dict[int | str, DbcMessage] = {}
    for message in load_dbc(path).messages:
        role = attribute(message, "RigRole")
        if role is None or role == "none":
            continue
        other = by_role.setdefault(role, message)
        if other is not message:
            raise DbcError(
                f"{path}: messages {other.name} and {message.name} both have RigRole {role}; "
                "exactly one must"
            )
    for role in ROLES:
        if role not in by_role:
            raise DbcError(f"{path}: no message has RigRole {role}; exactly one must")
    network = Network(*(_codec(by_role[role], role, path) for role in ROLES))
    _require_distinct_data_ids(network, path)
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
        modes=_words(mode),
        fault_states=_words(fault_state),
        mode_shift=mode.start - 8 if mode else 0,  # within byte 1
        fault_state_shift=fault_state.start - 8 if fault_state else 0,
    )


def _words(signal: Signal | None) -> dict[int, str]:
    """The value table of a signal, with words as text."""
    choices = signal.choices if signal and signal.choices else {}
    return {int(number): str(word) for number, word in choices.items()}


def _require_distinct_data_ids(network: Network, path: str | Path) -> None:
    """Refuse two 16-bit data identifiers that give the same 8-bit CRC."""
    by_crc: dict[int, MessageCodec] = {}
    for codec in network:
        frame = bytearray(FRAME_BYTES)
        Protector(codec.data_id).protect(frame)
        other = by_crc.setdefault(frame[0], codec)
        if other is not codec:
            raise DbcError(
                f"{path}: messages {other.name} and {codec.name}: E2EDataId {other.data_id} and "
                f"{codec.data_id} give the same CRC, so that either passes as the other; change one"
            )
