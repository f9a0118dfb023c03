"""(3.1)-(3.8) in a world that pushes, once more, force by force, for an ODE solver."""

from itertools import pairwise

import numpy as np
from scipy.integrate import quad, solve_ivp

G = 9.81


def regular(speed):
    """V_r of a standing car is 1 m/s; its slope goes smoothly from 0 to 1 at 2 m/s."""
    if speed >= 2.0:
        return speed
    return 1.0 + quad(lambda v: 3 * (v / 2) ** 2 - 2 * (v / 2) ** 3, 0.0, speed)[0]


class Integrated:
    """The car behind two lags of first order and a sensor likewise, with dead times.

    States: β, γ, δ̇, δ, torque and force difference as applied, the sensor's filter.

    Args:
        p: the car's parameters.
        stages: of both actuators and the sensor.
        tick_s: the tick.
        commands: (ticks, 2).
        world: (ticks + 1, 6), straight lines between.
        speed: of the time.
        rtol: of the solver.
    """

    def __init__(self, p, stages, tick_s, commands, world, speed, rtol=1e-11):
        self.p, self.stages, self.tick_s = p, stages, tick_s
        self.commands, self.world, self.speed = np.asarray(commands), np.asarray(world), speed
        ticks = len(commands)
        starts = {round(k * tick_s, 12) for k in range(ticks + 1)}
        for stage in stages[:2]:
            late = {round(k * tick_s + stage.dead_time_s, 12) for k in range(ticks)}
            starts |= {time_s for time_s in late if time_s < ticks * tick_s}
        x, self.parts = np.zeros(7), []
        for begin, end in pairwise(sorted(starts)):
            u = [self.command(channel, 0.5 * (begin + end)) for channel in range(2)]
            solved = solve_ivp(
                self.rates, (begin, end), x, args=(u,), method="DOP853", dense_output=True,
                rtol=rtol, atol=0.01 * rtol,
            )  # fmt: skip
            assert solved.success
            self.parts.append((begin, end, solved.sol, u))
            x = solved.y[:, -1]

    def command(self, channel, time_s):
        k = int(np.floor((time_s - self.stages[channel].dead_time_s) / self.tick_s))
        return self.commands[k, channel] if k >= 0 else 0.0

    def at(self, time_s):
        return [
            np.interp(time_s, self.tick_s * np.arange(len(self.world)), column)
            for column in self.world.T
        ]

    def forces(self, time_s, x):
        """Lateral force of each axle, N, and V, V_r."""
        p, v = self.p, self.speed(time_s)
        *_, front, rear = self.at(time_s)
        v_r = regular(v)
        beta, yaw_rate, _, steer = x[:4]
        v_y = v_r * beta
        slip_f = (v * steer - v_y - p.front_axle_distance_m * yaw_rate) / v_r
        slip_r = (-v_y + p.rear_axle_distance_m * yaw_rate) / v_r
        force_f = 2 * front * p.front_cornering_stiffness_n_per_rad * slip_f
        return force_f, 2 * rear * p.rear_cornering_stiffness_n_per_rad * slip_r, v, v_r

    def accelerometer(self, time_s, x):
        force_f, force_r, *_ = self.forces(time_s, x)
        return (force_f + force_r + self.at(time_s)[0]) / self.p.mass_kg

    def d_star(self, time_s, x):
        d = self.p.lateral_weight
        return d * self.accelerometer(time_s, x) + (1 - d) * self.speed(time_s) * x[1]

    def rates(self, time_s, x, u):
        p = self.p
        side, moment, bank, kick, *_ = self.at(time_s)
        force_f, force_r, v, v_r = self.forces(time_s, x)
        lags = [stage.lag_s for stage in self.stages]
        torque, push = (
            state if lag else given for state, lag, given in zip(x[4:6], lags, u, strict=False)
        )
        turning = (force_f + force_r + side + p.mass_kg * G * bank) / p.mass_kg
        yaw = force_f * p.front_axle_distance_m - force_r * p.rear_axle_distance_m
        yaw += 0.5 * p.rear_track_m * push + moment
        column = torque + kick - p.steering_damping_nms_per_rad * x[2] - p.trail_m * force_f
        return np.array(
            [
                (turning - v * x[1]) / v_r,
                yaw / p.yaw_inertia_kgm2,
                column / p.steering_inertia_kgm2,
                x[2],
                (u[0] - x[4]) / lags[0] if lags[0] else 0.0,
                (u[1] - x[5]) / lags[1] if lags[1] else 0.0,
                (self.d_star(time_s, x) - x[6]) / lags[2] if lags[2] else 0.0,
            ]
        )

    def state(self, time_s):
        if time_s <= 0.0:
            return np.zeros(7)
        part = next(part for part in self.parts if time_s <= part[1] + 1e-12)
        return part[2](time_s)

    def answers(self):
        """Output and reading at the end of each tick, as ``follow`` returns them."""
        sensor, found = self.stages[2], []
        for k in range(len(self.commands)):
            end = (k + 1) * self.tick_s
            seen = end - sensor.dead_time_s
            read = 0.0
            if seen > 0.0:
                x = self.state(seen)
                read = x[6] if sensor.lag_s else self.d_star(seen, x)
            found.append((self.d_star(end, self.state(end)), read))
        return np.array(found)
