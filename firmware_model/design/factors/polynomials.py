"""A congruence of real polynomials, coefficients with the highest power first."""

import numpy as np
from numpy.typing import NDArray

Polynomial = NDArray[np.float64]


def congruent(
    factor: Polynomial, wanted: Polynomial, modulus: Polynomial
) -> tuple[Polynomial, Polynomial]:
    """x of degree below that of ``modulus``, and a quotient: factor x + modulus quotient = wanted.

    ``modulus`` is monic and has no root in common with ``factor``. A linear system: each power of s
    times ``factor`` leaves a remainder, and the remainders must add up to the remainder of
    ``wanted``.
    """
    size = len(modulus) - 1
    if size == 0:
        return np.zeros(1), wanted
    powers = [np.eye(1, i + 1)[0] for i in reversed(range(size))]
    columns = [_remainder(np.convolve(factor, power), modulus) for power in powers]
    x = np.linalg.solve(np.array(columns).T, _remainder(wanted, modulus)).astype(np.float64)
    quotient, _ = np.polydiv(np.polysub(wanted, np.convolve(factor, x)), modulus)
    return x, np.asarray(quotient, dtype=np.float64)


def monic(roots: tuple[complex, ...]) -> Polynomial:
    """Π (s - root)."""
    return np.atleast_1d(np.poly(roots).real).astype(np.float64)


def _remainder(polynomial: Polynomial, modulus: Polynomial) -> Polynomial:
    """Remainder of the division by ``modulus``: one coefficient for each root of ``modulus``."""
    _, rest = np.polydiv(polynomial, modulus)
    size = len(modulus) - 1
    return np.concatenate([np.zeros(max(size - len(rest), 0)), rest])[-size:]
