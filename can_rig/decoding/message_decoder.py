"""Decodes all frames of a DBC message at once into columns, and counts frames without a row."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np
from cantools.database.can import Message as DbcMessage
from numpy.typing import NDArray

from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.signal_columns import Column, signal_column
from can_rig.frames.codec import ROLES, SPEED
from can_rig.frames.databases import attribute
from can_rig.frames.frame_columns import crcs
from can_rig.frames.protection import COUNTERS, FRAME_BYTES
from can_rig.logs.frames import CLASSIC_BYTES, REMOTE, Frames, UInt8s

COUNTER_BITS: Final = 0x0F

Rows = NDArray[np.bool_]


@dataclass
class Counts:
    """Outcome of the frames of one message.

    ``frames`` is the sum of ``decoded`` and of the five reasons after it.
    """

    frames: int = 0
    decoded: int = 0
    """Frames with a row."""
    too_short: int = 0
    """No signal fits into so few bytes; with E2E, any other number than in the database."""
    remote: int = 0
    """Remote frames (no payload)."""
    unknown_multiplexer: int = 0
    """The multiplexer has a value for which the database has no signals."""
    wrong_crc: int = 0
    """E2E: damaged, from a wrong sender, or with the invalid counter 15."""
    repeated: int = 0
    """E2E: the same counter as the frame before; 15 lost frames look the same."""
    shorter: int = 0
    """Decoded, but shorter than in the database: signals beyond the end are missing."""
    longer: int = 0
    """Decoded, but with more bytes than in the database."""
    gaps: int = 0
    """E2E: decoded, but the counter shows missing frames."""
    lost: int = 0
    """E2E: number of missing frames in all gaps; the true number may exceed the count by a multiple
    of 15."""

    def as_dict(self) -> dict[str, int]:
        """Every count, by name."""
        return asdict(self)


class MessageDecoder:
    """Decodes the frames of one message, chunk after chunk.

    Args:
        message: from any cantools database.
        wanted: the signals to decode; None: all.
        name: name of the message in the result; None: as in the database.

    Raises:
        DbcError: a signal is a float of an odd length.
    """

    def __init__(
        self, message: DbcMessage, wanted: Collection[str] | None = None, name: str | None = None
    ) -> None:
        self.message = message
        self.counts = Counts()
        self._name = name or message.name
        where = f"message {self._name}"
        columns = [signal_column(signal, where) for signal in message.signals]
        inside = [
            c
            for c in columns
            if c.first_bit >= 0 < c.length and c.first_bit + c.length <= 8 * message.length
        ]
        self._layout = {column.name: column for column in inside}
        self._wanted = [name for name in self._layout if wanted is None or name in wanted]
        outside = [signal for signal in message.signals if signal.name not in self._layout]
        self._tree = message.signal_tree
        if any(signal.is_multiplexer for signal in outside):
            outside, self._wanted, self._tree = message.signals, [], []
        self.left_out = [f"{self._name}.{signal.name}" for signal in outside]
        """Signals outside the message, or with a multiplexer outside."""
        # The signals in every frame: those at the root of the tree, including multiplexers.
        self._always = {n if isinstance(n, str) else next(iter(n)) for n in self._tree}
        self._data_id = protected_by(message)
        self._counter: int | None = None

    @property
    def signals(self) -> list[str]:
        """Names of the decoded signals."""
        return self._wanted

    def decode(self, frames: Frames, row: NDArray[np.int64]) -> MessageColumns:
        """The columns of the usable ``frames``; all ``frames`` have the message's identifier."""
        self.counts.frames += len(frames)
        usable = self._usable(frames)
        if not usable.all():
            frames, row = frames[usable], row[usable]
        data = _at_least(frames.data, max(self.message.length, CLASSIC_BYTES))
        present: dict[str, Rows] = {}
        short = frames.length < self.message.length
        bits = 8 * frames.length.astype(np.int64) if short.any() else None
        known = self._find(self._tree, data, bits, np.ones(len(frames), bool), present)
        self.counts.unknown_multiplexer += int((~known).sum())
        if bits is not None:
            empty = short & known & ~np.any([*present.values(), ~short], axis=0)
            self.counts.too_short += int(empty.sum())
            known &= ~empty
        if not known.all():
            frames, row, data, short = frames[known], row[known], data[known], short[known]
            present = {name: mask[known] for name, mask in present.items()}
        self.counts.decoded += len(frames)
        self.counts.shorter += int(short.sum())
        self.counts.longer += int((frames.length > self.message.length).sum())
        signals, codes = {}, {}
        for name in self._wanted:
            there = present.get(name, np.zeros(len(frames), bool))  # behind no multiplexer's value
            raw, signals[name] = self._column(name, data, there)
            if self._layout[name].choices:
                codes[name] = raw
        layout = {name: self._layout[name] for name in self._wanted}
        return MessageColumns(self._name, frames.time_ns, row, signals, codes, layout)

    def _usable(self, frames: Frames) -> Rows:
        """(n,) whether a frame has a payload and, if protected, is intact and not repeated."""
        counts = self.counts
        remote = frames.has(REMOTE)
        counts.remote += int(remote.sum())
        if self._data_id is None:
            return ~remote
        short = ~remote & (frames.length != self.message.length)
        counts.too_short += int(short.sum())
        whole = ~remote & ~short
        usable: Rows = whole & intact_rows(frames.data, frames.length, self._data_id)
        counts.wrong_crc += int(whole.sum() - usable.sum())
        counter = counters(frames.data)[usable]
        ahead = steps(counter, self._counter)
        counts.repeated += int((ahead == 0).sum())
        counts.gaps += int((ahead > 1).sum())
        counts.lost += int((ahead[ahead > 1] - 1).sum())
        if len(counter):
            self._counter = int(counter[-1])
        usable[usable] = ahead != 0
        return usable

    def _find(
        self,
        tree: Sequence[Any],
        data: UInt8s,
        bits: NDArray[np.int64] | None,
        rows: Rows,
        present: dict[str, Rows],
    ) -> Rows:
        """Set ``present`` for the ``rows`` that contain each signal of ``tree``.

        Args:
            tree: signals, and signals below values of a multiplexer.
            data: (n, bytes) payloads.
            bits: (n,) lengths of the payloads; None: every signal fits.
            rows: (n,) the frames to look at.
            present: gets (n,) for each signal.

        Returns (n,) whether every multiplexer has a value known to the database.
        """
        known, nowhere = np.ones(len(rows), dtype=bool), np.zeros(len(rows), dtype=bool)
        for node in tree:
            name, branches = (node, None) if isinstance(node, str) else next(iter(node.items()))
            column = self._layout.get(name)
            if column is None:  # the signal exceeds the message
                continue
            here = rows if bits is None else rows & (bits >= column.first_bit + column.length)
            present[name] = present.get(name, nowhere) | here
            if branches is None:
                continue
            number = column.physical(column.raw(data))  # as in cantools: scaled, then truncated
            number = np.trunc(number) if number.dtype.kind == "f" else number
            for value in np.unique(number[here]).tolist():
                chosen = here & (number == value)
                if value in branches:
                    known &= self._find(branches[value], data, bits, chosen, present)
                else:
                    known &= ~chosen
        return known

    def _column(self, name: str, data: UInt8s, rows: Rows) -> tuple[Column, Column]:
        """Raw and physical values; masked arrays for a multiplexed signal."""
        column = self._layout[name]
        if name in self._always and rows.all():
            raw = column.raw(data)
            return raw, column.physical(raw)
        raw = column.raw(data[rows])
        return _spread(raw, rows), _spread(column.physical(raw), rows)


def _spread(values: Column, rows: Rows) -> Column:
    whole = np.zeros(len(rows), dtype=values.dtype)
    whole[rows] = values
    return np.ma.MaskedArray(whole, mask=~rows)


def _at_least(data: UInt8s, width: int) -> UInt8s:
    missing = width - data.shape[1]
    return np.pad(data, ((0, 0), (0, missing))) if missing > 0 else data


def protected_by(message: DbcMessage) -> int | None:
    """The E2E data identifier of a message of the rig; None for foreign messages."""
    data_id = attribute(message, "E2EDataId")
    if attribute(message, "RigRole") not in (*ROLES, SPEED) or not isinstance(data_id, int):
        return None
    return data_id if 0 < data_id <= 0xFFFF and message.length == CLASSIC_BYTES else None


# The check of AUTOSAR E2E profile 1 for many frames at once: a vectorised `frames.protection`.


def intact_rows(data: UInt8s, length: UInt8s, data_id: int) -> Rows:
    """(n,) result of e2e_p01_check for payloads (n, 8 or more) of these lengths."""
    whole: Rows = crcs(data, data_id) == data[:, 0]
    whole &= counters(data) < COUNTERS
    whole &= length == FRAME_BYTES
    return whole


def counters(data: UInt8s) -> UInt8s:
    """(n,) alive counters of payloads."""
    return data[:, 1] & np.uint8(COUNTER_BITS)


def steps(counter: UInt8s, before: int | None) -> NDArray[np.int64]:
    """(n,) increments of the counter, 0..14; 1 is in sequence.

    Args:
        counter: (n,) of intact frames, in their order.
        before: the last preceding counter; None: the first frame starts the sequence.
    """
    numbers = counter.astype(np.int64)
    first = (numbers[:1] - 1) if before is None else np.array([before])
    ahead: NDArray[np.int64] = np.diff(numbers, prepend=first[: len(numbers)]) % COUNTERS
    return ahead
