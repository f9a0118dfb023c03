"""The assertions hold of right filters, and fail of wrong ones by what they say."""

import ctypes
import math
import subprocess
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

from firmware_model import Filter, discretise, testing
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.rounding import run_error
from firmware_model.discretisation.sections import Sections
from firmware_model.errors import DesignError, ParameterError
from firmware_model.law.core import biquad

TICK_S = 1e-3
BUTTERWORTH = signal.ZerosPolesGain(*signal.butter(4, 300.0, analog=True, output="zpk"))
COEFFICIENTS = ([3.0, 30.0], [1.0, 14.0, 140.0, 400.0])
LEAD = ([1.0, 5.0], [1.0, 500.0])
RULES: list[Any] = ["tustin", "tustin-held", "zoh"]


def changed(made: Filter, section: int, coefficient: int, factor: float) -> Filter:
    coefficients = made.sections.coefficients.copy()
    coefficients[section, coefficient] *= factor
    return Filter(
        Sections(coefficients, made.tick_s), made.rule, made.prewarp_rad_per_s, made.precision
    )


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("system", [BUTTERWORTH, BUTTERWORTH.to_ss(), COEFFICIENTS])
def test_they_hold(system, rule, precision):
    made = discretise(system, TICK_S, rule, precision=precision)
    testing.assert_follows(made, system, tick_s=TICK_S, rule=rule)
    testing.assert_follows(made, system, [1.0, 30.0, 300.0], tick_s=TICK_S, rule=rule, within=1e-4)
    testing.assert_dc_gain(made, system)
    testing.assert_stable(made, margin=1e-3)
    testing.assert_step(made, system, within=0.02)
    testing.assert_float32_follows(made)
    testing.assert_bit_identical(made, np.linspace(-1.0, 1.0, 300))


def test_they_hold_of_feedthrough_and_prewarp_and_a_constant():
    made = discretise(LEAD, TICK_S, prewarp_rad_per_s=50.0)
    testing.assert_follows(made, LEAD, tick_s=TICK_S, rule="tustin", prewarp_rad_per_s=50.0)
    testing.assert_dc_gain(made, 0.01)
    testing.assert_step(made, LEAD, within=0.03)
    constant = discretise(([2.0], [1.0]), TICK_S)
    testing.assert_step(constant, ([2.0], [1.0]), within=1e-15)
    testing.assert_stable(constant)
    testing.assert_follows(constant, control.ss([], [], [], 2.0), tick_s=TICK_S, rule="tustin")
    nothing = ([0.0], [1.0, 2.0])
    testing.assert_follows(discretise(nothing, TICK_S), nothing, tick_s=TICK_S, rule="tustin")
    testing.assert_dc_gain(discretise(([1.0], [1.0, 0.0]), TICK_S), ([1.0], [1.0, 0.0]))
    testing.assert_dc_gain(discretise(LEAD, TICK_S), 0.0101, within=0.02)


@pytest.mark.parametrize("system", [BUTTERWORTH, LEAD])
def test_the_step_of_a_held_input_is_exact(system):
    held = discretise(system, TICK_S, "zoh")
    testing.assert_step(held, system, within=1e-12)
    testing.assert_follows(held, system, tick_s=TICK_S, rule="zoh")
    testing.assert_dc_gain(held, system)


def test_theory_without_digits_says_nothing():
    """1e20 less 1e20 leaves no digit of the theory."""
    lost = signal.StateSpace([[-1.0]], [[1e10]], [[-1e10]], [[1e20]])
    testing.assert_follows(
        discretise(([1.0], [1.0]), TICK_S), lost, [1e-40], tick_s=TICK_S, rule="tustin"
    )


@pytest.mark.every_case
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("coefficient", range(5))
def test_a_coefficient_that_is_off_is_seen(rule, coefficient):
    made = discretise(COEFFICIENTS, TICK_S, rule)
    section = int(np.argmax(made.sections.coefficients[:, coefficient] != 0.0))
    wrong = changed(made, section, coefficient, 1.0 + (0.1 if rule == "zoh" else 1e-9))
    if wrong.sections.coefficients[section, coefficient] == 0.0:
        pytest.skip("the rule has no such coefficient")
    with pytest.raises(AssertionError, match=r"rad/s the response is .* theory .* allowed"):
        testing.assert_follows(wrong, COEFFICIENTS, tick_s=TICK_S, rule=rule)


def test_another_filter_is_seen():
    made = discretise(BUTTERWORTH, TICK_S)
    other = signal.ZerosPolesGain(*signal.butter(4, 310.0, analog=True, output="zpk"))
    with pytest.raises(AssertionError, match=r"at 300 rad/s the response is"):
        testing.assert_follows(made, other, 300.0, tick_s=TICK_S, rule="tustin", within=1e-2)
    with pytest.raises(AssertionError, match=r"at tick \d+ the step response is .* theory"):
        testing.assert_step(made, other)
    with pytest.raises(AssertionError, match=r"DC gain 1, theory 1\.01: off by 0\.01"):
        testing.assert_dc_gain(made, 1.01)
    with pytest.raises(AssertionError, match="DC gain inf, theory 1"):
        testing.assert_dc_gain(discretise(([1.0], [1.0, 0.0]), TICK_S), 1.0)


@pytest.mark.parametrize(("pole", "margin"), [(0.0, 0.0), (1.0, 0.0), (-1.0, 0.01), (-1e-13, 0.0)])
def test_stability_is_by_the_stored_coefficients(pole, margin):
    made = discretise(ZeroPoleGain((), (pole,), 1.0), TICK_S)
    if margin or pole >= 0.0:
        with pytest.raises(AssertionError, match=r"a pole at \|z\| = .*: must be inside"):
            testing.assert_stable(made, margin=margin)
    else:
        testing.assert_stable(made)  # 1 - 1e-16, which z alone cannot tell from 1


MEANT: Any = {"tick_s": TICK_S, "rule": "tustin"}
MADE = discretise(([1.0], [0.1, 1.0]), TICK_S)
REFUSED: dict[str, tuple[Any, str]] = {
    "filter and system exchanged": (
        lambda: testing.assert_follows(([1.0], [1.0, 1.0]), MADE, **MEANT),  # type: ignore[arg-type]
        "filter must be a Filter, of discretise or Filter.from_…; not tuple",
    ),
    "beyond Nyquist": (
        lambda: testing.assert_follows(MADE, ([1.0], [0.1, 1.0]), [1.0, math.pi / TICK_S], **MEANT),
        "rad_per_s = .*below the Nyquist frequency, 3141.59 rad/s",
    ),
    "no tick": (
        lambda: testing.assert_follows(MADE, LEAD, tick_s=0.0, rule="tustin"),
        "tick_s = 0.0: must be one finite number",
    ),
    "no rule": (
        lambda: testing.assert_follows(MADE, LEAD, tick_s=TICK_S, rule="foh"),  # type: ignore[arg-type]
        "rule = 'foh': must be one of tustin",
    ),
    "below 0": (
        lambda: testing.assert_follows(MADE, ([1.0], [0.1, 1.0]), -1.0, **MEANT),
        "at least 0",
    ),
    "no frequency": (
        lambda: testing.assert_follows(MADE, ([1.0], [0.1, 1.0]), [], **MEANT),
        "one row of f",
    ),
    "no ticks": (
        lambda: testing.assert_step(MADE, ([1.0], [0.1, 1.0]), ticks=0),
        "ticks = 0: must be a whole number of at least 1",
    ),
    "a margin outside the circle": (
        lambda: testing.assert_stable(MADE, margin=2.0),
        "margin = 2.0: must be 0 or above, below 1",
    ),
    "no samples": (lambda: testing.assert_float32_follows(MADE, []), r"u has shape \(0,\): must"),
    "letters": (lambda: testing.assert_bit_identical(MADE, "abc"), "must be one row of real"),  # type: ignore[arg-type]
}


@pytest.mark.every_case
@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_compared_is_refused_in_one_line(kind):
    asked, message = REFUSED[kind]
    with pytest.raises(ParameterError, match=message):
        asked()


def test_a_number_of_any_library_is_a_gain():
    for one in (1, 1.0, np.float32(1.0), np.int64(1)):
        testing.assert_dc_gain(MADE, one)


def test_float32_that_computes_less_exactly_than_it_could_is_seen(monkeypatch):
    """With half of the digits of float32 the same filter is outside its bound."""
    made = discretise(([1.0], [0.001, 1.0]), TICK_S)
    run = Filter.run

    def coarse(self: Filter, u: Any) -> Any:
        answer = run(self, u)
        return (
            answer.astype(np.float16).astype(np.float32) if self.precision == "float32" else answer
        )

    testing.assert_float32_follows(made, np.ones(100))
    monkeypatch.setattr(Filter, "run", coarse)
    with pytest.raises(AssertionError, match=r"float32 is off by .*, its coefficients allow"):
        testing.assert_float32_follows(made, np.ones(100))


def test_a_bit_that_differs_is_seen(monkeypatch):
    made = discretise(BUTTERWORTH, TICK_S)
    run = Filter.run
    monkeypatch.setattr(Filter, "run", lambda self, u: np.nextafter(run(self, u), math.inf))
    with pytest.raises(AssertionError, match=r"at tick 0 compiled answers .*, interpreted"):
        testing.assert_bit_identical(made)


def test_the_bound_of_a_run_is_that_of_the_worst_input():
    """One section, y[k] = s: by hand, the rounding of each tick's state decays by 1 + α1."""
    alpha = -0.5
    sections = Sections(np.array([[0.0, 1.0, 0.0, -alpha, 0.0]]), TICK_S)
    decay = 1.0 / -alpha  # Σ|impulse response| of the state, and of the output
    at_y, at_1 = decay, 4.0 * (1.0 + 0.5 * decay) + decay
    by_hand = 2.0**-24 * (at_y * (1.0 + 0.5 * decay) + at_1 * decay)
    assert run_error(sections, 1000) == pytest.approx(by_hand, rel=1e-12)
    assert run_error(sections, 1000, "float64") == pytest.approx(by_hand * 2.0**-29, rel=1e-12)


def test_interpreted_is_interpreted():
    state = biquad.at_rest("float32")
    made = discretise(BUTTERWORTH, TICK_S, precision="float32")
    step = getattr(biquad.advance, "py_func", biquad.advance)
    assert type(step(made.cascade, state, np.float32(1.0))) is np.float32


def test_another_constant_gain_is_seen_at_0_rad_per_s():
    low_pass, high_pass = ([100.0], [1.0, 100.0]), ([1.0, 0.0], [1.0, 100.0])
    made = discretise(low_pass, TICK_S)
    testing.assert_follows(made, low_pass, [0.0, 10.0], **MEANT)
    with pytest.raises(AssertionError, match=r"at 0 rad/s the response is 1.*theory 0.5"):
        testing.assert_follows(made, ([50.0], [1.0, 100.0]), 0.0, **MEANT)
    with pytest.raises(ParameterError, match=r"rad_per_s = 0: a response of 0 has no .*dc_gain"):
        testing.assert_follows(made, high_pass, 0.0, **MEANT)
    with pytest.raises(ParameterError, match="rad_per_s = 0: a response of inf has no"):
        testing.assert_follows(made, ([1.0], [1.0, 0.0]), 0.0, **MEANT)


def test_matrices_that_integrate_have_an_infinite_gain():
    made = Filter.from_state_space([[1.0]], [[1.0]], [[1.0]], 0.0, tick_s=1.0)
    testing.assert_dc_gain(made, ([1.0], [1.0, 0.0]))
    with pytest.raises(AssertionError, match="DC gain inf, theory 1"):
        testing.assert_dc_gain(made, 1.0)


def test_a_step_that_overflows_is_no_reference():
    grows = ([1.0], [1.0, -1000.0])
    with pytest.raises(ParameterError, match=r"ticks = 1000: .* overflows; must be fewer ticks"):
        testing.assert_step(discretise(LEAD, TICK_S), grows)
    testing.assert_step(discretise(grows, TICK_S, "zoh"), grows, ticks=100)


def test_another_tick_and_another_rule_are_seen():
    low_pass = ([100.0], [1.0, 100.0])
    with pytest.raises(AssertionError, match=r"a tick of 0.1 s: 0.001 s is meant"):
        testing.assert_follows(discretise(low_pass, 0.1), low_pass, **MEANT)
    with pytest.raises(AssertionError, match=r"a tick of 0.00100000004.* s: 0.001 s is meant"):
        testing.assert_follows(discretise(low_pass, np.float32(TICK_S)), low_pass, **MEANT)
    with pytest.raises(AssertionError, match="the filter is by zoh: tustin is meant"):
        testing.assert_follows(discretise(low_pass, TICK_S, "zoh"), low_pass, **MEANT)


def in_every_form(zpk: Any) -> list[Filter]:
    """What scipy calculates, through each of the ways in."""
    sos, (a, b, c, d) = signal.zpk2sos(*zpk), signal.zpk2ss(*zpk)
    stages = np.column_stack([sos[:, :3], -sos[:, 4:]])
    return [
        Filter.from_sos(sos, tick_s=TICK_S),
        Filter.from_sos(2.0 * sos, gain=[2.0, 0.5], tick_s=TICK_S),
        Filter.from_cmsis(stages.ravel(), tick_s=TICK_S),
        Filter.from_ba(*signal.zpk2tf(*zpk), tick_s=TICK_S),
        Filter.from_zpk(*zpk, tick_s=TICK_S),
        Filter.from_state_space(a, b, c, d, tick_s=TICK_S),
    ]


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_coefficients_of_scipy_follow_theory_and_other_ticks_and_rules_do_not(order):
    analog = signal.butter(order, 300.0, analog=True, output="zpk")
    system = signal.ZerosPolesGain(*analog)
    for made in in_every_form(signal.bilinear_zpk(*analog, fs=1.0 / TICK_S)):
        testing.assert_follows(made, system, **MEANT)
        testing.assert_stable(made)
        with pytest.raises(AssertionError, match="theory"):
            testing.assert_follows(made, system, tick_s=TICK_S, rule="zoh")
    for made in in_every_form(signal.bilinear_zpk(*analog, fs=2.0 / TICK_S)):
        with pytest.raises(AssertionError, match="theory"):
            testing.assert_follows(made, system, **MEANT)


def test_a_run_from_coefficients_is_scipys():
    zpk = signal.butter(3, 0.1, output="zpk")
    u = np.random.default_rng(5).standard_normal(300)
    expected = signal.sosfilt(signal.zpk2sos(*zpk), u)
    for made in in_every_form(zpk):
        within = 1e-5 if made.precision == "float32" else 1e-12
        np.testing.assert_allclose(made.run(u), expected, atol=within)
    fir = Filter.from_ba([0.25, 0.5, 0.25], [1.0], tick_s=TICK_S)
    np.testing.assert_allclose(fir.run(u), signal.lfilter([0.25, 0.5, 0.25], 1.0, u), atol=1e-14)


SECTION = [1.0, 0.0, 0.0, 1.0, -0.5, 0.0]
REFUSED_COEFFICIENTS: dict[str, tuple[Any, str]] = {
    "one row": (lambda: Filter.from_sos(SECTION, tick_s=1.0), r"shape \(6,\): must be \(n, 6\)"),
    "NaN": (lambda: Filter.from_ba([math.nan], [1.0], tick_s=1.0), "b: every number must be real"),
    "no tick": (lambda: Filter.from_sos([SECTION], tick_s=0.0), "tick_s = 0.0: must be one finite"),
    "a row": (lambda: Filter.from_ba([[1.0]], [1.0], tick_s=1.0), "must be one row"),
    "ragged": (lambda: Filter.from_sos([SECTION, [1.0]], tick_s=1.0), "rows of different lengths"),
    "order": (lambda: Filter.from_zpk([], [0.5] * 17, 1.0, tick_s=1.0), "a filter of order 17"),
    "a0": (lambda: Filter.from_sos([[1, 0, 0, 0, 1, 0]], tick_s=1.0), "a0 = 0 is improper"),
    "a[0]": (lambda: Filter.from_ba([1.0], [0.0, 1.0], tick_s=1.0), r"a\[0\] = 0: improper"),
    "unstable": (lambda: Filter.from_cmsis([1.0, 0.0, 0.0, -1.5, 0.0], tick_s=1.0),
                 r"a pole at \|z\| = 1.5: unstable"),
    "six a stage": (lambda: Filter.from_cmsis(SECTION, tick_s=1.0), "6 coefficients: must be 5 a"),
    "improper": (lambda: Filter.from_zpk([0.1, 0.2], [0.5], 1.0, tick_s=1.0), "future input"),
    "no conjugate": (lambda: Filter.from_zpk([], [0.5j], 1.0, tick_s=1.0), "conjugate is missing"),
    "matrices": (lambda: Filter.from_state_space([[0.5]], [[1.0, 2.0]], [[1.0]], 0.0, tick_s=1.0),
                 "a, b, c, d have shapes"),
}  # fmt: skip


@pytest.mark.every_case
@pytest.mark.parametrize("kind", REFUSED_COEFFICIENTS)
def test_wrong_coefficients_are_refused_in_one_line(kind):
    asked, message = REFUSED_COEFFICIENTS[kind]
    with pytest.raises(DesignError, match=message):
        asked()


C_FILTERS = """
/* CMSIS-DSP's direct form I of two stages, and what from_c must refuse */
float df1(float *s, float u) {
    static const float k[2][5] = {{%s}, {%s}};
    for (int i = 0; i < 2; i++, s += 4) {
        float y = k[i][0]*u + k[i][1]*s[0] + k[i][2]*s[1] + k[i][3]*s[2] + k[i][4]*s[3];
        s[1] = s[0]; s[0] = u; s[3] = s[2]; s[2] = y;
        u = y;
    }
    return u;
}
double low_pass(double *s, double u) { return s[0] = 19.0/21.0*s[0] + u*(2.0/21.0); }
float limited(float *s, float u) { s[0] = 0.5f*s[0] + u; return s[0] > 100.0f ? 100.0f : s[0]; }
float hidden(float *s, float u) { static float x; x = 0.5f*x + u; return x + 0.0f*s[0]; }
"""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    """Filters in C, compiled as their author would; the Butterworth filter in float."""
    folder = tmp_path_factory.mktemp("c")
    sos = signal.zpk2sos(*signal.bilinear_zpk(*OF_FOUR, fs=1.0 / TICK_S))
    rows = (", ".join(f"{k:.9e}f" for k in (*row[:3], *-row[4:])) for row in sos)
    (folder / "filters.c").write_text(C_FILTERS % tuple(rows))
    command = ["cc", "-shared", "-fPIC", "-O2", "-o", "filters.so", "filters.c"]
    subprocess.run(command, cwd=folder, check=True)
    return ctypes.CDLL(str(folder / "filters.so"))


OF_FOUR = signal.butter(4, 300.0, analog=True, output="zpk")


def test_a_c_function_is_the_filter_that_it_should_be(library):
    of_four = signal.ZerosPolesGain(*OF_FOUR)
    made = Filter.from_c(library.df1, states=8, tick_s=TICK_S)
    testing.assert_follows(made, of_four, **MEANT)
    for wrong in ({"tick_s": TICK_S, "rule": "zoh"}, {"tick_s": 0.1, "rule": "tustin"}):
        with pytest.raises(AssertionError, match=r"theory|meant"):
            testing.assert_follows(made, of_four, **wrong)
    low_pass = Filter.from_c(library.low_pass, states=1, tick_s=TICK_S, precision="float64")
    expected = signal.lfilter([2 / 21], [1.0, -19 / 21], np.ones(50))
    np.testing.assert_allclose(low_pass.run(np.ones(50)), expected, atol=1e-14)


def test_coefficients_of_cmsis_are_the_filter_that_cmsis_runs():
    """The signs of a1 and a2 as CMSIS-DSP's own code takes them."""
    dsp = pytest.importorskip("cmsisdsp")
    sos = signal.zpk2sos(*signal.bilinear_zpk(*OF_FOUR, fs=1.0 / TICK_S))
    stages = np.column_stack([sos[:, :3], -sos[:, 4:]]).astype(np.float32)
    cascade = dsp.arm_biquad_cascade_df2T_instance_f32()
    dsp.arm_biquad_cascade_df2T_init_f32(cascade, len(sos), stages.ravel(), np.zeros(2 * len(sos)))
    u = np.random.default_rng(3).standard_normal(500).astype(np.float32)
    made = Filter.from_cmsis(stages, tick_s=TICK_S)
    np.testing.assert_allclose(made.run(u), dsp.arm_biquad_cascade_df2T_f32(cascade, u), atol=1e-5)


C_REFUSED = {
    "low_pass of double": ("low_pass", 1, "not finite|not linear"),
    "limited": ("limited", 1, "not linear in its 1 states .*tried at 1000"),
    "hidden": ("hidden", 1, "has a state elsewhere"),
    "more states": ("df1", 7, "more than 7 states"),
    "no state": ("df1", 0, "states = 0: must be a whole number, 1 to 64"),
}


@pytest.mark.every_case
@pytest.mark.parametrize("kind", C_REFUSED)
def test_a_c_function_that_is_no_filter_is_refused(library, kind):
    name, states, message = C_REFUSED[kind]
    with pytest.raises(DesignError, match=message):
        Filter.from_c(getattr(library, name), states=states, tick_s=TICK_S)


@pytest.mark.parametrize("function", [abs, None, b"step"])
def test_a_function_of_python_is_no_c_function(function):
    with pytest.raises(ParameterError, match=r"function is a .*: must be a function of a library"):
        Filter.from_c(function, states=1, tick_s=TICK_S)


@pytest.mark.parametrize("within", [math.nan, math.inf, -1e-3])
def test_a_deviation_that_allows_everything_or_nothing_is_refused(within):
    other, made = ([90.0], [1.0, 100.0]), discretise(([100.0], [1.0, 100.0]), TICK_S)
    for compare in (
        lambda: testing.assert_follows(made, other, tick_s=TICK_S, rule="tustin", within=within),
        lambda: testing.assert_dc_gain(made, other, within=within),
        lambda: testing.assert_step(made, other, within=within),
    ):
        with pytest.raises(ParameterError, match=r"within = .*: must be 0 or above, and finite"):
            compare()


def test_a_bound_of_its_own_sees_what_one_for_all_let_pass():
    """A coefficient 1e-7 off in a zero-order hold of order 4: 1e-5 of the largest passed."""
    made = changed(discretise(BUTTERWORTH, TICK_S, "zoh"), 0, 1, 1.0 + 1e-7)
    with pytest.raises(AssertionError, match="theory"):
        testing.assert_follows(made, BUTTERWORTH, tick_s=TICK_S, rule="zoh")


def test_the_step_of_coefficients_needs_the_rule():
    of = BUTTERWORTH.to_ss()
    a, b, c, d, _ = signal.cont2discrete((of.A, of.B, of.C, of.D), TICK_S, "zoh")
    made = Filter.from_state_space(a, b, c, d, tick_s=TICK_S)
    testing.assert_step(made, BUTTERWORTH, rule="zoh", within=1e-9)
    testing.assert_follows(made, BUTTERWORTH, tick_s=TICK_S, rule="zoh")
    testing.assert_dc_gain(made, BUTTERWORTH)
    with pytest.raises(ParameterError, match="a filter from coefficients has no rule"):
        testing.assert_step(made, BUTTERWORTH)
