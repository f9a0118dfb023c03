"""A transfer function as a state space: a chain of sections, its unstable poles apart."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_model.design.factors.coprime import unstable
from firmware_model.design.factors.polynomials import congruent, monic
from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.errors import ParameterError

Matrix = NDArray[np.float64]
Realisation = tuple[Matrix, Matrix, Matrix, float]


@dataclass(frozen=True)
class Parts:
    """A transfer function as residues/Π(s - p) + ``stable``, over its unstable poles p.

    ``residues`` (k,) are the coefficients of a polynomial, highest power first.
    """

    residues: Matrix
    stable: ZeroPoleGain


def in_parts(g: ZeroPoleGain, name: str) -> Parts:
    """The partial fractions of ``g``; zero and ``g`` for a stable ``g``.

    Raises:
        ParameterError: ``g`` needs fewer zeros than poles; the message calls ``g`` ``name``.
    """
    if g.gain != 0.0 and g.relative_degree < 1:
        raise ParameterError(
            f"{name} has {len(g.zeros)} zeros and {g.order} poles: must have fewer zeros than "
            "poles, as a plant that its input reaches only through states"
        )
    poles = unstable(g)
    if not poles:
        return Parts(np.zeros(0), g)
    rest = tuple(pole for pole in g.poles if pole.real < 0)
    residues, numerator = congruent(monic(rest), g.numerator(), monic(poles))
    zeros = ZeroPoleGain.from_coefficients(numerator, [1.0])
    return Parts(residues, ZeroPoleGain(zeros.zeros, rest, zeros.gain))


def companion(poles: Roots) -> Matrix:
    """A (k, k) whose first state is n/Π(s - p) u, with n the coefficients of b, (k,)."""
    a = np.eye(len(poles), k=1)
    a[:, :1] -= monic(poles)[1:, np.newaxis]
    return a


def realised(g: ZeroPoleGain) -> Realisation:
    """A (n, n), b (n,), c (n,) and d with ``g`` = c (sI - A)⁻¹ b + d, n its poles; g is proper.

    One companion form would hold the coefficients of a polynomial of high order and lose digits;
    each section of a chain holds the coefficients of two roots:

        x1' = x2,  x2' = -a0 x1 - a1 x2 + u,  y = c0 x1 + c1 x2 + d u
    """
    numerators, denominators = _sections(g.zeros), _sections(g.poles)
    numerators += [np.ones(1)] * (len(denominators) - len(numerators))
    a, b, c, feedthrough = np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0
    for num, den in zip(numerators, denominators, strict=True):
        order, before = len(den) - 1, len(a)
        padded = np.concatenate([num, np.zeros(order + 1 - len(num))])
        own_b, own_d = np.eye(order)[-1], float(padded[-1])
        own_c = padded[:-1] - own_d * den[:-1]
        own_a = np.eye(order, k=1)
        own_a[-1] -= den[:-1]
        a = np.block([[a, np.zeros((before, order))], [np.outer(own_b, c), own_a]])
        b = np.concatenate([b, feedthrough * own_b])
        c = np.concatenate([own_d * c, own_c])
        feedthrough *= own_d
    return a, b, g.gain * c, g.gain * feedthrough


def _sections(roots: Sequence[complex]) -> list[Matrix]:
    """Monic polynomials of the roots in pairs, lowest power first; the last may have one root.

    ``roots`` are in the order of ``ZeroPoleGain``: real roots come first.
    """
    real = [root.real for root in roots if root.imag == 0]
    pairs = [np.array([abs(root) ** 2, -2.0 * root.real, 1.0]) for root in roots if root.imag > 0]
    twos = [np.array([r * q, -(r + q), 1.0]) for r, q in zip(real[::2], real[1::2], strict=False)]
    last = [np.array([-real[-1], 1.0])] if len(real) % 2 else []
    return [*twos, *pairs, *last]
