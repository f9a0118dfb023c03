"""Numbers of a formula in the precision of the table, compiled and interpreted alike.

A float32 times a Python literal is a float64 for numba and a float32 for NumPy. So no literal takes
part in arithmetic here unless it went through ``real``: the two then agree in every bit, and a
target whose floating-point unit is single computes in single precision throughout.
"""

from __future__ import annotations

from firmware_model.compiled import firmware


@firmware
def real(value: float, like: float) -> float:
    """``value`` in the precision of ``like``: in C, ``(real)value``."""
    return type(like)(value)
