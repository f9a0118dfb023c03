"""The plants of the thesis as a class, exact for held commands."""

import numpy as np

from can_rig.scenario.build import continuous_car
from firmware_model.analysis.sampled_plant import follow_plant, sample


class LinearPlant:
    """The built-in plant that the settings name, without actuators and sensor."""

    def __init__(self, settings):
        self._plant = continuous_car(settings)
        self._dt_s = 0.0  # what the matrices are for; the first advance makes them
        self._x = np.zeros(len(self._plant.a))

    def reset(self):
        self._x[:] = 0.0

    def advance(self, dt_s, torque_nm, force_difference_n):
        if dt_s != self._dt_s:
            self._sampled, self._dt_s = sample(self._plant, dt_s), dt_s
        s = self._sampled
        return float(follow_plant(s.phi, s.gamma, s.c, self._x, torque_nm, force_difference_n))

    def signals(self):
        return {"yaw_rate_rad_per_s": float(self._x[1])}
