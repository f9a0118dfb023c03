"""The threshold budget, ``design.fault_threshold_mps2 = "from-budget"``: d̂ of a healthy car.

The threshold must be above everything that contributes to d̂ without a fault. Each contribution is
computed from the scenario:

    model         the car as modelled, on the scenario's own reference from its first step on: what
                  the estimator's discretisation rule leaves of hold, delay and limits
    noise         rms of d̂ due to the sensor's noise, times the necessary number of sigmas
    quantisation  one LSB of D* on the bus

Cars that differ from the model contribute to the share instead: what a car of ``budget.box`` shows
is a share of what the torque does, and ``design.fault_threshold_share`` must be above that. It is
the largest over the vertices of a box around the model, on the scenario's own reference, as the
firmware itself computes it.

The sigmas: white noise reaches d̂ unfiltered (F1 accounts for what the noise makes of the commands,
which leaves F2 y), so |d̂| is beyond z sigmas in m ticks in a row with probability p^m, where p is
that of a single tick. Of the ticks of an hour, ``budget.false_alarms_per_hour`` may begin such a
row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from can_rig.assessment.tuning.box import Car, cars, parameter_ranges
from can_rig.frames.network import Network
from can_rig.scenario.build import continuous_design, target
from can_rig.scenario.reference import LANE_CHANGE_S, reference
from can_rig.scenario.settings import DesignSettings, Scenario
from firmware_model.analysis.margins import HEALTHY, noise_gain
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import Trace, simulate
from firmware_model.discretisation.tables import build
from firmware_model.target.structs import FloatArray, Record

NO_DETECTION = 1e9  # a share with which no d̂ exceeds the adaptive threshold
SAFETY_FACTOR = 1.2  # of the threshold over the budget
HOUR_S = 3600.0
MIN_PROBABILITY = 1e-300  # that a double can halve and invert
SETTLED_S = 60.0  # every transient of a car and every fading peak has decayed by then
PERIODS = 10.0  # of a sine, after which it shows nothing new

OnCar = Callable[[int, int], None]
"""Called with the number of cars that have been simulated, and of all that will be."""


@dataclass(frozen=True)
class ThresholdBudget:
    """Largest |d̂| of a healthy loop by cause, m/s², and the sigmas that the noise is given.

    ``cars`` is what other cars show, as a share of what the torque does, without a unit.
    """

    model: float
    noise: float
    quantisation: float
    sigmas: float
    cars: float

    @property
    def total(self) -> float:
        """What the threshold must cover if all causes coincide, m/s²."""
        return self.model + self.noise + self.quantisation

    @property
    def threshold(self) -> float:
        """What ``from-budget`` stands for, m/s²."""
        return SAFETY_FACTOR * self.total

    @property
    def share(self) -> float:
        """The ``fault_threshold_share`` that ``from-budget`` asks for at least."""
        return SAFETY_FACTOR * self.cars

    def describe(self, chosen: DesignSettings, box: float, steady_gain: float) -> Iterator[str]:
        """Whether the thresholds cover d̂ of a healthy car, a line for each of them.

        Args:
            chosen: has both thresholds.
            box: by how much the parameters of other cars may differ, 0.2 for ±20 %.
            steady_gain: G1(0), m/s² per N m.
        """
        threshold, share = chosen.fault_threshold_mps2, chosen.fault_threshold_share
        yield (
            f"decision: the threshold of {threshold:.3g} m/s² {_covers(threshold, self.total)} "
            f"what the modelled car shows without a fault, {self.total:.3g}: model "
            f"{self.model:.2g}, noise {self.noise:.2g} ({self.sigmas:.1f} sigma), one LSB of D* "
            f"{self.quantisation:.0e}; a loss can be detected where |torque| is above "
            f"{threshold / abs(steady_gain):.2g} N m"
        )
        if box > 0.0:
            yield (
                f"other cars: the share of {share:.3g} {_covers(share, self.cars)} what cars "
                f"within ±{box:.0%} show on this drive, {self.cars:.2g} of what the torque does"
            )
        elif share == 0.0:
            yield (
                "other cars: none: a car whose d̂ exceeds the threshold is taken for a loss; "
                "design.fault_threshold_share allows for such cars, budget.box says which"
            )


def threshold_budget(
    scenario: Scenario, network: Network, on_car: OnCar = lambda done, of: None
) -> ThresholdBudget:
    """The contributions to d̂ of a healthy car in ``scenario``.

    The scenario's own threshold matters for ``cars`` alone, where it is above what the budget asks
    for: only d̂ beyond the threshold counts against the share.

    Args:
        scenario: a reference of hours takes minutes: every car drives all of it.
        network: of the scenario.
        on_car: told after each car.

    Raises:
        ScenarioError: a design or a box that cannot be made.
    """
    place = replace(target(scenario, network), threshold=math.inf, lsb_1=0.0, lsb_2=0.0)
    table = build(continuous_design(scenario), place)
    drive = _drive(scenario)
    nominal, *others = cars(scenario.model, parameter_ranges(scenario.model, scenario.budget.box))

    def healthy(table: Record, car: Car, number: int) -> Trace:
        trace = simulate(table, sample(car.plant, scenario.tick_s), drive)
        on_car(number, 1 + len(others))
        return trace

    sigmas = noise = 0.0
    if scenario.noise.dstar_rms_mps2 > 0.0:
        loop = sampled_loop(linear_controller(table), nominal.plant, scenario.tick_s, HEALTHY)
        sigmas = sigmas_for(
            scenario.budget.false_alarms_per_hour,
            scenario.tick_s,
            int(table.decision.confirm_ticks),
        )
        noise = sigmas * noise_gain(loop, 2) * scenario.noise.dstar_rms_mps2
        if others:  # then Hd̂ counts too, and H amplifies white noise a little
            noise *= math.sqrt(2.0 / (1.0 + float(table.adaptive_threshold.change_memory)))
    found = ThresholdBudget(
        model=float(np.abs(healthy(table, nominal, 1).fault_estimate).max()),  # finite: limited
        noise=noise,
        quantisation=network.feedback.lsb,
        sigmas=sigmas,
        cars=0.0,
    )
    floor = max(found.threshold, scenario.design.fault_threshold_mps2)
    table = build(
        continuous_design(scenario), replace(place, threshold=floor, model_share=NO_DETECTION)
    )
    shown = (
        float(healthy(table, car, number).share_shown.max()) for number, car in enumerate(others, 2)
    )
    return replace(found, cars=max(shown, default=0.0))


def _drive(scenario: Scenario) -> FloatArray:
    """The reference, (ticks,), for as long as it makes a healthy car do anything new."""
    period_s = 2.0 * math.pi / scenario.reference.frequency_rad_per_s
    new_until_s = {
        "step": 0.0,
        "sine": PERIODS * period_s,
        "lane-change": LANE_CHANGE_S + 2.5 * period_s,
        "csv": scenario.duration_s,
    }[scenario.reference.kind]
    duration_s = min(scenario.duration_s, new_until_s + SETTLED_S)
    return reference(replace(scenario, duration_s=duration_s))


def _covers(value: float, needed: float) -> str:
    return "covers" if value >= needed else "DOES NOT COVER"


def sigmas_for(false_alarms_per_hour: float, tick_s: float, confirm_ticks: int) -> float:
    """z with (ticks of an hour) p^m = false alarms, p the chance of a tick beyond ±z sigmas."""
    p = (false_alarms_per_hour * tick_s / HOUR_S) ** (1.0 / confirm_ticks)
    return -NormalDist().inv_cdf(min(max(p, MIN_PROBABILITY), 1.0) / 2.0)
