"""Real-rational transfer functions in factored form: roots lose no digits, expanded polynomials do.

A product of factored forms only joins lists of roots, so the tracking controller keeps its order of
4 where polynomial algebra without cancellation reaches 12 and has to guess common factors.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import zip_longest
from typing import Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_model.errors import ParameterError, require_order, require_positive

Roots = tuple[complex, ...]


@dataclass(frozen=True)
class ZeroPoleGain:
    """``gain · Π(s - zero) / Π(s - pole)``, continuous, one input, one output, real-rational.

    Roots are in rad/s and ordered canonically: real roots by magnitude, then conjugate pairs
    (+imaginary first), so equal functions written with the same roots compare equal. A zero
    ``gain`` is the zero function and drops its roots. Nothing cancels unless ``cancelled`` asks.

    Raises ``ParameterError`` for a value that is not finite, or a complex root without exact
    conjugate.
    """

    zeros: Roots
    poles: Roots
    gain: float

    def __post_init__(self) -> None:
        gain = float(self.gain)
        if not math.isfinite(gain):
            raise ParameterError(f"gain = {gain}: must be finite")
        zeros, poles = _canonical("zeros", self.zeros), _canonical("poles", self.poles)
        object.__setattr__(self, "zeros", zeros if gain else ())
        object.__setattr__(self, "poles", poles if gain else ())
        object.__setattr__(self, "gain", gain)

    @classmethod
    def constant(cls, k: float) -> Self:
        """The static gain ``k``."""
        return cls((), (), k)

    @classmethod
    def from_coefficients(cls, num: ArrayLike, den: ArrayLike) -> Self:
        """``num(s)/den(s)``, real coefficients with the highest power first; roots by eigenvalues.

        Raises ``ParameterError`` for a zero ``den``, coefficients that are not finite, or an
        overflow in the ratio to the leading coefficient.
        """
        numerator, denominator = _trimmed("num", num), _trimmed("den", den)
        if denominator.size == 0:
            raise ParameterError("den is identically zero: one coefficient must differ from 0")
        if numerator.size == 0:
            return cls.constant(0.0)
        gain = float(numerator[0] / denominator[0])
        return cls(_roots("num", numerator), _roots("den", denominator), gain)

    @classmethod
    def lag(cls, tau_s: float, order: int) -> Self:
        """The low-pass filter ``1/(1 + τs)^order`` of (3.30) and (3.34), τ in seconds.

        Raises ``ParameterError`` unless τ is finite and > 0 and the order an integer >= 1.
        """
        require_positive("tau_s", tau_s)
        require_order("order", order)
        with np.errstate(over="ignore", under="ignore"):
            gain = float(np.float_power(tau_s, -order))
        if gain in (0.0, math.inf):
            raise ParameterError(f"tau_s = {tau_s}: to the power of {-order} it leaves the floats")
        return cls((), (complex(-1.0 / tau_s),) * order, gain)

    @overload
    def __call__(self, s: complex) -> complex: ...
    @overload
    def __call__(self, s: NDArray[np.complex128]) -> NDArray[np.complex128]: ...
    def __call__(self, s: complex | NDArray[np.complex128]) -> complex | NDArray[np.complex128]:
        """The value at ``s`` in rad/s, a scalar or an array of any shape; not finite at a pole."""
        point = np.asarray(s, dtype=np.complex128)
        value = np.full(point.shape, self.gain, dtype=np.complex128)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Zero by pole, so that no partial product grows with the order.
            for zero, pole in zip_longest(self.zeros, self.poles):
                value = value if zero is None else value * (point - zero)
                value = value if pole is None else value / (point - pole)
        return value if point.ndim else complex(value)

    def __mul__(self, other: "ZeroPoleGain") -> "ZeroPoleGain":
        """The series connection; common roots stay until ``cancelled`` is called."""
        return ZeroPoleGain(
            self.zeros + other.zeros, self.poles + other.poles, self.gain * other.gain
        )

    def scaled(self, k: float) -> "ZeroPoleGain":
        """``k`` times this function."""
        return ZeroPoleGain(self.zeros, self.poles, self.gain * k)

    def inverse(self) -> "ZeroPoleGain":
        """``1/G(s)``, possibly improper; ``ParameterError`` for the zero function."""
        if self.gain == 0:
            raise ParameterError("gain = 0: the zero function has no inverse")
        return ZeroPoleGain(self.poles, self.zeros, 1.0 / self.gain)

    def cancelled(self) -> "ZeroPoleGain":
        """The same function without the pole-zero pairs that are equal to the last bit."""
        common = Counter(self.zeros) & Counter(self.poles)
        return ZeroPoleGain(
            tuple((Counter(self.zeros) - common).elements()),
            tuple((Counter(self.poles) - common).elements()),
            self.gain,
        )

    @property
    def order(self) -> int:
        """The number of poles, cancelling ones included."""
        return len(self.poles)

    @property
    def relative_degree(self) -> int:
        """Poles less zeros: how fast the response rolls off; 0 for a constant."""
        return len(self.poles) - len(self.zeros)

    @property
    def feedthrough(self) -> float:
        """The limit for s → ∞ of a proper function: the gain where zeros are as many as poles."""
        return self.gain if self.relative_degree == 0 else 0.0

    @property
    def is_proper(self) -> bool:
        """No more zeros than poles."""
        return self.relative_degree >= 0

    def is_stable(self) -> bool:
        """Every pole strictly in the left half plane."""
        return all(pole.real < 0 for pole in self.poles)

    @property
    def dc_gain(self) -> float:
        """The limit for s → 0+: finite, or an infinity with the sign of the limit."""
        zeros_at_origin, poles_at_origin = self.zeros.count(0j), self.poles.count(0j)
        if zeros_at_origin > poles_at_origin:
            return 0.0
        limit = self.gain * _product_at_origin(self.zeros) / _product_at_origin(self.poles)
        return math.copysign(math.inf, limit) if poles_at_origin > zeros_at_origin else limit

    def numerator(self) -> NDArray[np.float64]:
        """Real coefficients, highest power first, with the gain: shape ``(len(zeros) + 1,)``."""
        return self.gain * _expanded(self.zeros)

    def denominator(self) -> NDArray[np.float64]:
        """Real monic coefficients, highest power first: shape ``(len(poles) + 1,)``."""
        return _expanded(self.poles)


def in_words(root: complex) -> str:
    """A root in rad/s, a real one without an imaginary part."""
    return f"{root if root.imag else root.real:.6g} rad/s"


def _canonical(name: str, roots: Iterable[complex]) -> Roots:
    """Real roots by magnitude, then pairs (u, conj u); the mirror image -conj sorts alike."""
    values = [complex(root) + 0j for root in roots]  # + 0j turns -0.0 into 0.0
    for value in values:
        if not (math.isfinite(value.real) and math.isfinite(value.imag)):
            raise ParameterError(f"{name} contain {value}: every root must be finite")
    upper = sorted((v for v in values if v.imag > 0), key=_in_order)
    lower = sorted((v.conjugate() for v in values if v.imag < 0), key=_in_order)
    if upper != lower:
        unpaired = (Counter(upper) - Counter(lower)) + (Counter(lower) - Counter(upper))
        raise ParameterError(f"{name} contain {next(iter(unpaired))} without its exact conjugate")
    real = sorted((v for v in values if v.imag == 0), key=_in_order)
    return (*real, *(root for u in upper for root in (u, u.conjugate())))


def _in_order(root: complex) -> tuple[float, float, float]:
    return root.imag, abs(root.real), root.real


def _trimmed(name: str, coefficients: ArrayLike) -> NDArray[np.float64]:
    """Coefficients from the first non-zero coefficient on; empty for the zero polynomial."""
    values = np.atleast_1d(np.asarray(coefficients, dtype=np.float64))
    if values.ndim != 1 or not np.isfinite(values).all():
        raise ParameterError(f"{name} = {values}: must be one row of finite coefficients")
    return np.trim_zeros(values, "f")


def _roots(name: str, coefficients: NDArray[np.float64]) -> Roots:
    with np.errstate(over="ignore"):
        monic = coefficients / coefficients[0]
    if not np.isfinite(monic).all():
        raise ParameterError(f"{name} leads with {coefficients[0]}: too small beside the others")
    return tuple(complex(root) for root in np.roots(monic))


def _real_factors(roots: Sequence[complex]) -> list[tuple[float, ...]]:
    """``s - r`` for a real root and ``s² - 2 Re(r) s + |r|²`` for a pair, in canonical order."""
    return [
        (1.0, -root.real)
        if root.imag == 0
        else (1.0, -2.0 * root.real, root.real**2 + root.imag**2)
        for root in roots
        if root.imag >= 0
    ]


def _expanded(roots: Sequence[complex]) -> NDArray[np.float64]:
    return reduce(np.convolve, (np.array(f) for f in _real_factors(roots)), np.ones(1))


def _product_at_origin(roots: Sequence[complex]) -> float:
    return math.prod(factor[-1] for factor in _real_factors(roots) if factor[-1] != 0)
