"""What the readers that build on python-can's share: their errors, and the size of their pieces."""

from __future__ import annotations

import logging
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

from can.io.blf import BLFParseError

from can_rig.errors import LogError

PIECE_MESSAGES: Final = 1 << 14
"""Messages that are held at once: python-can's take some 600 bytes each."""

# What a reader of python-can logs about a bad line is also in our error. Without a handler it would
# be printed too; an application that configures logging still gets it.
logging.getLogger("can.io").addHandler(logging.NullHandler())


@contextmanager
def one_line_errors(place: Callable[[], str]) -> Iterator[None]:
    """Whatever a reader of python-can raises about a file, as one line that begins with the place.

    Raises:
        LogError: the line.
    """
    try:
        yield
    except OSError as error:
        raise LogError(f"{place()}: cannot be read: {error.strerror}") from None
    except (BLFParseError, ValueError, IndexError, KeyError, struct.error, zlib.error) as error:
        reason = str(error) or type(error).__name__
        raise LogError(f"{place()}: does not follow the format: {reason}") from None
