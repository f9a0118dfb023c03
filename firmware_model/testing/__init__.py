"""Assertions for tests of discretised filters: against theory, never against golden numbers.

Each takes a ``Filter`` of ``discretise`` and raises ``AssertionError`` with one line: where the
filter is how far from theory, and what was allowed. What is allowed comes from the coefficients,
where the caller does not say: how far rounding can move the answer (``single_filter.rounding``).
What is no filter, frequency or sample raises ``ParameterError``.

Nothing else imports this room.
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
