"""Buses that a format knows by their numbers alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import Frames

MAX_CHANNELS: Final = 255


def numbered(frames: Frames, first: int = 0) -> Frames:
    """Frames whose ``channel`` is the number of a bus, with indices of the buses that occur.

    Args:
        frames: at least one.
        first: what the format calls the first bus; it is called 0 here, as in python-can.

    Raises:
        LogError: there are more buses than an index can tell.
    """
    found = np.flatnonzero(np.bincount(frames.channel))
    if len(found) > MAX_CHANNELS:
        raise LogError(f"{len(found)} buses; there must be at most {MAX_CHANNELS} in a log")
    names = tuple(str(number - first) for number in found.tolist())
    if len(found) == 1:
        return replace(frames, channel=np.zeros(len(frames), np.uint8), channels=names)
    index = np.zeros(int(found[-1]) + 1, np.uint8)
    index[found] = np.arange(len(found))
    return replace(frames, channel=index[frames.channel], channels=names)
