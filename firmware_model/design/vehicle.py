"""The car: Tables 3.1 and 3.2, and the state space (3.9)-(3.15) derived from (3.1)-(3.8).

The lateral forces are linear in the slip angles (3.5), (3.6); the speed is constant, so (3.1) drops
out. With Yf, Yr the force of one front tire and of one rear tire, the world's side force F, yaw
moment M, bank angle φ and torque K on the column, and a friction factor μ of each axle:

    a          = (2 Yf + 2 Yr + F)/m             the specific force, which an accelerometer reads
    V (β̇ + γ)  = a + g φ                                            (3.2)
    J γ̇        = 2 l_f Yf - 2 l_r Yr + d_r/2 X_diff + M             (3.3)
    J_s δ̈      = T + K - C_s δ̇ - 2 ξ Yf                             (3.4)
    Yf = μ_f K_f (δ - β - l_f γ/V),   Yr = μ_r K_r (l_r γ/V - β)    (3.5), (3.6)
    D*         = d a + (1 - d) V γ                                  (3.8)

D* is the sensor's: without gravity's part, which no accelerometer reads.

Division by V makes these singular in a standing car. Below ``LOW_SPEED_MPS`` the slips divide by
the regular speed V_r ≥ V instead. With the state β = v_y/V_r and the share s = V/V_r,

    front slip = s δ - β - l_f γ/V_r,   rear slip = l_r γ/V_r - β,   β̇ = (a + g φ)/V_r - s γ.

V_r is twice differentiable, so nothing jumps. Without forces γ = V δ/(l_f + l_r), the kinematic
car; in a standing car the tires only damp.
"""

import math
from dataclasses import dataclass, fields
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from firmware_model.errors import ParameterError, require_positive

Variant = Literal["physics", "published"]
Matrix = NDArray[np.float64]
StateSpace = tuple[Matrix, Matrix, Matrix]

GRAVITY_MPS2: Final = 9.81
LOW_SPEED_MPS: Final = 2.0
"""Below, the slips divide by ``regular_speed``."""

WORLD: Final = ("side_force_n", "yaw_moment_nm", "bank_rad", "steering_kick_nm")
"""The world's inputs F, M, φ and K."""
WITNESSES: Final = (
    "yaw_rate_rad_per_s",
    "specific_force_mps2",
    "steering_angle_rad",
    "steering_rate_rad_per_s",
)
"""What further sensors read: γ, the lateral specific force a, δ and δ̇."""
SPECIFIC_FORCE: Final = 1
"""The row of a."""


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


def dstar(
    lateral_weight: float, lateral_mps2: Matrix, yaw_rate: Matrix, speed_mps: Matrix
) -> Matrix:
    """D* [m/s²] of (3.8) from sensors: d a + (1 - d) V γ, with γ in rad/s; any common shape."""
    return lateral_weight * lateral_mps2 + (1.0 - lateral_weight) * speed_mps * yaw_rate


@dataclass(frozen=True, eq=False)
class WorldInputs:
    """How the world acts on a plant, and what further sensors read: n states, m inputs, r sensors.

    ``ẋ = A x + B u + E w``, ``y = C x + F w``, ``further sensors = rows x + direct w``.

    Attributes:
        e: (n, m), E. For the car m = 4, in the units of ``WORLD``.
        f: (1, m), F of the output before the sensor.
        read: (1, m), F of the sensor's reading; zero for a sensor that lags.
        rows: (r, n). For the car r = 4, in the units of ``WITNESSES``.
        direct: (r, m).
    """

    e: Matrix
    f: Matrix
    read: Matrix
    rows: Matrix
    direct: Matrix


def regular_speed(speed_mps: float) -> float:
    """V_r [m/s]: the speed itself from ``LOW_SPEED_MPS`` on, half of that in a standing car.

    V_r/V_low = 1/2 + r³ - r⁴/2 with r = V/V_low, whose slope is 3r² - 2r³.
    """
    if speed_mps >= LOW_SPEED_MPS:
        return speed_mps
    r = speed_mps / LOW_SPEED_MPS
    return LOW_SPEED_MPS * (0.5 + r * r * r * (1.0 - 0.5 * r))


def vehicle_state_space(parameters: VehicleParameters, variant: Variant = "physics") -> StateSpace:
    """A (4, 4), B (4, 2) and C (1, 4) of (3.9): ``ẋ = A x + B u``, ``D* = C x``.

    States (3.10): slip angle β [rad], yaw rate γ [rad/s], steer rate [rad/s], steer angle δ [rad].
    Inputs (3.11): steering motor torque T [N m], rear driving-force difference X_diff [N].
    Output (3.12): D* [m/s²] of (3.8). ``physics`` is (3.1)-(3.8) worked out; ``published`` has
    l_r in place of l_f in C(1,2), the slip behind the printed numerators (3.35) and (3.36).

    Raises ``ParameterError`` for any other variant.
    """
    return single_track(parameters, variant)[0]


def single_track(
    parameters: VehicleParameters,
    variant: Variant = "physics",
    friction: tuple[float, float] = (1.0, 1.0),
    rolling: tuple[float, float] | None = None,
) -> tuple[StateSpace, WorldInputs]:
    """A, B, C of ``vehicle_state_space``, and the world's inputs with the further sensors.

    Args:
        parameters: the car and its speed.
        variant: of C; raises ``ParameterError`` for an unknown one.
        friction: μ of the front axle and of the rear axle; 1 is dry.
        rolling: V_r [m/s] and s, to take the equations apart; by default those of the speed.
    """
    if variant not in get_args(Variant):
        raise ParameterError(f"variant = {variant!r}: must be one of {get_args(Variant)}")
    m, j = parameters.mass_kg, parameters.yaw_inertia_kgm2
    if rolling is None:
        regular = regular_speed(parameters.speed_mps)
        rolling = regular, parameters.speed_mps / regular
    v, s = rolling
    lf, lr = parameters.front_axle_distance_m, parameters.rear_axle_distance_m
    kf = friction[0] * parameters.front_cornering_stiffness_n_per_rad
    kr = friction[1] * parameters.rear_cornering_stiffness_n_per_rad
    js, cs = parameters.steering_inertia_kgm2, parameters.steering_damping_nms_per_rad
    trail, track, d = parameters.trail_m, parameters.rear_track_m, parameters.lateral_weight

    # (3.5), (3.6) in (3.2): the specific force, row by row of the state.
    acceleration = np.array(
        [-2 * (kf + kr) / m, -2 * (lf * kf - lr * kr) / (m * v), 0.0, s * (2 * kf / m)]
    )
    slip_rate = acceleration / v - np.array([0.0, s, 0.0, 0.0])
    # (3.3) and (3.4) divided by their inertias.
    yaw_acceleration = [
        -2 * (lf * kf - lr * kr) / j,
        -2 * (lf**2 * kf + lr**2 * kr) / (j * v),
        0.0,
        s * (2 * lf * kf / j),
    ]
    alignment = 2 * trail * kf / js
    steer_acceleration = [alignment, alignment * lf / v, -cs / js, -s * alignment]

    a = np.array([slip_rate, yaw_acceleration, steer_acceleration, [0.0, 0.0, 1.0, 0.0]])
    b = np.array([[0.0, 0.0], [0.0, track / (2 * j)], [1 / js, 0.0], [0.0, 0.0]])
    e = np.zeros((4, len(WORLD)))
    e[0] = 1 / (m * v), 0.0, GRAVITY_MPS2 / v, 0.0
    e[1, 1], e[2, 3] = 1 / j, 1 / js
    rows, direct = np.zeros((len(WITNESSES), 4)), np.zeros((len(WITNESSES), len(WORLD)))
    rows[SPECIFIC_FORCE], direct[SPECIFIC_FORCE, 0] = acceleration, 1 / m
    rows[0, 1] = rows[2, 3] = rows[3, 2] = 1.0
    if variant == "published":
        acceleration[1] = -2 * (lr * kf - lr * kr) / (m * v)
    # (3.8): d·a + (1 - d)·V·γ
    c = (d * acceleration + np.array([0.0, (1 - d) * (s * v), 0.0, 0.0]))[np.newaxis, :]
    f = d * direct[SPECIFIC_FORCE : SPECIFIC_FORCE + 1]
    return (a, b, c), WorldInputs(e, f, f, rows, direct)
