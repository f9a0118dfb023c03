"""Compressed blocks of known size, unpacked by libdeflate, which is twice as fast as zlib."""

from __future__ import annotations

import zlib

import deflate


class InflateError(ValueError):
    """What is wrong with the compressed bytes."""


def inflated(packed: bytes, size: int) -> bytes:
    """At most ``size`` bytes; fewer where ``packed`` is cut off.

    Raises:
        InflateError: it is not what zlib compressed, or damaged.
    """
    if size > 0:  # of nothing libdeflate does not even read the header
        try:
            return bytes(deflate.zlib_decompress(packed, size))
        except (deflate.DeflateError, ValueError):
            pass  # cut off, or longer than it says: zlib gives what there is
    try:
        return zlib.decompressobj().decompress(packed, max(size, 1))[:size]
    except zlib.error as error:
        raise InflateError(str(error)) from None
