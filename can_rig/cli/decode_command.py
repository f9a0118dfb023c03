"""``can-rig decode``: a log through a DBC, into files, with an account of what was not decoded."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from cantools.database.can import Database
from rich.console import Console
from rich.table import Table

from can_rig.cli.progress import reading
from can_rig.decoding.database import load_database
from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_columns import MessageColumns
from can_rig.decoding.output import TABLES, Output, output, refuse_output
from can_rig.errors import LogError
from can_rig.frames.dbc import shipped_dbc
from can_rig.logs.formats import format_of
from can_rig.logs.frames import concatenate
from can_rig.logs.log import Log
from can_rig.logs.reading import read_log
from can_rig.results.run_folder import LOG, SUMMARY

_CELLS: Final = 1 << 22  # of a chunk of a wide table: bounds its memory
_LEAST_ROWS: Final = 1 << 10
_SHOWN: Final = 5  # unknown identifiers in the table


@dataclass(frozen=True)
class Selection:
    """What of a log is decoded; None: all."""

    messages: Collection[str] | None
    signals: Collection[str] | None
    channel: str | None

    def decoder(self, database: Database) -> Decoder:
        """A new one."""
        return Decoder(database, self.messages, self.signals, self.channel)


class Form(NamedTuple):
    """How it is written."""

    relative: bool
    """Time counts from the start of the recording."""
    names: bool
    """Words of value tables in place of numbers."""


def decode_command(
    source: Path,
    dbc: Path | None,
    strict: bool,
    outputs: Sequence[Path],
    selection: Selection,
    form: Form,
    as_json: bool,
    force: bool,
) -> int:
    """``can-rig decode``: the exit status.

    Raises:
        LogError: the log cannot be read, or an output not written.
        DbcError: the DBC cannot be read or has no such message or signal.
    """
    log = read_log(source / LOG if source.is_dir() else source)
    database = load_database(dbc or _own_dbc(source), strict)
    decoder = selection.decoder(database)
    for path in outputs:
        refuse_output(path, force)
    layout = {}
    if any(path.suffix in TABLES for path in outputs):
        layout = _survey(log, selection.decoder(database))
        columns = sum(len(message.signals) for message in layout.values()) + 2
        log.chunk_frames = min(log.chunk_frames, max(_CELLS // columns, _LEAST_ROWS))
    with ExitStack() as stack:
        writers: list[Output] | None = None

        def opened() -> list[Output]:
            start_ns = 0 if form.relative else log.start_ns
            return [
                stack.enter_context(output(path, layout, start_ns, form.names)) for path in outputs
            ]

        for frames in reading(log, "decoding"):
            writers = opened() if writers is None else writers
            start_ns = log.start_ns if form.relative else 0
            chunk = decoder.decode(replace(frames, time_ns=frames.time_ns - start_ns))
            for writer in writers:
                writer.write(chunk)
        if writers is None:
            if format_of(log.path) == ".log":  # without a header, nothing says that it is a log
                raise LogError(
                    f"{log.path}: no frame in it; a log as candump -L writes it is right"
                )
            opened()
    if as_json:
        print(json.dumps(_summary(log, decoder, outputs), ensure_ascii=False))
    else:
        _print(decoder, outputs)
    for note in filter(None, (log.notice, decoder.nothing_on_channel)):
        Console(stderr=True, soft_wrap=True).print(
            f"note: {note}", style="yellow", markup=False, highlight=False
        )
    return 0


def _own_dbc(source: Path) -> Path:
    """The DBC of a run folder's scenario; otherwise that of the car."""
    try:
        kind = json.loads((source / SUMMARY).read_text("utf-8"))["scenario"]["plant"]["kind"]
    except (OSError, ValueError, KeyError, TypeError):
        kind = None
    return shipped_dbc("chapter_2.dbc" if kind == "chapter-2" else "steer_by_wire.dbc")


def _survey(log: Log, decoder: Decoder) -> dict[str, MessageColumns]:
    """By message that occurs, its columns without rows; of a pipe, which is read once, of all."""
    if log.path.is_file():
        for frames in reading(log, "looking through"):
            decoder.decode(frames)
    return {
        name: message.decode(concatenate([]), np.zeros(0, dtype=np.int64))
        for name, message in decoder.messages.items()
        if message.counts.frames or not log.path.is_file()
    }


def _summary(log: Log, decoder: Decoder, outputs: Sequence[Path]) -> dict[str, Any]:
    return {
        "log": str(log.path),
        "frames": decoder.frames,
        "messages": {n: c.as_dict() for n, c in decoder.counts.items() if c.frames},
        "unknown": dict(decoder.unknown.most_common()),
        "error_frames": decoder.error_frames,
        "not_wanted": decoder.not_wanted,
        "notice": log.notice,
        "out": [str(path) for path in outputs],
    }


def _print(decoder: Decoder, outputs: Sequence[Path]) -> None:
    """One row a message that occurs; only the columns in which there is something."""
    counts = {name: c.as_dict() for name, c in decoder.counts.items() if c.frames}
    headings = ["frames", "decoded"]
    if counts:
        every = next(iter(counts.values()))
        headings += [h for h in every if h not in headings and any(c[h] for c in counts.values())]
    table = Table(box=None, pad_edge=False)
    table.add_column("message")
    for heading in headings:
        table.add_column(heading.replace("_", " "), justify="right")
    for name, count in counts.items():
        table.add_row(name, *(str(count[heading]) for heading in headings))
    console = Console()
    console.print(table)
    unknown = decoder.unknown.most_common(_SHOWN)
    if unknown:
        some = ", ".join(f"identifier 0x{digits}: {count}" for digits, count in unknown)
        more = ", …" if len(decoder.unknown) > len(unknown) else ""
        total = decoder.unknown.total()
        console.print(f"frames not in the database: {total} ({some}{more})", highlight=False)
    if decoder.error_frames:
        console.print(f"error frames: {decoder.error_frames}", highlight=False)
    if decoder.not_wanted:
        console.print(f"of other messages or buses: {decoder.not_wanted}", highlight=False)
    for path in outputs:
        console.print(f"written  {path}", soft_wrap=True, markup=False, highlight=False)
