"""``design.fault_threshold_mps2 = "from-budget"``: how much d̂ a healthy car may show.

The threshold has to stand above all that makes some d̂ without a fault, and each part is computed
from the scenario, not guessed:

    model         the car as modelled, on the scenario's own reference from its first step on: what
                  the estimator's rule leaves of hold, delay and limits
    noise         rms of d̂ from the sensor's noise, times as many sigmas as it takes
    quantisation  one step of D* on the bus

Other cars do not count there. What a car of ``budget.box`` shows is a share of what the torque
does, and ``design.fault_threshold_share`` has to be above that: the largest of the vertices of a
box around the model, on the scenario's own reference, as the firmware itself sees it.

The sigmas: d̂ takes over white noise as it is (F1 knows what the noise makes of the commands, so
only F2 y is left), so it is above z sigmas in m ticks in a row with probability p^m, p that of one
tick. Of the ticks of an hour ``budget.false_alarms_per_hour`` may be the first of such a row.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from can_rig.assessment.tuning.box import Car, cars, ranges
from can_rig.frames.network import Network
from can_rig.scenario.build import continuous_design, target
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import DesignSettings, Scenario
from firmware_model.analysis.margins import HEALTHY, noise_gain
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import Trace, simulate
from firmware_model.discretisation.tables import build
from firmware_model.target.structs import Record

IGNORED = 1e9  # a share at which no d̂ is too much
MARGIN = 1.2  # between the budget and the threshold
HOUR_S = 3600.0
LEAST_CHANCE = 1e-300  # that a double can halve and invert


@dataclass(frozen=True)
class Budget:
    """Largest |d̂| of a healthy loop by cause, m/s², and the sigmas that the noise was given.

    ``cars`` is a share of what the torque does, without a unit.
    """

    model: float
    noise: float
    quantisation: float
    sigmas: float
    cars: float

    @property
    def total(self) -> float:
        """All that the threshold has to cover, at once, m/s²."""
        return self.model + self.noise + self.quantisation

    @property
    def threshold(self) -> float:
        """What ``from-budget`` stands for, m/s²."""
        return MARGIN * self.total

    @property
    def share(self) -> float:
        """What ``from-budget`` makes of ``fault_threshold_share``."""
        return MARGIN * self.cars

    def describe(self, chosen: DesignSettings, box: float, steady_gain: float) -> Iterator[str]:
        """What d̂ shows without a fault and what the thresholds make of it, a line each.

        Args:
            chosen: with both thresholds.
            box: by how much other cars may be off.
            steady_gain: of G1 at s = 0, m/s² per N m.
        """
        threshold, share = chosen.fault_threshold_mps2, chosen.fault_threshold_share
        yield (
            f"decision: the threshold of {threshold:.3g} m/s² {_covers(threshold, self.total)} "
            f"what the modelled car shows without a fault, {self.total:.3g}: model "
            f"{self.model:.2g}, noise {self.noise:.2g} ({self.sigmas:.1f} sigma), one step of D* "
            f"{self.quantisation:.0e}; a loss shows from |torque| = "
            f"{threshold / abs(steady_gain):.2g} N m on"
        )
        if box > 0.0:
            yield (
                f"other cars: the share of {share:.3g} {_covers(share, self.cars)} what cars "
                f"±{box:.0%} show on this drive, {self.cars:.2g} of what the torque does"
            )
        elif share == 0.0:
            yield (
                "other cars: none: one whose d̂ passes the threshold is taken for a loss; "
                "design.fault_threshold_share would allow for it, and budget.box says how much"
            )


def budget(scenario: Scenario, network: Network) -> Budget:
    """The parts of the budget of ``scenario``.

    Its own threshold counts for ``cars`` alone, where it is above what the budget asks for: what is
    below it is no matter of the share.

    Raises:
        ScenarioError: a design or a box that cannot be made.
    """
    place = replace(target(scenario, network), threshold=math.inf, lsb_1=0.0, lsb_2=0.0)
    table = build(continuous_design(scenario), place)
    wanted = reference(scenario)
    nominal, *others = cars(scenario.model, ranges(scenario.model, scenario.budget.box))

    def healthy(table: Record, car: Car) -> Trace:
        return simulate(table, sample(car.plant, scenario.tick_s), wanted)

    sigmas = noise = 0.0
    if scenario.noise.dstar_rms_mps2 > 0.0:
        loop = sampled_loop(linear_controller(table), nominal.plant, scenario.tick_s, HEALTHY)
        sigmas = sigmas_for(
            scenario.budget.false_alarms_per_hour,
            scenario.tick_s,
            int(table.decision.confirm_ticks),
        )
        noise = sigmas * noise_gain(loop, 2) * scenario.noise.dstar_rms_mps2
        if others:  # what counts then is Hd̂ too, and H passes on a little more of white noise
            noise *= math.sqrt(2.0 / (1.0 + float(table.adaptive_threshold.change_memory)))
    found = Budget(
        model=float(np.abs(healthy(table, nominal).fault_estimate).max()),  # finite: limited
        noise=noise,
        quantisation=network.feedback.lsb,
        sigmas=sigmas,
        cars=0.0,
    )
    floor = max(found.threshold, scenario.design.fault_threshold_mps2)
    table = build(continuous_design(scenario), replace(place, threshold=floor, model_share=IGNORED))
    shown = (float(healthy(table, car).share_shown.max()) for car in others)
    return replace(found, cars=max(shown, default=0.0))


def _covers(value: float, needed: float) -> str:
    return "covers" if value >= needed else "DOES NOT COVER"


def sigmas_for(false_alarms_per_hour: float, tick_s: float, confirm_ticks: int) -> float:
    """z with (ticks of an hour) p^m = false alarms, p the chance of a tick beyond ±z sigmas."""
    p = (false_alarms_per_hour * tick_s / HOUR_S) ** (1.0 / confirm_ticks)
    return -NormalDist().inv_cdf(min(max(p, LEAST_CHANCE), 1.0) / 2.0)
