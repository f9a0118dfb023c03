"""Lumping of permanently equal states.

A dead time is a chain of states; each state takes over the previous state's value after a tick. The
bus, the actuators, the sensor and the controller's model of all three each hold such a chain of the
same commands. Equal states stay equal from the first tick on, so a single state represents the
group: the loop behaves as before, with fewer poles at z = 0. Eigenvalues take the cube of the size,
and a dead time of 50 ms at 1 kHz is 100 states instead of 200 or 300.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_model.target.structs import FloatArray


def lumps(a: FloatArray, b: FloatArray) -> NDArray[np.int_]:
    """The number of each state's lump, shape (n,), 0, 1, ... in the order of their first states.

    Args:
        a: (n, n), of ξ⁺ = Aξ + Bu.
        b: (n, m).
    """
    single = (np.count_nonzero(a, axis=1) == 1) & ~b.any(axis=1)
    source = np.argmax(a != 0.0, axis=1)
    copies = single & (a[np.arange(len(a)), source] == 1.0)
    numbers: dict[object, int] = {}
    lump = np.full(len(a), -1)
    for state in range(len(a)):
        chain, at = [], state
        while lump[at] < 0 and copies[at] and at not in chain:
            chain.append(at)
            at = int(source[at])
        if lump[at] < 0:  # the begin of a chain, or a place in a circle of copies
            own = at if at in chain else (a[at].tobytes(), b[at].tobytes())
            lump[at] = numbers.setdefault(own, len(numbers))
        for copy in reversed(chain):
            if lump[copy] < 0:
                lump[copy] = numbers.setdefault(("after", lump[source[copy]]), len(numbers))
    return lump


def lumped(
    a: FloatArray, b: FloatArray, rows: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A, B and ``rows`` (r, n) of the lumped system."""
    lump = lumps(a, b)
    _, first = np.unique(lump, return_index=True)
    belongs = np.zeros((len(a), len(first)))
    belongs[np.arange(len(a)), lump] = 1.0
    return a[first] @ belongs, b[first], rows @ belongs
