"""The nonlinear car against an ODE solver, bristles and the linear car."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from can_rig.plant.frameless import frameless
from can_rig.plant.nonlinear_car import NonlinearCar, _advance, _rates, brush, car_of
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import PlantSettings
from firmware_model.analysis.changing_plant import changing_plant, follow_changing
from firmware_model.design.actuator_dynamics import IDEAL
from firmware_model.law.status import FaultState
from tests.rig.plant.linear import LinearPlant

# --- the car once more, in forces and positions of the plane ------------------------------------

G = 9.81
CAR = PlantSettings()
stiffnesses, grips = st.floats(1e3, 2e5), st.floats(1e2, 2e4)
speeds = st.floats(-30.0, 30.0).map(lambda v: round(v, 9))  # no subnormal quotients


def perpendicular(vector):
    return np.array([-vector[1], vector[0]])


def direction(angle):
    return np.array([math.cos(angle), math.sin(angle)])


def tire(slip, stiffness, grip):
    """Fiala's force at a slip angle, as the textbook prints it; a wheel may roll backward."""
    t = math.tan(math.asin(math.sin(slip)))
    if abs(t) >= 3 * grip / stiffness:
        return math.copysign(grip, t)
    cubic = stiffness**3 * t**3 / (27 * grip**2)
    return stiffness * t - stiffness**2 * t * abs(t) / (3 * grip) + cubic


def calm(p):
    """The world that pushes nothing, at the begin and at the end of a step."""
    return np.tile([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, p.speed_mps], (2, 1))


def world_rates(time_s, x, p, torque, force_difference, world=None):
    """The car anew, in the plane of the road: vectors, headings and courses, slips by atan2.

    States: heading, course (direction of the velocity), yaw rate, steer rate, steer angle. At a
    time ``world`` has side force, yaw moment, bank, torque on the column, both frictions, speed.
    """
    heading, course, yaw_rate, steer_rate, steer = x
    lf, lr = p.front_axle_distance_m, p.rear_axle_distance_m
    side, turning, bank, kick, mu_f, mu_r, speed = calm(p)[0] if world is None else world(time_s)
    weight = p.friction * p.mass_kg * G / (lf + lr)  # times the other axle's distance: its grip
    push = np.clip(force_difference, -mu_r * weight * lf, mu_r * weight * lf)
    velocity = speed * direction(course)
    stiff_f, stiff_r = p.front_cornering_stiffness_n_per_rad, p.rear_cornering_stiffness_n_per_rad
    axles = (
        (lf, heading + steer, 2 * mu_f * stiff_f, mu_f * weight * lr),
        (-lr, heading, 2 * mu_r * stiff_r, mu_r * weight * lf),
    )
    total = (side + p.mass_kg * G * math.sin(bank)) * perpendicular(direction(heading))
    moment, front = p.rear_track_m * push / 2 + turning, 0.0
    for at, wheel_heading, stiffness, grip in axles:
        if at < 0:
            grip = math.sqrt(grip**2 - push**2)  # noqa: PLW2901
        lever = at * direction(heading)
        moving = velocity + yaw_rate * perpendicular(lever)
        wheel = direction(wheel_heading)
        slip = -math.atan2(moving @ perpendicular(wheel), moving @ wheel)
        size = tire(slip, stiffness, grip)
        force = size * perpendicular(wheel)
        total += force
        moment += lever[0] * force[1] - lever[1] * force[0]
        front = size if at > 0 else front
    acceleration = total @ perpendicular(direction(course)) / p.mass_kg
    column = torque + kick - p.steering_damping_nms_per_rad * steer_rate - p.trail_m * front
    return np.array(
        [
            yaw_rate,
            acceleration / speed,
            moment / p.yaw_inertia_kgm2,
            column / p.steering_inertia_kgm2,
            steer_rate,
        ]
    )


def specific_force(x, p, *commands, time_s=0.0):
    """What turns the course, without gravity's part, m/s²."""
    world = commands[2](time_s) if len(commands) > 2 else calm(p)[0]
    course_rate = world_rates(time_s, x, p, *commands)[1]
    return world[6] * course_rate - G * math.sin(world[2]) * math.cos(x[1] - x[0])


def output(x, p, *commands, time_s=0.0):
    """D* of (3.8) in those states."""
    v = commands[2](time_s)[6] if len(commands) > 2 else p.speed_mps
    d = p.lateral_weight
    return d * specific_force(x, p, *commands, time_s=time_s) + (1 - d) * v * x[2]


# --- the tire ------------------------------------------------------------------------------------


@pytest.mark.parametrize("slip", [1e-4, 0.01, 0.05, 0.1, 0.2, 0.3, 0.35, 1.2])
def test_the_tire_is_bristles_that_stick_until_friction_is_reached(slip):
    """Each bristle, 2/n of the contact, bends with its way from the front or slides."""
    stiffness, grip, count = 67400.0, 7506.0, 200_000
    way = (np.arange(count) + 0.5) * 2.0 / count  # contact from 0 to 2
    sticking = stiffness / 2.0 * math.tan(slip) * way
    sliding = 0.75 * grip * (1.0 - (way - 1.0) ** 2)  # a parabola that sums to the grip
    expected = np.minimum(sticking, sliding).mean() * 2.0
    assert brush(stiffness, grip, math.cos(slip), -math.sin(slip)) == pytest.approx(expected, 1e-8)


@given(stiffnesses, grips, speeds.filter(lambda v: abs(v) > 0.1), speeds)
def test_a_tire_is_odd_bounded_and_never_pushes(stiffness, grip, along, across):
    force = brush(stiffness, grip, along, across)
    assert brush(stiffness, grip, along, -across) == -force
    assert brush(stiffness, grip, -along, across) == force  # a wheel that rolls backward
    assert abs(force) <= grip * (1 + 1e-12)
    assert abs(force) <= stiffness * abs(across / along) * (1 + 1e-12)
    assert force * across <= 0.0


# --- the car -------------------------------------------------------------------------------------


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

SHORT = ["duration_s=4.5", "fault.at_s=2.0"]


def driven(*settings):
    scenario = load("nonlinear-car", [*SHORT, *settings])
    trace = frameless(scenario)
    return trace, np.abs(1.0 - trace.measured)


def test_the_design_that_has_not_seen_it_survives_the_loss_of_its_motor():
    trace, error = driven()
    assert error[1900:2000].max() < 1e-4
    # X_diff is at its limit for a while; the compensation makes up for the model's estimate of the
    # cost, and these tires would have cost less.
    assert 0.05 < error[2000:].max() < 0.12
    assert error[-300:].max() < 1e-3
    # another car, and no suspicion all the same
    assert np.abs(trace.fault_estimate[:2000]).max() > 1e-3
    state = trace.fault_state
    assert not np.isin(state[:2000], (FaultState.SUSPECTED, FaultState.CONFIRMED)).any()
    assert (state[-300:] == FaultState.CONFIRMED).all()
    assert trace.command_2[-1] == pytest.approx(2989.0, rel=0.01)


def test_without_a_limit_below_friction_the_same_loss_spins_it():
    scenario = load("nonlinear-car")
    assert scenario.limits.force_difference_n < car_of(scenario.plant).grip_r
    _, error = driven("limits.force_difference_n=1e6")
    assert error[2000:].max() > 2.0
    _, linear = driven("limits.force_difference_n=1e6", "plant.kind=steer-by-wire")
    assert linear[2000:].max() < 0.06  # the linear car knows of no friction
