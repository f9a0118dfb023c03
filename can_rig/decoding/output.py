"""Where decoded messages go, by the name of the output; nothing half written is left behind."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Final, Protocol

from can_rig.decoding.message_columns import MessageColumns
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing

TABLES: Final = (".csv", ".parquet")
"""What becomes one table of all messages."""

_MF4: Final = ".mf4"


class Output(Protocol):
    """A file, or several, that decoded chunks go to."""

    def write(self, chunk: Mapping[str, MessageColumns]) -> None:
        """Add the messages of a chunk of the log."""

    def close(self) -> None:
        """Finish."""


def refuse_output(path: Path, force: bool) -> None:
    """Refuse an output that cannot be one, or is there already and may not be replaced.

    Raises:
        LogError: the reason.
    """
    if path.suffix not in {"", _MF4, *TABLES}:
        raise LogError(
            f"{path}: nothing is written as {path.suffix}; .csv, .parquet, .mf4 are right, or a "
            "folder, without a suffix"
        )
    refuse_existing(path, force, "--out")
    if not path.exists():
        return
    if path.is_dir() and any(inside.suffix != ".csv" for inside in path.iterdir()):
        raise LogError(f"{path}: holds more than decoded messages, so --force does not replace it")
    if path.is_dir() != (path.suffix == ""):
        raise LogError(f"{path}: a {'folder' if path.is_dir() else 'file'}, not to be replaced")


@contextmanager
def output(
    path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool
) -> Iterator[Output]:
    """An output at ``path``, which is there, whole, when the context is left without an error.

    Args:
        path: ``.csv``, ``.parquet``, ``.mf4``, or a folder.
        layout: of a table of all messages: its messages, without rows.
        start_ns: the start of the recording, on the clock of the columns.
        names: words of value tables in place of numbers.

    Raises:
        LogError: it cannot be written.
    """
    with atomic(path) as part:
        writer = _writer(part, layout, start_ns, names)
        yield writer
        writer.close()


def _writer(path: Path, layout: Mapping[str, MessageColumns], start_ns: int, names: bool) -> Output:
    if path.suffix == _MF4:
        from can_rig.decoding.mf4 import DecodedMf4  # noqa: PLC0415 (slow to import)

        return DecodedMf4(path, start_ns)
    from can_rig.decoding.tables import FolderOfTables, WideTable  # noqa: PLC0415 (slow to import)

    if path.suffix in TABLES:
        return WideTable(path, layout, start_ns, names)
    return FolderOfTables(path, start_ns, names)
