"""Buses that a format knows by their numbers alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from can_rig.errors import LogError
from can_rig.logs.frames import Frames

MAX_CHANNELS: Final = 255


def numbered(frames: Frames, first: int = 0) -> Frames:
    """Frames with the bus number as ``channel``, indexed over the buses present.

    Args:
        frames: at least one frame.
        first: the format's number of the first bus; the result counts from 0, as python-can does.

    Raises:
        LogError: more buses than an index can hold.
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
