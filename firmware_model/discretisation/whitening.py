"""Design of the whitener for the noise of the sensor and the disturbances of the plant.

The measurement of a healthy plant, minus the model's answer, is

    e = l + n + rounding,  n(k) = a n(k-1) + white,  l = a random walk d after two equal lags

The lags are as slow as channel 1: the onset of a disturbance is as smooth as the onset of a loss,
so the smoothness alone is no evidence. The stationary Kalman filter of this model has the gain K
and the innovation

    W = 1 - C (zI - A + K C)⁻¹ K,  variance S = C P Cᵀ + R
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy import linalg

from firmware_model.discretisation.sections import Sections, from_delta_zpk
from firmware_model.discretisation.targets import Target
from firmware_model.law.structs import Precision

# rms rounding error of a perfect sensor, in units of the measurement
NO_NOISE: dict[Precision, float] = {"float64": 1e-9, "float32": 1e-6}


class Whitening(NamedTuple):
    """W and the variance S of the white noise."""

    sections: Sections
    variance: float

    def energy(self, ticks: int) -> float:
        """Σ y² of the first ``ticks`` answers y of W to a step of size 1."""
        answer = np.ones(ticks)
        for b0, b1, b2, a1, a2 in self.sections.coefficients:
            s1 = s2 = 0.0
            for k, u in enumerate(answer.tolist()):
                y = b0 * u + s1
                s1, s2 = s1 + b1 * u - a1 * y + s2, s2 + b2 * u - a2 * y
                answer[k] = y
        return float(answer @ answer)


# rms of the white part of D*, over the disturbance: no model of a disturbed plant is finer
FINEST = 0.05
LEAST = 1e-5  # disturbance of a tick over white noise: less is beyond the solver's digits


def whitening(channel_1: Sections, target: Target) -> Whitening:
    """W for the ``target``'s noise and disturbance, after lags as slow as ``channel_1``.

    A disturbance below ``LEAST`` of the noise does not show, and W is the noise's.
    """
    a = target.noise_pole
    noise = (1.0 - a * a) * target.noise_rms**2
    rounding = target.resolution**2 / 12.0 + NO_NOISE[target.precision] ** 2
    finest = FINEST * target.disturbance
    rounding = max(rounding, finest**2 - noise)
    lag = math.exp(-2.0 / max(mean_delay(channel_1), 1e-9))
    least = LEAST * math.sqrt((noise + rounding) / target.tick_s)
    blocks = []  # dynamics, input gains and output of each part of e
    if target.disturbance >= least:
        dynamics = np.array([[1.0, 0.0, 0.0], [1.0 - lag, lag, 0.0], [0.0, 1.0 - lag, lag]])
        variance = np.diag([target.disturbance**2 * target.tick_s, 0.0, 0.0])
        blocks.append((dynamics, variance, [0.0, 0.0, 1.0]))
    if a > 0.0 and noise > 0.0:
        blocks.append((np.array([[a]]), np.array([[noise]]), [1.0]))
    else:
        rounding += noise
    if not blocks:
        return Whitening(Sections(np.zeros((0, 5)), target.tick_s), rounding)
    dynamics = linalg.block_diag(*(block[0] for block in blocks))
    growth = linalg.block_diag(*(block[1] for block in blocks))
    output = np.concatenate([block[2] for block in blocks])[None, :]
    unit = growth.max()  # the solver compares with 1
    covariance = unit * linalg.solve_discrete_are(
        dynamics.T, output.T, growth / unit, np.array([[rounding / unit]])
    )
    innovation = float((output @ covariance @ output.T).item() + rounding)
    gain = dynamics @ covariance @ output.T / innovation
    own = np.eye(len(dynamics))
    zeros = linalg.eigvals(dynamics - own)
    poles = linalg.eigvals(dynamics - gain @ output - own)
    return Whitening(from_delta_zpk(zeros, poles, 1.0, target.tick_s), innovation)


def mean_delay(sections: Sections) -> float:
    """Mean delay of the step response in ticks, -G'(0)/G(0); 0 without a finite positive one."""
    delay = 0.0
    for b0, b1, b2, a1, a2 in sections.coefficients:
        if a1 == 0.0 and a2 == 0.0:
            continue
        above, below = (b1, a1) if a2 or b2 else (b0, 1.0)
        at_rest = (b2, a2) if a2 or b2 else (b1, a1)
        if at_rest[0] == 0.0 or at_rest[1] == 0.0:
            return 0.0
        delay += below / at_rest[1] - above / at_rest[0]
    return delay if 0.0 < delay < math.inf else 0.0
