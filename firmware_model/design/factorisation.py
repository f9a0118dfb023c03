"""Inner-outer factorisation of a stable channel: G = Gi·Go with Gi(0) = 1, (3.31).

A zero z in the right half plane has no stable inverse. The mirror image -conj(z) has a stable
inverse, and

    (s - z) = (z - s)/(conj(z) + s) · (-1)(s + conj(z))

moves the difference into an all-pass factor; over a conjugate pair that factor is real, and is 1
at s = 0.
"""

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import (
    AxisZeroError,
    ParameterError,
    UnstablePlantError,
    ZeroChannelError,
)

AXIS_TOLERANCE = 1e-6
"""Least damping ratio |Re z|/|z| of a zero. 1/Go rings with the damping of G's zeros; below 1e-6 it
is a resonator for thousands of seconds, and a double zero on the axis, which rounding splits by
√eps ≈ 1.5e-8, still counts as on it."""


def inner_outer(
    g: ZeroPoleGain, axis_tolerance: float = AXIS_TOLERANCE, name: str = "G"
) -> tuple[ZeroPoleGain, ZeroPoleGain]:
    """``(inner, outer)``: inner all-pass with inner(0) = 1, outer stable and minimum phase.

    Without zeros in the right half plane the inner factor is the constant 1 and ``outer`` is ``g``.
    ``name`` is what messages call ``g``.

    Raises ``ZeroChannelError`` for g = 0, ``UnstablePlantError`` for a pole that is not in the left
    half plane, ``AxisZeroError`` for a zero on or near the imaginary axis, s = 0 included.
    """
    refuse_axis_zeros(g, name, axis_tolerance)
    for pole in g.poles:
        if pole.real >= 0:
            raise UnstablePlantError(
                f"{name} has a pole at {pole:.6g} rad/s, must have real part < 0"
            )
    mirrored = [z for z in g.zeros if z.real > 0]
    kept = [z for z in g.zeros if z.real < 0]
    images = [-z.conjugate() for z in mirrored]
    sign = (-1.0) ** len(mirrored)
    inner = ZeroPoleGain(tuple(mirrored), tuple(images), sign)
    outer = ZeroPoleGain((*kept, *images), g.poles, sign * g.gain)
    return inner, outer


def refuse_axis_zeros(g: ZeroPoleGain, name: str, axis_tolerance: float = AXIS_TOLERANCE) -> None:
    """Raise unless ``g`` is not zero and clear of zeros on the imaginary axis.

    ``name`` is what messages call it; the errors are those of ``inner_outer``.
    """
    if not 0 <= axis_tolerance < 1:
        raise ParameterError(f"axis_tolerance = {axis_tolerance}: must lie in 0..1, below 1")
    if g.gain == 0:
        raise ZeroChannelError(f"{name}(s) is identically zero, must not be")
    for zero in g.zeros:
        if abs(zero.real) <= axis_tolerance * abs(zero):
            raise AxisZeroError(
                f"{name} has a zero at {zero:.6g} rad/s, on the imaginary axis within a damping"
                f" ratio of {axis_tolerance:g}: must be clear of it"
            )
