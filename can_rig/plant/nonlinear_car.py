"""A car beyond the design's model: nonlinear tires, nonlinear angles, the thesis's parameters.

A single-track car at a given speed V, steered by a motor torque on a free steering column. With
the slip angle β, the yaw rate γ, the steer angle δ, Yf and Yr the lateral forces of a whole axle,
and the world's side force F, yaw moment M, bank angle φ and torque K on the column:

    a         = (Yf cos(δ - β) + (Yr + F) cos β)/m    the specific force across the course
    V (β̇ + γ) = a + g sin φ cos β                     what turns the course; (3.2)
    J γ̇       = l_f Yf cos δ - l_r Yr + d_r/2 X_diff + M        (3.3)
    J_s δ̈     = T + K - C_s δ̇ - ξ Yf                            (3.4)
    D*        = d a + (1 - d) V γ                               (3.8)

(3.1) drops out: a force along the course holds the speed. Small angles and stiff tires turn these
into ``vehicle.single_track``, the ``physics`` car. As there, below ``LOW_SPEED_MPS`` V_r replaces V
in V β̇, in V sin β and in the tires' rolling speed. What it leaves out: load transfer, relaxation
lengths, the pneumatic trail's own change, steering stops and drive force beyond X_diff.

Tires are Fiala's brush (Pacejka, "Tire and Vehicle Dynamics", 3.2): bristles of a parabolic
contact stick until friction μ F_z is reached, from the trailing edge on. The world's friction
factors multiply both the friction and the stiffness of an axle.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from can_rig.scenario.plant_settings import PlantSettings
from firmware_model.compiled import compiled
from firmware_model.design.vehicle import (
    GRAVITY_MPS2,
    WITNESSES,
    regular_speed,
    vehicle_state_space,
)
from firmware_model.law.structs import FloatArray

LONGEST_STEP_S = 1e-3
STEP_OF_FASTEST_MODE = 0.1


class Car(NamedTuple):
    """Parameters of the equations, in their symbols; one stiffness covers both tires of an axle."""

    m: float  # kg
    j: float  # kg m²
    lf: float  # m
    lr: float  # m
    half_track: float  # m
    js: float  # kg m²
    cs: float  # N m s/rad
    trail: float  # m
    v: float  # m/s
    d: float
    stiffness_f: float  # N/rad, the slope at zero slip
    stiffness_r: float  # N/rad
    grip_f: float  # N, μ times the static load of the axle
    grip_r: float  # N


def car_of(settings: PlantSettings) -> Car:
    """Table 3.1's parameters; K_f and K_r of (3.5), (3.6) belong to one tire."""
    lf, lr = settings.front_axle_distance_m, settings.rear_axle_distance_m
    grip = settings.friction * settings.mass_kg * GRAVITY_MPS2
    return Car(
        m=settings.mass_kg,
        j=settings.yaw_inertia_kgm2,
        lf=lf,
        lr=lr,
        half_track=settings.rear_track_m / 2,
        js=settings.steering_inertia_kgm2,
        cs=settings.steering_damping_nms_per_rad,
        trail=settings.trail_m,
        v=settings.speed_mps,
        d=settings.lateral_weight,
        stiffness_f=2 * settings.front_cornering_stiffness_n_per_rad,
        stiffness_r=2 * settings.rear_cornering_stiffness_n_per_rad,
        grip_f=grip * lr / (lf + lr),
        grip_r=grip * lf / (lf + lr),
    )


class NonlinearCar:
    """``plant.kind = "can_rig.plant.nonlinear_car:NonlinearCar"``; see ``plant_protocol``.

    Runge and Kutta's fourth order in equal steps of at most 1 ms, and of at most a tenth of the
    linear car's fastest time constant: an error of 0.1⁵/120 ≈ 1e-7 of a mode a step at worst. At 10
    m/s the fastest mode is 16 rad/s and the error 1e-11. Modes slow down at most as 1/V_r.
    """

    def __init__(self, settings: PlantSettings) -> None:
        self._car = car_of(settings)
        fastest = float(np.abs(np.linalg.eigvals(vehicle_state_space(settings)[0])).max())
        self._part_s = STEP_OF_FASTEST_MODE / fastest
        self._calm = np.tile([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, settings.speed_mps], (2, 1))
        self._state = np.zeros(4)
        self._specific_force = 0.0

    @property
    def state(self) -> tuple[float, float, float, float]:
        """β [rad], γ [rad/s], δ̇ [rad/s], δ [rad], in the order of (3.10)."""
        beta, yaw_rate, steer_rate, steer = self._state.tolist()
        return beta, yaw_rate, steer_rate, steer

    def reset(self) -> None:
        """Straight ahead."""
        self._state[:] = 0.0
        self._specific_force = 0.0

    def signals(self) -> dict[str, float]:
        """β, γ and δ."""
        beta, yaw_rate, _, steer = self.state
        return {"side_slip_rad": beta, "yaw_rate_rad_per_s": yaw_rate, "steering_angle_rad": steer}

    def witnesses(self) -> dict[str, float]:
        """What further sensors read, by the names ``WITNESSES``."""
        _, yaw_rate, steer_rate, steer = self.state
        values = (yaw_rate, self._specific_force, steer, steer_rate)
        return dict(zip(WITNESSES, values, strict=True))

    def advance(
        self,
        dt_s: float,
        torque_nm: float,
        force_difference_n: float,
        world: FloatArray | None = None,
    ) -> float:
        """D* [m/s²] ``dt_s`` seconds later, both commands [N m], [N] held until then.

        ``world`` (2, 7) has ``vehicle.WORLD``, the friction factors of both axles and the speed
        [m/s], now and at the end, on straight lines between; None: calm, dry, the settings' speed.
        """
        if world is None:
            world, part_s = self._calm, self._part_s
        else:
            slowest, roughest = world[:, 6].min(), max(1.0, world[:, 4:6].max())
            slower = regular_speed(slowest) / (regular_speed(self._car.v) * roughest)
            part_s = self._part_s * min(1.0, slower)
        steps = max(1, math.ceil(dt_s / min(LONGEST_STEP_S, part_s) - 1e-9))
        output, self._specific_force = _advance(
            self._car, self._state, dt_s / steps, steps, torque_nm, force_difference_n, world
        )
        return float(output)


@compiled
def brush(stiffness: float, grip: float, along: float, across: float) -> float:
    """Lateral force [N] of an axle whose wheels roll at ``along`` and slide at ``across`` [m/s].

    With t = -across/|along| = tan α, C the stiffness and G the grip:

        Y = Ct - C²|t|t/(3G) + C³t³/(27G²)  while |t| < 3G/C,  then G, against the sliding.
    """
    if stiffness * abs(across) >= 3.0 * grip * abs(along):
        return -math.copysign(grip, across)
    part = -stiffness * across / (3.0 * grip * abs(along))  # share of the slip at full sliding
    return 3.0 * grip * part * (1.0 - abs(part) + part * part / 3.0)


_regular_speed = compiled(regular_speed)


@compiled
def _rates(car: Any, state: Any, torque: float, force_difference: float, world: Any) -> Any:
    """β̇, γ̇, δ̈, δ̇, D* as the fifth and a as the sixth; ``world`` (7,) as in ``advance``.

    The rear wheels push with ±X_diff/2. A longitudinal push reduces the lateral grip: a wheel's
    friction circle leaves √((μ F_z)² - (X_diff/2)²), and no wheel pushes harder than μ F_z.
    """
    beta, yaw_rate, steer_rate, steer = state[0], state[1], state[2], state[3]
    side_force, moment, bank, kick = world[0], world[1], world[2], world[3]
    front, rear, v = world[4], world[5], world[6]
    grip = rear * car.grip_r
    push = min(max(force_difference, -grip), grip)
    grip_r = math.sqrt(grip**2 - push**2)

    v_r = _regular_speed(v)
    along = v * math.cos(beta)  # of the body, at either axle
    rolling = v_r * math.cos(beta)
    across_f = v_r * math.sin(beta) + car.lf * yaw_rate
    across_r = v_r * math.sin(beta) - car.lr * yaw_rate
    wheel_along = rolling * math.cos(steer) + across_f * math.sin(steer)
    wheel_across = across_f * math.cos(steer) - along * math.sin(steer)
    force_f = brush(front * car.stiffness_f, front * car.grip_f, wheel_along, wheel_across)
    force_r = brush(rear * car.stiffness_r, grip_r, rolling, across_r)

    across = force_f * math.cos(steer - beta) + force_r * math.cos(beta)
    acceleration = (across + side_force * math.cos(beta)) / car.m
    turning = acceleration + GRAVITY_MPS2 * math.sin(bank) * math.cos(beta)
    yaw_moment = car.lf * force_f * math.cos(steer) - car.lr * force_r + car.half_track * push
    column_moment = torque - car.cs * steer_rate - car.trail * force_f
    return np.array(
        [
            turning / v_r - v / v_r * yaw_rate,
            (yaw_moment + moment) / car.j,
            (column_moment + kick) / car.js,
            steer_rate,
            car.d * acceleration + (1.0 - car.d) * v * yaw_rate,
            acceleration,
        ]
    )


@compiled
def _advance(
    car: Any, state: Any, step_s: float, steps: int, torque: float, push: float, world: Any
) -> tuple[float, float]:
    """``steps`` classical Runge-Kutta steps, the state in place; D* and a at their end."""
    begin, rise = world[0], world[1] - world[0]
    for step in range(steps):
        now = begin + step / steps * rise
        half = begin + (step + 0.5) / steps * rise
        then = begin + (step + 1) / steps * rise
        k1 = _rates(car, state, torque, push, now)[:4]
        k2 = _rates(car, state + step_s / 2.0 * k1, torque, push, half)[:4]
        k3 = _rates(car, state + step_s / 2.0 * k2, torque, push, half)[:4]
        k4 = _rates(car, state + step_s * k3, torque, push, then)[:4]
        state += step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    end = _rates(car, state, torque, push, world[1])
    return end[4], end[5]
