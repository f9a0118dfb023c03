"""Decodes the frames known to one database: by identifier or, for J1939, by parameter group.

A database has a single J1939 message for a parameter group, whatever the sender. The message gets
an additional signal, ``SourceAddress``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from typing import Final

import numpy as np
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage
from numpy.typing import NDArray

from can_rig.decoding.j1939 import GROUP_BIT, group_key, group_keys, with_source
from can_rig.decoding.j1939_transport import is_transport
from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.message_decoder import MessageDecoder
from can_rig.errors import DbcError
from can_rig.logs.frames import EXTENDED, Frames, concatenate

Numbered = tuple[Frames, NDArray[np.int64]]
"""Frames, and (n,) their numbers in the log."""

_EXTENDED_BIT: Final = 31  # above the identifier, as in a DBC


def named(database: Database) -> dict[str, DbcMessage]:
    """The messages by name; messages of equal name get their identifiers as suffix."""
    every = Counter(message.name for message in database.messages)
    return {
        message.name
        if every[message.name] == 1
        else f"{message.name}_{message.frame_id:X}": message
        for message in database.messages
    }


class DatabaseDecoder:
    """Decodes chunk after chunk of frames of a database.

    Args:
        database: any cantools CAN database.
        prefix: before the names of its messages in the result.
        wanted: the message decoders by name, as `message_decoders` makes them.
    """

    def __init__(self, database: Database, prefix: str, wanted: dict[str, MessageDecoder]) -> None:
        self.decoders: Final = {f"{prefix}{name}": found for name, found in wanted.items()}
        """The messages to decode, in the order of the database."""
        by_key = {}
        for name, message in named(database).items():
            by_key[message.frame_id | message.is_extended_frame << _EXTENDED_BIT] = prefix + name
        for name, message in named(database).items():
            if message.is_extended_frame and message.protocol == "j1939":
                by_key[group_key(message.frame_id)] = prefix + name
        keys = sorted(by_key)
        self._keys: Final = np.array(keys, dtype=np.uint32)
        self._groups: Final = [bool(key & GROUP_BIT and not key >> _EXTENDED_BIT) for key in keys]
        self._names: Final = [by_key[key] for key in keys]
        self.not_wanted = 0
        """Number of frames of messages outside the selection."""

    @property
    def has_groups(self) -> bool:
        """Whether the database has J1939 messages."""
        return any(self._groups)

    def name_of(self, identifier: int, is_extended: bool) -> str | None:
        """The name of an identifier's message; J1939 by parameter group."""
        extended = np.array([identifier | is_extended << _EXTENDED_BIT], np.uint32)
        place = int(self._find(extended)[0]) if self._names else 0
        if place == len(self._names) and is_extended and self.has_groups:
            place = int(self._find(group_keys(np.array([identifier], np.uint32)))[0])
        return self._names[place] if place < len(self._names) else None

    def decode(
        self, sources: Sequence[Numbered]
    ) -> tuple[dict[str, MessageColumns], list[NDArray[np.bool_]]]:
        """The columns of a chunk by message, and of every source (n,) which frames are known.

        Args:
            sources: the frames of the chunk and, where `has_groups`, the longer messages that were
                put together from them.
        """
        parts: dict[str, list[Numbered]] = {}
        known = []
        for at, (frames, rows) in enumerate(sources):
            places = self._places(frames)
            known.append(places < len(self._names))
            if self.has_groups and at == 0:
                known[0] |= is_transport(frames)
            for name, chosen in self._by_name(places).items():
                if name in self.decoders:
                    parts.setdefault(name, []).append((frames[chosen], rows[chosen]))
                elif at == 0:
                    self.not_wanted += len(chosen)
        is_group = {name for name, group in zip(self._names, self._groups, strict=True) if group}
        found = {}
        for name, decoder in self.decoders.items():
            if name in parts:
                frames, rows = _in_order(parts[name])
                columns = decoder.decode(frames, rows)
                found[name] = with_source(columns, frames, rows) if name in is_group else columns
        return found, known

    def _by_name(self, places: NDArray[np.int16]) -> dict[str, NDArray[np.int64]]:
        """Row numbers of the frames, by message, in order."""
        order = np.argsort(places, kind="stable")
        ends = np.cumsum(np.bincount(places, minlength=len(self._names) + 1))
        chosen: dict[str, NDArray[np.int64]] = {}
        for place, name in enumerate(self._names):
            here = order[ends[place - 1] if place else 0 : ends[place]]
            if len(here) and name in chosen:  # known by identifier, and by group
                here = np.sort(np.concatenate([chosen[name], here]))
            if len(here):
                chosen[name] = here
        return chosen

    def _places(self, frames: Frames) -> NDArray[np.int16]:
        """(n,) index of each frame's message in the sorted messages.

        An unknown message has the number of messages as index.
        """
        if not len(self._keys):
            return np.zeros(len(frames), dtype=np.int16)
        extended = frames.has(EXTENDED)
        extended_bit = extended.astype(np.uint32) << np.uint32(_EXTENDED_BIT)
        places = self._find(frames.arbitration_id | extended_bit)
        if self.has_groups:
            left = np.flatnonzero(extended & (places == len(self._keys)))
            places[left] = self._find(group_keys(frames.arbitration_id[left]))
        return places.astype(np.int16)  # NumPy sorts 16 bits by radix

    def _find(self, keys: NDArray[np.uint32]) -> NDArray[np.int64]:
        places = np.searchsorted(self._keys, keys)
        places[places == len(self._keys)] = 0
        places[self._keys[places] != keys] = len(self._keys)
        return places


def _in_order(parts: Sequence[Numbered]) -> Numbered:
    """Frames of several sources in the order of their numbers."""
    if len(parts) == 1:
        return parts[0]
    rows = np.concatenate([at for _, at in parts])
    order = np.argsort(rows, kind="stable")
    return concatenate([frames for frames, _ in parts])[order], rows[order]


def message_decoders(
    database: Database,
    prefix: str,
    messages: Collection[str] | None,
    signals: Collection[str] | None,
) -> dict[str, MessageDecoder]:
    """A decoder for each selected message, by name without the prefix.

    Raises:
        DbcError: a message cannot be decoded.
    """
    found = {}
    for name, message in named(database).items():
        names = {name, message.name, prefix + name, prefix + message.name}
        if message.is_container or not (messages is None or names & set(messages)):
            continue
        wanted = None
        if signals is not None:
            every = [signal.name for signal in message.signals]
            wanted = [s for s in every if {s, *(f"{one}.{s}" for one in names)} & set(signals)]
            if not wanted:
                continue
        found[name] = MessageDecoder(message, wanted, prefix + name)
    return found


def require_names(
    databases: Iterable[tuple[str, Database]],
    messages: Collection[str] | None,
    signals: Collection[str] | None,
) -> None:
    """Refuse names of messages and signals unknown to every database (prefix, database).

    Raises:
        DbcError: the first unknown name.
    """
    known: list[str] = []
    inside: list[str] = []
    for prefix, database in databases:
        for name, message in named(database).items():
            names = dict.fromkeys([name, message.name, prefix + name, prefix + message.name])
            known += names
            inside += [f"{one}.{signal.name}" for one in names for signal in message.signals]
            inside += [signal.name for signal in message.signals]
    for wanted, there, kind in ((messages, known, "message"), (signals, inside, "signal")):
        for name in wanted or ():
            if name not in there:
                near = get_close_matches(name, there, 3, 0.5) or sorted(set(there))[:5]
                raise DbcError(f"no {kind} {name} in the database; it has {', '.join(near)}, …")
