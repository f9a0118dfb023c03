"""The bytes of a log, plain or gzipped, in blocks of bounded size."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from itertools import chain
from typing import Final

from can_rig.errors import LogError
from can_rig.logs.log import Log

BLOCK_BYTES: Final = 1 << 22
_MAGIC: Final = b"\x1f\x8b"  # first bytes of every gzipped file
_GZIP: Final = 16 + zlib.MAX_WBITS


def blocks(log: Log) -> Iterator[bytes]:
    """The text of ``log``, decompressed if necessary; keeps ``log.fraction``.

    A truncated gzipped file yields its intact text, and a notice.

    Raises:
        LogError: the file cannot be read or decompressed.
    """
    packed = _file_blocks(log)
    first = next(packed, b"")
    whole = chain([first], packed)
    is_packed = first.startswith(_MAGIC) or log.path.suffix.lower() == ".gz"
    return _decompressed(log, whole) if is_packed else whole


def _file_blocks(log: Log) -> Iterator[bytes]:
    try:
        with log.path.open("rb") as file:
            size = log.path.stat().st_size
            done = 0
            while block := file.read(BLOCK_BYTES):
                done += len(block)
                yield block
                log.fraction = min(done / size, 1.0) if size else 0.0  # a pipe has no size
    except OSError as error:
        raise LogError(f"{log.path}: cannot be read: {error.strerror}") from None


def _decompressed(log: Log, packed: Iterator[bytes]) -> Iterator[bytes]:
    """All members of a gzip file in a row, as ``gunzip`` gives them."""
    member = zlib.decompressobj(_GZIP)
    begun = False
    offset = 0  # position of the block in the file
    for block in packed:
        rest = block
        while rest:
            try:
                text = member.decompress(rest, BLOCK_BYTES)
            except zlib.error as error:
                raise LogError(
                    f"{log.path}: not a gzip file, or damaged in the {len(block)} bytes from byte "
                    f"{offset}: {error}"
                ) from None
            begun = True
            if text:
                yield text
            rest = member.unconsumed_tail
            if member.eof:
                rest = member.unused_data.lstrip(b"\0")  # zeros may pad the end
                member, begun = zlib.decompressobj(_GZIP), False
        offset += len(block)
    if begun:
        yield member.flush()
        log.notice = f"{log.path}: the compressed file is cut off; its last frames are missing"
