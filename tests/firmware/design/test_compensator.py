"""The compensator: G2 F̂ = q G2i, and the printed (3.38)."""

import numpy as np
import pytest

from firmware_model.design.continuous_design import compensator, inner_outer
from firmware_model.design.plants import chapter_2, steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ImproperError

S = 1j * np.logspace(-2, 5, 30)
PRINTED_3_36 = ZeroPoleGain.from_coefficients(
    [0.0023, 0.00352, 0.8719, 5.8851], [1, 27.8684, 494.8547, 5616.1, 20333]
)
CHANNELS = [chapter_2().g2, steer_by_wire().g2, PRINTED_3_36, ZeroPoleGain.lag(0.3, 3)]


@pytest.mark.parametrize("g2", CHANNELS)
@pytest.mark.parametrize("tau_s", [1e-3, 0.01, 2.0])
@pytest.mark.parametrize("alpha", [3, 4])
def test_what_it_adds_is_the_loss_low_passed(g2, tau_s, alpha):
    f2 = compensator(g2, tau_s, alpha)
    inner, _ = inner_outer(g2)
    assert g2(S) * f2(S) == pytest.approx(inner(S) / (1 + tau_s * S) ** alpha, rel=1e-10)
    assert f2.is_stable()
    assert f2.is_proper
    assert f2.dc_gain == pytest.approx(1 / g2.dc_gain, rel=1e-12)


def test_3_38_with_its_errata():
    f2 = compensator(steer_by_wire(variant="published").g2, 0.001, 1)
    lead = f2.inverse()
    assert lead.denominator()[:3] == pytest.approx([1, 27.8684, 494.8547], abs=5e-5)
    printed = np.polymul([0.001, 1], [0.00227068, 0.03517193, 0.87190826, 5.88510794])
    assert lead.numerator() == pytest.approx(printed, rel=3e-6)
    assert f2.relative_degree == 0
    assert f2.dc_gain == pytest.approx(3455, abs=0.5)


def test_the_least_alpha_is_named_and_suffices():
    g2 = ZeroPoleGain.lag(0.3, 3)
    with pytest.raises(ImproperError, match=r"alpha = 2: .* alpha must be at least 3"):
        compensator(g2, 0.001, 2)
    assert compensator(g2, 0.001, 3).relative_degree == 0
