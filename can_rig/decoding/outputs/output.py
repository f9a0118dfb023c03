"""Decoded messages into files, by the name of the output; nothing incomplete is left behind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

from can_rig.decoding.message_columns import MessageColumns
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing

TABLES: Final = (".csv", ".parquet")
"""Formats with one table of all messages."""

_MF4: Final = ".mf4"
_MCAP: Final = ".mcap"


class Output(Protocol):
    """One or several files that decoded chunks are written to."""

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk of the log."""

    def close(self) -> None:
        """Finish the files."""


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an output of an unknown format, or one that exists and must not be replaced.

    Raises:
        LogError: the reason.
    """
    if path.suffix not in {"", _MF4, _MCAP, *TABLES}:
        raise LogError(
            f"{path}: cannot be written as {path.suffix}; it must be .csv, .parquet, .mf4 or "
            ".mcap, or a folder, without a suffix"
        )
    refuse_existing(path, force, "--out")
    if not path.exists():
        return
    if path.is_dir() and any(inside.suffix != ".csv" for inside in path.iterdir()):
        raise LogError(
            f"{path}: holds other files than decoded messages, so that --force does not replace it"
        )
    if path.is_dir() != (path.suffix == ""):
        found, other = ("folder", "file") if path.is_dir() else ("file", "folder")
        raise LogError(f"{path}: is a {found}, which --force does not replace by a {other}")


@contextmanager
def output(
    path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool
) -> Iterator[Output]:
    """An output at ``path``, which exists, complete, once the context is left without an error.

    Args:
        path: ``.csv``, ``.parquet``, ``.mf4``, ``.mcap``, or a folder.
        layout: the messages of a table of all messages, without rows.
        start_ns: start of the recording, on the clock of the columns [ns].
        names: whether to write words of value tables instead of numbers.

    Raises:
        LogError: it cannot be written.
    """
    with atomic(path) as part:
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
    from can_rig.decoding.outputs.tables import FolderOfTables, WideTable  # noqa: PLC0415 (slow to import)

    if path.suffix in TABLES:
        return WideTable(path, layout, start_ns, names)
    return FolderOfTables(path, start_ns, names)
