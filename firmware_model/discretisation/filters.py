"""A single discretised filter from any continuous filter, for unit tests.

Also as a pair of C files: constants, and the lines of `target.filters.biquad`. `can_rig.export`
translates the same loops; a test compares both texts.
"""

from __future__ import annotations

import ctypes
import math
import re
import textwrap
from collections.abc import Callable, Sequence
from string import Template
from types import SimpleNamespace
from typing import Final, cast

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.compiled import compiled
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.rules import Rule
from firmware_model.discretisation.sections import ComplexArray, Sections, from_delta_zpk
from firmware_model.discretisation.systems import Polynomials, StateSpace, zero_pole_gain
from firmware_model.discretisation.tustin import RULES, by_rule, tustin
from firmware_model.errors import ParameterError
from firmware_model.law.core import biquad
from firmware_model.law.structs import MAX_SECTIONS, FloatArray, Precision, Records, zeroed

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
    ctype fenv inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic stdbool
    stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
"""
MACROS: Final = "linux unix i386 mips sparc sun PPC"
TAKEN: Final = {
    KEYWORDS: "a keyword of C",
    CPP_KEYWORDS: "a keyword of C++, which may include the header",
    LIBRARY: "a name of the C library",
    MACROS: "a macro of some compilers",
}

MAX_STATES: Final = 64
"""Of a C function: 16 stages of 4 in direct form I."""

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
#if defined(FLT_EVAL_METHOD) && FLT_EVAL_METHOD != 0 && FLT_EVAL_METHOD != 16
#error "the filter must be rounded after every operation: FLT_EVAL_METHOD must be 0 or 16"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#elif defined(__GNUC__)
#pragma GCC optimize("fp-contract=off")
#elif defined(_MSC_VER)
#pragma fp_contract(off)
#endif

/* beta0, beta1, beta2, alpha1, alpha2, a row a section */
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
        } else {
            /* as it is */
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
        "zero": literal(0.0, precision),
        "sections": str(len(coefficients)),
        "rows": "\n".join(_row(row, precision) for row in coefficients),
        "what": "\n * ".join(textwrap.wrap(what, 96)),
    }
    return {f"{name}.h": HEADER.substitute(words), f"{name}.c": SOURCE.substitute(words)}


def _row(row: FloatArray, precision: Precision) -> str:
    return f"    {{{', '.join(literal(float(each), precision) for each in row)}}},"


def literal(value: float, precision: Precision) -> str:
    """The shortest literal with exactly this value."""
    if precision == "float64":
        return repr(float(value))  # NumPy names its own types in repr
    shortest = str(np.float32(value))
    return f"{shortest if '.' in shortest or 'e' in shortest else shortest + '.0'}f"


class Filter:
    """A discretised filter with a private state: ``step`` is ``biquad.advance``.

    Attributes:
        sections: the second-order sections, with the stored coefficients.
        tick_s: sampling period, seconds.
        rule: the discretisation, or None for a filter from its own coefficients.
        given: the filter in z as its coefficients were given, in factors; empty of ``discretise``.
        prewarp_rad_per_s: the frequency at which Tustin kept the response, or None.
        precision: of coefficients, state and arithmetic.
        cascade: the same constants as the record of ``biquad.Constants`` that runs. Read-only.
    """

    def __init__(
        self,
        sections: Sections,
        rule: Rule | None,
        prewarp_rad_per_s: float | None,
        precision: Precision,
        given: Sequence[ZeroPoleGain | Polynomials | StateSpace] = (),
    ) -> None:
        """Store ``sections`` in ``precision``; ``discretise`` and ``from_…`` make them."""
        self.given = tuple(given)
        self._exact = sections
        stored = _stored(sections.coefficients, precision)
        self.sections = Sections(stored.astype(np.float64), sections.tick_s)
        self.tick_s = sections.tick_s
        self.rule = rule
        self.prewarp_rad_per_s = prewarp_rad_per_s
        self.precision = precision
        self._cascades = zeroed(biquad.Constants, precision)
        self._cascades["n"] = len(stored)
        self._cascades["coefficients"][0, : len(stored)] = stored
        self._cascades.flags.writeable = False
        # A record taken earlier could still be written.
        self.cascade: biquad.Constants = self._cascades[0]
        self._states = zeroed(biquad.State, precision)

    def in_precision(self, precision: Precision) -> Filter:
        """The same filter at rest, stored and computed in ``precision``.

        Raises:
            ParameterError: an unknown precision, or a precision too small for a coefficient.
        """
        _require_precision(precision)
        return Filter(self._exact, self.rule, self.prewarp_rad_per_s, precision, self.given)

    @classmethod
    def from_sos(
        cls,
        sos: ArrayLike,
        *,
        tick_s: float,
        gain: ArrayLike = 1.0,
        precision: Precision = "float64",
    ) -> Filter:
        """A filter of second-order sections in powers of 1/z, as scipy and MATLAB write them.

        Args:
            sos: b0, b1, b2, a0, a1, a2, a row a section, shape (n, 6).
            tick_s: sampling period, seconds.
            gain: factor of the whole filter, or MATLAB's scale values, shape (m,).
            precision: that of the coefficients: they are rounded to it first.

        Raises:
            ParameterError: a wrong shape, a number that is not finite, a0 = 0, an unstable section.
        """
        rows, factor = _numbers("sos", sos, precision), _numbers("gain", gain, precision)
        if rows.ndim != 2 or rows.shape[1] != 6 or not 1 <= len(rows) <= MAX_SECTIONS:
            raise ParameterError(
                f"sos has shape {rows.shape}: must be (n, 6), rows b0 b1 b2 a0 a1 a2, "
                f"n at most {MAX_SECTIONS}"
            )
        if not rows[:, 3].all():
            raise ParameterError("sos: a section with a0 = 0 is improper; must not be 0")
        b, a = rows[:, :3] / rows[:, 3:4], rows[:, 3:] / rows[:, 3:4]
        given = [Polynomials(*pair) for pair in zip(b, a, strict=True)]
        first = (b[:, 2] == 0.0) & (a[:, 2] == 0.0)  # z/z cancels: a section of first order
        powers = np.where(first, 1.0, 2.0)
        b_at_1, a_at_1 = np.where(first, 0.0, [b.sum(axis=1), (1.0 + a[:, 1]) + a[:, 2]])
        delta = np.stack([b[:, 0], powers * b[:, 0] + b[:, 1], b_at_1, powers + a[:, 1], a_at_1], 1)
        delta[0, :3] *= factor.prod()
        return _of_coefficients(Sections(delta, _tick(tick_s)), precision, given)

    @classmethod
    def from_cmsis(
        cls, coefficients: ArrayLike, *, tick_s: float, precision: Precision = "float32"
    ) -> Filter:
        """A filter of CMSIS-DSP biquads: b0, b1, b2, a1, a2 a stage, with the sign of a1, a2.

        CMSIS-DSP adds a1 y[n-1] + a2 y[n-2], where scipy and MATLAB subtract.

        Args:
            coefficients: as ``arm_biquad_cascade_df2T_init_f32`` takes them, shape (5n,) or (n, 5).
            tick_s: sampling period, seconds.
            precision: that of the coefficients.

        Raises:
            ParameterError: as ``from_sos``.
        """
        flat = _numbers("coefficients", coefficients, precision).ravel()
        if not flat.size or flat.size % 5:
            raise ParameterError(f"{flat.size} coefficients: must be 5 a stage, b0 b1 b2 a1 a2")
        rows = flat.reshape(-1, 5)
        sos = np.column_stack([rows[:, :3], np.ones(len(rows)), -rows[:, 3:]])
        return cls.from_sos(sos, tick_s=tick_s, precision=precision)

    @classmethod
    def from_ba(
        cls, b: ArrayLike, a: ArrayLike, *, tick_s: float, precision: Precision = "float64"
    ) -> Filter:
        """A filter b(1/z)/a(1/z), the arguments of scipy's ``lfilter`` and MATLAB's ``filter``.

        Raises:
            ParameterError: as ``from_sos``; a[0] = 0; an order above 16.
        """
        above, below = _numbers("b", b, precision), _numbers("a", a, precision)
        for name, row in (("b", above), ("a", below)):
            if row.ndim != 1 or not row.size:
                raise ParameterError(f"{name} has shape {row.shape}: must be one row")
        if below[0] == 0.0:
            raise ParameterError("a[0] = 0: improper, a filter that needs its future input")
        size = max(len(above), len(below))
        given = Polynomials(*(np.pad(row, (0, size - len(row))) for row in (above, below)))
        return _of_roots(given.zero_pole_gain(), tick_s, precision, given)

    @classmethod
    def from_zpk(
        cls,
        zeros: ArrayLike,
        poles: ArrayLike,
        gain: float,
        *,
        tick_s: float,
        precision: Precision = "float64",
    ) -> Filter:
        """A filter gain Π(z - zero)/Π(z - pole), roots in z.

        Raises:
            ParameterError: as ``from_sos``; a complex root without its conjugate.
            ImproperError: more zeros than poles.
        """
        _require_precision(precision)
        roots = SimpleNamespace(zeros=np.atleast_1d(zeros), poles=np.atleast_1d(poles), gain=gain)
        given = zero_pole_gain(roots)
        return _of_roots(given, tick_s, precision, given)

    @classmethod
    def from_state_space(
        cls,
        a: ArrayLike,
        b: ArrayLike,
        c: ArrayLike,
        d: ArrayLike,
        *,
        tick_s: float,
        precision: Precision = "float64",
    ) -> Filter:
        """A filter x⁺ = a x + b u, y = c x + d u; shapes (n, n), (n, 1), (1, n), (1, 1).

        Raises:
            ParameterError: as ``from_sos``.
        """
        named = zip("abcd", (a, b, c, d), strict=True)
        m = [np.atleast_2d(_numbers(name, each, precision)) for name, each in named]
        n = m[0].shape[1]
        wanted = [(n, n), (n, 1), (1, n), (1, 1)]
        if [each.shape for each in m] != wanted:
            raise ParameterError(
                f"a, b, c, d have shapes {[each.shape for each in m]}: must be {wanted}"
            )
        given = StateSpace(m[0], m[1], m[2], m[3].item())
        in_delta = StateSpace(m[0] - np.eye(n), m[1], m[2], given.d).zero_pole_gain()
        return _of_roots(in_delta, tick_s, precision, given, origin=0.0)

    @classmethod
    def from_c(
        cls, function: object, *, states: int, tick_s: float, precision: Precision = "float32"
    ) -> Filter:
        """The filter that a compiled C function is: ``float step(float *state, float u)``.

        ``state`` has ``states`` numbers, all zero at rest; ``float64`` means ``double``. Calls with
        a single 1 as input or state answer the filter's matrices, each number exactly.

        Args:
            function: of a library that ctypes loaded: ``ctypes.CDLL("./filter.so").step``.
            states: how many numbers the state has, 1 to 64; CMSIS-DSP's df1 has 4 a stage.
            tick_s: sampling period, seconds.
            precision: of the function's numbers.

        Raises:
            ParameterError: not a function of ctypes; not linear, or with a state elsewhere; as
                ``from_state_space``.
        """
        _require_precision(precision)
        if isinstance(states, bool) or not (isinstance(states, int) and 1 <= states <= MAX_STATES):
            raise ParameterError(f"states = {states!r}: must be a whole number, 1 to {MAX_STATES}")
        call = _c_function(function, states, precision)
        read = np.column_stack([call(row[:-1], row[-1]) for row in np.eye(states + 1)])
        rng = np.random.default_rng(1)
        for size in (1e-3, 1.0, 1e3):
            at = (size * rng.standard_normal(states + 1)).astype(precision).astype(np.float64)
            error = np.abs(call(at[:-1], at[-1]) - read @ at)
            allowed = 8 * (states + 2) * np.finfo(precision).eps * (np.abs(read) @ np.abs(at))
            if not (error <= allowed).all():
                raise ParameterError(
                    f"the C function is not linear in its {states} states and its input (tried at "
                    f"{size:g}), or has a state elsewhere: must be linear, its state in the array"
                )
        a, b, c, d = read[:-1, :-1], read[:-1, -1:], read[-1:, :-1], read[-1:, -1:]
        return cls.from_state_space(a, b, c, d, tick_s=tick_s, precision=precision)

    def step(self, u: float) -> float:
        """The answer to the sample ``u``, and the state one tick later."""
        return float(biquad.advance(self.cascade, self._states[0], self._real(u)))

    def run(self, u: ArrayLike) -> FloatArray:
        """The answers to the samples ``u``, shape (n,), in the filter's precision.

        The run continues from the state after the last call.

        Raises:
            ParameterError: ``u`` is not one row of real numbers.
        """
        samples = np.asarray(u)
        if samples.ndim != 1 or samples.dtype.kind not in "iufb":
            raise ParameterError(f"u has shape {samples.shape}: must be one row of real samples")
        inputs = np.ascontiguousarray(samples, self.precision)
        outputs = np.empty_like(inputs)
        _run(self._cascades, self._states, inputs, outputs)
        return outputs

    def reset(self, u: float = 0.0) -> float:
        """Settle into the steady state for a constant input ``u``; returns the output there.

        A section that integrates has no steady state unless its input is zero: it is left at rest.
        """
        return float(biquad.settle(self.cascade, self._states[0], self._real(u)))

    def frequency_response(self, rad_per_s: ArrayLike) -> ComplexArray:
        """H(e^{jωT}) of the stored coefficients at ω, an array of any shape, in rad/s."""
        return self.sections.at_delta(_on_circle(np.asarray(rad_per_s, np.float64) * self.tick_s))

    @property
    def poles(self) -> ComplexArray:
        """Poles in z, shape (order,)."""
        delta = [np.roots(below) for _, below in map(_fraction, self.sections.coefficients)]
        return 1.0 + np.concatenate(delta).astype(np.complex128)

    @property
    def order(self) -> int:
        """The number of poles."""
        return len(self.poles)

    @property
    def dc_gain(self) -> float:
        """The limit for z → 1; an infinity where the filter integrates."""
        gain, zeros = 1.0, 0.0
        for above, below in map(_fraction, self.sections.coefficients):
            (numerator, order), (denominator, poles) = _lowest(above), _lowest(below)
            gain *= numerator / denominator
            zeros += order - poles
        return gain if zeros == 0 else 0.0 if zeros > 0 else math.copysign(math.inf, gain)

    @property
    def is_stable(self) -> bool:
        """Whether the stored coefficients have every pole inside the unit circle."""
        # |1 + δ| < 1 from δ: near z = 1, δ has more digits than z
        delta = [np.roots(below) for _, below in map(_fraction, self.sections.coefficients)]
        return all(2.0 * d.real + abs(d) ** 2 < 0.0 for d in np.concatenate(delta))

    def to_scipy_sos(self) -> FloatArray:
        """The sections in powers of 1/z for ``scipy.signal.sosfilt``, shape (sections, 6).

        For a filter slow relative to the tick, standard sections have fewer digits than sections in
        δ.
        """
        return self.sections.sos

    def to_c(self, name: str = "filter") -> dict[str, str]:
        """The filter as complete C99, text by file name: ``name.h`` and ``name.c``.

        ``name_step`` and ``name_reset`` return the same bits as ``step`` and ``reset``.

        Args:
            name: name of the files and of the state's struct, and prefix of the functions.

        Raises:
            ParameterError: ``name`` is no C identifier.
        """
        return c_source(self.sections.coefficients, self.precision, name, repr(self)[1:-1])

    def __repr__(self) -> str:
        """Order, rule, tick, precision, DC gain, and how near the poles are to the circle."""
        rule: str = self.rule or "from its coefficients"
        if self.prewarp_rad_per_s is not None:
            rule += f" prewarped at {self.prewarp_rad_per_s:g} rad/s"
        radius = f", largest |pole| {np.abs(self.poles).max():.6g}" if self.order else ""
        return (
            f"<Filter of order {self.order}, {rule}, tick {self.tick_s:g} s, {self.precision}: "
            f"DC gain {self.dc_gain:.6g}{radius}>"
        )

    def _real(self, u: float) -> float:
        return cast(float, np.float32(u)) if self.precision == "float32" else float(u)


def discretise(
    system: object,
    tick_s: float,
    rule: Rule = "tustin",
    *,
    prewarp_rad_per_s: float | None = None,
    precision: Precision = "float64",
) -> Filter:
    """A continuous filter as the second-order sections that the firmware runs.

    The gain is spread over the sections by powers of two, so float32 holds every signal between
    sections; powers of two change no bit of an answer.

    Args:
        system: one input, one output: a ``TransferFunction`` or ``StateSpace`` of python-control
            or ``scipy.signal``, a ``ZerosPolesGain``, a ``ZeroPoleGain``, or ``(num, den)`` with
            the highest power of s first.
        tick_s: sampling period, seconds.
        rule: ``tustin``; ``tustin-held``, for an input held over each tick; or ``zoh``, exact for a
            held input.
        prewarp_rad_per_s: frequency at which ``tustin`` keeps the response exactly.
        precision: ``float64`` or ``float32``, of coefficients, state and arithmetic.

    Raises:
        ParameterError: an invalid filter, tick, rule or precision; an order above 16.
        ImproperError: more zeros than poles, or feedthrough with ``tustin-held``.
    """
    if not _is_number(tick_s):
        raise ParameterError(f"tick_s = {tick_s!r}: must be one number of seconds (one rate)")
    if not (isinstance(rule, str) and rule in RULES):
        raise ParameterError(f"rule = {rule!r}: must be one of {', '.join(RULES)}")
    _require_precision(precision)
    if not (prewarp_rad_per_s is None or _is_number(prewarp_rad_per_s)):
        raise ParameterError(f"prewarp_rad_per_s = {prewarp_rad_per_s!r}: must be one frequency")
    if rule != "tustin" and prewarp_rad_per_s is not None:
        raise ParameterError(f"prewarp_rad_per_s with rule = {rule}: must be left out, or tustin")
    g = zero_pole_gain(system)
    if g.order > 2 * MAX_SECTIONS:
        raise ParameterError(
            f"a filter of order {g.order}: must be of order {2 * MAX_SECTIONS} or less, which is "
            "what the controller's layout holds; split it into filters in series"
        )
    tick_s = float(tick_s)
    if prewarp_rad_per_s is None:
        sections = by_rule(rule, g, tick_s)
    else:
        sections = tustin(g, tick_s, prewarp_rad_per_s)
    return Filter(_spread(sections), rule, prewarp_rad_per_s, precision)


def _numbers(name: str, values: ArrayLike, precision: Precision) -> FloatArray:
    """``values`` rounded to ``precision``."""
    _require_precision(precision)
    try:
        numbers = np.asarray(values)
    except ValueError:
        raise ParameterError(f"{name}: rows of different lengths") from None
    if numbers.dtype.kind not in "iuf" or not np.isfinite(numbers).all():
        raise ParameterError(f"{name}: every number must be real and finite")
    return numbers.astype(precision).astype(np.float64)


def _c_function(
    function: object, states: int, precision: Precision
) -> Callable[[FloatArray, float], FloatArray]:
    """(state, u) → the next state and the answer, shape (states + 1,)."""
    real = ctypes.c_float if precision == "float32" else ctypes.c_double
    if not hasattr(function, "argtypes"):
        raise ParameterError(
            f"function is a {type(function).__name__}: must be a function of a library that "
            'ctypes loaded, ctypes.CDLL("./filter.so").step'
        )
    address = ctypes.cast(cast(ctypes.c_void_p, function), ctypes.c_void_p).value
    compiled_step = ctypes.CFUNCTYPE(real, ctypes.POINTER(real), real)(address or 0)

    def call(state: FloatArray, u: float) -> FloatArray:
        memory = (real * (states + MAX_STATES))(*state, *[math.nan] * MAX_STATES)
        answer = compiled_step(memory, u)
        after = np.array([*memory[:states], answer])
        if not (np.isfinite(after).all() and np.isnan(memory[states:]).all()):
            raise ParameterError(
                f"the C function uses more than {states} states, or its answer is not finite: "
                "must keep to its states"
            )
        return after

    return call


def _tick(tick_s: object) -> float:
    if not (_is_number(tick_s) and 0.0 < cast(float, tick_s) < math.inf):
        raise ParameterError(f"tick_s = {tick_s!r}: must be one finite number of seconds above 0")
    return float(cast(float, tick_s))


def _of_roots(
    g: ZeroPoleGain,
    tick_s: float,
    precision: Precision,
    given: ZeroPoleGain | Polynomials | StateSpace,
    origin: float = 1.0,
) -> Filter:
    if g.order > 2 * MAX_SECTIONS:
        raise ParameterError(f"a filter of order {g.order}: must be {2 * MAX_SECTIONS} or less")
    zeros, poles = ([root - origin for root in roots] for roots in (g.zeros, g.poles))
    sections = _spread(from_delta_zpk(zeros, poles, g.gain, _tick(tick_s)))
    return _of_coefficients(sections, precision, [given])


def _of_coefficients(
    sections: Sections,
    precision: Precision,
    given: Sequence[ZeroPoleGain | Polynomials | StateSpace],
) -> Filter:
    made = Filter(sections, None, None, precision, given)
    radius = float(np.abs(made.poles).max(initial=0.0))
    if radius > 1.0 + 1e-6:  # roots on the circle are found within rounding
        raise ParameterError(
            f"a pole at |z| = {radius:.6g}: unstable; must be inside the unit circle "
            "(from_cmsis has the other sign of a1 and a2)"
        )
    return made


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.floating) and not isinstance(value, bool)


def _require_precision(precision: object) -> None:
    if not (isinstance(precision, str) and precision in ("float64", "float32")):
        raise ParameterError(f"precision = {precision!r}: must be float64 or float32")


@compiled
def _run(
    cascades: Records[biquad.Constants], states: Records[biquad.State], u: FloatArray, y: FloatArray
) -> None:
    for k in range(len(u)):
        y[k] = biquad.advance(cascades[0], states[0], u[k])


def _stored(coefficients: FloatArray, precision: Precision) -> FloatArray:
    """The coefficients in ``precision``; ``ParameterError`` for a coefficient out of range."""
    with np.errstate(over="ignore", under="ignore"):
        stored = coefficients.astype(precision)
    least = np.finfo(precision).tiny
    lost = ~np.isfinite(stored) | ((np.abs(stored) < least) & (coefficients != 0.0))
    if lost.any():
        raise ParameterError(
            f"a coefficient of {coefficients[lost][0]:.3g} is outside the range of {precision}: "
            "poles must be faster or the tick longer"
        )
    return cast(FloatArray, stored)


def _spread(sections: Sections) -> Sections:
    """The same filter with gains of the same size in all sections, by powers of two."""
    poles = np.angle(sections.poles)
    delta = _on_circle(np.array([*poles[poles > 0.0], 1e-9, math.pi / 2.0, math.pi]))
    exponents = []
    for row in sections.coefficients:
        with np.errstate(divide="ignore", invalid="ignore"):  # a pole on the circle
            size = np.abs(Sections(row[None].copy(), sections.tick_s).at_delta(delta)).max()
        exponents.append(int(np.frexp(size)[1]) if np.isfinite(size) else 0)
    share, left = divmod(sum(exponents), len(exponents))
    coefficients = sections.coefficients.copy()
    for i, exponent in enumerate(exponents):
        coefficients[i, :3] = np.ldexp(coefficients[i, :3], share + (i < left) - exponent)
    return Sections(coefficients, sections.tick_s)


def _on_circle(angles: FloatArray) -> ComplexArray:
    """e^{jθ} - 1 at θ in radians, any shape, with all digits near θ = 0."""
    half = 0.5 * angles
    return np.asarray(2j * np.sin(half) * np.exp(1j * half))


def _fraction(row: FloatArray) -> tuple[Sequence[float], Sequence[float]]:
    """Numerator and denominator in δ, without the δ/δ of a section of lower order."""
    above, below = [float(b) for b in row[:3]], [1.0, *(float(a) for a in row[3:])]
    while above[-1] == 0.0 and below[-1] == 0.0:
        del above[-1], below[-1]
    return above, below


def _lowest(polynomial: Sequence[float]) -> tuple[float, float]:
    """The coefficient of the lowest non-zero power of δ, and the power; for zero, 0 and ∞."""
    for power, coefficient in enumerate(reversed(polynomial)):
        if coefficient != 0.0:
            return coefficient, power
    return 0.0, math.inf
