"""The tracking controller at minimal order against (3.32)-(3.34) in 50 digits."""

import mpmath
import pytest

from firmware_model.design.continuous_design import tracking
from firmware_model.design.factors import roots_of_one_less_one
from firmware_model.design.plants import Plant, chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import AxisZeroError, ImproperError, ZeroChannelError

PLANTS = [chapter_2(), steer_by_wire(), steer_by_wire(variant="published")]
OMEGAS = [1e-3, 0.1, 1.0, 17.0, 300.0, 1e4]


def _thesis_c(plant: Plant, tau_q_s: float, alpha_q: int, omega: float) -> complex:
    """(3.32): Q/(1 - Q G1) with Q = q̂/G1, from A, B, C, nothing multiplied out."""
    with mpmath.workdps(50):
        s = mpmath.mpc(0, omega)
        matrix = s * mpmath.eye(len(plant.a)) - mpmath.matrix(plant.a.tolist())
        g1 = (
            mpmath.matrix(plant.c.tolist())
            * mpmath.lu_solve(matrix, mpmath.matrix(plant.b[:, 0].tolist()))
        )[0]
        q = 1 / ((1 + mpmath.mpf(tau_q_s) * s) ** alpha_q * g1)
        return complex(q / (1 - q * g1))


@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("alpha_q", [2, 3, 4, 7])
@pytest.mark.parametrize("tau_q_s", [1e-3, 0.02, 1.0])
def test_it_is_3_32(plant, alpha_q, tau_q_s):
    c = tracking(plant.g1, tau_q_s, alpha_q).controller
    assert c.order == len(plant.g1.zeros) + alpha_q
    for omega in OMEGAS:
        expected = _thesis_c(plant, tau_q_s, alpha_q, omega)
        assert c(1j * omega) == pytest.approx(expected, rel=1e-11)


def test_3_40_with_its_errata():
    c = tracking(steer_by_wire(variant="published").g1, 0.001, 2).controller
    assert c.order == 4
    assert c.numerator() / c.gain == pytest.approx([1, 27.8684, 494.8547, 5616.1, 20333], rel=3e-5)
    denominator = c.inverse().numerator()
    printed = [0.00000201, 0.00406489, 0.09299355, 0.8270962]
    for value, digits, decimals in zip(denominator, printed, [8, 8, 7, 7], strict=False):
        assert value == pytest.approx(digits, abs=1.01 * 10**-decimals)
    assert denominator[-1] == 0.0


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 8, 13, 100])
def test_roots_of_one(order):
    roots = roots_of_one_less_one(order)
    assert len(set(roots)) == order
    for root in roots:
        assert (1 + root) ** order == pytest.approx(1, abs=1e-12)
    with mpmath.workdps(40):
        expected = [complex(mpmath.expjpi(mpmath.mpf(2 * k) / order) - 1) for k in range(order)]
    for value in expected:
        assert min(abs(root - value) for root in roots) <= 1e-15 * abs(value)
    assert roots[0] == 0
    ZeroPoleGain((), roots, 1.0)  # refuses unless the pairs are exact


def test_relative_degree_is_the_least_alpha_q():
    g1 = steer_by_wire().g1
    with pytest.raises(ImproperError, match=r"alpha_q = 1: .* alpha_q must be at least 2"):
        tracking(g1, 0.001, 1)
    assert tracking(g1, 0.001, 2).controller.relative_degree == 0
    assert tracking(chapter_2().g1, 0.001, 1).controller.relative_degree == 0


@pytest.mark.parametrize(
    ("g1", "error", "named"),
    [
        (ZeroPoleGain((0,), (-1, -2), 1.0), AxisZeroError, "G1 has a zero at 0"),
        (ZeroPoleGain((3j, -3j), (-1, -2), 1.0), AxisZeroError, "G1 has a zero at 0\\+3j"),
        (ZeroPoleGain.constant(0.0), ZeroChannelError, "G1"),
    ],
)
def test_plants_refused(g1, error, named):
    with pytest.raises(error, match=named):
        tracking(g1, 0.001, 2)
