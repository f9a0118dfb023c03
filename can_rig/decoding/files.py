"""A whole log, decoded into files chunk by chunk; incomplete files are removed."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_decoder import MessageColumns
from can_rig.errors import LogError
from can_rig.logs.frames import ALL, Frames, Log, concatenate
from can_rig.storage.files import atomic, refuse_existing
from can_rig.storage.folders import Kind, refuse_folder, whole_folder

_WRITERS: Final = {
    ".csv": "tables.WideCsv",
    ".parquet": "tables.FolderOfTables",
    "": "tables.FolderOfTables",
    ".mf4": "to_mf4.DecodedMf4",
    ".mcap": "to_mcap.DecodedMcap",
}
"""The `Output` by suffix; imported on use, because their libraries are slow to import."""

_FOLDERS: Final = (".parquet", "")
"""Suffixes of folders with a file for each message."""

INDEX: Final = "_decoded.json"
"""In a folder of decoded messages: the message of each file."""

_CELLS: Final = 1 << 22  # of a chunk, if all its frames are of the widest message: bounds memory
_LEAST_ROWS: Final = 1 << 10

Reading = Callable[[Log, str], Iterator[Frames]]
"""Yields the chunks of a log; the text describes the activity for a progress display."""


def _own(folder: Path) -> list[str]:
    """The files that the index of a folder names, and itself."""
    try:
        files = json.loads((folder / INDEX).read_text("utf-8"))["files"]
        return [*(name for name in files if name == Path(name).name), INDEX]
    except (OSError, ValueError, KeyError, TypeError):
        return [INDEX]


DECODED: Final = Kind("a folder of decoded messages", INDEX, _own, lambda _: True)


class Contents(NamedTuple):
    """What an output needs to know of the log and of the user's wishes."""

    layout: Mapping[str, MessageColumns]
    """For a single CSV, the possible messages, without rows."""
    start_ns: int
    """Start of the recording, on the clock of the columns [ns]."""
    names: bool
    """Whether to write words of value tables instead of numbers."""


class Output(Protocol):
    """One or several files that receive decoded chunks; made from a path and `Contents`."""

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk of the log."""

    def close(self) -> None:
        """Finish the files."""


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an unknown format, or an existing output without ``force``.

    Raises:
        LogError, RunFolderError: the reason.
    """
    if path.suffix not in _WRITERS:
        raise LogError(
            f"{path}: cannot be written as {path.suffix}; it must be .csv, .parquet, .mf4 or "
            ".mcap, or a folder, without a suffix"
        )
    if path.suffix in _FOLDERS:
        refuse_folder(path, DECODED, force)
    else:
        refuse_existing(path, force, "--out")


@contextmanager
def output(path: Path, contents: Contents, force: bool) -> Iterator[Output]:
    """An output at ``path``, which exists, complete, once the context is left without an error.

    Args:
        path: ``.csv``, ``.mf4``, ``.mcap``, or a folder: ``.parquet``, or without a suffix.
        contents: see `Contents`.
        force: replace an earlier output.

    Raises:
        LogError, RunFolderError: the output cannot be written.
    """
    folder = path.suffix in _FOLDERS
    whole = whole_folder(path, DECODED, force=force) if folder else atomic(path, force=force)
    with whole as part:
        module, name = _WRITERS[part.suffix].split(".")
        writer: Any = getattr(import_module(f"can_rig.decoding.{module}"), name)(part, contents)
        yield writer
        writer.close()


def decode_to_files(
    log: Log,
    making: Callable[[], Decoder],
    outputs: Sequence[Path],
    reading: Reading,
    *,
    relative: bool = False,
    names: bool = False,
    force: bool = False,
) -> Decoder:
    """Decode ``log`` into every one of ``outputs``; returns the counts of the frames.

    All outputs appear at the end, complete.

    Args:
        log: read as often as needed; a pipe once.
        making: makes a decoder for the wanted part of the log.
        outputs: see ``output``.
        reading: iterates over the log and shows the progress.
        relative: time counts from the start of the recording.
        names: words of value tables in place of numbers.
        force: earlier outputs are replaced.

    Raises:
        LogError: the log cannot be read, lacks the selected bus, or is no log; an output cannot be
            written.
        DbcError: the database lacks a selected message or signal.
    """
    decoder = making()
    widest = max((len(message.signals) for message in decoder.messages.values()), default=0)
    log.chunk_frames = min(log.chunk_frames, max(_CELLS // (widest + 1), _LEAST_ROWS))
    layout = {}
    if any(path.suffix == ".csv" for path in outputs):
        layout = _survey(log, making(), reading)
    with ExitStack() as stack:
        writers: list[Output] | None = None

        def opened() -> list[Output]:
            start_ns = 0 if relative else log.start_ns
            contents = Contents(layout, start_ns, names)
            return [stack.enter_context(output(path, contents, force)) for path in outputs]

        for frames in reading(log, "decoding"):
            writers = opened() if writers is None else writers
            start_ns = log.start_ns if relative else 0
            chunk = decoder.decode(replace(frames, time_ns=frames.time_ns - start_ns))
            for writer in writers:
                writer.write(chunk)
        if writers is None:
            # Without a header, any text could be a log.
            if log.format.key == ".log" and log.window == ALL:
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
