"""Principal directions of a box of cars: against derivatives by hand and an independent SVD."""

import numpy as np
import pytest

from firmware_model.design.mismatch import TRUSTED, Channels, Mismatch, principal_mismatch
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.law.structs import FloatArray

TRACKING_S = 0.05
GAIN_PART, LAG_PART, LAG_S = 0.2, 0.3, 0.1
Places = list[FloatArray]


def lag_at(gain: float, lag: float) -> ZeroPoleGain:
    """Gain and time constant of a lag, each off by a part of itself."""
    return ZeroPoleGain.lag(LAG_S * (1.0 + LAG_PART * lag), 1).scaled(1.0 + GAIN_PART * gain)


def unity() -> ZeroPoleGain:
    return ZeroPoleGain.constant(1.0)


def made(parameters: int, of, most: int = 4) -> tuple[Mismatch, Places]:  # type: ignore[no-untyped-def]
    """The directions, and where each car was made, the last ones those of the directions.

    ``of`` gives G1 at a place, or both channels; G2 alone is 1 everywhere.
    """
    places: Places = []

    def make(place: FloatArray) -> Channels:
        places.append(np.array(place))
        channels = of(place)
        return channels if isinstance(channels, tuple) else (channels, unity())

    return principal_mismatch(make, parameters, TRACKING_S, 1, most), places


def gram(*of_g2: int) -> FloatArray:
    """∫ of the products of d ln G/dp on a step that D* follows with two lags, by hand.

    Of G1, and of a G2 that has in it the gain (0) or the lag (1) of G1, whichever are named.
    """
    omega = np.geomspace(0.3, 10.0 / TRACKING_S, 200_001)
    s = 1j * omega
    step = 1.0 / (s * (1.0 + s * TRACKING_S) ** 2)
    derivatives = [GAIN_PART * step, -LAG_PART * LAG_S * s / (1.0 + LAG_S * s) * step]
    products = np.array(
        [[np.trapezoid((a * b.conj()).real, omega) for b in derivatives] for a in derivatives]
    )
    both = np.array([float(i in of_g2) for i in range(2)])
    return products * (1.0 + np.outer(both, both))


@pytest.mark.parametrize("of_g2", [(), (0,), (1,), (0, 1)])
def test_they_are_the_eigenvectors_of_what_the_parameters_show(of_g2):
    """In both channels: the torque does the work before a loss, the force difference after it."""

    def channels(place: FloatArray) -> Channels:
        return lag_at(*place), lag_at(*(place[i] if i in of_g2 else 0.0 for i in range(2)))

    found, places = made(2, channels)
    values, vectors = np.linalg.eigh(gram(*of_g2))
    expected = np.sqrt(values[::-1])
    np.testing.assert_allclose(found.singular_values, expected, rtol=0.03)
    for place, vector in zip(places[-2:], vectors.T[::-1], strict=True):
        assert np.linalg.norm(place) == pytest.approx(0.05)
        assert abs(place @ vector) / 0.05 == pytest.approx(1.0, abs=1e-3)
    assert found.cars == tuple(channels(place) for place in places[-2:])


def test_parameters_that_show_alike_are_one_direction():
    found, places = made(2, lambda place: lag_at(place[0] + place[1], 0.0))
    assert len(found.cars) == 1
    assert abs(places[-1][0] - places[-1][1]) < 1e-9


def test_parameters_that_only_the_second_channel_shows_are_directions_too():
    found, _ = made(2, lambda place: (lag_at(place[0], 0.0), lag_at(0.0, place[1])))
    assert len(found.cars) == 2


@pytest.mark.parametrize("most", [1, 2, 3, 4])
def test_what_shows_nothing_is_no_direction_and_there_is_room_for_so_many(most):
    """The largest stay."""
    found, _ = made(3, lambda place: lag_at(place[0], 0.0 * place[1]))
    assert len(found.cars) == 1
    assert len(found.singular_values) == 3

    def four(place: FloatArray) -> ZeroPoleGain:
        fast, slow = (0.02, 0.5) * (1.0 + 0.5 * place[2:])
        return lag_at(*place[:2]) * ZeroPoleGain.lag(fast, 1) * ZeroPoleGain.lag(slow, 1)

    found, _ = made(4, four, most)
    everything, _ = made(4, four)
    assert len(everything.cars) == len(found.singular_values) == 4
    assert found.cars == everything.cars[:most]
    assert list(found.singular_values) == sorted(found.singular_values, reverse=True)


def test_without_parameters_the_model_is_trusted():
    assert made(0, lambda place: lag_at(0.0, 0.0)) == (TRUSTED, [])
    assert TRUSTED.cars == ()


def test_each_car_stands_at_its_place():
    found, _ = made(2, lambda place: lag_at(*place))
    assert len(found.cars) == len(found.places) == 2
    for (g1, _), place in zip(found.cars, found.places, strict=True):
        assert g1(1j) == pytest.approx(lag_at(*place)(1j), rel=1e-14)
    assert TRUSTED.places == []
