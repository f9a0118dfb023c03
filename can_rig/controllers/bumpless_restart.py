"""How a controller that starts while the car drives takes over without a bump.

After a restart or a long sleep, a controller finds actuators at zero, a reference that may be far
from D*, and filter memories that match neither car nor reference. Started from rest, C would answer
the control error with a raw step, and F1 would take the car's remaining motion for a lost channel.
The controller therefore

1. listens for ``LISTEN_S`` and sends no command. After the actuators' hold time no command drives
the car, so D* is the free response of F1's own model of the car. F1 starts from the state of least
energy that explains the received samples (least squares, regularised in the norm of the
observability Gramian by the expected noise): d̂ starts at zero. Under noise, few samples leave the
further motion uncertain, so the decision gets the variance of the predicted motion, and takes no
error within this variance for a fault.
2. starts C at rest, like the actuators, and makes C follow, from the free motion of D*,

       r' = y_free + w (r - y_free),    w = s³(10 - 15 s + 6 s²),  s = t / RETURN_S

   F1 contains the motion y_free already, so C, which works on r' - y + G1 u1, receives r' - y_free.
   The difference starts at zero, with zero slope and curvature, so the torque starts smoothly at
   zero; w is the polynomial of least jerk (Flash and Hogan, J. Neurosci. 5 (1985) 1688). r' is r
   once w is 1 and the motion has faded.

If the motor died before the outage, d̂ shows the loss within a few ticks, at the first small
torques, and X_diff takes over as after any loss.

Actuators that hold a command for longer than half of the listening may still act at the end of
listening. The actuator state is then unknown, so the loop starts at the settled state for D*, with
a standard deviation as large as D*. An unstable plant gets the same start: F1's models are stable,
so no model motion matches the plant's.
"""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from can_rig.controllers.protocol import LISTEN_S, Inputs
from can_rig.scenario.settings import Scenario
from firmware_model.law.filters.biquad import advance, at_rest
from firmware_model.law.layout import Table
from firmware_model.law.structs import FloatArray

RETURN_S: Final = 0.4  # X_diff then keeps below 4000 N for 1 m/s², should the motor be dead
FEWEST_SAMPLES: Final = 10  # of the free response, however long a tick is


class Restarted(Protocol):
    """The controller that takes over: a ``Firmware``."""

    def reset(self, reference: float) -> None:
        """See ``Controller``."""

    def change_speed(self, speed: float) -> None:
        """See ``Firmware``."""

    def move(self, sections: FloatArray, doubt: float) -> None:
        """See ``Firmware``."""


class BumplessRestart:
    """One take-over, from the first received sample to the last tick with r' in place of r.

    Args:
        restarted: the controller that takes over.
        scenario: gives the actuators' hold time and the noise of D*.
        table: the controller's constant table; None: the motion of the plant is unknown.
        lsb: resolution of D* on the wire, m/s².
    """

    def __init__(
        self,
        restarted: Restarted,
        scenario: Scenario,
        table: Table | None = None,
        lsb: float = 0.0,
    ) -> None:
        self._restarted = restarted
        held = round(scenario.actuator.hold_s / scenario.tick_s) + scenario.latency_ticks
        self._listen_ticks = max(round(LISTEN_S / scenario.tick_s), FEWEST_SAMPLES)
        known = (
            table is not None
            and held <= self._listen_ticks // 2
            and table.tracking.stabiliser.n == 0
        )
        self._held_ticks = held if known else None
        self._return_ticks = max(round(RETURN_S / scenario.tick_s), 1)
        self._variance = scenario.model.sensor.noise_mps2**2 + lsb**2 / 12.0
        self._motion: FreeMotion | None = None
        if table is not None:
            self._motion = FreeMotion(table, max(self._listen_ticks, self._return_ticks))
        self._heard: list[float] = []
        self._level = 0.0
        self._since = 0

    @property
    def listens(self) -> bool:
        """Whether the controller still listens and may send no command."""
        return len(self._heard) < self._listen_ticks

    @property
    def done(self) -> bool:
        """Whether r' is r from the next tick on."""
        motion = 0.0 if self._motion is None else self._motion.output
        faded = abs(motion) <= math.sqrt(self._variance)
        return self._since > self._return_ticks and faded

    @property
    def heard_enough(self) -> bool:
        """Whether at most half of the samples of the listening time are missing."""
        return sum(map(math.isfinite, self._heard)) * 2 >= self._listen_ticks

    def hear(self, inputs: Inputs) -> None:
        """Take in D* of a tick without commands."""
        if not math.isnan(inputs.speed_mps):
            self._restarted.change_speed(inputs.speed_mps)
        self._heard.append(inputs.measurement)

    def start(self) -> None:
        """Put the controller where the ticks that were heard have left the car."""
        motion = self._motion
        if self._held_ticks is None or motion is None:
            finite = [y for y in self._heard if math.isfinite(y)]
            self._level = finite[-1] if finite else 0.0
            doubt = self._level**2
        else:
            free = np.array(self._heard[self._held_ticks :])
            doubt = motion.fit(free, self._variance)
        self._restarted.reset(self._level)
        if motion is not None:
            self._restarted.move(motion.sections, doubt)

    def miss(self) -> None:
        """Let a tick pass without a command: the car moves on, r' comes no nearer to r."""
        if self._motion is not None:
            self._motion.advance()

    def reference(self, reference: float) -> float:
        """r' of the next tick, minus the motion in F1's states."""
        s = min(self._since / self._return_ticks, 1.0)
        w = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        self._since += 1
        motion = 0.0 if self._motion is None else self._motion.advance()
        return w * (reference - motion) + (1.0 - w) * self._level


class FreeMotion:
    """The free motion of D*, in the states of F1's first model.

    x⁺ = Φx, y = cx over the section states that the section's input reaches: the second state of a
    first-order section is unreachable.

    Args:
        table: the controller's constant table.
        ticks: the length of the fit and of the prediction.
    """

    def __init__(self, table: Table, ticks: int) -> None:
        cascade = table.estimator.channel_1
        self._index = [
            (i, j)
            for i in range(cascade.n)
            for j in (0, 1)
            if j == 0 or cascade.coefficients[i, 2:5:2].any()
        ]
        order = len(self._index)
        self._phi, self._c = np.zeros((order, order)), np.zeros(order)
        for column, at in enumerate(self._index):
            unit = at_rest()
            unit.accumulators[at] = 1.0
            self._c[column] = advance(cascade, unit, 0.0)
            self._phi[:, column] = [unit.accumulators[i] for i in self._index]
        self.sections: FloatArray = np.zeros_like(unit.accumulators)
        gramian = solve_discrete_lyapunov(self._phi.T, np.outer(self._c, self._c))
        values, vectors = np.linalg.eigh(gramian)
        self._root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T  # W = rootᵀ root
        self._x = np.zeros(order)
        self._free = np.zeros((ticks, order))  # cΦᵏ
        row = self._c
        for k in range(ticks):
            self._free[k] = row
            row = row @ self._phi

    def fit(self, heard: FloatArray, variance: float) -> float:
        """Go to the state after ``heard``, shape (ticks,): D* of successive ticks, nan for a gap.

        The estimated initial state x minimises Σ(y - cΦᵏx)² + λ xᵀWx, with xᵀWx the energy of the
        whole later motion and λ from the ``variance`` of a sample and the received energy: the mean
        of a Gaussian x with that energy.

        Returns:
            the largest variance of the error of D* within ``ticks``.
        """
        there = np.isfinite(heard)
        energy = float(heard[there] @ heard[there])
        if energy == 0.0:
            return 0.0
        weight = math.sqrt(variance * len(self._x) / energy)
        seen = self._free[: len(heard)][there]
        spread = np.linalg.pinv(np.vstack([seen, weight * self._root]))
        spread = np.linalg.matrix_power(self._phi, len(heard)) @ spread
        self._x = spread[:, : len(seen)] @ heard[there]
        for at, value in zip(self._index, self._x, strict=True):
            self.sections[at] = value
        return variance * float(np.max(np.sum((self._free @ spread) ** 2, axis=1)))

    @property
    def output(self) -> float:
        """D* of this tick."""
        return float(self._c @ self._x)

    def advance(self) -> float:
        """D* of this tick, without any driving input."""
        y = self.output
        self._x = self._phi @ self._x
        return y
