"""The observer of a takeover: where the plant moves, in the states of G1.

Least squares with a fading memory: the sample before n ticks counts λ²ⁿ, λ = exp(-1/memory). The
recursive form is a Kalman filter of Φ/λ without process noise, so the gain needs no noise level.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy import linalg

from firmware_model.discretisation.sections import Sections, energy_of, realisation
from firmware_model.discretisation.targets import Target
from firmware_model.errors import DesignError
from firmware_model.law.supervision.takeover import Constants

MEMORY_S: Final = 0.05
LEAST_MEMORY: Final = 3.0
"""Ticks, however long a tick is."""
LISTENING: Final = 2.5
"""Listening over memory."""
RETURN_S: Final = 0.2
"""X_diff then keeps below 4000 N for 1 m/s², should the motor be dead."""
FADED: Final = 1e-4
"""Part of the motion that may be dropped."""
MOVES: Final = 6.0
"""Deviations of the noise for a moving plant."""
DOUBTED: Final = 0.2
"""Deviation of m, over the largest m: the plant is not the model."""
LITTLE: Final = 1e-6
"""Variance per tick, as a part of the sensor's, that keeps the equation of the gain solvable."""
SOLVED: Final = 1e-3
"""Change of the gain by a step of its recursion, over the gain, up to which the gain is solved."""
FALSE_VERDICTS: Final = 1e-2
"""Of a healthy channel 1, in a takeover."""


def fill_takeover(takeover: Constants, target: Target, g1: Sections) -> None:
    """Fill in the constants; ``g1``: the model of channel 1, stable."""
    memory = max(MEMORY_S / target.tick_s, LEAST_MEMORY)
    phi, _, c, _, reached = realisation(g1)
    try:
        gain, covariance = observer(phi, c, memory)
    except (DesignError, linalg.LinAlgError):
        return  # no stable observer in double precision: no takeover
    takeover.gain.flat[reached] = gain
    variance = target.noise_rms**2 + target.resolution**2 / 12.0
    takeover.enabled = True
    takeover.least = MOVES * math.sqrt(target.noise_rms**2 + target.resolution**2)
    takeover.listening = math.ceil(LISTENING * memory)
    takeover.returning = max(math.ceil(RETURN_S / target.tick_s), takeover.listening)
    slowest = max(abs(np.linalg.eigvals(phi)), default=0.0)
    fades = math.log(FADED) / math.log(slowest) if 0.0 < slowest < 1.0 else 0.0
    takeover.lasting = takeover.returning + math.ceil(fades)
    takeover.doubt = variance * largest_variance(phi, c, covariance)
    takeover.doubted = DOUBTED**2


def evidence_in_takeover(takeover: Constants, confirm: float) -> float:
    """The evidence that confirms a loss in a takeover, at most ``confirm``.

    Each tick begins one candidate at most, which exceeds h by chance with e^-h.
    """
    if not takeover.enabled:
        return confirm
    return min(math.log(takeover.lasting / FALSE_VERDICTS), confirm)


def observer(phi: np.ndarray, c: np.ndarray, memory: float) -> tuple[np.ndarray, np.ndarray]:
    """The gain L of x⁺ = Φ x + L (y - c x), and the covariance of x for samples of variance 1.

    Args:
        phi: Φ, shape (n, n), stable.
        c: shape (n,).
        memory: time constant of the fading memory, in ticks.

    Raises:
        DesignError: double precision gives no gain, or a gain that its recursion changes.
        LinAlgError: no solution of the Riccati equation.
    """
    row = c[None, :]
    energies = np.diag(energy_of(phi, c))
    scale = np.diag(LITTLE / np.maximum(energies, LITTLE * energies.max()))
    faster = phi * math.exp(1.0 / memory)
    covariance = linalg.solve_discrete_are(faster.T, row.T, scale, np.eye(1))
    gain = (phi @ covariance @ row.T / (row @ covariance @ row.T + 1.0))[:, 0]
    learned = faster - np.outer(gain, c) * math.exp(1.0 / memory)
    after = learned @ covariance @ faster.T + scale
    again = (phi @ after @ row.T / (row @ after @ row.T + 1.0))[:, 0]
    if np.abs(again - gain).max() > SOLVED * np.abs(gain).max():
        raise DesignError("the observer of the takeover has no gain in double precision")
    corrected = phi - np.outer(gain, c)
    return gain, energy_of(corrected.T, gain)


def largest_variance(phi: np.ndarray, c: np.ndarray, covariance: np.ndarray) -> float:
    """The largest variance of c x from now on, where x has ``covariance`` and moves freely."""
    largest = 0.0
    while (now := float(c @ covariance @ c)) > largest:
        largest = now
        covariance = phi @ covariance @ phi.T
    return largest
