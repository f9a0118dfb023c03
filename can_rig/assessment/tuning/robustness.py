"""Step 3 of the search: whether a tuning works with every car of the box, and if not, why."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from can_rig.assessment.tuning.box import Car, is_stable
from can_rig.assessment.tuning.candidate import AFTER_S, frameless_table, loss_in_a_step
from can_rig.assessment.tuning.refusals import Refusal
from can_rig.scenario.build import target
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.target.structs import Record

AT_REST = 0.05  # largest error that counts as rest, as a share of the step


def box_refusal(
    scenario: Scenario, table: Record, cars: Sequence[Car], spare_ticks: int
) -> Refusal | None:
    """The first test that ``scenario``'s tuning fails with one of ``cars``; None: it passes."""
    if not is_stable(table, cars, scenario.tick_s, spare_ticks):
        return Refusal.BOX_SPARE if is_stable(table, cars, scenario.tick_s, 0) else Refusal.BOX
    refusals = (unrest(scenario, table, car) for car in cars)
    return next((refusal for refusal in refusals if refusal is not None), None)


def unrest(scenario: Scenario, table: Record, car: Car) -> Refusal | None:
    """Why D* of ``car`` does not come to rest at the step, before or after the loss; None: it does.

    A limit is the reason if D* comes to rest without it.
    """
    if _comes_to_rest(scenario, table, car):
        return None
    for refusal, without in (
        (Refusal.FORCE_LIMIT, {"limit_2": math.inf}),
        (Refusal.TORQUE_LIMIT, {"limit_1": math.inf}),
        (Refusal.BOTH_LIMITS, {"limit_1": math.inf, "limit_2": math.inf}),
    ):
        if _comes_to_rest(scenario, frameless_table(scenario, **without), car):
            return refusal
    return Refusal.REST


def has_control_authority(scenario: Scenario, car: Car) -> bool:
    """Whether X_diff alone can hold the step with ``car``: if not, no tuning comes to rest."""
    _, force_n = car.steady_commands(scenario.reference.amplitude_mps2)
    return (1.0 - AT_REST) * force_n <= target(scenario, None).limit_2


def _comes_to_rest(scenario: Scenario, table: Record, car: Car) -> bool:
    loss, step, left = loss_in_a_step(scenario)
    run = simulate(table, sample(car.plant, scenario.tick_s), step, effectiveness=left)
    error, last = np.abs(run.error), round(0.25 * AFTER_S / scenario.tick_s)
    largest = max(error[loss - last : loss].max(), error[-last:].max())
    return bool(largest <= AT_REST * abs(step[0]))
