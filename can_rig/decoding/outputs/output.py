"""Writes decoded messages to files, in the format of the output's name.

Incomplete files are removed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

from can_rig.decoding.message_columns import MessageColumns
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.folders import Kind, refuse_folder, whole_folder

CSV: Final = ".csv"
"""Format with one table of all messages."""

_PARQUET: Final = ".parquet"
_OF_FILES: Final = {"": CSV, _PARQUET: _PARQUET}
"""Suffix of a folder with a file for each message, and suffix of the files."""
_MF4: Final = ".mf4"
_MCAP: Final = ".mcap"

INDEX: Final = "_decoded.json"
"""In a folder of decoded messages: the message of each file."""


def _own(folder: Path) -> list[str]:
    """The files that the index of a folder names, and itself."""
    try:
        files = json.loads((folder / INDEX).read_text("utf-8"))["files"]
        return [*(name for name in files if name == Path(name).name), INDEX]
    except (OSError, ValueError, KeyError, TypeError):
        return [INDEX]


DECODED: Final = Kind("a folder of decoded messages", INDEX, _own, lambda _: True)


class Output(Protocol):
    """One or several files that receive decoded chunks."""

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk of the log."""

    def close(self) -> None:
        """Finish the files."""


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an unknown format, or an existing output without ``force``.

    Raises:
        LogError, RunFolderError: the reason.
    """
    if path.suffix not in {CSV, _MF4, _MCAP, *_OF_FILES}:
        raise LogError(
            f"{path}: cannot be written as {path.suffix}; it must be .csv, .parquet, .mf4 or "
            ".mcap, or a folder, without a suffix"
        )
    if path.suffix in _OF_FILES:
        refuse_folder(path, DECODED, force)
    else:
        refuse_existing(path, force, "--out")


@contextmanager
def output(
    path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool, force: bool
) -> Iterator[Output]:
    """An output at ``path``, which exists, complete, once the context is left without an error.

    Args:
        path: ``.csv``, ``.mf4``, ``.mcap``, or a folder: ``.parquet``, or without a suffix.
        layout: for `CSV`, the possible messages, without rows.
        start_ns: start of the recording, on the clock of the columns [ns].
        names: whether to write words of value tables instead of numbers.
        force: replace an earlier output.

    Raises:
        LogError, RunFolderError: the output cannot be written.
    """
    folder = path.suffix in _OF_FILES
    whole = whole_folder(path, DECODED, force=force) if folder else atomic(path, force=force)
    with whole as part:
        writer = _writer(part, layout, start_ns, names)
        yield writer
        writer.close()


def _writer(path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool) -> Output:
    if path.suffix == _MF4:
        from can_rig.decoding.outputs.mf4 import DecodedMf4  # noqa: PLC0415 (slow to import)

        return DecodedMf4(path, start_ns)
    if path.suffix == _MCAP:
        from can_rig.decoding.outputs.mcap import DecodedMcap  # noqa: PLC0415 (an extra)

        return DecodedMcap(path, names)
    if path.suffix == CSV:
        from can_rig.decoding.outputs.wide_csv import WideCsv  # noqa: PLC0415 (slow to import)

        return WideCsv(path, layout, start_ns, names)
    from can_rig.decoding.outputs.tables import FolderOfTables  # noqa: PLC0415 (slow to import)

    return FolderOfTables(path, _OF_FILES[path.suffix], start_ns, names, INDEX)
