"""Garbage collection off during imports: hundreds of thousands of imported objects stay alive.

Python would search the growing heap again and again, and a last time at process exit; the searches
take a third of the time of a short command.
"""

from __future__ import annotations

import atexit
import gc


def collect_nothing() -> None:
    """Switch garbage collection off from here on, at process exit too."""
    gc.disable()
    atexit.register(gc.freeze)


def collect_again() -> None:
    """Switch garbage collection on again, except for imported objects."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
