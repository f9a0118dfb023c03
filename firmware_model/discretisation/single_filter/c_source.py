"""A filter as a pair of C files: constants, and the lines of `target.filters.biquad`.

`can_rig.export` translates the same loops; a test compares both texts.
"""

from __future__ import annotations

import re
import textwrap
from string import Template
from typing import Final

import numpy as np

from firmware_model.errors import ParameterError
from firmware_model.target.structs import FloatArray, Precision

KEYWORDS: Final = """
    auto break case char const continue default do double else enum extern float for goto if inline
    int long register restrict return short signed sizeof static struct switch typedef union
    unsigned void volatile while alignas alignof asm bool constexpr false nullptr static_assert
    thread_local true typeof
"""
CPP_KEYWORDS: Final = """
    and and_eq bitand bitor catch char8_t char16_t char32_t class co_await co_return co_yield compl
    concept const_cast consteval constinit decltype delete dynamic_cast explicit export friend
    mutable namespace new noexcept not not_eq operator or or_eq private protected public
    reinterpret_cast requires static_cast template this throw try typeid typename using virtual
    wchar_t xor xor_eq
"""
LIBRARY: Final = r"""
    NULL EOF errno assert offsetof signbit NAN INFINITY HUGE_VAL I complex imaginary noreturn stdin
    stdout stderr (FLT|DBL|LDBL)_\w+ U?INT\w*_(MAX|MIN|C) u?int\w*_t
    (size|ptrdiff|float|double|l?l?div|clock|time)_t va_list tm FILE
"""
TAKEN: Final = {
    KEYWORDS: "a keyword of C",
    CPP_KEYWORDS: "a keyword of C++, which may include the header",
    LIBRARY: "a name of the C library",
}

HEADER: Final = Template("""\
/* $what
 *
 * A tick is ${name}_step with one sample. Answers and state have the same bits as those of
 * Filter.step of firmware_model: real numbers are $real, and rounded after every operation.
 * The state is the caller's memory; all of it zero, the filter is at rest.
 */
#ifndef ${guard}_H
#define ${guard}_H

#define ${guard}_SECTIONS $sections

#ifdef __cplusplus
extern "C" {
#endif

/* State: second-order sections, transposed direct form II in delta = z - 1. */
struct $name {
    $real accumulators[${guard}_SECTIONS][2]; /* s1, s2, a row a section */
};

/* The answer to the sample u, and the state one tick later. */
$real ${name}_step(struct $name *state, $real u);

/* Put the filter into its steady state for a constant input u; returns the output.
 *
 * A section that integrates has no steady state unless u is zero: it is left at rest.
 */
$real ${name}_reset(struct $name *state, $real u);

#ifdef __cplusplus
}
#endif

#endif
""")

SOURCE: Final = Template("""\
#include "$name.h"

#include <float.h>
#include <stdint.h>

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__ != 0) || \\
    defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "the filter needs IEEE 754 arithmetic: compile without -ffast-math and its parts"
#endif
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0
#error "the filter must be rounded after every operation: FLT_EVAL_METHOD must be 0"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif

/* beta0, beta1, beta2, alpha1, alpha2, a row a section; gcc needs -ffp-contract=off. */
static const $real coefficients[${guard}_SECTIONS][5] = {
$rows
};

$real ${name}_step(struct $name *state, $real u)
{
    $real (*s)[2] = state->accumulators;
    for (int32_t i = 0; i < ${guard}_SECTIONS; i++) {
        const $real y = coefficients[i][0] * u + s[i][0];
        s[i][0] += coefficients[i][1] * u - coefficients[i][3] * y + s[i][1];
        s[i][1] += coefficients[i][2] * u - coefficients[i][4] * y;
        u = y;
    }
    return u;
}

$real ${name}_reset(struct $name *state, $real u)
{
    $real (*s)[2] = state->accumulators;
    for (int32_t i = 0; i < ${guard}_SECTIONS; i++) {
        const $real b0 = coefficients[i][0];
        const $real b1 = coefficients[i][1];
        const $real b2 = coefficients[i][2];
        const $real a1 = coefficients[i][3];
        const $real a2 = coefficients[i][4];
        $real y = u * b0;
        if (a2 != $zero) {
            y = u * b2 / a2;
        } else if (a1 != $zero) {
            y = u * b1 / a1;
        }
        s[i][0] = y - b0 * u;
        s[i][1] = a1 * y - b1 * u;
        u = y;
    }
    return u;
}
""")


def c_source(
    coefficients: FloatArray, precision: Precision, name: str, what: str
) -> dict[str, str]:
    """``name.h`` and ``name.c`` of a cascade of sections, text by file name.

    Args:
        coefficients: β0, β1, β2, α1, α2, exact in ``precision``, shape (sections, 5).
        precision: of coefficients, state and arithmetic.
        name: name of the files and of the state's struct, and prefix of the functions.
        what: description of the filter.

    Raises:
        ParameterError: ``name`` is no C identifier, or a reserved name of C or C++.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
        raise ParameterError(
            f"name = {name!r}: must be a name in C, a letter and then letters, digits or _"
        )
    for taken, owner in TAKEN.items():
        if re.fullmatch("|".join(taken.split()), name):
            raise ParameterError(f"name = {name!r}: is {owner}, must be another name")
    words = {
        "name": name,
        "guard": name.upper(),
        "real": "float" if precision == "float32" else "double",
        "zero": _literal(0.0, precision),
        "sections": str(len(coefficients)),
        "rows": "\n".join(_row(row, precision) for row in coefficients),
        "what": "\n * ".join(textwrap.wrap(what, 96)),
    }
    return {f"{name}.h": HEADER.substitute(words), f"{name}.c": SOURCE.substitute(words)}


def _row(row: FloatArray, precision: Precision) -> str:
    return f"    {{{', '.join(_literal(float(each), precision) for each in row)}}},"


def _literal(value: float, precision: Precision) -> str:
    """The shortest literal with exactly this value."""
    if precision == "float64":
        return repr(value)
    shortest = str(np.float32(value))
    return f"{shortest if '.' in shortest or 'e' in shortest else shortest + '.0'}f"
