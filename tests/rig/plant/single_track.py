"""The single-track car once more, in forces and positions of the plane, for an ODE solver."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from can_rig.scenario.settings import PlantSettings

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
