"""The plants: 1×2 systems as a state space and as two factored channels; the thesis's are stable.

The state space simulates; the channels G1, G2 design. Numerators come from Faddeev and LeVerrier's

    adj(sI - A) = Σ M_k s^(n-k),   M_1 = I,   M_(k+1) = A M_k + c_k I,   c_k = -tr(A M_k)/k,

where a structural zero of A, B, C stays exactly zero, so a relative degree is never a rounding.
"""

import cmath
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from firmware_model.design.factors import (
    CoprimeFactors,
    companion,
    in_parts,
    left_coprime,
    realised,
    unstable,
    with_poles_of,
)
from firmware_model.design.vehicle import (
    TABLE_3_2,
    WITNESSES,
    WORLD,
    Variant,
    VehicleParameters,
    WorldInputs,
    single_track,
)
from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.errors import ParameterError, UnstablePlantError, ZeroChannelError

Matrix = NDArray[np.float64]

_EPS = float(np.finfo(np.float64).eps)
LOOKED_AT = cmath.exp(1j)  # direction in s for the comparison of channels: usually free of poles
_AGREEMENT = 1e-6  # relative; far above rounding, far below the effect of a wrong root


@dataclass(frozen=True, eq=False)
class Plant:
    """``y = [G1 G2] u`` of (2.2), (3.16): input 1 is the channel that can be lost.

    ``a`` (n, n), ``b`` (n, 2), ``c`` (1, n) are read-only float64 copies; ``g1`` and ``g2`` are the
    transfer functions (3.18), (3.19) of its columns. Units are those of the inputs and the output:
    for the car [N m], [N] and [m/s²]. Two plants are equal only if they are the same object.

    A plant with actuators and a sensor (``actuator_dynamics``) has dead times outside G1 and G2,
    s: ``dead_times_s`` from each input, ``sensor_dead_time_s`` to the output. ``sensed`` (1, n) is
    the output before the sensor, by default ``c``. ``world`` has the world's inputs.

    Raises ``ParameterError`` for mismatched shapes, values that are not finite, dead times below
    zero and channels that contradict the state space; ``UnstablePlantError`` for poles of a single
    channel outside the left half plane; ``ZeroChannelError``.
    """

    name: str
    a: Matrix
    b: Matrix
    c: Matrix
    g1: ZeroPoleGain
    g2: ZeroPoleGain
    sensed: Matrix | None = None
    dead_times_s: tuple[float, float] = (0.0, 0.0)
    sensor_dead_time_s: float = 0.0
    world: WorldInputs | None = None

    def __post_init__(self) -> None:
        matrices = _validated(self.name, self.a, self.b, self.c)
        for label, matrix in zip("abc", matrices, strict=True):
            object.__setattr__(self, label, matrix)
        for dead_time_s in (*self.dead_times_s, self.sensor_dead_time_s):
            if not 0.0 <= dead_time_s < math.inf:
                raise ParameterError(
                    f"{self.name}: dead time {dead_time_s:g} s: must be finite and 0 or above"
                )
        _refuse_zero(self.name, self.g1, self.g2)
        _refuse_unshared(self.name, self.g1, self.g2)
        _refuse_disagreement(self)

    @property
    def path_dead_times_s(self) -> tuple[float, float]:
        """Dead time from each input to the measurement, s: actuator plus sensor."""
        first, second = self.dead_times_s
        return first + self.sensor_dead_time_s, second + self.sensor_dead_time_s

    def coprime(self, tau_q_s: float) -> CoprimeFactors:
        """M, N1 and N2 for a q̂ of ``tau_q_s`` seconds; of a stable plant 1, G1 and G2."""
        return left_coprime(self.g1, self.g2, tau_q_s)

    @property
    def integrates(self) -> bool:
        """Whether it has a pole at 0: no command then holds a steady output."""
        return 0j in self.g1.poles

    @classmethod
    def from_state_space(
        cls, name: str, a: ArrayLike, b: ArrayLike, c: ArrayLike, world: WorldInputs | None = None
    ) -> Self:
        """The plant of any ``a`` (n, n), ``b`` (n, 2), ``c`` (1, n); channels of order n.

        Unreachable and unobservable modes of a channel stay as pole-zero pairs. Raises what
        ``Plant`` raises.
        """
        a, b, c = _validated(name, a, b, c)
        poles = _poles(a)
        rows = (ZeroPoleGain.from_coefficients(row, [1.0]) for row in numerators(a, b, c))
        g1, g2 = (ZeroPoleGain(row.zeros, poles, row.gain) for row in rows)
        return cls(name, a, b, c, g1, g2, world=world)

    @classmethod
    def from_transfer_functions(
        cls, name: str, g1: ZeroPoleGain, g2: ZeroPoleGain, gw: ZeroPoleGain | None = None
    ) -> Self:
        """The plant of two strictly proper channels that share only the unstable modes.

        ``gw`` is the strictly proper transfer function from the world's push to the output.

        The partial fractions n_i/Π(s - p) + S_i separate the unstable modes, so both inputs drive
        the same modes: otherwise channel 2 could not hold the modes of a lost channel 1.

        Raises the errors of ``Plant``, and ``ParameterError`` for a channel with feedthrough and
        for a push that drives unstable modes of its own.
        """
        _refuse_zero(name, g1, g2)
        largest = max(map(abs, (*g1.poles, *g2.poles)), default=0.0)
        rounding = (g1.order + g2.order) * _EPS * largest
        g1 = ZeroPoleGain(g1.zeros, tuple(_on_axis(p, rounding) for p in g1.poles), g1.gain)
        g2 = ZeroPoleGain(g2.zeros, tuple(_on_axis(p, rounding) for p in g2.poles), g2.gain)
        g2 = with_poles_of(g2, unstable(g1))
        _refuse_unshared(name, g1, g2)
        poles = unstable(g1)
        first, second = in_parts(g1, "G1"), in_parts(g2, "G2")
        (a1, b1, c1, _), (a2, b2, c2, _) = realised(first.stable), realised(second.stable)
        k, k1 = len(poles), len(poles) + len(a1)
        b = np.zeros((k1 + len(a2), 2))
        b[:k, 0], b[k:k1, 0] = first.residues, b1
        b[:k, 1], b[k1:, 1] = second.residues, b2
        a = linalg.block_diag(companion(poles), a1, a2)
        c = np.concatenate([np.eye(1, k)[0], c1, c2])
        if gw is None:
            return cls(name, a, b, c[np.newaxis], g1, g2)
        gw = with_poles_of(gw, poles)
        if Counter(unstable(gw)) not in (Counter(), Counter(poles)):
            raise ParameterError(
                f"{name}: unstable poles of Gw: {_listed(unstable(gw))}: must be none, or those of "
                f"G1 and G2, {_listed(poles)}; zeros cancel what the push does not reach"
            )
        third = in_parts(gw, "Gw")
        a3, b3, c3, _ = realised(third.stable)
        column = np.concatenate([np.zeros(len(a)), b3])
        column[: len(third.residues)] = third.residues
        a, b = linalg.block_diag(a, a3), np.concatenate([b, np.zeros((len(a3), 2))])
        return cls(name, a, b, np.concatenate([c, c3])[np.newaxis], g1, g2, world=push(column))


def push(column: ArrayLike) -> WorldInputs:
    """The world of a plant by numbers: one input, through E = ``column`` (n,)."""
    n, r, m = len(np.asarray(column)), len(WITNESSES), len(WORLD)
    e, none = np.zeros((n, m)), np.zeros((1, m))
    e[:, 0] = column
    return WorldInputs(e, none, none, np.zeros((r, n)), np.zeros((r, m)))


def steer_by_wire(parameters: VehicleParameters = TABLE_3_2, variant: Variant = "physics") -> Plant:
    """The car of §3.2: steering torque [N m] and rear force difference [N] to D* [m/s²].

    The front wheels are free to align, so what makes a car weave is a short trail with little
    damping at speed, or oversteer with a steering gear that hardly lets them align.

    Raises ``ParameterError`` for an unknown variant.
    """
    (a, b, c), world = single_track(parameters, variant)
    return Plant.from_state_space(f"steer-by-wire ({variant})", a, b, c, world)


def chapter_2() -> Plant:
    """The example (2.38), ``[(s+3)/((s+1)(s+2))  (s+6)/((s+4)(s+5))]``; states block-diagonal."""
    g1, g2 = ZeroPoleGain((-3,), (-1, -2), 1.0), ZeroPoleGain((-6,), (-4, -5), 1.0)
    return Plant.from_transfer_functions("chapter-2", g1, g2)


def numerators(a: Matrix, b: Matrix, c: Matrix) -> Matrix:
    """Coefficients of ``C adj(sI - A) B``, highest power first: shape (2, n), a row an input.

    A coefficient within its own rounding error of zero is returned as zero.
    """
    n = len(a)
    coefficients, errors = np.empty((2, n)), np.empty((2, n))
    for k, (m, size, _) in enumerate(_leverrier(a)):
        coefficients[:, k] = c[0] @ m @ b
        errors[:, k] = n * n * _EPS * (np.abs(c[0]) @ size @ np.abs(b))
    return np.where(np.abs(coefficients) <= errors, 0.0, coefficients)


def _leverrier(a: Matrix) -> Iterator[tuple[Matrix, Matrix, float]]:
    """M_k, a bound of |M_k| and so of its rounding error over eps, and c_k, for k = 1..n."""
    n = len(a)
    m, size = np.eye(n), np.eye(n)
    for k in range(n):
        a_m = a @ m
        shift = -float(np.trace(a_m)) / (k + 1)
        yield m, size, shift
        m = a_m + shift * np.eye(n)
        size = np.abs(a) @ size + abs(shift) * np.eye(n)


def _poles(a: Matrix) -> Roots:
    """The eigenvalues of A, moved to 0 or to the imaginary axis if within rounding.

    m poles at 0 make the last m coefficients of det(sI - A) zero within rounding error; the
    computed eigenvalues may be off by the m-th root of the error.
    """
    n = len(a)
    rounding = n * _EPS * float(np.linalg.norm(a))
    poles = np.array([_on_axis(complex(pole), rounding) for pole in np.linalg.eigvals(a)])
    vanishing = [
        abs(c_k) <= n * n * _EPS * float(np.trace(np.abs(a) @ size))
        for _, size, c_k in _leverrier(a)
    ]
    at_rest = n if all(vanishing) else vanishing[::-1].index(False)
    smallest = np.argsort(np.abs(poles))[:at_rest]
    reach = float(np.linalg.norm(a)) * (n * _EPS) ** (1.0 / max(at_rest, 1))
    if (np.abs(poles[smallest]) <= reach).all():
        poles[smallest] = 0.0
    return tuple(complex(pole) for pole in poles)


def _validated(name: str, a: ArrayLike, b: ArrayLike, c: ArrayLike) -> tuple[Matrix, ...]:
    """Read-only float64 copies of A, B, C after checks of shapes and finite values."""
    n = np.shape(a)[0] if np.ndim(a) else 0
    matrices = []
    for label, value, shape in (("A", a, (n, n)), ("B", b, (n, 2)), ("C", c, (1, n))):
        matrix = np.array(value, dtype=np.float64)
        if n == 0 or matrix.shape != shape:
            raise ParameterError(
                f"{name}: {label} has shape {matrix.shape}, must be {shape}, n >= 1"
            )
        if not np.isfinite(matrix).all():
            raise ParameterError(f"{name}: {label} has an entry that is not finite")
        matrix.flags.writeable = False
        matrices.append(matrix)
    return tuple(matrices)


def _on_axis(pole: complex, rounding: float) -> complex:
    return complex(0.0 if abs(pole.real) <= rounding else pole.real, pole.imag)


def _refuse_zero(name: str, g1: ZeroPoleGain, g2: ZeroPoleGain) -> None:
    for label, channel in (("G1", g1), ("G2", g2)):
        if channel.gain == 0:
            raise ZeroChannelError(f"{name}: {label}(s) is identically zero")


def _refuse_unshared(name: str, g1: ZeroPoleGain, g2: ZeroPoleGain) -> None:
    """A mode within reach of one input alone cannot be held by the other input."""
    first, second = unstable(g1), unstable(g2)
    if Counter(first) != Counter(second):
        raise UnstablePlantError(
            f"{name}: unstable poles of G1: {_listed(first)}; of G2: {_listed(second)}: must be "
            "the same, or one input alone cannot hold them"
        )


def _listed(roots: Roots) -> str:
    words = [f"{root if root.imag else root.real:.6g}" for root in roots]
    return f"{', '.join(words)} rad/s" if roots else "none"


def _refuse_disagreement(plant: Plant) -> None:
    """Check the channels against C(sI - A)⁻¹B at the magnitudes of the poles."""
    sizes = {abs(pole) for pole in (*plant.g1.poles, *plant.g2.poles)} - {0.0} or {1.0}
    points = LOOKED_AT * np.array(sorted(sizes))
    resolvents = np.linalg.inv(points[:, None, None] * np.eye(len(plant.a)) - plant.a)
    responses = (plant.c @ resolvents @ plant.b)[:, 0]
    scales = (np.abs(plant.c) @ np.abs(resolvents) @ np.abs(plant.b))[:, 0]
    given = np.stack([plant.g1(points), plant.g2(points)], axis=1)
    agree = (np.abs(given - responses) <= _AGREEMENT * scales).all(axis=1)
    if not agree.all():
        at = int(np.argmin(agree))
        raise ParameterError(
            f"{plant.name}: [G1 G2] = {given[at]} at s = {points[at]:.6g} rad/s,"
            f" but C(sI - A)^-1 B = {responses[at]}: must agree; numbers of less different size may"
            " help"
        )
