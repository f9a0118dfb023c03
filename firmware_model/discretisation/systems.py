"""Continuous filters of other libraries, one input and one output, as zeros, poles and gain.

Attributes identify the objects of python-control and ``scipy.signal``, so this module imports
neither library. No function expands a state space into polynomials.
"""

from __future__ import annotations

import cmath
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.held_input import refined
from firmware_model.discretisation.sections import ComplexArray
from firmware_model.errors import ParameterError
from firmware_model.law.structs import FloatArray

ROUNDING = 100 * np.finfo(np.float64).eps
"""Relative distance within which two roots of another library are a conjugate pair."""

PROBED = cmath.exp(1j)
"""Direction in s in which responses are compared: at π/4 or π/2 a root may well be."""

WANTED = (
    "must be a TransferFunction or StateSpace of python-control or scipy.signal, a ZerosPolesGain, "
    "a ZeroPoleGain, or a tuple (num, den)"
)
OF_SCIPY = {3: "ZerosPolesGain(zeros, poles, gain)", 4: "StateSpace(a, b, c, d)"}
"""What scipy's other tuples may be, by length; those of sampled filters look the same."""


@dataclass(frozen=True)
class Polynomials:
    """``num(s)/den(s)``, real coefficients with the highest power first."""

    num: FloatArray
    den: FloatArray

    def __call__(self, s: ComplexArray) -> ComplexArray:
        """The value at ``s`` in rad/s, an array of any shape."""
        return np.asarray(np.polyval(self.num, s) / np.polyval(self.den, s))

    def zero_pole_gain(self) -> ZeroPoleGain:
        """The same function in factored form; roots by eigenvalues."""
        return ZeroPoleGain.from_coefficients(self.num, self.den)


@dataclass(frozen=True)
class StateSpace:
    """``c (sI - a)⁻¹ b + d``; shapes (n, n), (n, 1), (1, n) and a number."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: float

    def __call__(self, s: ComplexArray) -> ComplexArray:
        """The value at ``s`` in rad/s, an array of any shape."""
        resolvent = s[..., None, None] * np.eye(len(self.a)) - self.a
        return np.asarray((self.c @ np.linalg.solve(resolvent, self.b))[..., 0, 0] + self.d)

    def zero_pole_gain(self) -> ZeroPoleGain:
        """The same function in factored form: the zeros are the poles of the inverse system.

        Without feedthrough the zeros are the eigenvalues of the zero dynamics: the motion in the
        largest subspace with an input that keeps the output at zero, ker(c, ca, …, ca^(r-1)).
        """
        if not len(self.a):
            return ZeroPoleGain.constant(self.d)
        a, (scale, _) = linalg.matrix_balance(self.a, permute=False, separate=True)
        b, c = self.b / scale[:, None], self.c * scale
        poles = linalg.eigvals(a)
        if self.d:
            return ZeroPoleGain(tuple(linalg.eigvals(a - b @ c / self.d)), tuple(poles), self.d)
        rows, markov = _until_the_input_shows(a, b, c)
        if not markov:
            return ZeroPoleGain.constant(0.0)
        held = a - b @ (rows[-1:] @ a) / markov
        silent = linalg.qr(rows.T)[0][:, len(rows) :]
        found = linalg.eigvals(silent.T @ held @ silent) if silent.size else np.empty(0)
        candidates = (found, refined(a, b, c, poles, found))
        return min((self._matched(zeros, poles) for zeros in candidates), key=self.distance)

    def _matched(self, zeros: Iterable[complex], poles: ComplexArray) -> ZeroPoleGain:
        """With the gain matched near the zeros and poles, not at infinity."""
        size = np.abs(poles[poles != 0.0])
        probe = PROBED * float(np.exp(np.log(size).mean())) if size.size else PROBED
        shape = np.prod([probe - q for q in zeros]) / np.prod([probe - p for p in poles])
        gain = (self(np.array([probe])).item() / shape).real
        return ZeroPoleGain(tuple(zeros), tuple(poles), gain)

    def distance(self, g: ZeroPoleGain) -> float:
        """The largest relative error of ``g`` as far from the origin as each of its roots."""
        sizes = np.abs([*g.zeros, *g.poles])
        points = PROBED * np.unique(sizes[sizes > 0.0])
        with np.errstate(all="ignore"):
            return float(np.nan_to_num(np.abs(g(points) / self(points) - 1.0)).max(initial=0.0))


def _until_the_input_shows(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, float]:
    """c, ca, …, ca^(r-1) up to the first non-zero product with b, and the product, else 0."""
    row, rows = c, [c]
    size = float(np.linalg.norm(c))
    for _ in range(len(a)):
        markov = (row @ b).item()
        if abs(markov) > len(a) * ROUNDING * size * float(np.linalg.norm(b)):
            return np.vstack(rows), markov
        size = float(np.linalg.norm(row) * np.linalg.norm(a))
        row = row @ a
        rows.append(row)
    return np.vstack(rows), 0.0


def continuous(system: object) -> ZeroPoleGain | Polynomials | StateSpace:
    """``system`` in the form of the argument.

    Raises:
        ParameterError: ``system`` is of a type unknown to ``discretise``, has several inputs or
            outputs, or is already sampled.
    """
    if isinstance(system, ZeroPoleGain | Polynomials | StateSpace):
        return system
    if isinstance(system, tuple) and len(system) == 2:
        return Polynomials(_row("num", system[0]), _row("den", system[1]))
    known: Any = system
    sampled_s = getattr(known, "dt", None)
    if sampled_s:
        raise ParameterError(f"a filter sampled already (dt = {sampled_s}): must be continuous")
    if hasattr(known, "A") and hasattr(known, "D"):
        return _state_space(known)
    if hasattr(known, "gain") and hasattr(known, "poles"):
        if np.ndim(known.gain):
            _refuse_several(1, np.size(known.gain))
        gain = complex(np.asarray(known.gain).item())
        if gain.imag or not cmath.isfinite(gain):
            raise ParameterError(f"gain = {known.gain}: must be real and finite")
        return ZeroPoleGain(_paired(known.zeros), _paired(known.poles), gain.real)
    if hasattr(known, "num") and hasattr(known, "den"):
        num, den = known.num, known.den
        if hasattr(known, "ninputs"):  # python-control: a matrix of rows
            _refuse_several(known.ninputs, known.noutputs)
            num, den = num[0][0], den[0][0]
        elif np.ndim(num) == 2:
            _refuse_several(1, len(num))
            num = num[0]
        return Polynomials(_row("num", num), _row("den", den))
    kind = type(system).__name__
    if isinstance(system, tuple):
        meant = OF_SCIPY.get(len(system))
        kind = f"a tuple of {len(system)}" + (f" (scipy.signal.{meant} is one)" if meant else "")
    raise ParameterError(f"a continuous filter {WANTED}; not {kind}")


def zero_pole_gain(system: object) -> ZeroPoleGain:
    """``system`` in factored form; raises as ``continuous`` does."""
    given = continuous(system)
    return given if isinstance(given, ZeroPoleGain) else given.zero_pole_gain()


def _state_space(known: Any) -> StateSpace:
    a, b, c, d = (np.asarray(m, np.float64) for m in (known.A, known.B, known.C, known.D))
    _refuse_several(b.shape[1], c.shape[0])
    if not all(np.isfinite(m).all() for m in (a, b, c, d)):
        raise ParameterError("A, B, C, D: every number must be finite")
    return StateSpace(a, b, c, d.item())


def _refuse_several(inputs: int, outputs: int) -> None:
    if inputs != 1 or outputs != 1:
        raise ParameterError(
            f"a filter with {inputs} input(s) and {outputs} output(s): must have one of each; "
            "discretise each channel alone"
        )


def _row(name: str, values: Any) -> FloatArray:
    row = np.atleast_1d(np.asarray(values))
    if row.ndim != 1 or not row.size or row.dtype.kind not in "iuf":
        raise ParameterError(f"{name} = {values}: must be one row of real coefficients")
    return row.astype(np.float64)


def _paired(roots: Iterable[complex]) -> tuple[complex, ...]:
    """Roots of another library, with exact conjugates in place of conjugates within rounding.

    Raises:
        ParameterError: a complex root without its conjugate.
    """
    values = [complex(root) for root in roots]
    if not all(map(cmath.isfinite, values)):
        raise ParameterError("zeros, poles: every root must be finite")
    real = [complex(r.real) for r in values if abs(r.imag) <= ROUNDING * abs(r)]
    upper = [r for r in values if r.imag > ROUNDING * abs(r)]
    lower = [r for r in values if r.imag < -ROUNDING * abs(r)]
    for root in upper:
        partner = min(lower, key=lambda r: abs(r.conjugate() - root), default=0j)
        if abs(partner.conjugate() - root) > ROUNDING * abs(root):
            raise ParameterError(f"a root at {root:g}: its conjugate is missing")
        lower.remove(partner)
    if lower:
        raise ParameterError(f"a root at {lower[0]:g}: its conjugate is missing")
    return (*real, *upper, *(root.conjugate() for root in upper))
