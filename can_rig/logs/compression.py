"""Compressed text of long runs, and compressed blocks of binary logs.

libdeflate is twice as fast as zlib.
"""

import gzip
import zlib
from pathlib import Path
from typing import IO, Final

import deflate

from can_rig.storage.files import atomic

MEMBER_BYTES: Final = 1 << 20
"""Text of a member of a file: gzip reads its members in a row, and needs the memory of one."""

LEVEL: Final = 6
"""Of 12: the next ones take three times as long for a fiftieth of the size."""


def stored(path: Path) -> Path:
    """``path``, or where only that is there the same gzipped, ``path.gz``."""
    packed = path.with_name(f"{path.name}.gz")
    return packed if packed.exists() and not path.exists() else path


def compress(path: Path) -> None:
    """Put ``path.gz`` in the place of a file; the same text gives the same bytes.

    Raises:
        LogError: the file cannot be written; then the other one stands.
    """
    packed = path.with_name(f"{path.name}.gz")
    with atomic(packed, force=False) as part, path.open("rb") as text, part.open("wb") as file:
        while member := text.read(MEMBER_BYTES):
            file.write(deflate.gzip_compress(member, LEVEL))
    path.unlink()


def open_text(path: Path, encoding: str = "utf-8") -> IO[str]:
    """A text file, gzipped if its name ends in ``.gz``; line ends as they are."""
    if path.suffix.lower() == ".gz":
        return gzip.open(path, "rt", encoding=encoding, newline="")
    return path.open(encoding=encoding, newline="")


class InflateError(ValueError):
    """The compressed bytes are damaged."""


def inflated(packed: bytes, size: int) -> bytes:
    """At most ``size`` bytes; fewer where ``packed`` is cut off.

    Raises:
        InflateError: the bytes are not zlib's, or damaged.
    """
    if size > 0:  # for size 0, libdeflate skips even the header
        try:
            return bytes(deflate.zlib_decompress(packed, size))
        except (deflate.DeflateError, ValueError):
            pass  # cut off, or longer than announced: zlib returns the rest
    try:
        return zlib.decompressobj().decompress(packed, max(size, 1))[:size]
    except zlib.error as error:
        raise InflateError(str(error)) from None
