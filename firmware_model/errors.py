"""Errors of a design, one class for each broken assumption.

``DesignError`` is a ``ValueError``: a caller catches all broken assumptions with one class.
"""

import math


class DesignError(ValueError):
    """An impossible design: the message names the broken assumption and the cause."""


class ParameterError(DesignError):
    """A number that is infinite, not a number, or outside its meaningful range."""


class UnstablePlantError(DesignError):
    """An unstable mode where stability is required, or a mode that one input alone cannot hold."""


class ImproperError(DesignError):
    """More zeros than poles: the low-pass filter's order α is too small (2.37), (3.29), (3.33)."""


class ZeroChannelError(DesignError):
    """A channel that is identically zero: no effect to lose (2.3), or no means to compensate."""


class AxisZeroError(DesignError):
    """A zero on or near the imaginary axis: no stable inverse, no inner-outer factorisation."""


class UnstableFilterError(DesignError):
    """A free parameter Q with a pole in the closed right half plane: not in RH∞ (Theorem 2.3.1)."""


def require_positive(name: str, value: float) -> None:
    """Raise ``ParameterError`` naming ``name`` unless ``value`` is finite and above zero."""
    if not (math.isfinite(value) and value > 0):
        raise ParameterError(f"{name} = {value}: must be finite and > 0")


def require_order(name: str, value: int) -> None:
    """Raise ``ParameterError`` naming ``name`` unless ``value`` is an integer of at least 1."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 1:
        raise ParameterError(f"{name} = {value!r}: must be an integer >= 1")
