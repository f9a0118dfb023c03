"""Actuators and a sensor in series with the car: against python-control and the identities."""

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_allclose

from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.errors import ImproperError, ParameterError

CAR = steer_by_wire()
NUMBERS = Plant.from_state_space("numbers", CAR.a, CAR.b, CAR.c)
POINTS = 1j * np.geomspace(0.1, 1e4, 60)
lags = st.floats(1e-4, 0.1)
frequencies = st.floats(10.0, 1e3)
stages = st.one_of(
    st.just(IDEAL),
    st.builds(Stage, lag_s=lags),
    st.builds(Stage, natural_frequency_rad_per_s=frequencies, damping=st.floats(0.05, 5.0)),
)


def continuous(stage: Stage) -> control.TransferFunction:
    """By python-control, from the textbook's coefficients."""
    omega = stage.natural_frequency_rad_per_s
    if omega is None:
        return control.tf([1.0], [stage.lag_s, 1.0])
    return control.tf([omega**2], [1.0, 2.0 * stage.damping * omega, omega**2])


@given(stages)
def test_a_stage_is_the_textbook_s_with_unity_gain(stage):
    expected = continuous(stage)(POINTS)
    assert_allclose(stage.transfer_function(POINTS), expected, rtol=1e-9, atol=1e-14)
    assert stage.transfer_function.dc_gain == pytest.approx(1.0, rel=1e-12)
    a, b, c = stage.realisation
    if len(a):
        realised = control.ss(a, b[:, None], c[None, :], [[0.0]])(POINTS)
        assert_allclose(realised, expected, rtol=1e-7, atol=1e-12)


@given(stages, stages, stages)
def test_a_plant_behind_stages_is_their_product(first, second, sensor):
    plant = actuated(CAR, first, second, sensor)
    response = control.ss(plant.a, plant.b, plant.c, np.zeros((1, 2)))(POINTS)[0]
    for channel, g, stage in ((0, plant.g1, first), (1, plant.g2, second)):
        car = (CAR.g1, CAR.g2)[channel]
        expected = car(POINTS) * continuous(stage)(POINTS) * continuous(sensor)(POINTS)
        assert_allclose(g(POINTS), expected, rtol=1e-8)
        assert_allclose(response[channel], expected, rtol=1e-5, atol=1e-14)
        poles = len(stage.realisation[0]) + len(sensor.realisation[0])
        assert g.relative_degree == car.relative_degree + poles
        assert g.zeros == car.zeros


@pytest.mark.parametrize("car", [CAR, NUMBERS])
def test_the_output_before_the_sensor_is_that_of_the_car(car):
    plant = actuated(car, Stage(0.005), IDEAL, Stage(0.01))
    assert plant.sensed is not None
    assert (plant.world is None) == (car is NUMBERS)
    before = control.ss(plant.a, plant.b, plant.sensed, np.zeros((1, 2)))(POINTS)[0]
    assert_allclose(before[0], car.g1(POINTS) * continuous(Stage(0.005))(POINTS), rtol=1e-6)
    assert_allclose(before[1], car.g2(POINTS), rtol=1e-6)


def test_behind_nothing_it_is_the_car_itself():
    assert actuated(CAR, IDEAL, IDEAL, IDEAL) is CAR


def test_dead_times_stay_beside_the_channels():
    plant = actuated(
        CAR, Stage(dead_time_s=0.002), Stage(dead_time_s=0.003), Stage(dead_time_s=0.01)
    )
    assert (plant.g1, plant.g2) == (CAR.g1, CAR.g2)
    assert plant.path_dead_times_s == pytest.approx((0.012, 0.013))


@pytest.mark.parametrize(
    ("stage", "line"),
    [
        ({"lag_s": -1e-3}, r"lag_s = -0.001: must be 0 or above"),
        ({"dead_time_s": -1e-3}, r"dead_time_s = -0.001: must be 0 or above"),
        ({"lag_s": 0.1, "natural_frequency_rad_per_s": 9.0}, r"lag_s = 0.1: must be 0 beside"),
        ({"natural_frequency_rad_per_s": 0.0}, r"natural_frequency_rad_per_s = 0"),
        ({"natural_frequency_rad_per_s": 5.0, "damping": 0.0}, r"damping = 0"),
    ],
)
def test_what_is_no_stage_is_refused(stage, line):
    with pytest.raises(ParameterError, match=line):
        Stage(**stage)


@pytest.mark.parametrize(
    ("specification", "line"),
    [
        ({"alpha": 1, "alpha_q": 4}, r"alpha = 1: .* must be at least 3"),
        ({"alpha": 3, "alpha_q": 3}, r"alpha_q = 3: .* must be at least 4"),
    ],
)
def test_an_order_that_lags_make_too_small_is_refused(specification, line):
    """G1 has relative degree 2 and G2 1; a lag and the sensor add one each."""
    plant = actuated(CAR, Stage(0.005), Stage(0.015), Stage(0.01))
    with pytest.raises(ImproperError, match=line):
        design(plant, DesignSpecification(tau_s=0.01, tau_q_s=0.01, **specification))
    design(plant, DesignSpecification(tau_s=0.01, tau_q_s=0.01, alpha=3, alpha_q=4))
