"""The five frames of a tick in anybody's database, by the signal of each role.

cantools reads the database in any format, and packs and unpacks the frames. Each role needs a
separate message and a representable 0; the layout is free.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cantools.database.can import Database, Message, Signal

from can_rig.errors import DbcError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.layout import ROLES
from can_rig.frames.mapped.database import load_for
from can_rig.frames.mapped.layout import AnyLayout, Places, Where, scale_of
from can_rig.frames.network import Network, require_distinct_data_ids, words_of
from firmware_model.target.status import Verdict

STATUS = "fault_estimate"  # the key of the status message's value
CODES = ("mode", "fault_state", "verdict")
WORDS = {
    "mode": {0: "INIT", 1: "RUN", 2: "HOLD", 3: "SAFE_STOP"},
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


def map_network(path: str | Path, mapping: Roles) -> Network:
    """The frames named by ``mapping`` in the database at ``path``.

    Raises:
        DbcError: an unknown database, message or signal, two roles for one message or signal, a
            signal too small for its role.
    """
    used = {name.partition(".")[0] for name in mapping.signals.values()}
    database = load_for(path, used)
    found = {
        key: _signal(database, path, key, name) for key, name in mapping.signals.items() if name
    }
    codecs: list[MessageCodec] = []
    by_id: dict[int, str] = {}
    for role in ROLES:
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
        if other != role:
            raise DbcError(
                f"network.signals: {other} and {role} both have identifier "
                f"0x{message.frame_id:X} ({message.name}): each must have a message of its own"
            )
        tick = _tick(message, role, mapping.tick, path)
        tick_key = "tick" if isinstance(mapping.tick, str) else f"ticks.{role}"
        played = {f"network.signals.{each}": found[each][1] for each in (key, *codes)}
        played |= {} if tick is None else {f"network.{tick_key}": tick}
        where = Where(f"{path}: message {message.name}", _keys_by_signal(message, played))
        layout = AnyLayout(message, Places(value, tick, **codes), where)
        data_id = mapping.data_ids.get(role)
        if data_id is not None:
            _require_room(message, (value, tick, *codes.values()), where)
        scale = scale_of(value, where)
        words = {code: words_of(signal) or WORDS[code] for code, signal in codes.items()}
        codecs.append(
            MessageCodec(
                role=role,
                name=message.name,
                frame_id=message.frame_id,
                sender=message.senders[0] if message.senders else "",
                data_id=data_id,
                cycle_time_ms=message.cycle_time,
                signal_name=value.name,
                unit=value.unit or "",
                lsb=scale.lsb,
                raw_minimum=-scale.raw_maximum,
                raw_maximum=scale.raw_maximum,
                minimum=-scale.raw_maximum * (scale.lsb or 1.0),
                maximum=scale.raw_maximum * (scale.lsb or 1.0),
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
    reference, feedback, command_1, command_2, status = codecs
    network = Network(reference, feedback, command_1, command_2, status, collisions)
    require_distinct_data_ids(network, path)
    return network


def _signal(database: Database, path: str | Path, key: str, name: str) -> tuple[Message, Signal]:
    where = f"network.signals.{key} = {name!r}"
    of, _, signal = name.partition(".")
    messages = {message.name: message for message in database.messages}
    if of not in messages:
        raise DbcError(f"{where}: {path} has no message {of}; {_hint(of, list(messages))}")
    signals = {each.name: each for each in messages[of].signals}
    if signal not in signals:
        raise DbcError(f"{where}: message {of} has no signal {signal}; {_hint(signal, signals)}")
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
            f"signal; {_hint(names[role], signals)}"
        )
    return signals[names[role]]


def _require_room(message: Message, signals: tuple[Signal | None, ...], where: Where) -> None:
    """Refuse a protected message with signals at the place of profile 1's CRC and counter."""
    taken = (1 << 12) - 1  # byte 0 and the low nibble of byte 1
    for signal in signals:
        if signal is not None and taken & _bits(message, signal):
            raise DbcError(
                f"{where.of(signal)} lies in byte 0 or the low half of byte 1: must "
                "leave them to the CRC and the counter of E2E profile 1"
            )
    if message.length < 2:
        raise DbcError(f"{where.message}: must have at least 2 bytes for E2E profile 1")


def _bits(message: Message, signal: Signal) -> int:
    """The frame bits of a signal, bit 0 the lowest of byte 0."""
    raw: dict[str, int | float] = {each.name: 0 for each in message.signals}
    before = message.encode(raw, scaling=False, strict=False)
    raw[signal.name] = -1 if signal.is_signed else (1 << signal.length) - 1
    if signal.is_float:
        return 0 if signal.start >= 12 else (1 << 12) - 1
    after = message.encode(raw, scaling=False, strict=False)
    return int.from_bytes(before, "little") ^ int.from_bytes(after, "little")


def _hint(name: str, known: list[str] | dict[str, Signal]) -> str:
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean {near[0]}?" if near else f"it has {', '.join(list(known)[:8]) or 'none'}"
