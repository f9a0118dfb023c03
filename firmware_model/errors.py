"""What can be wrong with a design, one class for each broken assumption.

``DesignError`` is a ``ValueError``, so a caller who does not care which assumption broke catches
that one.
"""

import math


class DesignError(ValueError):
    """A design that cannot be made: the message names the assumption and what broke it."""


class ParameterError(DesignError):
    """A number that is not finite, or outside the range in which it means anything."""


class UnstablePlantError(DesignError):
    """A mode that is not stable where it must be, or that one input alone cannot hold."""


class ImproperError(DesignError):
    """More zeros than poles: the low-pass filter's order α is too small (2.37), (3.29), (3.33)."""


class ZeroChannelError(DesignError):
    """A channel that is identically zero: nothing to lose (2.3), or nothing to compensate with."""


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
