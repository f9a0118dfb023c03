"""Ctrl-C while a command is still being imported: no traceback out of somebody's library."""

from __future__ import annotations

import os
import signal

from can_rig.errors import INTERRUPTED


def end_at_once() -> None:
    """From here on Ctrl-C ends the process silently: no file needs cleaning up yet."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # nohup: it is ignored
        signal.signal(signal.SIGINT, _end)


def raise_again() -> None:
    """From here on Ctrl-C raises ``KeyboardInterrupt``, so half-written files are removed."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end(_number: int, _frame: object) -> None:
    os._exit(INTERRUPTED)
