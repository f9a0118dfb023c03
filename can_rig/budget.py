"""``design.fault_threshold_mps2 = "from-budget"``: how much d̂ a healthy car may show.

The threshold has to stand above all that makes some d̂ without a fault, and each part is computed
from the scenario, not guessed:

    model         the car as modelled, on the scenario's own reference from its first step on: what
                  the estimator's rule leaves of hold, delay and limits
    cars          what a car of ``budget.box`` adds to that: the vertices of a box around the model
    noise         rms of d̂ from the sensor's noise, times as many sigmas as it takes
    quantisation  one step of D* on the bus

The sigmas: d̂ takes over white noise as it is (F1 knows what the noise makes of the commands, so
only F2 y is left), so it is above z sigmas in m ticks in a row with probability p^m, p that of one
tick. Of the ticks of an hour ``budget.false_alarms_per_hour`` may be the first of such a row.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from can_rig.build import continuous_design, target
from can_rig.messages import Network
from can_rig.reference import reference
from can_rig.settings import Scenario
from can_rig.tuning.box import cars, ranges
from firmware_model.margins import HEALTHY, noise_gain
from firmware_model.plants import Plant
from firmware_model.sampled_loop import linear_controller, sampled_loop
from firmware_model.sampled_plant import sample
from firmware_model.simulation import simulate
from firmware_model.tables import build

MARGIN = 1.2  # between the budget and the threshold
HOUR_S = 3600.0
LEAST_CHANCE = 1e-300  # that a double can halve and invert


@dataclass(frozen=True)
class Budget:
    """Largest |d̂| of a healthy loop by cause, m/s², and the sigmas that the noise was given."""

    model: float
    cars: float
    noise: float
    quantisation: float
    sigmas: float

    @property
    def total(self) -> float:
        """All of it at once."""
        return self.model + self.cars + self.noise + self.quantisation

    @property
    def threshold(self) -> float:
        """What ``from-budget`` stands for."""
        return MARGIN * self.total

    def describe(self, threshold: float, steady_gain: float) -> str:
        """One line: what d̂ shows without a fault, and what a threshold makes of it.

        Args:
            threshold: of |d̂|, m/s².
            steady_gain: of G1 at s = 0, m/s² per N m.
        """
        covered = "covers" if threshold >= self.total else "DOES NOT COVER"
        return (
            f"decision: the threshold of {threshold:.3g} m/s² {covered} what a healthy car shows, "
            f"{self.total:.3g}: model {self.model:.2g}, other cars {self.cars:.2g}, noise "
            f"{self.noise:.2g} ({self.sigmas:.1f} sigma), one step of D* {self.quantisation:.0e}; "
            f"a loss shows from |torque| = {threshold / abs(steady_gain):.2g} N m on"
        )


def budget(scenario: Scenario, network: Network) -> Budget:
    """The parts of the budget of ``scenario``; its threshold does not count.

    Raises:
        ScenarioError: a design or a box that cannot be made.
    """
    place = replace(target(scenario, network), threshold=math.inf, lsb_1=0.0, lsb_2=0.0)
    table = build(continuous_design(scenario), place)
    wanted = reference(scenario)
    share = scenario.budget.box
    some = cars(scenario.model, ranges(scenario.model, share))

    def largest(car: Plant) -> float:
        estimate = simulate(table, sample(car, scenario.tick_s), wanted).fault_estimate
        return float(np.abs(estimate).max())  # finite: commands are limited, cars are stable

    nominal, *others = (largest(car.plant) for car in some)
    sigmas = noise = 0.0
    if scenario.noise.dstar_rms_mps2 > 0.0:
        loop = sampled_loop(linear_controller(table), some[0].plant, scenario.tick_s, HEALTHY)
        sigmas = sigmas_for(
            scenario.budget.false_alarms_per_hour, scenario.tick_s, int(table.confirm_ticks)
        )
        noise = sigmas * noise_gain(loop, 2) * scenario.noise.dstar_rms_mps2
    return Budget(
        model=nominal,
        cars=max([nominal, *others]) - nominal,
        noise=noise,
        quantisation=network.feedback.lsb,
        sigmas=sigmas,
    )


def sigmas_for(false_alarms_per_hour: float, tick_s: float, confirm_ticks: int) -> float:
    """z with (ticks of an hour) p^m = false alarms, p the chance of a tick beyond ±z sigmas."""
    p = (false_alarms_per_hour * tick_s / HOUR_S) ** (1.0 / confirm_ticks)
    return -NormalDist().inv_cdf(min(max(p, LEAST_CHANCE), 1.0) / 2.0)
