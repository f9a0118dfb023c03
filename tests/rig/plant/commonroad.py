"""CommonRoad's single-track cars as a plant: ``commonroad-vehicle-models`` from PyPI.

    [plant]
    kind = "tests.rig.plant.commonroad:CommonRoadCar"

    [plant.parameters]
    model = "st"     # or "std", the drift model
    vehicle = 2

They are steered by the rate of an angle; the steering column of the thesis makes one of a torque,
J_s δ̈ = T - C_s δ̇ - ξ Y_f, with the front axle's force Y_f from the car's own lateral motion. The
rear force difference adds its moment to the yaw. The speed is held.
"""

from importlib import import_module

import numpy as np
from vehiclemodels.init_std import init_std
from vehiclemodels.vehicle_dynamics_st import vehicle_dynamics_st
from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

LONGEST_STEP_S = 2.5e-4  # the wheels of the drift model are fast
STEER, SPEED, YAW_RATE, SLIP = 2, 3, 5, 6


class CommonRoadCar:
    """ST or STD with a steering column; ``settings.parameters`` choose model and vehicle."""

    def __init__(self, settings):
        self.settings = settings
        chosen = settings.parameters
        vehicle = f"parameters_vehicle{chosen['vehicle']}"
        self.car = getattr(import_module(f"vehiclemodels.{vehicle}"), vehicle)()
        self.drifts = chosen["model"] == "std"
        self.reset()

    def reset(self):
        start = [0.0, 0.0, 0.0, self.settings.speed_mps, 0.0, 0.0, 0.0]
        self.x = np.array(init_std(start, self.car) if self.drifts else start)
        self.steer_rate = 0.0

    def advance(self, dt_s, torque_nm, force_difference_n):
        steps = int(np.ceil(dt_s / LONGEST_STEP_S - 1e-9))
        for _ in range(steps):
            self._step(dt_s / steps, torque_nm, force_difference_n)
        return self._rates(torque_nm, force_difference_n)[2]

    def signals(self):
        return {
            "side_slip_rad": self.x[SLIP],
            "yaw_rate_rad_per_s": self.x[YAW_RATE],
            "steering_angle_rad": self.x[STEER],
        }

    def _step(self, h_s, torque_nm, force_difference_n):
        """One of Heun's steps; the speed is put back."""
        x, rate = self.x, self.steer_rate
        k1, a1, _ = self._rates(torque_nm, force_difference_n)
        self.x, self.steer_rate = x + h_s * k1, rate + h_s * a1
        k2, a2, _ = self._rates(torque_nm, force_difference_n)
        self.x = x + 0.5 * h_s * (k1 + k2)
        self.x[SPEED] = self.settings.speed_mps
        self.steer_rate = rate + 0.5 * h_s * (a1 + a2)

    def _rates(self, torque_nm, force_difference_n):
        """ẋ, δ̈ and D*."""
        car, own = self.car, self.settings
        dynamics = vehicle_dynamics_std if self.drifts else vehicle_dynamics_st
        rates = np.array(dynamics(self.x.tolist(), [self.steer_rate, 0.0], car))
        v, yaw_rate = self.x[SPEED], self.x[YAW_RATE]
        acceleration = v * (rates[SLIP] + yaw_rate)
        front = (car.b * car.m * acceleration + car.I_z * rates[YAW_RATE]) / (car.a + car.b)
        rates[YAW_RATE] += 0.5 * own.rear_track_m * force_difference_n / car.I_z
        column = torque_nm - own.steering_damping_nms_per_rad * self.steer_rate
        steer_acceleration = (column - own.trail_m * front) / own.steering_inertia_kgm2
        d = own.lateral_weight
        return rates, steer_acceleration, d * acceleration + (1.0 - d) * v * yaw_rate
