"""The car's state space against the equations of motion (3.1)-(3.8) and the printed numbers."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import scipy.signal
from hypothesis import given, strategies as st

from firmware_model.design.vehicle import TABLE_3_2, VehicleParameters, vehicle_state_space
from firmware_model.errors import ParameterError

factor = st.floats(0.7, 1.3)
cars = st.builds(
    lambda scale, speed, d: VehicleParameters(
        *(getattr(TABLE_3_2, f.name) * k for f, k in zip(fields(TABLE_3_2), scale, strict=False)),
        speed_mps=speed,
        lateral_weight=d,
    ),
    st.lists(factor, min_size=10, max_size=10),
    st.floats(2, 50),
    st.sampled_from([0.0, 1.0]) | st.floats(1e-6, 1),
)


@given(cars, st.lists(st.floats(-1, 1), min_size=4, max_size=4), st.floats(-9, 9), st.floats(-9, 9))
def test_rows_are_the_equations_of_motion(car, state, torque, force_difference):
    a, b, c = vehicle_state_space(car)
    x = np.array(state)
    beta, yaw_rate, steer_rate, steer = state
    slip_rate, yaw_acceleration, steer_acceleration, steer_rate_again = a @ x + b @ np.array(
        [torque, force_difference]
    )
    v, lf, lr = car.speed_mps, car.front_axle_distance_m, car.rear_axle_distance_m
    front = -car.front_cornering_stiffness_n_per_rad * (beta + lf / v * yaw_rate - steer)  # (3.5)
    rear = -car.rear_cornering_stiffness_n_per_rad * (beta - lr / v * yaw_rate)  # (3.6)

    def close(value: float) -> object:
        return pytest.approx(value, rel=1e-9, abs=1e-6)

    assert car.mass_kg * v * (slip_rate + yaw_rate) == close(2 * front + 2 * rear)  # (3.2)
    assert car.yaw_inertia_kgm2 * yaw_acceleration == close(
        2 * front * lf - 2 * rear * lr + car.rear_track_m / 2 * force_difference
    )  # (3.3)
    assert car.steering_inertia_kgm2 * steer_acceleration == close(
        torque - 2 * car.trail_m * front - car.steering_damping_nms_per_rad * steer_rate
    )  # (3.4)
    assert steer_rate_again == steer_rate
    d = car.lateral_weight
    assert (c @ x)[0] == close((slip_rate + yaw_rate) * d * v + yaw_rate * (1 - d) * v)  # (3.8)


def _tf(variant: str, channel: int) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = vehicle_state_space(TABLE_3_2, variant)
    num, den = scipy.signal.ss2tf(a, b, c, np.zeros((1, 2)), input=channel)
    return num[0], den


def test_printed_denominator():
    _, den = _tf("physics", 0)
    assert den[:3] == pytest.approx([1, 27.8684, 494.8547], abs=5e-5)
    assert den[3:] == pytest.approx([5.6161e3, 2.0333e4], abs=0.5)  # 20332.53 in four digits


@pytest.mark.parametrize(
    ("variant", "channel", "expected"),
    [
        ("physics", 0, [2.00930, 49.43839, 477.97980]),
        ("physics", 1, [0.00267668, 0.04069101, 0.99003151, 6.80202]),
        ("published", 0, [2.0093, 46.2900, 413.5481]),  # (3.35)
        ("published", 1, [0.00227068, 0.03517193, 0.87190826, 5.88510794]),
        ("published", 1, [0.0023, 0.0352, 0.8719, 5.8851]),  # (3.36), .00352 corrected
    ],
)
def test_numerators(variant, channel, expected):
    num, _ = _tf(variant, channel)
    for value, printed in zip(num[-len(expected) :], expected, strict=True):
        decimals = len(str(printed).partition(".")[2])
        assert value == pytest.approx(printed, abs=0.501 * 10**-decimals)


def test_the_variants_differ_in_one_entry():
    physics, published = (vehicle_state_space(TABLE_3_2, v) for v in ("physics", "published"))
    assert np.array_equal(physics[0], published[0])
    assert np.array_equal(physics[1], published[1])
    assert (physics[2] != published[2]).tolist() == [[False, True, False, False]]


def test_table_3_2_is_the_default():
    assert VehicleParameters() == TABLE_3_2
    values = [getattr(TABLE_3_2, f.name) for f in fields(TABLE_3_2)]
    assert values == [1400, 2457, 1.02, 1.58, 1.48, 11.98, 9, 33700, 56200, 0.05, 10, 0.5]


@pytest.mark.parametrize("field", [f.name for f in fields(VehicleParameters)])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, -1.0])
def test_every_field_refuses_nonsense_by_name(field, value):
    with pytest.raises(ParameterError, match=rf"^{field} = {value}: must "):
        replace(TABLE_3_2, **{field: value})


@pytest.mark.parametrize(
    "field",
    [
        f.name
        for f in fields(VehicleParameters)
        if f.name not in ("steering_damping_nms_per_rad", "lateral_weight")
    ],
)
def test_zero_is_refused_where_it_means_nothing(field):
    with pytest.raises(ParameterError, match=rf"^{field} = 0.0: must be finite and > 0"):
        replace(TABLE_3_2, **{field: 0.0})


def test_ends_of_the_ranges_are_allowed():
    assert replace(TABLE_3_2, steering_damping_nms_per_rad=0.0).steering_damping_nms_per_rad == 0
    for d in (0.0, 1.0):
        assert replace(TABLE_3_2, lateral_weight=d).lateral_weight == d
    with pytest.raises(ParameterError, match=r"lateral_weight = 1.01: must lie in 0\.\.1"):
        replace(TABLE_3_2, lateral_weight=1.01)


def test_unknown_variant():
    with pytest.raises(ParameterError, match="variant = 'printed': must be one of"):
        vehicle_state_space(TABLE_3_2, "printed")  # type: ignore[arg-type]
