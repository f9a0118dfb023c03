"""Constants of ``target.fault_decision.hypotheses``: sizes of faults and thresholds of evidence."""

from __future__ import annotations

import math

from firmware_model.discretisation.targets import Target
from firmware_model.target.structs import Record

AHEAD = 2.0  # least ratio of a found fault's evidence to faults at other places
SENSOR_AHEAD = 3.0  # the ratio for a sensor fault, where an error costs a compensation
LEAST_SHARE, MOST_SHARE = 0.5, 1.5  # share of a lost force; of a channel in another car
MOTION = 3.0  # deviations of the noise for a moved car
LEAST_CHANCE = 1e-6  # chance of a repeated number: no sensor is finer


def fill_hypotheses(table: Record, target: Target) -> None:
    """Fill in the constants; the decision and the test have their constants already."""
    constants, signatures = table.hypotheses, table.hypotheses.signatures
    constants.ahead = AHEAD
    constants.sensor_ahead = SENSOR_AHEAD
    constants.jump = table.decision.suspect
    constants.both_lost = table.decision.recover
    signatures.candidate.restart = table.sequential_test.restart
    signatures.candidate.lifetime = table.decision.horizon
    signatures.candidate.promising = table.decision.suspect
    for limits, least, most in (
        (constants.torque_lost, -MOST_SHARE, MOST_SHARE),
        (signatures.torque_offset, -target.limit_1, target.limit_1),
        (signatures.force_lost, LEAST_SHARE, MOST_SHARE),
        (signatures.sensor_biased, -math.inf, math.inf),
        (signatures.sensor_drifting, -math.inf, math.inf),
        (constants.frozen.size_of_one, 1.0, 1.0),
    ):
        limits.least, limits.most = least, most
    fill_frozen(constants.frozen, target)


def fill_frozen(frozen: Record, target: Target) -> None:
    """Numbers that repeat anyway (a perfect sensor on a car at rest) are no evidence."""
    frozen.repetition = repetition(target)
    frozen.least_motion = math.inf
    if frozen.repetition > 0.0:
        frozen.least_motion = MOTION * math.hypot(target.noise_rms, target.resolution)


def repetition(target: Target) -> float:
    """-ln of the chance that the noise of two ticks in a row falls into one step of the sensor.

    The difference has a density of 1/(√(2π) σ) at most; 0 where the bound gives no information.
    """
    change = target.noise_rms * math.sqrt(2.0 * (1.0 - target.noise_pole))
    chance = target.resolution / (math.sqrt(2.0 * math.pi) * change) if change > 0.0 else 1.0
    return -math.log(min(max(chance, LEAST_CHANCE), 1.0))
