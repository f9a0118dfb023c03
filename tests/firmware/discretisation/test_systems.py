"""Filters of other libraries: each is understood as its own library understands it."""

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.systems import continuous, zero_pole_gain
from firmware_model.errors import ParameterError

S = 1j * np.geomspace(0.01, 1e4, 30)
NUM, DEN = [3.0, 30.0], [1.0, 14.0, 140.0, 400.0]
SYSTEMS = {
    "python-control, transfer function": control.tf(NUM, DEN),
    "python-control, state space": control.ss(control.tf(NUM, DEN)),
    "python-control, zeros and poles": control.zpk([-10.0], np.roots(DEN), 3.0),
    "scipy, transfer function": signal.TransferFunction(NUM, DEN),
    "scipy, lti": signal.lti(NUM, DEN),
    "scipy, zeros and poles": signal.ZerosPolesGain([-10.0], np.roots(DEN), 3.0),
    "scipy, a gain in a list": signal.ZerosPolesGain([-10.0], np.roots(DEN), [3.0]),
    "scipy, state space": signal.TransferFunction(NUM, DEN).to_ss(),
    "scipy, a numerator of one row": SimpleNamespace(num=[NUM], den=DEN),
    "coefficients": (NUM, DEN),
    "ours": ZeroPoleGain.from_coefficients(NUM, DEN),
}


@pytest.mark.parametrize("kind", SYSTEMS)
def test_every_kind_is_the_same_filter(kind):
    expected = np.polyval(NUM, S) / np.polyval(DEN, S)
    np.testing.assert_allclose(continuous(SYSTEMS[kind])(S), expected, rtol=1e-10)
    g = zero_pole_gain(SYSTEMS[kind])
    assert (len(g.zeros), len(g.poles)) == (1, 3)
    np.testing.assert_allclose(g(S), expected, rtol=1e-10)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e6])
def test_conjugates_that_rounding_has_parted_are_a_pair(size):
    """Relative to their size; and a root at the origin is real."""
    pole = size * complex(-1.0, 2.0)
    near = pole.conjugate() * (1.0 + 1e-15)
    zero = size * complex(-3.0, 1e-16)
    g = zero_pole_gain(signal.ZerosPolesGain([zero, 0.0], [near, pole], 1.0))
    assert g.zeros == (0.0, -3.0 * size)
    assert g.poles == (pole, pole.conjugate())


MATRICES = np.diag([-1.0, -2.0])
REFUSED: dict[str, tuple[Any, str]] = {
    "sampled, python-control": (control.tf([1.0], [1.0, 0.5], 0.1), "dt = 0.1.*must be continuous"),
    "sampled, scipy": (signal.dlti([1.0], [1.0, 0.5], dt=0.1), "dt = 0.1.*must be continuous"),
    "sampled, dt unknown": (control.tf([1.0], [1.0, 0.5], True), "must be continuous"),
    "2 by 2, python-control": (control.ss(MATRICES, np.eye(2), np.eye(2), np.zeros((2, 2))),
                               r"2 input\(s\) and 2 output\(s\): must have one of each"),
    "transfer functions of 1 by 2": (control.tf([[[1.0], [2.0]]], [[[1.0, 1.0], [1.0, 2.0]]]),
                                     r"2 input\(s\) and 1 output"),
    "2 outputs, scipy": (signal.StateSpace(MATRICES, np.ones((2, 1)), np.eye(2), np.zeros((2, 1))),
                         r"1 input\(s\) and 2 output"),
    "2 numerators, scipy": (signal.TransferFunction([[1.0, 0.0], [0.0, 1.0]], [1.0, 2.0, 3.0]),
                            r"1 input\(s\) and 2 output"),
    "2 gains, scipy": (signal.ZerosPolesGain([[-1.0], [-2.0]], [-3.0, -4.0], [1.0, 2.0]),
                       r"1 input\(s\) and 2 output"),
    "no filter": ("1/(s+1)", "must be a TransferFunction.*not str"),
    "a list": ([[1.0], [1.0, 1.0]], "not list"),
    "a response": (control.frd([1.0], [1.0]), "not FrequencyResponseData"),
    "nothing": (None, "not NoneType"),
    "no coefficients": (([], [1.0, 1.0]), r"num = \[\]: must be one row of real"),
    "scipy's zeros, poles, gain": (
        signal.butter(2, 1.0, analog=True, output="zpk"),
        r"not a tuple of 3 \(scipy.signal.ZerosPolesGain\(zeros, poles, gain\) is one\)"),
    "only A": (SimpleNamespace(A=1.0), "not SimpleNamespace"),
    "only D": (SimpleNamespace(D=1.0), "not SimpleNamespace"),
    "only gain": (SimpleNamespace(gain=1.0), "not SimpleNamespace"),
    "only poles": (SimpleNamespace(poles=1.0), "not SimpleNamespace"),
    "only num": (SimpleNamespace(num=1.0), "not SimpleNamespace"),
    "only den": (SimpleNamespace(den=1.0), "not SimpleNamespace"),
    "scipy's matrices": (tuple(signal.butter(1, 1.0, analog=True)) * 2,
                         r"not a tuple of 4 \(scipy.signal.StateSpace\(a, b, c, d\) is one\)"),
    "a tuple of one": (([1.0],), "not a tuple of 1$"),
    "letters": (("ab", [1.0, 1.0]), "num = ab: must be one row of real"),
    "complex coefficients": (([1j], [1.0, 1.0]), "num = .*must be one row of real"),
    "a matrix of coefficients": (([1.0], [[1.0, 1.0]]), "den = .*must be one row of real"),
    "not finite": (([np.nan], [1.0, 1.0]), "finite"),
    "zero denominator": (([1.0], [0.0]), "den is identically zero"),
    "a state space that is not finite": (signal.StateSpace([[-np.inf]], [[1.0]], [[1.0]], [[0.0]]),
                                         "A, B, C, D: every number must be finite"),
    "roots that are not finite": (SimpleNamespace(zeros=[], poles=[np.nan], gain=1.0),
                                  "zeros, poles: every root must be finite"),
    "a gain that is not real": (SimpleNamespace(zeros=[], poles=[-1.0], gain=1j),
                                "gain = 1j: must be real and finite"),
    "a zero without its conjugate": (signal.ZerosPolesGain([1 + 1j], [-1.0, -2.0], 1.0),
                                     r"1\+1j: its conjugate is missing"),
    "a pole without its conjugate": (signal.ZerosPolesGain([], [-1 - 1j], 1.0),
                                     r"-1-1j: its conjugate is missing"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_no_such_filter_is_refused_in_one_line(kind):
    system, message = REFUSED[kind]
    with pytest.raises(ParameterError, match=message) as caught:
        zero_pole_gain(system)
    assert "\n" not in str(caught.value)


def test_neither_library_is_imported_unless_the_caller_has():
    code = (
        "import sys, firmware_model as m; assert 'numba' not in sys.modules, 'heavy root';"
        "m.discretise(([1.0], [1.0, 1.0]), 0.1).run([1.0]);"
        "print({'control', 'scipy.signal', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout == "set()\n"
