"""Compressed blocks of Vector binary logs and of MDF, unpacked by libdeflate.

libdeflate is twice as fast as zlib.
"""

from __future__ import annotations

import zlib

import deflate


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
