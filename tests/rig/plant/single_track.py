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


def world_rates(_, x, p, torque, force_difference):
    """The car anew, in the plane of the road: vectors, headings and courses, slips by atan2.

    States: heading, course (direction of the velocity), yaw rate, steer rate, steer angle.
    """
    heading, course, yaw_rate, steer_rate, steer = x
    lf, lr = p.front_axle_distance_m, p.rear_axle_distance_m
    weight = p.friction * p.mass_kg * G / (lf + lr)  # times the other axle's distance: its grip
    push = np.clip(force_difference, -weight * lf, weight * lf)
    velocity = p.speed_mps * direction(course)
    axles = (
        (lf, heading + steer, 2 * p.front_cornering_stiffness_n_per_rad, weight * lr),
        (-lr, heading, 2 * p.rear_cornering_stiffness_n_per_rad, weight * lf),
    )
    total, moment, front = np.zeros(2), p.rear_track_m * push / 2, 0.0
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
    column = torque - p.steering_damping_nms_per_rad * steer_rate - p.trail_m * front
    return np.array(
        [
            yaw_rate,
            acceleration / p.speed_mps,
            moment / p.yaw_inertia_kgm2,
            column / p.steering_inertia_kgm2,
            steer_rate,
        ]
    )


def output(x, p, *commands):
    """D* of (3.8) in those states."""
    course_rate = world_rates(0.0, x, p, *commands)[1]
    d, v = p.lateral_weight, p.speed_mps
    return d * v * course_rate + (1 - d) * v * x[2]
