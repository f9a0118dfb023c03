"""Typed records ↔ CAN frames, through a DBC.

The DBC is the only truth about frames: names, identifiers, units, scaling and ranges come from it,
and frames are found by their `RigRole` attribute. `load_network` refuses a DBC whose layout is
not that of `frame_layout`. A `Transmitter` and a `Receiver` add the end-to-end protection.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Final

import cantools
from can import Message
from cantools.database.can import Database, Signal
from cantools.database.can import Message as DbcMessage
from cantools.database.errors import Error

from can_rig.errors import DbcError
from can_rig.frames import layout as frame_layout
from can_rig.frames.codec import MessageCodec, Record
from can_rig.frames.layout import ROLES
from can_rig.frames.protection import FRAME_BYTES, USABLE, Checker, Protector

__all__ = [
    "MessageCodec",
    "Network",
    "Receiver",
    "Record",
    "Transmitter",
    "load_dbc",
    "load_network",
    "shipped_dbc",
]


class Transmitter:
    """The sending end of one frame: codec and protection."""

    def __init__(self, codec: MessageCodec) -> None:
        self.codec: Final = codec
        self._protector = Protector(codec.data_id)

    def frame(
        self,
        value: float,
        tick: int,
        mode: int = 0,
        fault_state: int = 0,
    ) -> Message:
        """The next frame, ready to send; arguments as those of `MessageCodec.encode`."""
        data = self.codec.encode(value, tick, mode, fault_state)
        self._protector.protect(data)
        return Message(0.0, self.codec.frame_id, False, False, False, None, FRAME_BYTES, data)


class Receiver:
    """The receiving end of one frame: protection and codec.

    Args:
        codec: the frame.
        max_delta_counter: as that of `Checker`.
    """

    def __init__(self, codec: MessageCodec, max_delta_counter: int = 1) -> None:
        self.codec: Final = codec
        self.checker: Final = Checker(codec.data_id, max_delta_counter)
        self._judged = False  # in this tick

    def accept(self, message: Message, tick: int | None = None) -> Record | None:
        """What the frame says; None if it is not to be used, for a reason that is counted.

        Args:
            message: a received frame with this codec's identifier.
            tick: the tick under way, any multiple of 65536 more; a frame of another one is not
                used. None takes a frame of any tick.

        The value is nan where the frame says NOT_AVAILABLE. Call `end_tick` when each tick
        is over.
        """
        data = message.data
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return None  # another frame that happens to have the same number
        if len(data) == FRAME_BYTES:
            record = self.codec.decode(data)
            if tick is None or record.tick == tick & 0xFFFF:
                self._judged = True
                return record if self.checker.check(data) in USABLE else None
        self.checker.reject(data)
        return None

    def end_tick(self) -> None:
        """Tell the checker of a tick in which no frame came that it could judge."""
        if not self._judged:
            self.checker.no_new_data()
        self._judged = False

    @property
    def rejected(self) -> dict[str, int]:
        """How many frames were not used, by `CheckStatus` in lower case; only what occurred."""
        counts = self.checker.counts
        return {s.name.lower(): n for s, n in counts.items() if n and s not in USABLE}


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
        """Their CAN identifiers, in the same order."""
        return tuple(codec.frame_id for codec in self)


def load_network(path: str | Path) -> Network:
    """The frames of the rig in the DBC at `path`, found by their `RigRole`.

    Raises:
        DbcError: it is not a DBC, a role is missing or given twice, a frame is not laid out as
            `frame_layout` says, or an `E2EDataId` is missing or does not tell two frames apart.
    """
    by_role: dict[int | str, DbcMessage] = {}
    for message in load_dbc(path).messages:
        role = frame_layout.attribute(message, "RigRole")
        if role is None or role == "none":
            continue
        other = by_role.setdefault(role, message)
        if other is not message:
            raise DbcError(
                f"{path}: messages {other.name} and {message.name} both have RigRole {role}; "
                "one must have it"
            )
    for role in ROLES:
        if role not in by_role:
            raise DbcError(f"{path}: no message has RigRole {role}; one must have it")
    network = Network(*(_codec(by_role[role], role, path) for role in ROLES))
    _require_distinct_data_ids(network, path)
    return network


def shipped_dbc(name: str) -> Path:
    """A DBC that comes with the package or lies in the checkout."""
    package = Path(str(files("can_rig")))
    folder = package / "dbc" if (package / "dbc").is_dir() else package.parent / "dbc"
    return folder / name


def load_dbc(path: str | Path, strict: bool = True) -> Database:
    """The DBC at `path`; one that is not `strict` may have signals that overlap.

    Raises:
        DbcError: it cannot be read, or is not a DBC.
    """
    try:
        loaded = cantools.database.load_file(path, database_format="dbc", strict=strict)
    except OSError as error:
        raise DbcError(f"{path}: cannot be read: {error.strerror}") from error
    except (Error, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())
        raise DbcError(f"{path}: not a DBC that can be loaded: {reason}") from error
    if not isinstance(loaded, Database):
        raise DbcError(f"{path}: holds no CAN messages; it must be a DBC")
    return loaded


def _codec(message: DbcMessage, role: str, path: str | Path) -> MessageCodec:
    where = f"{path}: message {message.name}"
    frame_layout.require_layout(message, role, where)
    data_id = frame_layout.attribute(message, "E2EDataId")
    if not isinstance(data_id, int) or not 0 < data_id <= 0xFFFF:
        raise DbcError(f"{where}: E2EDataId is {data_id}; it must be 1..65535")
    value = frame_layout.value_signal(message)
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
    """A value table; cantools's named values as the text they print as."""
    choices = signal.choices if signal and signal.choices else {}
    return {int(number): str(word) for number, word in choices.items()}


def _require_distinct_data_ids(network: Network, path: str | Path) -> None:
    """The 16-bit data identifiers enter an 8-bit CRC: different ones can still look the same."""
    by_crc: dict[int, MessageCodec] = {}
    for codec in network:
        frame = bytearray(FRAME_BYTES)
        Protector(codec.data_id).protect(frame)
        other = by_crc.setdefault(frame[0], codec)
        if other is not codec:
            raise DbcError(
                f"{path}: messages {other.name} and {codec.name}: E2EDataId {other.data_id} and "
                f"{codec.data_id} give the same CRC; either passes as the other, change one"
            )
