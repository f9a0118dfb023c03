"""The assertions: response, DC gain, step, stability, precision, bit identity."""

from __future__ import annotations

import math
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation import rounding
from firmware_model.discretisation.filters import Filter
from firmware_model.discretisation.held_input import response, sampled
from firmware_model.discretisation.rules import RULE_NAMES, Rule
from firmware_model.discretisation.sections import ComplexArray
from firmware_model.discretisation.systems import continuous, zero_pole_gain
from firmware_model.discretisation.tustin import image_of_infinity
from firmware_model.errors import ParameterError
from firmware_model.law.core import biquad
from firmware_model.law.structs import FloatArray

ROUNDINGS = 16
"""Roundings of each number on its way from the continuous filter to its section: more than any."""

ROUNDINGS_HELD = 256
"""The same for sampled state spaces, and for roots of coefficients in z."""

OF_ZOH = 1e-5
"""Error of any zero-order hold's zeros, as a share of the largest response."""

NOISE_TICKS = 4096


def assert_follows(
    filter: Filter,
    system: object,
    rad_per_s: ArrayLike | None = None,
    *,
    tick_s: float,
    rule: Rule,
    prewarp_rad_per_s: float | None = None,
    within: float | None = None,
) -> None:
    """Assert the tick, the rule and the rule's theoretical frequency response.

    ``tustin``: H(e^{jωT}) = G(j(2/T) tan(ωT/2)), with prewarp a factor that keeps the prewarp
    frequency replaces 2/T; ``tustin-held``: 2/(z + 1) times the ``tustin`` response; ``zoh``: the
    response of the sampled state space.

    Args:
        filter: the filter, of ``discretise`` or of ``Filter.from_…``.
        system: the continuous filter, in any form of ``discretise``.
        tick_s: the sampling period that is meant, seconds.
        rule: the discretisation that is meant.
        prewarp_rad_per_s: the frequency at which ``tustin`` is meant to keep the response.
        rad_per_s: frequencies below π/T, shape (m,); left out: 200 up to 0.95 of that.
        within: relative error that is allowed; left out: a bound from the coefficients.
    """
    _require_filter(filter, within)
    if rule not in RULE_NAMES:
        raise ParameterError(f"rule = {rule!r}: must be one of {', '.join(RULE_NAMES)}")
    if not isinstance(tick_s, Real) or not 0.0 < tick_s < math.inf:
        raise ParameterError(f"tick_s = {tick_s!r}: must be one finite number of seconds above 0")
    assert math.isclose(filter.tick_s, tick_s, rel_tol=1e-12), (
        f"the filter has a tick of {filter.tick_s:.12g} s: {tick_s:.12g} s is meant"
    )
    assert filter.rule in (None, rule), f"the filter is by {filter.rule}: {rule} is meant"
    omega = _grid(filter) if rad_per_s is None else _below_nyquist(rad_per_s, filter.tick_s)
    if not omega.all() and (gain := zero_pole_gain(system).dc_gain) in (0.0, math.inf, -math.inf):
        raise ParameterError(
            f"rad_per_s = 0: a response of {gain:g} has no relative deviation; must be above 0 "
            "(assert_dc_gain compares that response)"
        )
    theory, of_theory = _theory(system, omega, tick_s, rule, prewarp_rad_per_s)
    angle = omega * filter.tick_s
    answer = filter.frequency_response(omega)
    if within is None:
        unit = rounding.ROUNDING
        conditioning = of_theory
        of_sections = rounding.of_sections(
            filter.sections, 2j * np.sin(angle / 2.0) * np.exp(0.5j * angle)
        )
        for factor in filter.given:
            of_roots = rounding.of_system(factor, np.exp(1j * angle))
            conditioning = conditioning + ROUNDINGS_HELD / ROUNDINGS * of_roots
            of_sections = of_sections + rounding.of_coefficients(factor, np.exp(1j * angle))
        share = unit["float64"] * conditioning + unit[filter.precision] * of_sections
        allowed = ROUNDINGS * share / np.sinc(angle / math.pi) * np.abs(theory)
        if rule == "zoh":
            allowed += _of_zoh(zero_pole_gain(system), tick_s, angle, theory, of_theory)
        allowed = np.where(np.isnan(allowed), np.inf, allowed)  # theory has lost every digit
    else:
        allowed = within * np.abs(theory)
    error = np.abs(answer - theory)
    worst = int(np.argmax(error - allowed))
    assert error[worst] <= allowed[worst], (
        f"at {omega[worst]:.6g} rad/s the response is {answer[worst]:.6g}, theory "
        f"{theory[worst]:.6g}: off by {error[worst]:.3g}, allowed {allowed[worst]:.3g}"
    )


def _theory(
    system: object, omega: FloatArray, tick_s: float, rule: Rule, prewarp_rad_per_s: float | None
) -> tuple[ComplexArray, FloatArray]:
    """The theoretical response of ``system`` at ``omega`` under the rule, and the conditioning."""
    half = 0.5 * omega * tick_s
    given = continuous(system)
    if rule == "zoh":
        g = zero_pole_gain(given)
        delta = 2j * np.sin(half) * np.exp(1j * half)
        theory = response(sampled(g, tick_s), delta) + g.feedthrough
        return theory, rounding.of_system(given, 1j * omega.astype(np.complex128))
    s = 1j * image_of_infinity(tick_s, prewarp_rad_per_s) * np.tan(half)
    theory, conditioning = given(s), rounding.of_system(given, s)
    if rule == "tustin-held":
        theory = theory / (np.cos(half) * np.exp(1j * half))  # (z + 1)/2
    return theory, conditioning


def _of_zoh(
    g: ZeroPoleGain,
    tick_s: float,
    angle: FloatArray,
    theory: ComplexArray,
    conditioning: FloatArray,
) -> FloatArray:
    """Errors of the roots of ``g``, the state space and the zeros, to the floor of the solver."""
    delta = 2j * np.sin(angle / 2.0) * np.exp(0.5j * angle)
    floor = (np.abs(theory) * np.fmax(1.0, conditioning)).max()
    held = rounding.of_held(g, tick_s, delta) + floor
    return np.asarray(ROUNDINGS_HELD * rounding.ROUNDING["float64"] * held)


def assert_dc_gain(
    filter: Filter, expected: float | object, *, within: float | None = None
) -> None:
    """Assert the gain for a constant input.

    A bare number does not say how well the zeros of a zero-order hold are known: ``OF_ZOH`` of the
    largest response is allowed there.

    Args:
        filter: the filter, of ``discretise`` or of ``Filter.from_…``.
        expected: the gain, or a continuous filter with the gain.
        within: relative error that is allowed; left out: a bound from the number of sections.
    """
    _require_filter(filter, within)
    gain = float(expected) if isinstance(expected, Real) else zero_pole_gain(expected).dc_gain
    if within is None:
        roundings: float = ROUNDINGS * 2 * len(filter.sections.coefficients)
        for factor in filter.given:
            try:
                with np.errstate(all="ignore"):
                    moved = rounding.of_coefficients(factor, np.ones(1, complex)).item()
            except np.linalg.LinAlgError:  # a pole at z = 1: no bound
                moved = math.inf
            roundings += ROUNDINGS * moved
        allowed = roundings * rounding.ROUNDING[filter.precision] * abs(gain)
        if filter.rule == "zoh":
            allowed += OF_ZOH * float(np.abs(filter.frequency_response(_grid(filter))).max())
    else:
        allowed = within * abs(gain)
    answer = filter.dc_gain
    assert answer == gain or abs(answer - gain) <= allowed < math.inf, (
        f"DC gain {answer:.9g}, theory {gain:.9g}: off by {abs(answer - gain):.3g}, "
        f"allowed {allowed:.3g}"
    )


def assert_stable(filter: Filter, *, margin: float = 0.0) -> None:
    """Every pole lies inside the circle of radius ``1 - margin``, by the stored coefficients."""
    _require_filter(filter)
    if not 0.0 <= margin < 1.0:
        raise ParameterError(f"margin = {margin}: must be 0 or above, below 1")
    radius = float(np.abs(filter.poles).max(initial=0.0))
    inside = filter.is_stable and radius <= 1.0 - margin
    assert inside, f"a pole at |z| = {radius:.9g}: must be inside {1.0 - margin:.9g}"


def assert_step(
    filter: Filter,
    system: object,
    *,
    rule: Rule | None = None,
    ticks: int = 1000,
    within: float = 0.01,
) -> None:
    """Assert the step response from rest against the exact solution of the continuous filter.

    A held input steps at the first tick, and ``zoh`` answers exactly; Tustin's ramps up over the
    tick before, so the exact answer half a tick later is the reference.

    Args:
        filter: the filter, of ``discretise`` or of ``Filter.from_…``.
        system: the continuous filter, in any form of ``discretise``.
        rule: the discretisation that is meant; left out: the filter's own.
        ticks: duration.
        within: error that is allowed, as a share of the largest answer.
    """
    _require_filter(filter, within)
    if not isinstance(ticks, Integral) or ticks < 1:
        raise ParameterError(f"ticks = {ticks!r}: must be a whole number of at least 1")
    if rule is None and filter.rule is None:
        raise ParameterError("a filter from coefficients has no rule: state rule=")
    g = zero_pole_gain(system)
    with np.errstate(over="ignore", invalid="ignore"):
        theory = _step_of(g, filter.tick_s, ticks, late=(rule or filter.rule) == "tustin")
    if not np.isfinite(theory).all():
        raise ParameterError(f"ticks = {ticks}: the unstable system overflows; must be fewer ticks")
    answer = filter.in_precision(filter.precision).run(np.ones(ticks))
    error, allowed = np.abs(answer - theory), within * np.abs(theory).max()
    worst = int(np.argmax(error))
    assert error[worst] <= allowed, (
        f"at tick {worst} the step response is {answer[worst]:.6g}, theory {theory[worst]:.6g}: "
        f"off by {error[worst]:.3g}, allowed {allowed:.3g}"
    )


def _step_of(g: ZeroPoleGain, tick_s: float, ticks: int, late: bool) -> FloatArray:
    """The continuous step response at every tick, or half a tick after each."""
    a, b, c = sampled(g, tick_s / 2.0 if late else tick_s)
    x, answers = np.zeros_like(b), []
    for _ in range(2 * ticks if late else ticks):
        answers.append((c @ x).item() + g.feedthrough)
        x = x + (a @ x + b)
    return np.array(answers[1::2] if late else answers)


def assert_float32_follows(filter: Filter, u: ArrayLike | None = None) -> None:
    """From rest, the filter in float32 answers as in float64, within the bound of ``run_error``.

    Args:
        filter: the discretised filter, in either precision.
        u: samples, shape (n,), rounded to float32 for both; left out: white noise.
    """
    _require_filter(filter)
    inputs = _noise() if u is None else _samples(u).astype(np.float32)
    single = filter.in_precision("float32")
    allowed = rounding.run_error(single.sections, len(inputs)) * float(np.abs(inputs).max())
    error = np.abs(single.run(inputs) - filter.in_precision("float64").run(inputs))
    worst = int(np.argmax(error))
    assert error[worst] <= allowed, (
        f"tick {worst}: float32 is off by {error[worst]:.3g}, its coefficients allow {allowed:.3g}"
    )


def assert_bit_identical(filter: Filter, u: ArrayLike | None = None) -> None:
    """From rest, every answer has the same bits compiled and interpreted.

    Args:
        filter: the discretised filter.
        u: samples, shape (n,); left out: white noise.
    """
    _require_filter(filter)
    inputs = (_noise() if u is None else _samples(u)).astype(filter.precision)
    answers = filter.in_precision(filter.precision).run(inputs)
    interpreted = getattr(biquad.advance, "py_func", biquad.advance)
    state = biquad.at_rest(filter.precision)
    for k, sample in enumerate(inputs):
        answer = np.asarray(interpreted(filter.cascade, state, sample))
        same = answer.tobytes() == answers[k].tobytes()
        assert same, f"at tick {k} compiled answers {answers[k]!r}, interpreted {answer!r}"


def _require_filter(filter: object, within: float | None = None) -> None:
    if not isinstance(filter, Filter):
        raise ParameterError(
            f"filter must be a Filter, of discretise or Filter.from_…; not {type(filter).__name__}"
        )
    if within is not None and not 0.0 <= within < math.inf:
        raise ParameterError(f"within = {within!r}: must be 0 or above, and finite")


def _below_nyquist(rad_per_s: ArrayLike, tick_s: float) -> FloatArray:
    omega = np.atleast_1d(np.asarray(rad_per_s, np.float64))
    if omega.ndim != 1 or not omega.size or not ((omega >= 0) & (omega < math.pi / tick_s)).all():
        raise ParameterError(
            f"rad_per_s = {rad_per_s!r}: must be one row of frequencies, at least 0 and below "
            f"the Nyquist frequency, {math.pi / tick_s:g} rad/s"
        )
    return omega


def _samples(u: ArrayLike) -> FloatArray:
    samples = np.asarray(u)
    if samples.ndim != 1 or not samples.size or samples.dtype.kind not in "iufb":
        raise ParameterError(
            f"u has shape {samples.shape}: must be one row of real samples, one at least"
        )
    return samples


def _grid(filter: Filter) -> FloatArray:
    """Frequencies from far below to shortly before the Nyquist frequency, rad/s."""
    return np.geomspace(1e-5, 0.95, 200) * math.pi / filter.tick_s


def _noise() -> FloatArray:
    return np.random.default_rng(1).standard_normal(NOISE_TICKS).astype(np.float32)
