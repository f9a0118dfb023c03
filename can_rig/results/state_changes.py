"""Changes of mode, fault state and verdict: events in words."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from can_rig.drawing.names import Names
from can_rig.frames.network import Network
from can_rig.results.curves import in_small_letters
from can_rig.results.isolation import in_words
from can_rig.storage import paged
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray


class Event(NamedTuple):
    """A moment, with its description."""

    time_s: float
    text: str


class StateChanges:
    """Finds the changes in columns of codes, which may come piece by piece.

    Args:
        names: of the plant's signals, for the verdicts.
        network: the frames, whose value tables have the words.
        first: whether the first known code is an event too, as at the begin of a run.
    """

    def __init__(self, names: Names, network: Network, first: bool = True) -> None:
        status = network.status
        self._words = {
            "mode": in_small_letters(status.modes),
            "fault state": in_small_letters(status.fault_states),
            "whose fault": {int(verdict): in_words(verdict, names) for verdict in Verdict},
        }
        self._last = dict.fromkeys(self._words, np.nan)
        self._first = first

    def of(self, state: str, time_s: FloatArray, codes: FloatArray) -> Iterator[Event]:
        """Every change, after the pieces before; nan: not known.

        Args:
            state: ``mode``, ``fault state`` or ``whose fault``.
            time_s: (n,)
            codes: (n,)
        """
        words = self._words[state]
        for rows in paged.blocks(len(codes)):
            known = rows.start + np.flatnonzero(np.isfinite(codes[rows]))
            if len(known) and np.isnan(self._last[state]) and not self._first:
                self._last[state] = codes[known[0]]
            changed = np.flatnonzero(np.diff(codes[known], prepend=self._last[state]) != 0.0)
            for row in known[changed].tolist():
                code = int(codes[row])
                yield Event(float(time_s[row]), f"{state}: {words.get(code, code)}")
            if len(known):
                self._last[state] = codes[known[-1]]
