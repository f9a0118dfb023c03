"""Standard output and error of any terminal, and what the operating system refuses in one line."""

from __future__ import annotations

import errno
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from can_rig.errors import RigError, one_line

_OF_A_STREAM = {errno.ENOSPC, errno.EIO, errno.EBADF}
"""Errors that name no file when they concern standard output."""


def write_what_can_be_written() -> None:
    """A terminal that has no ² shows a question mark; what can be shown is shown."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # closed by the shell
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]


@contextmanager
def refusals_in_one_line() -> Iterator[None]:
    """A full disk, too many open files and the like end the command with one line.

    Output that still waits is written before the context is left, because afterwards Python would
    print a traceback for it.
    """
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:  # whoever read it, such as head, has seen enough
        sys.stdout = None
        sys.exit(1)
    except OSError as error:
        with suppress(OSError):  # standard error may be full too
            print(f"error: {_reason(error)}", file=sys.stderr)
        sys.stdout = None  # Python flushes it once more
        sys.unraisablehook = lambda _: None  # of what was half made, such as an event loop
        sys.exit(RigError.exit_status)


def _reason(error: OSError) -> str:
    reason = error.strerror or one_line(error)
    if error.filename is not None:
        return f"{error.filename}: {reason}"
    if error.errno in _OF_A_STREAM:
        return f"standard output cannot be written: {reason}"
    return reason
