"""The matrices of any linear controller, from its answers to impulses.

A controller of another kind shows its step, not its memories. Its impulse response
h(n) = C Aⁿ⁻¹ B, h(0) = D, has the realisation of Ho and Kalman (Zeitschrift für
Regelungstechnik 14, 1966; by singular values: Juang and Pappa, J. Guidance 8, 1985): from
H = [h(t + s + 1)] and H' = [h(t + s + 2)], A = Σ^-½ Uᵀ H' V Σ^-½. The times t and s lie close at
first and then grow by a constant factor, so that a lag of a tick and an integrator both have full
weight. The answers to other inputs must then agree with the matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from firmware_model.analysis.sampled_loop import LinearController
from firmware_model.errors import DesignError
from firmware_model.law.structs import FloatArray

SIZE: Final = 1e-5
"""Of an impulse, m/s²: within every limit and boundary layer."""
LAST: Final = 1500
"""The longest t and s, in ticks."""
TIMES: Final = np.unique(np.concatenate([np.arange(16), np.geomspace(16, LAST, 24).astype(int)]))
RANK: Final = 1e-9
"""Smallest singular value that counts, as a share of the largest."""
AGREES: Final = 1e-4
"""Largest difference of an answer from the matrices' answer, as a share of the largest answer."""

Respond = Callable[[FloatArray], FloatArray]
"""From inputs (n, 2), measurement and reference, to answers (n, 3), from rest."""


class NotLinearError(DesignError):
    """A controller whose answers no matrices explain."""


def read_off(respond: Respond, latency_ticks: int) -> LinearController:
    """The matrices of the controller that answers ``respond``.

    Raises:
        NotLinearError: the answers are not those of a linear controller around rest.
    """
    ticks = 2 * LAST + 3
    response = np.zeros((ticks, 3, 2))
    for column in range(2):
        impulse = np.zeros((ticks, 2))
        impulse[0, column] = SIZE
        response[:, :, column] = respond(impulse) / SIZE
    scale = np.abs(response).max(axis=(0, 2))
    scale[scale == 0.0] = 1.0
    h = response / scale[:, None]
    blocks = h[TIMES[:, None] + TIMES[None, :] + 1], h[TIMES[:, None] + TIMES[None, :] + 2]
    now, later = (
        block.transpose(0, 2, 1, 3).reshape(3 * len(TIMES), 2 * len(TIMES)) for block in blocks
    )
    u, sigma, v = np.linalg.svd(now, full_matrices=False)
    n = int((sigma > RANK * sigma[0]).sum()) if sigma[0] > 0.0 else 0
    root = np.sqrt(sigma[:n])
    a = (u[:, :n].T @ later @ v[:n].T) / root[:, None] / root
    b, c = root[:, None] * v[:n, :2], u[:3, :n] * root * scale[:, None]
    law = LinearController(a, b, c, response[0], latency_ticks)
    _require_agreement(law, respond, ticks)
    return law


def _require_agreement(law: LinearController, respond: Respond, ticks: int) -> None:
    """Compare the answers to inputs of another size and shape."""
    random = np.random.default_rng(1)
    inputs = np.zeros((ticks, 2))
    inputs[: ticks // 2] = 0.3 * SIZE * random.standard_normal((ticks // 2, 2))
    answers, x = respond(inputs), np.zeros(len(law.a))
    expected = np.empty_like(answers)
    with np.errstate(over="ignore", invalid="ignore"):  # matrices that explain nothing may explode
        for k, w in enumerate(inputs):
            expected[k] = law.c @ x + law.d @ w
            x = law.a @ x + law.b @ w
    largest = np.abs(answers).max(axis=0)
    off = np.abs(answers - expected).max(axis=0)
    if not (off <= AGREES * largest + 1e-9 * SIZE).all():
        worst = float(np.max(off / np.where(largest > 0.0, largest, 1.0)))
        by = f"{worst:.2%}" if worst <= 1.0 else "more than 100%"
        raise NotLinearError(
            f"its answers around rest grow without end or are not linear: off by {by}"
        )
