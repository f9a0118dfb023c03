"""Assertions for tests of discretised filters: against theory, never against golden numbers.

Each assertion takes a ``Filter`` of ``discretise`` and raises ``AssertionError`` with one line: the
place, the deviation from theory, and the allowed deviation. The default tolerance comes from the
coefficients: the bound of the rounding error (``discretisation.rounding``). Invalid filters,
frequencies or samples raise ``ParameterError``.

No other room imports this room.
"""

from firmware_model.testing.assertions import (
    OF_ZOH,
    ROUNDINGS,
    assert_bit_identical,
    assert_dc_gain,
    assert_float32_follows,
    assert_follows,
    assert_stable,
    assert_step,
)

__all__ = [
    "OF_ZOH",
    "ROUNDINGS",
    "assert_bit_identical",
    "assert_dc_gain",
    "assert_float32_follows",
    "assert_follows",
    "assert_stable",
    "assert_step",
]
