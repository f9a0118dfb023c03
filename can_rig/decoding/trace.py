"""Frames for a page: raw bytes, and the layouts of the signals in the bytes."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Final

import can
import numpy as np
from cantools.database.can import Message as DbcMessage

from can_rig.decoding.decode import Databases, Decoder
from can_rig.decoding.message_decoder import signal_column
from can_rig.drawing.names import printed
from can_rig.errors import DbcError
from can_rig.logs.frames import ERROR, EXTENDED, NS_PER_S, REMOTE, Frames, Log

MOST_FRAMES: Final = 200_000
"""Of a page; the page says that it has the first frames only."""

PROTECTION: Final = ("Checksum", "AliveCounter", "Tick")
"""Signals that protect a frame of the rig, and say nothing of the plant."""


class Kinds:
    """Numbers the kinds of frames, by identifier, bus and message."""

    def __init__(self, databases: Databases) -> None:
        self._decoder = Decoder(databases)
        self._numbers: dict[tuple[int, int, str], int] = {}
        self.described: list[dict[str, Any]] = []
        """Of each kind its identifier, bus, message and signals, for JSON."""

    def number(self, identifier: int, flags: int, bus: str) -> int:
        """The number of a kind; a new kind is described.

        Args:
            identifier: of the frame.
            flags: ``EXTENDED``, ``REMOTE`` and ``ERROR`` of ``Frames.flags``.
            bus: its name.
        """
        kind = identifier, flags, bus
        if kind not in self._numbers:
            self._numbers[kind] = len(self.described)
            self.described.append(self._described(*kind))
        return self._numbers[kind]

    def _described(self, identifier: int, flags: int, bus: str) -> dict[str, Any]:
        extended = bool(flags & EXTENDED)
        name = None if flags & ERROR else self._decoder.name_of(identifier, extended, bus)
        signals = [] if name is None else _signals(self._decoder.messages[name].message)
        kinds = ((ERROR, "error frame"), (REMOTE, f"{name or ''} remote".strip()))
        said = next((words for flag, words in kinds if flags & flag), name or "")
        identifier_text = f"{identifier:0{8 if extended else 3}X}"
        return {"identifier": identifier_text, "bus": bus, "name": said, "signals": signals}


def _signals(message: DbcMessage) -> list[dict[str, Any]]:
    """The signals of a message, a multiplexer before its signals; check values are the last."""
    found = []
    for signal in sorted(message.signals, key=lambda each: _rank(message, each.name)):
        try:
            column = signal_column(signal, message.name)
        except DbcError:
            continue
        described = vars(column).copy()
        conversion = described.pop("conversion")
        described |= {
            "unit": printed(column.unit),
            "scale": conversion.scale,
            "offset": conversion.offset,
            "words": described.pop("choices"),
            "under": signal.multiplexer_signal,
            "ids": list(signal.multiplexer_ids or ()),
        }
        found.append(described)
    return found


def _rank(message: DbcMessage, name: str) -> tuple[bool, int]:
    above = message.get_signal_by_name(name).multiplexer_signal
    return name in PROTECTION, 0 if above is None else 1 + _rank(message, above)[1]


class Collected:
    """The first frames of a log, for a page.

    Args:
        kinds: numbers their kinds.
        log: whose chunks are taken.
        start_s: the time on the page at which the log begins, in s.
    """

    def __init__(self, kinds: Kinds, log: Log, start_s: float = 0.0) -> None:
        self._kinds, self._log, self._start_s = kinds, log, start_s
        self._parts: list[tuple[Any, ...]] = []
        self._count = 0
        self._is_whole = True

    def passing(self, chunks: Iterable[Frames]) -> Iterator[Frames]:
        """The chunks, which are collected while they pass."""
        for frames in chunks:
            self.take(frames)
            yield frames

    @property
    def is_full(self) -> bool:
        """Whether the page takes no further frame."""
        return not self._is_whole

    def take(self, frames: Frames) -> None:
        """Collect a chunk."""
        some = frames[: MOST_FRAMES - self._count]
        self._is_whole &= len(some) == len(frames)
        if not len(some):
            return
        self._count += len(some)
        flags = some.flags & (EXTENDED | REMOTE | ERROR)
        keys = np.stack([some.arbitration_id, flags, some.channel], axis=1)
        every, which = np.unique(keys, axis=0, return_inverse=True)
        numbers = [self._kinds.number(i, f, some.channels[c]) for i, f, c in every.tolist()]
        lengths = np.where(some.has(REMOTE | ERROR), 0, some.length).astype(np.uint8)
        inside = np.arange(some.data.shape[1]) < lengths[:, np.newaxis]
        time_s = (some.time_ns - self._log.start_ns) / NS_PER_S + self._start_s
        kinds = np.array(numbers, dtype="<u2")[which.ravel()]
        self._parts.append((time_s, kinds, lengths, some.data[inside]))

    def for_page(self) -> tuple[int, bytes, list[dict[str, Any]], str]:
        """The frames of a page; see ``drawing.bench.Recording``."""
        if not self._parts:
            return 0, b"", [], ""
        time_s, kinds, lengths, data = map(np.concatenate, zip(*self._parts, strict=True))
        note = "" if self._is_whole else f", the first until {time_s[-1]:.6g} s; --from shows later"
        whole = packed(time_s, kinds, lengths, data.tobytes())
        return len(time_s), whole, self._kinds.described, note


def packed(time_s: Any, kinds: Any, lengths: Any, data: bytes) -> bytes:
    """Frames as ``trace.js`` reads them.

    Args:
        time_s: (n,) times.
        kinds: (n,) numbers of ``Kinds``.
        lengths: (n,) payload lengths.
        data: all payloads, one after the other.
    """
    columns = ((time_s, "<f8"), (kinds, "<u2"), (lengths, "u1"))
    return b"".join([*(np.asarray(of, dtype=kind).tobytes() for of, kind in columns), data])


def of_messages(messages: Sequence[tuple[float, can.Message]], kinds: Kinds) -> bytes:
    """Received messages, each with its time in s, as ``trace.js`` reads them."""
    numbers = [
        kinds.number(
            message.arbitration_id,
            EXTENDED * message.is_extended_id
            | REMOTE * message.is_remote_frame
            | ERROR * message.is_error_frame,
            str(message.channel or "can"),
        )
        for _, message in messages
    ]
    payloads = [b"" if m.is_remote_frame or m.is_error_frame else m.data for _, m in messages]
    times_s = [time_s for time_s, _ in messages]
    return packed(times_s, numbers, [len(each) for each in payloads], b"".join(payloads))
