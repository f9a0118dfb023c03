"""Frames of a log → columns of physical values, through any CAN database.

    from can_rig.decoding.decode import decode_log

    messages = decode_log("drive.log", "car.dbc")
    messages["DSTAR_FEEDBACK"].signals["DStar"]     # numpy
    messages["DSTAR_FEEDBACK"].to_pandas()

No frame is lost silently: `Decoder.counts` says for every message how many frames there are and why
some of them give no row, `Decoder.unknown` how many frames have an identifier that is not in the
database.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database
from cantools.database.can import Message as DbcMessage

from can_rig.decoding.database import load_database
from can_rig.decoding.message_columns import MessageColumns, joined
from can_rig.decoding.message_decoder import Counts, MessageDecoder
from can_rig.errors import DbcError
from can_rig.logs.frames import ERROR, EXTENDED, Frames
from can_rig.logs.reading import read_log

_EXTENDED_BIT: Final = 31  # above the identifier, as in a DBC


class Decoder:
    """Decodes chunk after chunk of a log.

    Args:
        database: any cantools CAN database.
        messages: names of the messages to decode; None: all. Where several have the same name,
            each has its identifier after it, as in ``NAME_1A0``; the name alone means all of them.
        signals: the signals to decode, as ``Signal`` or ``Message.Signal``; None: all. Messages
            without any of them are not decoded.
        channel: the only bus to decode; None: all.

    Raises:
        DbcError: a name is not in the database, or one of its messages cannot be decoded.
    """

    def __init__(
        self,
        database: Database,
        messages: Collection[str] | None = None,
        signals: Collection[str] | None = None,
        channel: str | None = None,
    ) -> None:
        self._channel = channel
        self._decoders = _decoders(database, messages, signals)
        known = {
            message.frame_id | message.is_extended_frame << _EXTENDED_BIT: name
            for name, message in _named(database).items()
        }
        keys = sorted(known)
        self._keys: Final = np.array(keys, dtype=np.uint32)
        self._names: Final = [known[key] for key in keys]
        self.frames = 0
        """Number of all frames so far."""
        self.error_frames = 0
        self.unknown: Counter[str] = Counter()
        """Number of frames by identifier, ``123`` or ``12345678``, that is not in the database."""
        self.not_wanted = 0
        """Number of frames of messages and buses that were not asked for."""
        self._channels: dict[str, None] = {}  # an ordered set

    @property
    def counts(self) -> dict[str, Counts]:
        """What became of the frames of each message that was asked for."""
        return {name: decoder.counts for name, decoder in self._decoders.items()}

    @property
    def left_out(self) -> list[str]:
        """Signals that do not lie within their messages, as ``Message.Signal``."""
        return [name for decoder in self._decoders.values() for name in decoder.left_out]

    @property
    def messages(self) -> dict[str, MessageDecoder]:
        """The messages to decode, in the order of the database."""
        return self._decoders

    @property
    def nothing_on_channel(self) -> str | None:
        """One line if the bus asked for is not in the log."""
        if self._channel is None or self._channel in self._channels:
            return None
        return f"no frame on bus {self._channel}; the log has {', '.join(self._channels)}"

    def decode(self, frames: Frames) -> dict[str, MessageColumns]:
        """The columns of a chunk, by message; only messages with a frame in it."""
        rows = np.arange(self.frames, self.frames + len(frames))
        self.frames += len(frames)
        self._channels.update(dict.fromkeys(frames.channels))
        keep = np.ones(len(frames), dtype=bool)
        if self._channel is not None and len(frames):
            keep = np.array([name == self._channel for name in frames.channels])[frames.channel]
            self.not_wanted += int((~keep).sum())
        errors = keep & frames.has(ERROR)
        self.error_frames += int(errors.sum())
        keep = keep & ~errors
        if not keep.all():
            frames, rows = frames[keep], rows[keep]
        places = self._places(frames)
        order = np.argsort(places, kind="stable")
        ends = np.cumsum(np.bincount(places, minlength=len(self._names) + 1))
        self._count_unknown(frames[order[ends[len(self._names) - 1] if self._names else 0 :]])
        found = {}
        for place, name in enumerate(self._names):
            chosen = order[ends[place - 1] if place else 0 : ends[place]]
            decoder = self._decoders.get(name)
            if decoder is None:
                self.not_wanted += len(chosen)
            elif len(chosen):
                found[name] = decoder.decode(frames[chosen], rows[chosen])
        return {name: found[name] for name in self._decoders if name in found}

    def _places(self, frames: Frames) -> np.ndarray[tuple[int], np.dtype[np.int16]]:
        """(n,) index of each frame's message in the sorted ones; their number for none of them."""
        if not len(self._keys):
            return np.zeros(len(frames), dtype=np.int16)
        keys = frames.arbitration_id | frames.has(EXTENDED).astype(np.uint32) << _EXTENDED_BIT
        places = np.searchsorted(self._keys, keys)
        places[places == len(self._keys)] = 0
        places[self._keys[places] != keys] = len(self._keys)
        return places.astype(np.int16)  # of 16 bits, which sort by radix

    def _count_unknown(self, frames: Frames) -> None:
        for extended, digits in ((False, 3), (True, 8)):
            chosen = frames.arbitration_id[frames.has(EXTENDED) == extended]
            for identifier, count in zip(*np.unique(chosen, return_counts=True), strict=True):
                self.unknown[f"{identifier:0{digits}X}"] += int(count)


class DecodedLog(dict[str, MessageColumns]):
    """The columns of a whole log, by message that occurs; and what was not decoded."""

    def __init__(
        self, columns: dict[str, MessageColumns], decoder: Decoder, notice: str | None
    ) -> None:
        super().__init__(columns)
        self.counts: Final = decoder.counts
        self.unknown: Final = decoder.unknown
        self.error_frames: Final = decoder.error_frames
        self.notice: Final = notice
        """One line if the end of the log is missing, else None."""


def decode_log(
    path: str | Path,
    database: Database | str | Path,
    messages: Collection[str] | None = None,
    signals: Collection[str] | None = None,
    channel: str | None = None,
) -> DecodedLog:
    """Decode a whole log in memory.

    Args:
        path: a log of any format that `read_log` reads.
        database: a cantools database, or a file of one.
        messages: see `Decoder`.
        signals: see `Decoder`.
        channel: see `Decoder`.

    Raises:
        LogError: the log cannot be read.
        DbcError: the database cannot be read, or has no such message or signal.
    """
    if not isinstance(database, Database):
        database = load_database(database)
    decoder = Decoder(database, messages, signals, channel)
    log = read_log(path)
    parts: dict[str, list[MessageColumns]] = {}
    for frames in log:
        for name, columns in decoder.decode(frames).items():
            parts.setdefault(name, []).append(columns)
    whole = {name: joined(parts[name]) for name in decoder.messages if name in parts}
    return DecodedLog(whole, decoder, log.notice)


def _named(database: Database) -> dict[str, DbcMessage]:
    """The messages by name; where several have the same one, with their identifiers after it."""
    every = Counter(message.name for message in database.messages)
    return {
        message.name
        if every[message.name] == 1
        else f"{message.name}_{message.frame_id:X}": message
        for message in database.messages
    }


def _decoders(
    database: Database, messages: Collection[str] | None, signals: Collection[str] | None
) -> dict[str, MessageDecoder]:
    named = _named(database)
    _require(messages or (), [*named, *(m.name for m in named.values())], "message")
    every = [f"{name}.{s.name}" for name, message in named.items() for s in message.signals]
    every += [f"{m.name}.{s.name}" for m in named.values() for s in m.signals]
    _require(signals or (), [*every, *(name.partition(".")[2] for name in every)], "signal")
    found = {}
    for name, message in named.items():
        if message.is_container or not (
            messages is None or name in messages or message.name in messages
        ):
            continue
        wanted = _of_message((name, message.name), [s.name for s in message.signals], signals)
        if wanted is None or wanted:
            found[name] = MessageDecoder(message, wanted, name)
    return found


def _of_message(
    messages: Iterable[str], names: Iterable[str], signals: Collection[str] | None
) -> list[str] | None:
    if signals is None:
        return None
    return [
        name
        for name in names
        if name in signals or any(f"{message}.{name}" in signals for message in messages)
    ]


def _require(wanted: Collection[str], names: Collection[str], kind: str) -> None:
    """Refuse a wanted name that is not one of ``names``."""
    for name in wanted:
        if name not in names:
            near = get_close_matches(name, names, 3, 0.5) or sorted(set(names))[:5]
            raise DbcError(f"no {kind} {name} in the database; it has {', '.join(near)}, …")
