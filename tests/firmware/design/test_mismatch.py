"""Principal directions of a box of cars: against derivatives by hand and an independent SVD."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_model.design.mismatch import TRUSTED, Mismatch, principal_mismatch
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.target.structs import FloatArray

TRACKING_S = 0.05
GAIN_PART, LAG_PART, LAG_S = 0.2, 0.3, 0.1
Places = list[FloatArray]


def lag_at(gain: float, lag: float) -> ZeroPoleGain:
    """Gain and time constant of a lag, each off by a part of itself."""
    return ZeroPoleGain.lag(LAG_S * (1.0 + LAG_PART * lag), 1).scaled(1.0 + GAIN_PART * gain)


def made(parameters: int, of) -> tuple[Mismatch, Places]:  # type: ignore[no-untyped-def]
    """The directions, and where each car was made, the last ones those of the directions."""
    places: Places = []

    def make(place: FloatArray) -> ZeroPoleGain:
        places.append(np.array(place))
        channel: ZeroPoleGain = of(place)
        return channel

    return principal_mismatch(make, parameters, TRACKING_S), places


def gram() -> FloatArray:
    """∫ of the products of d ln G1/dp on a step that D* follows with two lags, by hand."""
    omega = np.geomspace(0.3, 10.0 / TRACKING_S, 200_001)
    s = 1j * omega
    step = 1.0 / (s * (1.0 + s * TRACKING_S) ** 2)
    derivatives = [GAIN_PART * step, -LAG_PART * LAG_S * s / (1.0 + LAG_S * s) * step]
    return np.array(
        [[np.trapezoid((a * b.conj()).real, omega) for b in derivatives] for a in derivatives]
    )


def test_they_are_the_eigenvectors_of_what_the_parameters_show() -> None:
    found, places = made(2, lambda place: lag_at(*place))
    values, vectors = np.linalg.eigh(gram())
    expected = np.sqrt(values[::-1])
    np.testing.assert_allclose(found.singular_values, expected, rtol=0.03)
    for place, vector in zip(places[-2:], vectors.T[::-1], strict=True):
        assert np.linalg.norm(place) == pytest.approx(0.05)
        assert abs(place @ vector) / 0.05 == pytest.approx(1.0, abs=1e-3)
    assert found.cars == tuple(lag_at(*place) for place in places[-2:])


def test_parameters_that_show_alike_are_one_direction() -> None:
    found, places = made(2, lambda place: lag_at(place[0] + place[1], 0.0))
    assert len(found.cars) == 1
    assert abs(places[-1][0] - places[-1][1]) < 1e-9


def test_what_shows_nothing_is_no_direction_and_three_are_enough() -> None:
    found, _ = made(3, lambda place: lag_at(place[0], 0.0 * place[1]))
    assert len(found.cars) == 1
    assert len(found.singular_values) == 3
    found, _ = made(
        4,
        lambda place: (
            lag_at(place[0], place[1])
            * ZeroPoleGain.lag(0.02 * (1.0 + 0.5 * place[2]), 1)
            * ZeroPoleGain.lag(0.5 * (1.0 + 0.5 * place[3]), 1)
        ),
    )
    assert len(found.cars) == 3
    assert len(found.singular_values) == 4


def test_without_parameters_the_model_is_trusted() -> None:
    assert made(0, lambda place: lag_at(0.0, 0.0)) == (TRUSTED, [])
    assert TRUSTED.cars == ()
