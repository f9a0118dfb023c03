"""Frames of a log → columns of physical values, through any CAN database.

    from can_rig.decoding.decode import decode_log

    messages = decode_log("drive.log", "car.dbc")
    messages["DSTAR_FEEDBACK"].signals["DStar"]     # numpy
    messages["DSTAR_FEEDBACK"].to_pandas()

No frame is lost silently: `Decoder.counts` has for every message the number of frames and the
reasons for missing rows, `Decoder.unknown` the number of frames with an unknown identifier.

Frames belong to a message by identifier or, for J1939, by parameter group: a database has a single
J1939 message for a group, whatever the sender; the message gets an additional signal,
``SourceAddress``.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

import numpy as np
from cantools.database.can import Database, Message as DbcMessage
from numpy.typing import NDArray

from can_rig.decoding.j1939 import (
    GROUP_BIT,
    Transport,
    group_key,
    group_keys,
    is_transport,
    with_source,
)
from can_rig.decoding.message_decoder import Counts, MessageColumns, MessageDecoder, joined
from can_rig.errors import DbcError
from can_rig.frames.databases import load_database
from can_rig.logs.frames import ERROR, EXTENDED, Frames, concatenate, window_of
from can_rig.logs.reading import read_log
from can_rig.storage import paged

Databases = Database | Sequence[tuple[str | None, Database]]
"""One database for all buses; or several, each for the named bus or, with None, for all buses."""

Numbered = tuple[Frames, NDArray[np.int64]]
"""Frames, and (n,) their numbers in the log."""

_EXTENDED_BIT: Final = 31  # above the identifier, as in a DBC


class Decoder:
    """Decodes chunk after chunk of a log.

    Args:
        databases: cantools CAN databases. Messages of a bus's own database have the bus name as
            prefix, as in ``can0.MESSAGE``.
        messages: names of the messages to decode; None: all. Messages of equal name have the
            identifier as suffix, as in ``NAME_1A0``; the plain name selects all namesakes.
        signals: the signals to decode, as ``Signal`` or ``Message.Signal``; None: all. Messages
            without a selected signal are not decoded.
        channel: the only bus to decode; None: all.

    Raises:
        DbcError: a name is unknown, or a message cannot be decoded.
    """

    def __init__(
        self,
        databases: Databases,
        messages: Collection[str] | None = None,
        signals: Collection[str] | None = None,
        channel: str | None = None,
    ) -> None:
        self._channel = channel
        of_bus = [(None, databases)] if isinstance(databases, Database) else list(databases)
        prefixed = [("" if bus is None else f"{bus}.", database) for bus, database in of_bus]
        _require_names(prefixed, messages, signals)
        self._parts = [
            (bus, _DatabaseDecoder(one, prefix, _message_decoders(one, prefix, messages, signals)))
            for (bus, one), (prefix, _) in zip(of_bus, prefixed, strict=True)
        ]
        self.messages: Final = {
            name: decoder for _, part in self._parts for name, decoder in part.decoders.items()
        }
        """The messages to decode, in the order of the databases."""
        self.frames = 0
        """Number of all frames so far."""
        self.error_frames = 0
        self.unknown: Counter[str] = Counter()
        """Number of frames by identifier, ``123`` or ``12345678``, for identifiers unknown to the
        databases."""
        self.transport: Final = Transport()
        """J1939 messages of several frames; empty unless a database has J1939 messages."""
        self._other_buses = 0
        self._channels: dict[str, None] = {}  # an ordered set

    @property
    def not_wanted(self) -> int:
        """Number of frames of messages and buses outside the selection."""
        return self._other_buses + sum(part.not_wanted for _, part in self._parts)

    @property
    def counts(self) -> dict[str, Counts]:
        """Outcome of the frames of each selected message."""
        return {name: decoder.counts for name, decoder in self.messages.items()}

    @property
    def left_out(self) -> list[str]:
        """Signals that exceed their messages, as ``Message.Signal``."""
        return [name for decoder in self.messages.values() for name in decoder.left_out]

    @property
    def nothing_on_channel(self) -> str | None:
        """One line if the log lacks the selected bus."""
        asked = [self._channel, *(bus for bus, _ in self._parts)]
        missing = [bus for bus in asked if bus is not None and bus not in self._channels]
        if not missing:
            return None
        return f"no frame on bus {missing[0]}; the log has {', '.join(self._channels)}"

    def names(self) -> dict[tuple[int, bool], str]:
        """The names of the messages by (identifier, extended)."""
        return {
            (decoder.message.frame_id, decoder.message.is_extended_frame): name
            for name, decoder in self.messages.items()
        }

    def name_of(self, identifier: int, is_extended: bool, bus: str) -> str | None:
        """The name of the message with the identifier on a bus; None: unknown."""
        found = (p.name_of(identifier, is_extended) for on, p in self._parts if on in (None, bus))
        return next((name for name in found if name is not None), None)

    def decode(self, frames: Frames) -> dict[str, MessageColumns]:
        """The columns of a chunk, by message; only messages with frames."""
        rows = np.arange(self.frames, self.frames + len(frames))
        self.frames += len(frames)
        self._channels.update(dict.fromkeys(frames.channels))
        keep = np.ones(len(frames), dtype=bool)
        if self._channel is not None:
            keep[:] = False
            keep[_on(frames, self._channel)] = True
            self._other_buses += int((~keep).sum())
        errors = keep & frames.has(ERROR)
        self.error_frames += int(errors.sum())
        keep = keep & ~errors
        if not keep.all():
            frames, rows = frames[keep], rows[keep]
        sources = [(frames, rows)]
        if any(part.has_groups for _, part in self._parts):
            sources.append(self.transport.put_together(frames, rows))
        known = [np.zeros(len(some), dtype=bool) for some, _ in sources]
        found: dict[str, MessageColumns] = {}
        for bus, part in self._parts:
            here = [_on(some, bus) for some, _ in sources]
            chosen = [(some[on], at[on]) for (some, at), on in zip(sources, here, strict=True)]
            columns, knows = part.decode(chosen)
            found |= columns
            for whole, on, one in zip(known, here, knows, strict=True):
                whole[on] |= one
        for (some, _), whole, unknown in zip(
            sources, known, (self.unknown, self.transport.unknown), strict=False
        ):
            if not whole.all():
                _count(unknown, some[~whole])
        return {name: found[name] for name in self.messages if name in found}

    def whole(self, batches: Iterable[Frames]) -> dict[str, MessageColumns]:
        """Every message of all batches, in the order of ``messages``."""
        parts: dict[str, list[MessageColumns]] = {}
        for frames in batches:
            for name, columns in self.decode(frames).items():
                before = parts.setdefault(name, [])
                before.append(columns)
                if sum(map(len, before[1:])) > paged.PAGED_ROWS:
                    before[:] = [joined(before)]
        return {name: joined(parts[name]) for name in self.messages if name in parts}


def _count(unknown: Counter[str], frames: Frames) -> None:
    """Count frames by their identifiers, as printed."""
    for extended, digits in ((False, 3), (True, 8)):
        chosen = frames.arbitration_id[frames.has(EXTENDED) == extended]
        for identifier, count in zip(*np.unique(chosen, return_counts=True), strict=True):
            unknown[f"{identifier:0{digits}X}"] += int(count)


def _on(frames: Frames, bus: str | None) -> Any:
    """The frames of the bus, as a mask (n,); for all buses: a slice."""
    if bus is None or not len(frames):
        return slice(None)
    return np.array([name == bus for name in frames.channels])[frames.channel]


class DecodedLog(dict[str, MessageColumns]):
    """The columns of a whole log, by message; and the counts of other frames."""

    def __init__(
        self, columns: dict[str, MessageColumns], decoder: Decoder, notice: str | None
    ) -> None:
        super().__init__(columns)
        self.counts: Final = decoder.counts
        self.unknown: Final = decoder.unknown
        self.error_frames: Final = decoder.error_frames
        self.transport: Final = decoder.transport
        self.notice: Final = notice
        """One line if the end of the log is missing, else None."""


def decode_log(
    path: str | Path,
    database: Databases | str | Path,
    messages: Collection[str] | None = None,
    signals: Collection[str] | None = None,
    *,
    from_s: float | None = None,
    to_s: float | None = None,
) -> DecodedLog:
    """Decode a log, or a part of it, in memory.

    Args:
        path: a log in a format of `read_log`.
        database: a cantools database, a database file, or several databases as in `Decoder`.
        messages: see `Decoder`.
        signals: see `Decoder`.
        from_s: only frames from so many seconds after the start of the recording on.
        to_s: only frames before this time after the start of the recording.

    Raises:
        LogError: the log cannot be read.
        DbcError: the database cannot be read, or lacks a selected message or signal.
    """
    if isinstance(database, str | Path):
        database = load_database(database)
    decoder = Decoder(database, messages, signals)
    log = read_log(path, window=window_of(from_s, to_s))
    return DecodedLog(decoder.whole(log), decoder, log.notice)


def _named(database: Database) -> dict[str, DbcMessage]:
    """The messages by name; messages of equal name get their identifiers as suffix."""
    every = Counter(message.name for message in database.messages)
    return {
        message.name
        if every[message.name] == 1
        else f"{message.name}_{message.frame_id:X}": message
        for message in database.messages
    }


class _DatabaseDecoder:
    """Decodes chunk after chunk of frames of a database.

    Args:
        database: any cantools CAN database.
        prefix: before the names of its messages in the result.
        wanted: the message decoders by name, as `_message_decoders` makes them.
    """

    def __init__(self, database: Database, prefix: str, wanted: dict[str, MessageDecoder]) -> None:
        self.decoders: Final = {f"{prefix}{name}": found for name, found in wanted.items()}
        """The messages to decode, in the order of the database."""
        by_key = {}
        for name, message in _named(database).items():
            by_key[message.frame_id | message.is_extended_frame << _EXTENDED_BIT] = prefix + name
        for name, message in _named(database).items():
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


def _message_decoders(
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
    for name, message in _named(database).items():
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


def _require_names(
    databases: Iterable[tuple[str, Database]],
    messages: Collection[str] | None,
    signals: Collection[str] | None,
) -> None:
    """Refuse names of messages and signals unknown to every database (prefix, database)."""
    known: list[str] = []
    inside: list[str] = []
    for prefix, database in databases:
        for name, message in _named(database).items():
            names = dict.fromkeys([name, message.name, prefix + name, prefix + message.name])
            known += names
            inside += [f"{one}.{signal.name}" for one in names for signal in message.signals]
            inside += [signal.name for signal in message.signals]
    for wanted, there, kind in ((messages, known, "message"), (signals, inside, "signal")):
        for name in wanted or ():
            if name not in there:
                by_lower = {one.lower(): one for one in there}
                close = get_close_matches(name.lower(), by_lower, 3, 0.5)
                near = [by_lower[one] for one in close] or sorted(set(there))[:5]
                raise DbcError(f"no {kind} {name} in the database; it has {', '.join(near)}, …")
