"""The nonlinear car against an ODE solver, a root finder and the linear car."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import root

from can_rig.assessment.resolve import load
from can_rig.plant.frameless import frameless
from can_rig.plant.nonlinear_car import NonlinearCar, _advance, _rates, car_of
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import PlantSettings
from firmware_model.analysis.changing_plant import changing_plant, follow_changing
from firmware_model.design.actuator_dynamics import IDEAL
from firmware_model.target.status import FaultState
from tests.helpers import decoded, record
from tests.rig.plant.linear import LinearPlant
from tests.rig.plant.single_track import (
    CAR,
    G,
    calm,
    output,
    specific_force,
    world_rates,
)


@pytest.mark.parametrize(
    "settings", [CAR, PlantSettings(speed_mps=25.0, friction=0.4, trail_m=0.1)]
)
@pytest.mark.parametrize("size", [0.1, 1.0, 3.0])
def test_between_ticks_it_is_the_car_of_an_ode_solver(settings, size):
    generator = np.random.default_rng(7)
    car, x, differences, reached = NonlinearCar(settings), np.zeros(5), [], []
    for torque, push in size * generator.normal(0.0, [150.0, 1500.0], (8, 2)):
        solution = solve_ivp(
            world_rates, (0.0, 0.05), x, args=(settings, torque, push),
            method="DOP853", rtol=1e-11, atol=1e-12, max_step=1e-3,
        )  # fmt: skip
        x = solution.y[:, -1]
        expected = output(x, settings, torque, push)
        differences.append(car.advance(0.05, torque, push) - expected)
        reached.append(expected)
        beta, yaw_rate, steer_rate, steer = car.state
        assert [beta, yaw_rate, steer_rate, steer] == pytest.approx(
            [x[1] - x[0], x[2], x[3], x[4]], rel=1e-6, abs=1e-8
        )
    assert np.abs(differences).max() < 1e-6 * np.abs(reached).max()


WORLD = np.array([900.0, 400.0, 0.1, 20.0])


@pytest.mark.parametrize("friction", [0.9, 0.4])
def test_in_wind_on_a_banked_road_with_ice_and_while_the_speed_changes(friction):
    settings, tick_s = PlantSettings(friction=friction), 0.02
    generator = np.random.default_rng(11)
    rows = np.hstack([
        WORLD * generator.normal(size=(9, 4)),
        generator.uniform(0.3, 1.2, (9, 2)),
        np.linspace(6.0, 25.0, 9)[:, None],
    ])  # fmt: skip

    def world(time_s):
        times_s = tick_s * np.arange(len(rows))
        return [np.interp(time_s, times_s, column) for column in rows.T]

    car, x = NonlinearCar(settings), np.zeros(5)
    errors, reached = [], []
    for k, (torque, push) in enumerate(generator.normal(0.0, [150.0, 400.0], (8, 2))):
        given, end_s = (settings, torque, push, world), (k + 1) * tick_s
        x = solve_ivp(
            world_rates, (end_s - tick_s, end_s), x, args=given,
            method="DOP853", rtol=1e-11, atol=1e-12, max_step=1e-3,
        ).y[:, -1]  # fmt: skip
        d_star = car.advance(tick_s, torque, push, rows[k : k + 2])
        read = list(car.witnesses().values())
        expected = [x[2], specific_force(x, *given, time_s=end_s), x[4], x[3]]
        errors.append([d_star - output(x, *given, time_s=end_s), *np.subtract(read, expected)])
        reached.append(expected)
    assert np.abs(reached).max() > 1.0
    assert np.abs(errors).max() < 1e-6


def test_a_world_of_little_strength_acts_as_on_the_linear_car_from_standstill_on():
    """Also where the equations are regular; halving all leaves a quarter of the difference."""
    ticks, tick_s, k = 150, 0.01, np.arange(151)[:, None]
    speeds, friction = 12.0 * (k / ticks) ** 2, 1.0 - 0.5 * np.sin(k / [20.0, 30.0]) ** 2
    push = WORLD * np.sin(k / [17.0, 15.0, 31.0, 9.0])
    changing = changing_plant(CAR, "physics", (IDEAL, IDEAL, IDEAL), 12.0, tick_s)
    times_s = tick_s * k[:, 0]
    within = changing.speeds(lambda at: np.interp(at, times_s, speeds[:, 0]), range(ticks))

    def difference(size):
        world, nonlinear = np.hstack([size * push, friction]), NonlinearCar(CAR)
        memory, found = (np.zeros(4), np.zeros(4), np.zeros((2, 2)), np.zeros(1)), []
        for each in range(ticks):
            rows = world[each : each + 2]
            linear, _ = follow_changing(
                changing.constants, memory, changing.work, within[each], each, size * 30.0, 0.0,
                1.0, 1.0, rows,
            )  # fmt: skip
            around = np.hstack([rows, speeds[each : each + 2]])
            found.append(nonlinear.advance(tick_s, size * 30.0, 0.0, around) - linear)
        return np.abs(found).max()

    differences = [difference(size) for size in (0.02, 0.01, 0.005)]
    assert differences[0] < 1e-2
    for coarse, fine in pairwise(differences):
        assert coarse / fine == pytest.approx(4.0, rel=0.2)


@pytest.mark.parametrize(
    ("torque", "push", "friction"),
    [(40.0, 0, 0.9), (200.0, 500, 0.9), (0, 2989, 0.9), (60, 0, 0.3)],
)
def test_steady_cornering_is_where_a_root_finder_finds_it(torque, push, friction):
    settings = PlantSettings(friction=friction)
    car = NonlinearCar(settings)
    settled = [car.advance(0.01, torque, push) for _ in range(4000)][-1]

    def residual(unknown):
        course, yaw_rate, steer = unknown
        rates = world_rates(0, [0.0, course, yaw_rate, 0.0, steer], settings, torque, push)
        return [rates[1] - yaw_rate, rates[2], rates[3]]

    found = root(residual, [0.0, 0.05, 0.0], tol=1e-13)
    course, yaw_rate, steer = found.x
    assert found.success
    assert settled == pytest.approx(yaw_rate * settings.speed_mps, rel=1e-8)
    assert car.state == pytest.approx([course, yaw_rate, 0.0, steer], rel=1e-7, abs=1e-9)


def test_steady_cornering_without_a_motor_needs_no_front_force():
    """The wheels align until ξ Yf = 0, so X_diff d_r/2 = l_r Yr: 2989 N for 1 m/s², as linear."""
    car = NonlinearCar(CAR)
    push = 2 * CAR.rear_axle_distance_m * CAR.mass_kg / CAR.rear_track_m
    settled = [car.advance(0.01, 0.0, push) for _ in range(4000)][-1]
    assert push == pytest.approx(2989.2, abs=0.1)
    assert settled == pytest.approx(1.0, rel=2e-3)  # cos β is what differs


def test_small_commands_make_it_the_linear_car_with_the_square_of_their_size():
    """The brush's second term is quadratic in the slip; halving the commands leaves a quarter."""
    commands = np.random.default_rng(3).normal(0.0, [40.0, 400.0], (100, 2))

    def difference(size):
        nonlinear, linear = NonlinearCar(CAR), LinearPlant(CAR)
        return max(
            abs(nonlinear.advance(0.02, *pair) - linear.advance(0.02, *pair))
            for pair in size * commands
        )

    differences = [difference(size) for size in (0.1, 0.05, 0.025)]
    assert differences[0] < 1e-2
    for coarse, fine in pairwise(differences):
        assert coarse / fine == pytest.approx(4.0, rel=0.1)


def test_the_integration_is_of_order_4():
    """From a state in which no tire passes zero or full slip within the time: smooth throughout."""
    car, start = car_of(CAR), np.array([-0.02, 0.3, 0.1, 0.06])

    def end(steps):
        state = start.copy()
        _advance(car, state, 0.1 / steps, steps, 60.0, 500.0, calm(CAR))
        return state

    exact = end(4000)
    errors = [np.abs(end(steps) - exact).max() for steps in (10, 20, 40)]
    for coarse, fine in pairwise(errors):
        assert math.log2(coarse / fine) == pytest.approx(4.0, abs=0.2)


def test_a_tick_is_steps_of_at_most_1_ms():
    one, many = NonlinearCar(CAR), NonlinearCar(CAR)
    for torque in (50.0, -80.0):
        for _ in range(10):
            step_by_step = many.advance(0.001, torque, 300.0)
        assert one.advance(0.01, torque, 300.0) == step_by_step
        assert one.state == many.state


def test_a_car_that_creeps_is_right():
    settings = PlantSettings(speed_mps=0.02)
    nonlinear, linear = NonlinearCar(settings), LinearPlant(settings)
    outputs = [(nonlinear.advance(0.01, 1e-3, 0.0), linear.advance(0.01, 1e-3, 0.0))
               for _ in range(100)]  # fmt: skip
    measured, expected = np.array(outputs).T
    assert np.abs(measured - expected).max() < 1e-3 * np.abs(expected).max()


big = st.floats(-5e5, 5e5)


@given(st.lists(st.tuples(big, big), min_size=1, max_size=15), st.floats(0.05, 1.5))
def test_no_command_takes_more_than_friction_from_the_road(commands, friction):
    """With d = 1 the output is the lateral acceleration; mirrored commands mirror the car."""
    settings = PlantSettings(friction=friction, lateral_weight=1.0)
    car, mirrored = NonlinearCar(settings), NonlinearCar(settings)
    for torque, push in commands:
        acceleration = car.advance(0.01, torque, push)
        assert abs(acceleration) <= friction * G * (1 + 1e-12)
        assert mirrored.advance(0.01, -torque, -push) == -acceleration


@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_cornering_saturates_with_friction(friction):
    """Twice the torque is twice the cornering of the linear car, and less and less of this one."""
    settings = PlantSettings(friction=friction)
    torques = friction / 0.9 * np.array([40.0, 80.0, 160.0, 320.0])
    settled = []
    for torque in torques:
        car = NonlinearCar(settings)
        settled.append([car.advance(0.01, torque, 0.0) for _ in range(3000)][-1])
    assert (np.diff(settled / torques) < 0).all()
    assert (np.diff(settled) > 0).all()
    assert 0.5 * friction * G < settled[-1] < friction * G


def test_what_the_rear_wheels_push_they_cannot_hold_sideways():
    """The car slides sideways at the rear: the circle is all that the force follows."""
    settings = PlantSettings(lateral_weight=1.0)
    car = car_of(settings)
    # Front wheels along their own way, so without a force; the rear at full slip.
    beta, yaw_rate = 0.0, 5.0
    steer = math.atan(car.lf * yaw_rate / car.v)
    state = np.array([beta, yaw_rate, 0.0, steer])
    for part, left in ((0.0, 1.0), (0.6, 0.8), (-0.8, 0.6), (1.0, 0.0), (7.0, 0.0)):
        rates = _rates(car, state, 0.0, part * car.grip_r, calm(settings)[0])
        assert rates[4] * car.m == pytest.approx(left * car.grip_r, abs=1e-6)
        push = np.clip(part, -1, 1) * car.grip_r
        moment = car.half_track * push - car.lr * left * car.grip_r
        assert rates[1] * car.j == pytest.approx(moment, abs=1e-6)
    assert car.grip_r == pytest.approx(4849.2, abs=0.1)


@pytest.mark.parametrize("speed", [5.0, 10.0, 30.0])
def test_left_alone_it_comes_to_rest_and_reset_is_at_rest(speed):
    car = NonlinearCar(PlantSettings(speed_mps=speed))
    thrown = [car.advance(0.01, 200.0, 1500.0) for _ in range(30)]
    left_alone = [car.advance(0.01, 0.0, 0.0) for _ in range(3000)]
    assert abs(left_alone[-1]) < 1e-6 * max(map(abs, thrown))
    car.advance(0.01, 1e4, 0.0)
    car.reset()
    assert car.state == (0.0, 0.0, 0.0, 0.0)
    assert car.advance(0.01, 0.0, 0.0) == 0.0


# --- through the rig -----------------------------------------------------------------------------

SHORT = ["duration_s=7.0", "fault.at_s=3.0"]


def test_the_design_that_has_not_seen_it_survives_the_loss_of_its_motor(tmp_path):
    log, _, scenario = record(tmp_path, *SHORT, name="nonlinear-car")
    signals = decoded(log)
    error = np.abs(1.0 - signals["DSTAR_FEEDBACK"])
    assert error[2800:3000].max() < 1e-4
    # X_diff is at its limit for a while; what the model says that this cost is made up for, and is
    # more than these tires would have done with it.
    assert 0.05 < error[3000:].max() < 0.12
    assert error[-500:].max() < 1e-3
    estimate = signals["CONTROLLER_STATUS"]
    assert np.abs(estimate[:3000]).max() > 1e-3  # another car, and no suspicion all the same
    state = frameless(scenario, network_of(scenario)).fault_state
    assert not np.isin(state[:3000], (FaultState.SUSPECTED, FaultState.CONFIRMED)).any()
    assert (state[-500:] == FaultState.CONFIRMED).all()
    assert signals["FORCE_DIFF_CMD"][-1] == pytest.approx(2989.0, rel=0.01)


def test_without_a_limit_below_friction_the_same_loss_spins_it(tmp_path):
    scenario = load("nonlinear-car")
    assert scenario.limits.force_difference_n < car_of(scenario.plant).grip_r
    free = [*SHORT, "limits.force_difference_n=1e6"]
    error = 1.0 - decoded(record(tmp_path, *free, name="nonlinear-car")[0])["DSTAR_FEEDBACK"]
    assert np.abs(error[3000:]).max() > 2.0
    other = record(tmp_path, *free, "plant.kind=steer-by-wire", name="nonlinear-car")[0]
    linear = 1.0 - decoded(other)["DSTAR_FEEDBACK"]
    assert np.abs(linear[3000:]).max() < 0.06  # the linear car knows of no friction
