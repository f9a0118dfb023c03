"""A whole log, decoded into files chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from can_rig.decoding.decode import Databases, Decoder
from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.outputs.output import CSV, Output, output
from can_rig.errors import LogError
from can_rig.logs.frames import Frames, concatenate
from can_rig.logs.log import Log

_CELLS: Final = 1 << 22  # of a chunk, if all its frames are of the widest message: bounds memory
_LEAST_ROWS: Final = 1 << 10

Reading = Callable[[Log, str], Iterator[Frames]]
"""Yields the chunks of a log; the text describes the activity for a progress display."""


@dataclass(frozen=True)
class Selection:
    """The part of a log to decode; None: all."""

    messages: Collection[str] | None = None
    signals: Collection[str] | None = None
    channel: str | None = None

    def decoder(self, databases: Databases) -> Decoder:
        """A new decoder for the selection."""
        return Decoder(databases, self.messages, self.signals, self.channel)


@dataclass(frozen=True)
class Form:
    """The form of the output."""

    relative: bool = False
    """Time counts from the start of the recording."""
    names: bool = False
    """Words of value tables in place of numbers."""
    force: bool = False
    """Earlier outputs are replaced."""


def decode_to_files(
    log: Log,
    databases: Databases,
    selection: Selection,
    outputs: Sequence[Path],
    form: Form,
    reading: Reading,
) -> Decoder:
    """Decode ``log`` into every one of ``outputs``; returns the counts of the frames.

    All outputs appear at the end, complete.

    Raises:
        LogError: the log cannot be read, lacks the selected bus, or is no log; an output cannot be
            written.
        DbcError: the database lacks a selected message or signal.
    """
    decoder = selection.decoder(databases)
    widest = max((len(message.signals) for message in decoder.messages.values()), default=0)
    log.chunk_frames = min(log.chunk_frames, max(_CELLS // (widest + 1), _LEAST_ROWS))
    layout = {}
    if any(path.suffix == CSV for path in outputs):
        layout = _survey(log, selection.decoder(databases), reading)
    with ExitStack() as stack:
        writers: list[Output] | None = None

        def opened() -> list[Output]:
            start_ns = 0 if form.relative else log.start_ns
            return [
                stack.enter_context(output(path, layout, start_ns, form.names, form.force))
                for path in outputs
            ]

        for frames in reading(log, "decoding"):
            writers = opened() if writers is None else writers
            start_ns = log.start_ns if form.relative else 0
            chunk = decoder.decode(replace(frames, time_ns=frames.time_ns - start_ns))
            for writer in writers:
                writer.write(chunk)
        if writers is None:
            if log.format.key == ".log":  # without a header, any text could be a log
                raise LogError(
                    f"{log.path}: has no frame in it; must be a log as candump -L writes it"
                )
            opened()
        if decoder.nothing_on_channel:
            raise LogError(f"{log.path}: {decoder.nothing_on_channel}")
    return decoder


def _survey(log: Log, decoder: Decoder, reading: Reading) -> dict[str, MessageColumns]:
    """Columns without rows for each message in the log.

    For a pipe, readable only once, for every message.
    """
    if log.path.is_file():
        for frames in reading(log, "looking through"):
            decoder.decode(frames)
    return {
        name: message.decode(concatenate([]), np.zeros(0, dtype=np.int64))
        for name, message in decoder.messages.items()
        if message.counts.frames or not log.path.is_file()
    }
