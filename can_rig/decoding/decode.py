"""Frames of a log → columns of physical values, through any CAN database.

    from can_rig.decoding.decode import decode_log

    messages = decode_log("drive.log", "car.dbc")
    messages["DSTAR_FEEDBACK"].signals["DStar"]     # numpy
    messages["DSTAR_FEEDBACK"].to_pandas()

No frame is lost silently: `Decoder.counts` has for every message the number of frames and the
reasons for missing rows, `Decoder.unknown` the number of frames with an unknown identifier.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from cantools.database.can import Database

from can_rig.decoding.database_decoder import DatabaseDecoder, message_decoders, require_names
from can_rig.decoding.j1939_transport import Transport
from can_rig.decoding.message_columns import MessageColumns, joined
from can_rig.decoding.message_decoder import Counts
from can_rig.frames.databases import load_database
from can_rig.logs.frames import ERROR, EXTENDED, Frames
from can_rig.logs.log import window_of
from can_rig.logs.reading import read_log

Databases = Database | Sequence[tuple[str | None, Database]]
"""One database for all buses; or several, each for the named bus or, with None, for all buses."""


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
        require_names(prefixed, messages, signals)
        self._parts = [
            (bus, DatabaseDecoder(one, prefix, message_decoders(one, prefix, messages, signals)))
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
    channel: str | None = None,
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
        channel: see `Decoder`.
        from_s: only frames from so many seconds after the start of the recording on.
        to_s: only frames before this time after the start of the recording.

    Raises:
        LogError: the log cannot be read.
        DbcError: the database cannot be read, or lacks a selected message or signal.
    """
    if isinstance(database, str | Path):
        database = load_database(database)
    decoder = Decoder(database, messages, signals, channel)
    log = read_log(path, window=window_of(from_s, to_s))
    parts: dict[str, list[MessageColumns]] = {}
    for frames in log:
        for name, columns in decoder.decode(frames).items():
            parts.setdefault(name, []).append(columns)
    whole = {name: joined(parts[name]) for name in decoder.messages if name in parts}
    return DecodedLog(whole, decoder, log.notice)
