"""Logs of any common format as columns of frames, chunk by chunk.

    for frames in read_log(Path("drive.log")):
        print(len(frames), frames.time_ns[0])

| suffix            | format                     |
|-------------------|----------------------------|
| `.log`, `.log.gz` | candump -L, candump -l     |
| `.asc`, `.asc.gz` | Vector ASCII               |
| `.blf`            | Vector binary logging      |
| `.trc`, `.trc.gz` | PEAK trace                 |
| `.mf4`            | ASAM MDF 4, bus logging    |
| `.csv`, `.csv.gz` | SavvyCAN (GVRET)           |
| any text          | BUSMASTER, by its heading; Microchip, CARBUS Analyzer |

Time stamps are integers in nanoseconds, read digit by digit; only an `.mf4` may have them in float
seconds since the start of the recording, which are rounded to the nearest nanosecond.
"""

import zlib
from pathlib import Path
from typing import Final

from can_rig.errors import LogError
from can_rig.logs.formats.busmaster import BUSMASTER
from can_rig.logs.formats.candump import CANDUMP
from can_rig.logs.formats.mdf import MDF
from can_rig.logs.formats.peak import MICROCHIP, PEAK
from can_rig.logs.formats.savvycan import SAVVYCAN
from can_rig.logs.formats.vector_ascii import VECTOR_ASCII
from can_rig.logs.formats.vector_binary import VECTOR_BINARY
from can_rig.logs.frames import ALL, Format, Log, Window

FORMATS: Final = (CANDUMP, VECTOR_ASCII, VECTOR_BINARY, PEAK, MDF, SAVVYCAN, MICROCHIP, BUSMASTER)
"""The first format with a fitting mark reads a file."""

WRITTEN: Final = {each.key: each for each in FORMATS if each.write}
"""By suffix."""

_HEAD_BYTES: Final = 1 << 14
_GZIP: Final = 16 + zlib.MAX_WBITS


def read_log(path: str | Path, chunk_frames: int = 1 << 18, window: Window = ALL) -> Log:
    """The log at ``path``; every iteration reads the file.

    Args:
        path: a log of a supported format; text may be gzipped. The first bytes decide the format,
            or else the suffix; a pipe without a suffix is of candump.
        chunk_frames: largest number of frames in a chunk, which bounds the memory.
        window: the part of the recording to read.

    Raises:
        LogError: the file is missing, or neither its first bytes nor its suffix belong to a log.
    """
    path = Path(path)
    found = content_format(path)
    if found is None and not path.suffix and (path.is_fifo() or path.is_socket()):
        found = CANDUMP
    if found is None and not path.exists():
        raise LogError(f"{path}: there is no such file")
    return Log(path, found or format_of(path), chunk_frames, window)


def format_of(path: Path) -> Format:
    """The format of ``path`` by its suffix, which ``.gz`` may follow.

    Raises:
        LogError: the suffix belongs to no log format.
    """
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    gzipped = bool(suffixes) and suffixes[-1] == ".gz"
    if gzipped:
        suffixes.pop()
    found = WRITTEN.get(suffixes[-1]) if suffixes else None
    if found is None or (gzipped and not found.gzipped):
        packed = ", ".join(key for key, each in WRITTEN.items() if each.gzipped)
        raise LogError(
            f"{path}: unknown log format; the suffix must be one of {', '.join(WRITTEN)} "
            f"({packed} may be followed by .gz)"
        )
    return found


def content_format(path: Path) -> Format | None:
    """The format of a log by its first bytes; None: the bytes fit no format.

    Raises:
        LogError: a binary log in a gzip file.
    """
    if not path.is_file():  # a pipe is read once
        return None
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        if packed := head[:2] == b"\x1f\x8b":
            head = zlib.decompressobj(_GZIP).decompress(head, _HEAD_BYTES)
    except (OSError, zlib.error):
        return None  # the reader reports the error
    found = next((each for each in FORMATS if each.mark.match(head)), None)
    if packed and found and not found.gzipped:
        raise LogError(f"{path}: packed by gzip: must be unpacked before, as by gunzip")
    return found
