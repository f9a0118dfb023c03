"""The car: Tables 3.1 and 3.2, and the state space (3.9)-(3.15) derived from (3.1)-(3.8).

The lateral forces are linear in the slip angles (3.5), (3.6); the speed is constant, so (3.1) drops
out. With Yf the force of one front tire, substitution gives each row of A below.
"""

import math
from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from firmware_model.errors import ParameterError, require_positive

Variant = Literal["physics", "published"]
StateSpace = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class VehicleParameters:
    """Table 3.1's symbols with their units in the names, and Table 3.2's values as defaults.

    Raises ``ParameterError`` naming the field, the value and the allowed range: all values are
    finite and positive, but the damping may be zero and the weight lies in 0..1.
    """

    mass_kg: float = 1400.0  # m
    yaw_inertia_kgm2: float = 2457.0  # J
    front_axle_distance_m: float = 1.02  # l_f, front axle to centre of gravity
    rear_axle_distance_m: float = 1.58  # l_r, rear axle to centre of gravity
    rear_track_m: float = 1.48  # d_r
    steering_inertia_kgm2: float = 11.98  # J_s
    steering_damping_nms_per_rad: float = 9.0  # C_s
    front_cornering_stiffness_n_per_rad: float = 33700.0  # K_f, one tire
    rear_cornering_stiffness_n_per_rad: float = 56200.0  # K_r, one tire
    trail_m: float = 0.05  # ξ
    speed_mps: float = 10.0  # V
    lateral_weight: float = 0.5  # d of (3.8): 0 weighs the yaw rate alone, 1 the acceleration

    def __post_init__(self) -> None:
        for field in fields(VehicleParameters):  # a subclass has fields of other kinds
            name, value = field.name, getattr(self, field.name)
            if name == "steering_damping_nms_per_rad":
                if not (math.isfinite(value) and value >= 0):
                    raise ParameterError(f"{name} = {value}: must be finite and >= 0")
            elif name == "lateral_weight":
                if not 0 <= value <= 1:
                    raise ParameterError(f"{name} = {value}: must lie in 0..1")
            else:
                require_positive(name, value)


TABLE_3_2 = VehicleParameters()


def vehicle_state_space(parameters: VehicleParameters, variant: Variant = "physics") -> StateSpace:
    """A (4, 4), B (4, 2) and C (1, 4) of (3.9): ``ẋ = A x + B u``, ``D* = C x``.

    States (3.10): slip angle β [rad], yaw rate γ [rad/s], steer rate [rad/s], steer angle δ [rad].
    Inputs (3.11): steering motor torque T [N m], rear driving-force difference X_diff [N].
    Output (3.12): D* [m/s²] of (3.8). ``physics`` is (3.1)-(3.8) worked out; ``published`` has
    l_r in place of l_f in C(1,2), the slip behind the printed numerators (3.35) and (3.36).

    Raises ``ParameterError`` for any other variant.
    """
    if variant not in get_args(Variant):
        raise ParameterError(f"variant = {variant!r}: must be one of {get_args(Variant)}")
    m, j, v = parameters.mass_kg, parameters.yaw_inertia_kgm2, parameters.speed_mps
    lf, lr = parameters.front_axle_distance_m, parameters.rear_axle_distance_m
    kf = parameters.front_cornering_stiffness_n_per_rad
    kr = parameters.rear_cornering_stiffness_n_per_rad
    js, cs = parameters.steering_inertia_kgm2, parameters.steering_damping_nms_per_rad
    trail, track, d = parameters.trail_m, parameters.rear_track_m, parameters.lateral_weight

    # (3.5), (3.6) in (3.2): V (β̇ + γ), the lateral acceleration, row by row of the state.
    acceleration = np.array(
        [-2 * (kf + kr) / m, -2 * (lf * kf - lr * kr) / (m * v), 0.0, 2 * kf / m]
    )
    slip_rate = acceleration / v - np.array([0.0, 1.0, 0.0, 0.0])
    # (3.3) and (3.4) divided by their inertias.
    yaw_acceleration = [
        -2 * (lf * kf - lr * kr) / j,
        -2 * (lf**2 * kf + lr**2 * kr) / (j * v),
        0.0,
        2 * lf * kf / j,
    ]
    alignment = 2 * trail * kf / js
    steer_acceleration = [alignment, alignment * lf / v, -cs / js, -alignment]

    a = np.array([slip_rate, yaw_acceleration, steer_acceleration, [0.0, 0.0, 1.0, 0.0]])
    b = np.array([[0.0, 0.0], [0.0, track / (2 * j)], [1 / js, 0.0], [0.0, 0.0]])
    if variant == "published":
        acceleration[1] = -2 * (lr * kf - lr * kr) / (m * v)
    # (3.8): d·V(β̇ + γ) + (1 - d)·V·γ
    c = (d * acceleration + np.array([0.0, (1 - d) * v, 0.0, 0.0]))[np.newaxis, :]
    return a, b, c
