"""Random stable filters, and what theory says of them in fifty digits."""

import math

import mpmath
import numpy as np

from firmware_model.design.zpk import ZeroPoleGain

Complexes = list[complex]


def roots(rng: np.random.Generator, count: int, nyquist: float) -> Complexes:
    """Real ones and pairs of damping 0.03 to 1, over four decades below the Nyquist frequency."""
    found: Complexes = []
    while len(found) < count:
        size = nyquist * 10 ** rng.uniform(-4.0, -0.05)
        if count - len(found) >= 2 and rng.random() < 0.6:
            damping = min(10 ** rng.uniform(-1.5, 0.0), 0.999)
            root = complex(-damping * size, math.sqrt(1.0 - damping**2) * size)
            found += [root, root.conjugate()]
        else:
            found.append(complex(-size))
    return found


def random_filter(rng: np.random.Generator, *, held: bool = False) -> tuple[ZeroPoleGain, float]:
    """A filter of order 1 to 12 whose response is of size 1 somewhere, and a tick of 1e-5 to 0.1 s.

    ``held``: without feedthrough.
    """
    order, tick_s = int(rng.integers(1, 13)), 10 ** rng.uniform(-5.0, -1.0)
    nyquist = math.pi / tick_s
    poles = roots(rng, order, nyquist)
    zeros = roots(rng, int(rng.integers(0, order + (not held))), nyquist)
    if rng.random() < 0.3:
        zeros = [-zero.conjugate() for zero in zeros]  # not minimum phase
    size = np.prod(np.abs(poles) / nyquist) / np.prod(np.abs(zeros) / nyquist)
    gain = float(size) * nyquist ** (order - len(zeros))
    return ZeroPoleGain(tuple(zeros), tuple(poles), gain), tick_s


def angles(rad_per_s: np.ndarray, tick_s: float) -> list[mpmath.mpf]:
    """ωT as exact as the floats are."""
    return [mpmath.mpf(float(omega)) * mpmath.mpf(tick_s) for omega in rad_per_s]


def tustin_exactly(
    system: ZeroPoleGain | tuple[np.ndarray, np.ndarray], rad_per_s: np.ndarray, tick_s: float
) -> np.ndarray:
    """G(j(2/T) tan(ωT/2)) from the roots, or from num(s)/den(s)."""
    with mpmath.workdps(50):
        warped = [
            mpmath.mpc(0, 2 / mpmath.mpf(tick_s) * mpmath.tan(angle / 2))
            for angle in angles(rad_per_s, tick_s)
        ]
        if isinstance(system, ZeroPoleGain):
            return np.array([complex(_value(system, s)) for s in warped])
        num, den = (row[::-1].tolist() for row in system)
        return np.array(
            [
                complex(mpmath.polyval(num, s, asc=True) / mpmath.polyval(den, s, asc=True))
                for s in warped
            ]
        )


def zoh_exactly(g: ZeroPoleGain, rad_per_s: np.ndarray, tick_s: float) -> np.ndarray:
    """d + Σ rᵢ/pᵢ (e^{pᵢT} - 1)/(z - e^{pᵢT}), by residues; d for as many zeros as poles."""
    with mpmath.workdps(70):
        poles = [mpmath.mpc(p) for p in g.poles]
        through = mpmath.mpf(g.gain if len(g.zeros) == len(poles) else 0)
        parts = []
        for i, pole in enumerate(poles):
            others = ZeroPoleGain(g.zeros, (), g.gain)
            residue = _value(others, pole)
            for j, other in enumerate(poles):
                residue = residue / (pole - other) if j != i else residue
            power = mpmath.exp(pole * mpmath.mpf(tick_s))
            held = (power - 1) / pole if pole else mpmath.mpf(tick_s)
            parts.append((residue * held, power))
        return np.array(
            [
                complex(through + sum(top / (mpmath.expj(angle) - power) for top, power in parts))
                for angle in angles(rad_per_s, tick_s)
            ]
        )


def _value(g: ZeroPoleGain, s: mpmath.mpc) -> mpmath.mpc:
    value = mpmath.mpf(g.gain)
    for zero in g.zeros:
        value *= s - mpmath.mpc(zero)
    for pole in g.poles:
        value /= s - mpmath.mpc(pole)
    return value
