"""Channels against their state space, and the properties the thesis's plants must have."""

import math
from dataclasses import replace

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy import linalg

from firmware_model.design.factors import unstable
from firmware_model.design.plants import Plant, chapter_2, numerators, steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.errors import ParameterError, ZeroChannelError
from tests.firmware.design.test_vehicle import cars

OMEGAS = np.e * np.logspace(-2, 5, 8)  # where no drawn pole lies on the imaginary axis


def _exact(plant: Plant, omega: float) -> list[complex]:
    """C(jωI - A)⁻¹B solved in 40 digits."""
    with mpmath.workdps(40):
        matrix = mpmath.mpc(0, omega) * mpmath.eye(len(plant.a)) - mpmath.matrix(plant.a.tolist())
        states = mpmath.inverse(matrix) * mpmath.matrix(plant.b.tolist())
        output = mpmath.matrix(plant.c.tolist()) * states
        return [complex(output[0]), complex(output[1])]


def _assert_channels_are_the_state_space(plant: Plant, rel: float) -> None:
    for omega in OMEGAS:
        given_values = [plant.g1(1j * omega), plant.g2(1j * omega)]
        assert given_values == pytest.approx(_exact(plant, omega), rel=rel)


@pytest.mark.compiled
@settings(max_examples=60)
@given(cars, st.sampled_from(["physics", "published"]))
@example(replace(TABLE_3_2, lateral_weight=0.0), "physics")
@example(replace(TABLE_3_2, lateral_weight=1e-6, speed_mps=2.0), "physics")
def test_channels_of_any_car(car, variant):
    plant = steer_by_wire(car, variant)
    _assert_channels_are_the_state_space(plant, rel=1e-12)
    assert plant.g1.poles == plant.g2.poles
    assert plant.g1.relative_degree == (3 if car.lateral_weight == 0 else 2)


def test_chapter_2_is_2_38_and_its_state_space():
    plant = chapter_2()
    _assert_channels_are_the_state_space(plant, rel=1e-14)
    for s in (0.3, 1.5j, -0.2 + 7j):
        assert plant.g1(s) == pytest.approx((s + 3) / ((s + 1) * (s + 2)), rel=1e-14)
        assert plant.g2(s) == pytest.approx((s + 6) / ((s + 4) * (s + 5)), rel=1e-14)
    assert (plant.g1.order, plant.g2.order) == (2, 2)


def test_the_car_is_stable_and_minimum_phase_over_speed_and_weight():
    for speed in np.linspace(2, 50, 17):
        for d in np.linspace(0, 1, 11):
            car = replace(TABLE_3_2, speed_mps=float(speed), lateral_weight=float(d))
            plant = steer_by_wire(car)
            for g in (plant.g1, plant.g2):
                assert g.is_stable()
                assert all(zero.real < 0 for zero in g.zeros)
            assert plant.g1.relative_degree == (3 if d == 0 else 2)
            assert plant.g2.relative_degree == 1


def test_the_slip_of_the_published_variant_is_not_minimum_phase_at_a_crawl():
    for speed, weight, minimum_phase in [(10.0, 0.5, True), (2.0, 0.0, True), (2.0, 0.5, False)]:
        car = replace(TABLE_3_2, speed_mps=speed, lateral_weight=weight)
        plant = steer_by_wire(car, "published")
        assert all(z.real < 0 for g in (plant.g1, plant.g2) for z in g.zeros) is minimum_phase


@pytest.mark.parametrize(
    ("variant", "torque_nm", "force_difference_n"),
    [("physics", 42.5, 2989), ("published", 49.2, 3455)],
)
def test_steady_commands_for_one_mps2(variant, torque_nm, force_difference_n):
    plant = steer_by_wire(variant=variant)
    assert 1 / plant.g1.dc_gain == pytest.approx(torque_nm, abs=0.05)
    assert 1 / plant.g2.dc_gain == pytest.approx(force_difference_n, abs=0.5)


@given(st.lists(st.floats(-3, 3), min_size=15, max_size=15), st.floats(0.5, 30))
def test_numerators_are_the_determinant_difference(entries, s):
    """``c adj(sI - A) b = det(sI - A + b c) - det(sI - A)``, the matrix determinant lemma."""
    a = np.array(entries[:9]).reshape(3, 3)
    b = np.array([entries[9:12], entries[12:15]]).T
    c = np.array([[1.0, -2.0, 0.5]])
    for row, column in zip(numerators(a, b, c), b.T, strict=True):
        shifted = s * np.eye(3) - a
        expected = np.linalg.det(shifted + np.outer(column, c)) - np.linalg.det(shifted)
        assert np.polyval(row, s) == pytest.approx(expected, rel=1e-9, abs=1e-8 * (1 + s) ** 3)


def test_a_zero_hidden_by_a_change_of_state_is_still_no_coefficient():
    a = np.diag([-1.0, -2.0, -3.0])
    b = np.array([[1.0, 1], [-2, 1], [1, 1]])  # c b = 0 and c A b = 0 for input 1
    c = np.array([[1.0, 1, 1]])
    t = np.array([[0.3, 0.7, 0.1], [0.2, -0.9, 0.4], [0.11, 0.13, 0.8]])
    inverse = np.linalg.inv(t)
    moved = Plant.from_state_space("moved", inverse @ a @ t, inverse @ b, c @ t)
    assert moved.g1.zeros == ()
    assert moved.g1.gain == pytest.approx(2.0, rel=1e-12)  # c A² b
    _assert_channels_are_the_state_space(moved, rel=1e-11)


def test_a_mode_that_one_input_does_not_reach_stays_as_a_pair():
    plant = chapter_2()
    full = Plant.from_state_space("full", plant.a, plant.b, plant.c)
    assert (full.g1.order, full.g2.order) == (4, 4)
    assert np.sort_complex(full.g1.zeros) == pytest.approx([-5, -4, -3], rel=1e-12)
    _assert_channels_are_the_state_space(full, rel=1e-12)


def test_matrices_are_read_only_copies():
    a, b, c = np.array([[-1]]), np.array([[1, 2]]), np.array([[1]])
    plant = Plant.from_state_space("small", a, b, c)
    a[0, 0] = 5
    assert plant.a.tolist() == [[-1.0]]
    for matrix in (plant.a, plant.b, plant.c):
        assert matrix.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            matrix[0, 0] = 1.0


def test_a_short_trail_makes_a_car_weave_and_a_stiff_steering_gear_one_that_oversteers():
    oversteering = replace(TABLE_3_2, front_axle_distance_m=1.9, rear_axle_distance_m=0.7)
    assert steer_by_wire(replace(oversteering, speed_mps=50.0)).g1.is_stable()
    stiff = replace(oversteering, steering_damping_nms_per_rad=1000.0, speed_mps=50.0)
    assert len(unstable(steer_by_wire(stiff).g1)) == 2
    undamped = replace(TABLE_3_2, steering_damping_nms_per_rad=0.0, trail_m=0.005)
    assert steer_by_wire(undamped).g1.is_stable()
    weaving = unstable(steer_by_wire(replace(undamped, speed_mps=30.0)).g1)
    assert weaving[0] == pytest.approx(0.64 + 5.15j, abs=0.01)


def free_masses(springs: int) -> np.ndarray:
    """Three masses on a rail and springs between them, of 1, 2 and 5 kg and 300 N/m: x, then v."""
    stiffness = 300.0 * np.array([[1.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    if springs < 2:
        stiffness = 300.0 * np.array([[1.0, -1, 0], [-1, 1, 0], [0, 0, 0]])
    by_mass = -stiffness / np.array([[1.0], [2.0], [5.0]])
    return np.block([[np.zeros((3, 3)), np.eye(3)], [by_mass, np.zeros((3, 3))]])


TURNED = linalg.qr(np.arange(36.0).reshape(6, 6) + np.eye(6))[0]


@pytest.mark.parametrize(("springs", "at_rest"), [(2, 2), (1, 4)])
@pytest.mark.parametrize("turned", [np.eye(6), TURNED], ids=["plain", "turned"])
def test_poles_on_the_axis_are_exactly_there(springs, at_rest, turned):
    """Double poles at 0, which eigenvalues miss by √eps, and undamped pairs."""
    a = turned @ free_masses(springs) @ turned.T
    plant = Plant.from_state_space("masses", a, turned[:, [3, 4]], turned[:, :1].T)
    assert plant.g1.poles.count(0j) == at_rest
    swinging = [pole for pole in plant.g1.poles if pole.imag > 0]
    assert all(pole.real == 0.0 for pole in plant.g1.poles)
    laplacian = linalg.eigvals(-free_masses(springs)[3:, :3]).real
    expected = np.sqrt(laplacian[laplacian > 1e-6])
    assert sorted(p.imag for p in swinging) == pytest.approx(sorted(expected), rel=1e-9)


@pytest.mark.parametrize("pole", [0.0, -1e-17, 1e-17, 1e-17j])
def test_a_pole_beside_the_axis_by_rounding_is_on_it(pole):
    a = [[pole.real, pole.imag, 1], [-pole.imag, pole.real, 0], [0, 0, -2.0]]
    plant = Plant.from_state_space("made", a, np.ones((3, 2)), [[1, 1, 0]])
    assert sorted(plant.g1.poles, key=abs) == [0, 0, -2]


def test_slow_poles_are_not_taken_for_poles_at_0():
    slow = [-1e-6, -2e-6, -1.0, -3.0]
    plant = Plant.from_state_space("slow", np.diag(slow), np.ones((4, 2)), np.ones((1, 4)))
    assert sorted(pole.real for pole in plant.g1.poles) == sorted(slow)


def test_a_swing_hardly_faster_than_rounding_is_not_taken_for_poles_at_0():
    turned = linalg.qr(np.arange(9.0).reshape(3, 3) + np.eye(3))[0]
    a = turned @ np.array([[-1, 0, 0], [0, 0, 1], [0, -(5e-8**2), 0]]) @ turned.T
    with pytest.raises(ParameterError, match=r"slow: \[G1 G2\] = .* but C\(sI - A\)"):
        Plant.from_state_space("slow", a, turned @ np.ones((3, 2)), [[1, 2, 3]])


def test_a_mass_that_nothing_holds_integrates():
    assert Plant.from_state_space("mass", [[0, 1], [0, 0]], [[0, 0], [1, 2]], [[1, 0]]).integrates


@pytest.mark.parametrize(("b", "named"), [([[0, 1]], "G1"), ([[1, 0]], "G2")])
def test_a_zero_channel_is_named(b, named):
    with pytest.raises(ZeroChannelError, match=rf"mute: {named}\(s\) is identically zero"):
        Plant.from_state_space("mute", [[-1.0]], b, [[1.0]])


@pytest.mark.parametrize(
    ("a", "b", "c", "named"),
    [
        ([[-1.0, 0]], [[1, 1]], [[1]], r"A has shape \(1, 2\), must be \(1, 1\)"),
        ([[-1.0]], [[1]], [[1]], r"B has shape \(1, 1\), must be \(1, 2\)"),
        ([[-1.0]], [[1, 1]], [1], r"C has shape \(1,\), must be \(1, 1\)"),
        (-1.0, [[1, 1]], [[1]], r"A has shape \(\)"),
        (np.empty((0, 0)), np.empty((0, 2)), np.empty((1, 0)), r"A has shape \(0, 0\)"),
        ([[np.nan]], [[1, 1]], [[1]], "A has an entry that is not finite"),
        ([[-1.0]], [[1, np.inf]], [[1]], "B has an entry that is not finite"),
        ([[-1.0]], [[1, 1]], [[np.nan]], "C has an entry that is not finite"),
    ],
)
def test_matrices_refused(a, b, c, named):
    with pytest.raises(ParameterError, match=f"odd: {named}"):
        Plant.from_state_space("odd", a, b, c)


def test_channels_of_another_state_space_are_refused():
    right = chapter_2()
    with pytest.raises(ParameterError, match=r"chapter-2: \[G1 G2\] = .* at s = 0.540302"):
        replace(right, g2=ZeroPoleGain(right.g2.zeros, right.g2.poles, 1.0001))
    with pytest.raises(ParameterError, match=r"\[G1 G2\]"):
        replace(right, g1=right.g2)


@pytest.mark.parametrize("dead_time_s", [-1e-3, math.inf, math.nan])
@pytest.mark.parametrize("where", ["dead_times_s", "sensor_dead_time_s"])
def test_a_dead_time_is_finite_and_not_below_zero(where, dead_time_s):
    value = (0.0, dead_time_s) if where == "dead_times_s" else dead_time_s
    with pytest.raises(ParameterError, match=r"dead time .* must be finite and 0 or above"):
        replace(steer_by_wire(), **{where: value})


def test_a_channel_that_feeds_through_has_no_such_state_space():
    lag = ZeroPoleGain((), (-1,), 1.0)
    with pytest.raises(ParameterError, match="G2 has 1 zeros and 1 poles: must have fewer zeros"):
        Plant.from_transfer_functions("any", lag, ZeroPoleGain((-2,), (-1,), 1.0))
