"""Columns of long runs: in files without a name, so that memory holds only what is being read.

A run of an hour at 1 kHz has 29 MB a signal. Short columns are plain arrays.
"""

import ctypes
import mmap
import os
import tempfile
import weakref
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import IO, Final

import numpy as np
from numpy.typing import NDArray

from can_rig.errors import RunFolderError

PAGED_ROWS: Final = 500_000
"""A column of more rows is in a file; a run of more ticks is a long one."""

BLOCK_ROWS: Final = 1 << 14
"""Rows of a long column that are worked on at once."""

DISK: Final = "/var/tmp"

M_MMAP_THRESHOLD: Final = -3
"""The number of glibc's parameter for ``mallopt``."""

LARGE: Final = 1 << 18
"""Bytes of an array whose memory returns to the system as soon as the array is gone."""

_MAPPED: Final[weakref.WeakSet[mmap.mmap]] = weakref.WeakSet()


def empty(rows: int, *more: int) -> NDArray[np.float64]:
    """(rows, ...) without values; the temporary file (``TMPDIR``) goes with the array.

    Raises:
        RunFolderError: there is no room for the file.
    """
    shape = (rows, *more)
    if rows <= PAGED_ROWS:
        return np.empty(shape)
    _return_large_arrays()
    size = 8 * int(np.prod(shape))
    try:
        with tempfile.TemporaryFile(dir=folder()) as file:
            os.posix_fallocate(
                file.fileno(), 0, size
            )  # a full disk is said here, and not by SIGBUS
            mapped = mmap.mmap(file.fileno(), size)
    except OSError as error:
        raise no_room(error) from None
    _MAPPED.add(mapped)
    return np.frombuffer(mapped, dtype=np.float64).reshape(shape)


@cache
def _return_large_arrays() -> None:
    """Fix the size from which glibc maps an array; glibc would raise the size to 32 MB.

    Masks and copies of a long run are smaller, and would stay in the heap after use.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, LARGE)


def no_room(error: OSError) -> RunFolderError:
    """What to say where a file cannot be made or written."""
    return RunFolderError(
        f"{folder()}: no room for the signals of a long run: {error.strerror}; "
        "TMPDIR names another folder for temporary files"
    )


def folder() -> str:
    """Where the files are: in ``TMPDIR``, or on the disk, as ``/tmp`` often is memory."""
    return os.environ.get("TMPDIR") or (
        DISK if os.access(DISK, os.W_OK | os.X_OK) else tempfile.gettempdir()
    )


def column(rows: int, part: Callable[[slice], NDArray[np.float64]]) -> NDArray[np.float64]:
    """(rows,), worked out part by part.

    Raises:
        RunFolderError: as ``empty``.
    """
    if rows <= PAGED_ROWS:
        return part(slice(0, rows))
    values = empty(rows)
    for some in blocks(rows):
        values[some] = part(some)
    return values


def rows_file(in_memory: int) -> IO[bytes]:
    """For rows that become ``columns``; on the disk from so many bytes on."""
    return tempfile.SpooledTemporaryFile(max_size=in_memory, dir=folder())


def append(file: IO[bytes], rows: Sequence[Sequence[float]]) -> None:
    """Add rows of the same length to a ``rows_file``.

    Raises:
        RunFolderError: there is no room.
    """
    try:
        file.write(np.array(rows, dtype=np.float64).tobytes())
    except OSError as error:
        raise no_room(error) from None


def columns(rows: IO[bytes], width: int) -> list[NDArray[np.float64]]:
    """The columns of a file of rows, all float64, one after the other.

    Raises:
        RunFolderError: as ``empty``.
    """
    count = rows.seek(0, os.SEEK_END) // (8 * width)
    rows.seek(0)
    found = [empty(count) for _ in range(width)]
    for some in blocks(count):
        part = np.frombuffer(rows.read(8 * width * (some.stop - some.start)))
        for values, its in zip(found, part.reshape(-1, width).T, strict=True):
            values[some] = its
    return found


def blocks(rows: int) -> Iterator[slice]:
    """Parts of a column of so many rows; what was read is let go after each."""
    for begin in range(0, rows, BLOCK_ROWS):
        yield slice(begin, min(begin + BLOCK_ROWS, rows))
        if rows > PAGED_ROWS:
            let_go()


def let_go() -> None:
    """Take what was read of all columns out of this process's memory; the files keep it."""
    for mapped in list(_MAPPED):
        mapped.madvise(mmap.MADV_DONTNEED)
