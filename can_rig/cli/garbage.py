"""No search for garbage among what a command imports: hundreds of thousands of objects that stay.

Python would look through them again and again while their number grows, and once more when the
process ends; that is a third of the time of a short command.
"""

from __future__ import annotations

import atexit
import gc


def collect_nothing() -> None:
    """From here on no garbage is looked for, nor when the process ends."""
    gc.disable()
    atexit.register(gc.freeze)


def collect_again() -> None:
    """From here on there may be some, but none in what has been imported."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()
