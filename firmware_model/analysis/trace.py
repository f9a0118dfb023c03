"""The signals of a run without frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.target.structs import FloatArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Trace:
    """One value a tick, each of shape (ticks,)."""

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    """The plant's output y, before its sensor."""
    measured: FloatArray
    """y as the controller gets it: by the sensor, with bias and noise, on the grid of its frame."""
    command_1: FloatArray
    command_2: FloatArray
    fault_estimate: FloatArray
    fault_state: NDArray[np.int64]
    mode: NDArray[np.int64]
    verdict: NDArray[np.int64]
    """Whose fault it is: a ``Verdict``."""
    evidence: FloatArray
    """The log-likelihood ratio of a loss, or of the return of a lost channel."""

    @property
    def error(self) -> FloatArray:
        """e = r - y (3.41)."""
        return self.reference - self.measurement
