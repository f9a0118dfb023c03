"""A filter alone: its answers, its figures, and what is refused."""

import math
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

import firmware_model
from firmware_model import Filter, discretise
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tustin import RULES, by_rule, tustin
from firmware_model.errors import ImproperError, ParameterError

LOW_PASS = signal.TransferFunction([100.0], [1.0, 100.0])
BUTTERWORTH = signal.ZerosPolesGain(*signal.butter(5, 300.0, analog=True, output="zpk"))
CAR = steer_by_wire()
TICK_S = 1e-3


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("rule", RULES)
def test_it_runs_the_sections_of_the_firmware(rule, precision):
    """Up to powers of two between the sections, which change no bit of an answer."""
    made = discretise(CAR.g1, TICK_S, rule, precision=precision)
    theirs = by_rule(rule, CAR.g1, TICK_S)
    unchanged = Filter(theirs, rule, None, precision)
    u = np.random.default_rng(2).standard_normal(500)
    assert np.array_equal(made.run(u), unchanged.run(u))
    there = unchanged.sections.coefficients[:, :3] != 0.0
    factors = (
        made.sections.coefficients[:, :3][there] / unchanged.sections.coefficients[:, :3][there]
    )
    assert set(np.frexp(factors)[0].tolist()) == {0.5}
    assert made.run(u).dtype == precision


def test_a_step_is_a_run_of_one_sample():
    stepped, run = discretise(BUTTERWORTH, TICK_S), discretise(BUTTERWORTH, TICK_S)
    u = np.random.default_rng(3).standard_normal(200)
    answers = run.run(u[:77])
    answers = np.concatenate([answers, run.run(u[77:])])  # goes on where it was
    assert [stepped.step(float(x)) for x in u] == answers.tolist()


def test_float32_computes_in_float32():
    made = discretise(LOW_PASS, TICK_S, precision="float32")
    answer = made.step(1.0 / 3.0)
    assert answer == float(np.float32(answer))
    assert answer != discretise(LOW_PASS, TICK_S).step(1.0 / 3.0)
    assert made.in_precision("float64").step(1.0) == discretise(LOW_PASS, TICK_S).step(1.0)


def test_reset_settles():
    made = discretise(BUTTERWORTH, TICK_S)
    assert made.reset(2.0) == pytest.approx(2.0, rel=1e-12)
    np.testing.assert_allclose(made.run(np.full(50, 2.0)), 2.0, rtol=1e-12)
    assert made.reset() == 0.0
    assert not made.run(np.zeros(5)).any()


def test_response_and_figures_are_scipys():
    made = discretise(BUTTERWORTH, TICK_S)
    omega = np.array([[0.0, 1.0], [300.0, 3000.0]])
    _, expected = signal.sosfreqz(made.to_scipy_sos(), omega.ravel() * TICK_S)
    np.testing.assert_allclose(made.frequency_response(omega), expected.reshape(2, 2), rtol=1e-8)
    _, poles, _ = signal.sos2zpk(made.to_scipy_sos())
    np.testing.assert_allclose(
        np.sort_complex(made.poles), np.sort_complex(poles[poles != 0.0]), rtol=1e-9
    )
    assert made.order == 5
    assert made.dc_gain == pytest.approx(1.0, rel=1e-13)
    assert made.is_stable


@pytest.mark.parametrize(
    ("system", "dc_gain", "order", "stable"),
    [
        (([1.0], [1.0, 0.0]), math.inf, 1, False),  # an integrator
        (([-1.0], [1.0, 0.0]), -math.inf, 1, False),
        (([1.0], [1.0, 0.0, 0.0]), math.inf, 2, False),
        (([1.0, 0.0], [1.0, 2.0]), 0.0, 1, True),  # a differentiator behind a lag
        (([1.0, 0.0, 0.0], [1.0, 2.0, 3.0]), 0.0, 2, True),
        (([4.0], [2.0]), 2.0, 0, True),
        (([0.0], [1.0, 2.0]), 0.0, 0, True),
        (([1.0], [1.0, 0.0, 9.0]), 1.0 / 9.0, 2, False),  # undamped
        (([1.0], [1.0, -3.0]), -1.0 / 3.0, 1, False),
    ],
)
def test_what_is_special_at_zero_frequency(system, dc_gain, order, stable):
    made = discretise(system, 0.01)
    assert made.dc_gain == pytest.approx(dc_gain, rel=1e-12)
    assert (made.order, made.is_stable) == (order, stable)


def test_it_says_what_it_is():
    assert repr(discretise(LOW_PASS, TICK_S)) == (
        "<Filter of order 1, tustin, tick 0.001 s, float64: DC gain 1, largest |pole| 0.904762>"
    )
    text = repr(discretise(([2.0], [1.0]), 0.1, prewarp_rad_per_s=3.0, precision="float32"))
    assert (
        text == "<Filter of order 0, tustin prewarped at 3 rad/s, tick 0.1 s, float32: DC gain 2>"
    )


def test_a_slow_filter_of_high_order_fits_float32():
    """The gain of 1e-53 is spread over the sections; in the first alone it would be zero."""
    system = signal.ZerosPolesGain(*signal.butter(12, 100.0, analog=True, output="zpk"))
    made = discretise(system, 1e-5, precision="float32")
    assert made.dc_gain == pytest.approx(1.0, abs=1e-4)
    assert (
        Filter(tustin(ZeroPoleGain((), (-1.0,), 1.0), 1e-3), "tustin", None, "float32").order == 1
    )
    with pytest.raises(ParameterError, match="outside the range of float32"):
        discretise(ZeroPoleGain((), (-1e-18,), 1e-36), 1e-25, precision="float32")


def test_its_constants_can_only_be_read():
    made = discretise(LOW_PASS, TICK_S)
    with pytest.raises(ValueError, match="read-only"):
        made.cascade.n = 2
    with pytest.raises(ValueError, match="read-only"):
        made.cascade.coefficients[0, 0] = 2.0
    assert made.cascade.n == 1


def test_a_tick_of_any_type_is_computed_with_in_float64():
    tick_s = np.float32(TICK_S)
    made, same = discretise(BUTTERWORTH, tick_s), discretise(BUTTERWORTH, float(tick_s))  # type: ignore[arg-type]
    assert np.array_equal(made.sections.coefficients, same.sections.coefficients)


def test_the_smallest_normal_number_is_held():
    least = float(np.finfo(np.float32).tiny)
    rows = np.array([[least, 0.0, 0.0, 0.0, 0.0]])
    assert Filter(Sections(rows, TICK_S), "tustin", None, "float32").dc_gain == least
    with pytest.raises(ParameterError, match="outside the range of float32"):
        Filter(Sections(0.5 * rows, TICK_S), "tustin", None, "float32")


def test_nothing_integrated_is_nothing():
    rows = np.array([[0.0, 0.0, 0.0, -0.5, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0]])
    assert Filter(Sections(rows, TICK_S), "tustin", None, "float64").dc_gain == 0.0


SECOND = {
    "resonance": (1.0, 2e-4, 1.0),
    "integrators": (1.0, 0.0, 0.0),
    "lags": (1.0, 2400.0, 1.28e6),
}


@pytest.mark.parametrize("second", SECOND)
@pytest.mark.parametrize("num", [[1e-12], [1.0, 0.0], [1e12, 0.0, 0.0]])
def test_all_sections_have_gains_of_the_same_size(second, num):
    """The largest of each, on the circle from 1e-9 rad on, within a few powers of two."""
    den = np.polymul(np.polymul(SECOND[second], [1.0, 20.0, 1e6]), [1.0, 30.0, 9e4])
    made = discretise((num, den), TICK_S)
    angles = np.concatenate([np.geomspace(1e-9, math.pi, 500), np.abs(np.angle(made.poles))])
    delta = np.expm1(1j * angles[angles > 0.0])
    peaks = [
        np.abs(Sections(row[None].copy(), TICK_S).at_delta(delta)).max()
        for row in made.sections.coefficients
    ]
    assert len(peaks) == 3
    assert max(peaks) / min(peaks) < 8.0


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a tick of zero": ({"tick_s": 0.0}, "tick_s = 0: must be finite and above 0"),
    "several rates": ({"tick_s": [0.001, 0.01]}, "tick_s = .*must be one number of seconds"),
    "a tick in words": ({"tick_s": "1 ms"}, "tick_s = '1 ms': must be one number"),
    "a tick of true": ({"tick_s": True}, "tick_s = True: must be one number"),
    "two rules": ({"rule": ["zoh", "tustin"]}, "rule = .*must be one of"),
    "prewarp in words": ({"prewarp_rad_per_s": "3 Hz"}, "prewarp_rad_per_s = '3 Hz': must be one"),
    "another rule": ({"rule": "euler"}, "rule = 'euler': must be one of tustin, tustin-held, zoh"),
    "another precision": ({"precision": "float16"}, "precision = 'float16': must be float64 or"),
    "prewarp of a held input": ({"rule": "zoh", "prewarp_rad_per_s": 3.0},
                                "prewarp_rad_per_s with rule = zoh: must be left out"),
    "prewarp beyond Nyquist": ({"prewarp_rad_per_s": 1e4}, "below the Nyquist frequency"),
    "order 17": ({"system": ZeroPoleGain.lag(0.1, 17)}, "order 17: must be of order 16 or less"),
    "several inputs": ({"system": control.ss(-np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)))},
                       "must have one of each"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_cannot_be_is_refused_in_one_line(kind):
    changed, message = REFUSED[kind]
    with pytest.raises(ParameterError, match=message) as caught:
        discretise(**{"system": LOW_PASS, "tick_s": TICK_S, **changed})
    assert "\n" not in str(caught.value)


def test_public_names_are_offered_for_completion():
    assert {*firmware_model.__all__, "__doc__"} <= {*dir(firmware_model)}


def test_what_needs_its_future_is_refused():
    with pytest.raises(ImproperError, match="must have at least as many poles"):
        discretise(([1.0, 0.0], [1.0]), TICK_S)
    with pytest.raises(ImproperError, match="use zoh or tustin"):
        discretise(([1.0, 0.0], [1.0, 1.0]), TICK_S, "tustin-held")


@pytest.mark.parametrize("u", [1.0, [[1.0]], ["a"], [1j]])
def test_a_run_takes_one_row_of_real_samples(u):
    with pytest.raises(ParameterError, match="must be one row of real samples"):
        discretise(LOW_PASS, TICK_S).run(u)


def test_order_16_runs():
    system = ZeroPoleGain.lag(0.05, 16)
    answer = discretise(system, 0.01).run(np.ones(1000))
    assert answer[-1] == pytest.approx(1.0, abs=1e-3)


def test_another_precision_is_one_that_there_is():
    with pytest.raises(ParameterError, match="precision = 'half': must be float64 or float32"):
        discretise(LOW_PASS, TICK_S).in_precision("half")  # type: ignore[arg-type]


def test_the_package_has_no_other_names():
    assert firmware_model.discretise is discretise
    with pytest.raises(AttributeError, match="no attribute 'discretize'"):
        firmware_model.discretize
