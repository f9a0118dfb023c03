"""A continuous design, discretised at a tick, as the constant table that ``step`` runs from.

The table has the filters of the law, the delays around them, the gains of the loops within one
tick, and the constants of ``law.supervision``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from typing import Any, cast

import numpy as np

from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.design.mismatch import STEP
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.coprime import SampledFactors, sampled_factors, sampled_over
from firmware_model.discretisation.monitor import fill_monitor
from firmware_model.discretisation.sections import Sections, make_up_gain
from firmware_model.discretisation.takeover import evidence_in_takeover, fill_takeover
from firmware_model.discretisation.targets import Reporting, Target, Witness
from firmware_model.discretisation.tustin import tustin, zoh
from firmware_model.discretisation.whitening import Whitening, whitening
from firmware_model.errors import DesignError, ParameterError
from firmware_model.law.core import biquad
from firmware_model.law.core.estimator import Constants as EstimatorConstants
from firmware_model.law.layout import Table
from firmware_model.law.status import Verdict
from firmware_model.law.structs import MAX_LATENCY_TICKS, MAX_SECTIONS, ranges_of, zeroed
from firmware_model.law.supervision import whitener
from firmware_model.law.supervision.covariance import LOSS_STATES, MAX_DIRECTIONS
from firmware_model.law.supervision.echoes import FORCE, TORQUE, Constants as EchoesConstants
from firmware_model.law.supervision.frozen import Constants as FrozenConstants
from firmware_model.law.supervision.signatures import (
    COMMAND_2,
    MINUS_ONE,
    MISSING,
    RAMP,
    THROUGH_G1,
    THROUGH_G2,
    THROUGH_M,
    TORQUE_ECHO_ROW,
)
from firmware_model.law.supervision.witness import Constants as WitnessConstants

AHEAD = 2.0  # least ratio of a found fault's evidence to faults at other places
SENSOR_AHEAD = 3.0  # the ratio for a sensor fault, where an error costs a compensation
LEAST_SHARE, MOST_SHARE = 0.5, 1.5  # share of a lost force; of a channel in another car
LONGEST = 5.0  # horizons after which every candidate begins again
HEALTH_S = 1.0  # memory of the fading sums of health
HEALTHY = 9.0  # the known faults must show so many times as much as d̂
LEAST_SHOWN = 0.2  # share of a loss that would show in d̂
MOTION = 3.0  # deviations of the noise for a moved car
LEAST_CHANCE = 1e-6  # chance of a repeated number: no sensor is finer


HYPOTHESES = (
    (Verdict.TORQUE_OFFSET, THROUGH_G1, MINUS_ONE, 0),
    (Verdict.FORCE_LOST, THROUGH_G2, COMMAND_2, 0),
    (Verdict.SENSOR_WRONG, THROUGH_M, MINUS_ONE, 0),
    (Verdict.SENSOR_DRIFTING, THROUGH_M, RAMP, 0),
    (Verdict.TORQUE_OFFSET, THROUGH_G1, MISSING, TORQUE),
    (Verdict.FORCE_LOST, THROUGH_G2, MISSING, FORCE),
)
"""The rows of the table: fault, what answers, input for a fault of size 1, whose echo."""


def fill_hypotheses(table: Table, target: Target) -> None:
    """Fill in the constants; the decision and the test have their constants already."""
    constants, signatures = table.hypotheses, table.hypotheses.signatures
    constants.ahead = AHEAD
    constants.sensor_ahead = SENSOR_AHEAD
    constants.jump = table.decision.suspect
    constants.both_lost = table.decision.certain
    constants.health.keep = _memory(target, HEALTH_S)
    constants.health.age = HEALTH_S / target.tick_s
    constants.health.nearer = HEALTHY**2
    constants.health.least = LEAST_SHOWN
    signatures.candidate.restart = table.sequential_test.restart
    signatures.candidate.lifetime = table.decision.horizon
    signatures.candidate.promising = table.decision.suspect
    signatures.candidate.longest = LONGEST * table.decision.horizon
    share, any_size = (LEAST_SHARE, MOST_SHARE), (-math.inf, math.inf)
    sizes = ((-target.limit_1, target.limit_1), share, any_size, any_size, share, share)
    signatures.n = len(HYPOTHESES) if target.echoes is not None else TORQUE_ECHO_ROW
    for row, kind, size in zip(signatures.rows, HYPOTHESES, sizes, strict=True):
        row.fault, row.through, row.input, row.echo = kind
        row.limits.least, row.limits.most = size
    for limits, least, most in (
        (constants.torque_lost, -MOST_SHARE, MOST_SHARE),
        (table.echoes.wrong, -MOST_SHARE, -LEAST_SHARE),
        (constants.frozen.size_of_one, 1.0, 1.0),
    ):
        limits.least, limits.most = least, most
    fill_frozen(constants.frozen, target)
    if target.echoes is not None:
        fill_echoes(table.echoes, target.echoes, target.tick_s)
        table.corroboration.gust = target.gust
        table.corroboration.follow = 1.0 - math.exp(-target.tick_s / GUST_S)


def fill_witness(witness: WitnessConstants, of: Witness, target: Target) -> None:
    """D* made of yaw rate and lateral acceleration."""
    witness.lateral_weight, witness.speed = of.lateral_weight, of.speed_mps
    witness.late = of.lag_s / target.tick_s
    witness.longest = max(math.ceil(ECHO_S / target.tick_s), LEAST_ECHO_TICKS)
    witness.keep, witness.nearer, witness.working = KEEP, NEARER, AGREEING_SAMPLES
    noise = math.hypot(of.noise_rms, target.noise_rms, target.resolution)
    witness.noise = (APART * noise) ** 2
    witness.doubt = of.doubt**2
    witness.makes = of.makes


def fill_echoes(
    echoes: EchoesConstants, actuators: tuple[Reporting, Reporting], tick_s: float
) -> None:
    """Both actuators between commands that arrive at ticks, with their commands held between."""
    echoes.longest = max(math.ceil(ECHO_S / tick_s), LEAST_ECHO_TICKS)
    echoes.working = WORKING_ECHOES
    echoes.hand_over = 1.0 - math.exp(-tick_s / HAND_OVER_S)
    for own, reporting in zip(echoes.actuators, actuators, strict=True):
        own.least = (CLEAR_OF_NOISE * reporting.noise_rms) ** 2
        actuator = reporting.actuator
        lag = actuator.transfer_function
        if lag.poles:
            stage = zoh(lag, tick_s)
            _fill_filter(own.stage, stage)
            own.lead = 1.0 / stage.coefficients[0][1] if len(lag.poles) == 1 else 1.0
        else:  # the command that arrived a tick ago
            own.lead = 1.0
            own.stage.n, own.stage.coefficients[0] = 1, (0.0, 1.0, 0.0, 1.0, 0.0)
        own.dead_ticks = round(actuator.dead_time_s / tick_s)


def fill_frozen(frozen: FrozenConstants, target: Target) -> None:
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


@dataclass(frozen=True)
class Filters:
    """The discretised filters of the control law, for whoever wants to look at them."""

    tracking: Sections
    estimator_1: Sections
    estimator_2: Sections
    measurement: Sections
    stabiliser: Sections | None
    one_plus_q: Sections
    compensator: Sections


def dead_ticks(design: ContinuousDesign, target: Target) -> tuple[int, int]:
    """The dead times that the design knows of, from each command to the measurement, in ticks.

    Raises:
        ParameterError: more than the controller's rings hold.
    """
    first, second = (
        round(dead_time_s / target.tick_s) for dead_time_s in design.plant.path_dead_times_s
    )
    for channel, ticks in ((1, first), (2, second)):
        if ticks > MAX_LATENCY_TICKS:
            raise ParameterError(
                f"dead time of channel {channel}: {ticks} ticks; must be at most "
                f"{MAX_LATENCY_TICKS}, {MAX_LATENCY_TICKS * target.tick_s:g} s"
            )
    return first, second


def algebraic_loop_gain(filters: Filters, delay_ticks: int) -> float:
    """Gain of the loop d̂ → u2 → d̂ within one tick: F̂, G2 and 1 + Q at z → ∞; T/(2τ+T) for α = 1.

    A delay of u2, by the bus or by a dead time, opens the loop: gain 0.
    """
    if delay_ticks > 0:
        return 0.0
    return (
        filters.compensator.feedthrough
        * filters.estimator_2.feedthrough
        * filters.one_plus_q.feedthrough
    )


def tracking_loop_gain(filters: Filters, target: Target, dead: tuple[int, int]) -> float:
    """Gain of the loop u1 → N1 u1 → u1 within one tick: U, N1 and R at z → ∞."""
    gain = filters.stabiliser.feedthrough if filters.stabiliser else 0.0
    if target.latency_ticks + dead[0] > 0:
        return gain
    return gain + filters.tracking.feedthrough * filters.estimator_1.feedthrough


SLOWEST_TRANSFER_S = 0.05  # some time constants of w (1/17.7 s for this car)
HASTE = 2.0  # pace of a transfer relative to the detection time
SHARE = 0.8  # tested share of a lost torque: of a complete loss, a half still counts
RESTART = -1.0  # evidence that ends a candidate
FRESHNESS = 0.1  # least growth of a candidate's information when the age doubles
DEVIATIONS, NEVER = 3.0, 1e9  # threshold for losses above the model's channel
SHARE_VARIANCE = 0.09  # of the share at the confirmation of a loss, at most
RECOVER = 2.0  # evidence of a return over evidence of a loss
CERTAIN = 5.0  # likewise of a second loss
MOMENT = 0.5  # deviation of a loss's moment, as a part of the time to confirmation
LEAST_DOUBT = 0.04  # for cars with a G1 20 % off the model
DOUBT = 9.0  # above 1, because the moment of the loss is unknown too
FOLLOW_S, FOLLOW_TICKS = 0.01, 3.0  # of each of the two lags before F̂
HORIZON_S = 1.0  # a loss with a longer detection time is undecidable
MISMATCH_S = 3.0  # time constant of a car's changes
MISMATCH_VARIANCE = 0.36  # of a parameter in a box of ±1: uniform plus a margin
BEYOND = 0.01  # second-order part of other cars' d̂: corners of a 20 % box show less
BEYOND_S = 1.0  # decay time of other cars
MOST_FORGOTTEN = 0.99  # in a tick: the rest divides the factors of P
REMAINDER_S = 0.12  # time constant of the remainder beyond the first order
WHITE = 0.1  # white part of the remainder
RULE_ERROR = {"zoh": 0.0, "tustin": 1.0, "tustin-held": 1.0}  # of a tick's change of G1 u1
POWERLESS_S = 0.3  # a car follows large commands sooner
WORKING_ECHOES = 50  # consecutive good echoes end a fault
HAND_OVER_S = 0.25  # lag, twice in a row, in which C takes over from F̂
KEEP = 0.8  # factor per sample of the fading sums of a witness
NEARER = 4.0  # ratio of squares: who is wrong is twice as far away
APART = 7.0  # deviations of the noise, in a fading sum of five samples
AGREEING_SAMPLES = 200  # consecutive samples end the denial of a sensor
GUST_S = 1.0 / 3.0  # lag beyond which a change is slow: steers and gusts differ most
CLEAR_OF_NOISE = 8.0  # least output, in deviations of the noise, to say that it is missing
ECHO_S, LEAST_ECHO_TICKS = 0.1, 5  # an echo that stays away for longer gives no information
LEAST_EVIDENCE = 1.0  # log-likelihood ratio of about 3 to 1


def discretise(design: ContinuousDesign, target: Target) -> Filters:
    """Each filter of ``design`` as second-order sections at the target's tick.

    Raises:
        DesignError: a tick out of range, or a filter of too high an order for the fixed layout.
    """
    tick_s, prewarp = target.tick_s, target.prewarp_rad_per_s
    nothing, unity = ZeroPoleGain.constant(0.0), ZeroPoleGain.constant(1.0)
    factors = _factors(design, target)
    follow = design.tracking
    stabiliser = follow.stabiliser if follow else None
    filters = Filters(
        tracking=tustin(follow.filter if follow else unity, tick_s, prewarp),
        estimator_1=factors.numerators[0],
        estimator_2=factors.numerators[1],
        measurement=factors.denominator,
        stabiliser=tustin(stabiliser, tick_s, prewarp) if stabiliser else None,
        one_plus_q=tustin(design.estimator.one_plus_q, tick_s),
        compensator=tustin(design.compensator or nothing, tick_s, prewarp),
    )
    for name, sections in vars(filters).items():
        if sections is not None and len(sections.coefficients) > MAX_SECTIONS:
            raise ParameterError(
                f"{name}: order {2 * len(sections.coefficients)} is more than the "
                f"{2 * MAX_SECTIONS} that the controller's layout holds; lower alpha or alpha_q"
            )
    return filters


def build(design: ContinuousDesign, target: Target) -> Table:
    """The table of ``design`` on ``target``: a read-only record of ``layout.table_type``.

    Raises:
        DesignError: a refusal of ``discretise``, or an algebraic loop gain of 1 or more, because
            saturation then has no unique answer, or more ticks than the law counts.
    """
    filters = discretise(design, target)
    dead = dead_ticks(design, target)
    loop_gain = algebraic_loop_gain(filters, target.latency_ticks + dead[1])
    if not loop_gain < 1.0:
        raise DesignError(
            f"the algebraic loop d̂ → u2 → d̂ has gain {loop_gain:.3g} at tick_s = "
            f"{target.tick_s:g}: must be below 1; a held-input estimator has no such loop"
        )
    tables = zeroed(Table, target.precision)
    table = tables[0]
    table.supervised = target.supervised
    _fill_loop(table, design, target, filters, dead)
    _fill_estimator(table.estimator, target, filters, dead)
    _fill_compensator(table, design, target, filters, loop_gain)
    for shortfall, model in (
        (table.shortfall_1, filters.estimator_1),
        (table.shortfall_2, filters.estimator_2),
    ):
        shortfall.gain[: len(model.coefficients)] = make_up_gain(model)
    white = whitening(filters.estimator_1, target)
    _fill_decision(table, target, white)
    _fill_mismatch(table, design, target, white)
    fill_hypotheses(table, target)
    table.prediction.enabled = not (
        table.estimator.feedthrough_2
        or (filters.estimator_1.feedthrough and table.estimator.shown_ticks_1 == 0)
    )
    table.prediction.fading = _memory(target, SLOWEST_TRANSFER_S)
    table.prediction.longest = math.ceil(target.blind_s / target.tick_s)
    if table.prediction.enabled and target.witness is not None:
        fill_witness(table.witness, target.witness, target)
    if table.prediction.enabled and not table.estimator.measurement.n:
        fill_takeover(table.takeover, target, filters.estimator_1)
    table.decision.takeover = evidence_in_takeover(table.takeover, table.decision.confirm)
    fill_monitor(table.monitor, design.plant, target)
    table.safe_stop.duration = math.ceil(target.safe_stop_s / target.tick_s)
    table.safe_stop.certain = math.ceil(POWERLESS_S / target.tick_s)
    for path, (least, largest) in ranges_of(Table).items():
        value = reduce(getitem, path, cast(Any, table))
        if not least <= value <= largest:
            what = f"{'.'.join(map(str, path))} is {value}: must be from {least} to {largest}"
            raise DesignError(f"table of the controller: {what}")
    tables.flags.writeable = False
    made: Table = tables[0]
    return made


def _factors(design: ContinuousDesign, target: Target) -> SampledFactors:
    """M, N1 and N2 of the model, as used in d̂."""
    channels = (design.plant.g1, design.plant.g2)
    slowest = design.factors.slowest_rad_per_s
    return sampled_factors(channels, slowest, target.estimator, target.tick_s)


def _fill_filter(cascade: biquad.Constants | whitener.Constants, sections: Sections) -> None:
    cascade.n = len(sections.coefficients)
    cascade.coefficients[: cascade.n] = sections.coefficients


def _fill_loop(
    table: Table, design: ContinuousDesign, target: Target, filters: Filters, dead: tuple[int, int]
) -> None:
    """Reference shaper, C, actuators."""
    closed = design.tracking is not None
    shaper, tracking = table.reference_shaper, table.tracking
    shaper.enabled = closed and math.isfinite(target.reference_acceleration)
    shaper.acceleration = target.reference_acceleration * target.tick_s**2
    _fill_filter(tracking.filter, filters.tracking)
    tracking.feedback = closed
    if filters.stabiliser:
        _fill_filter(tracking.stabiliser, filters.stabiliser)
    tracking.excuses_limits = filters.stabiliser is None
    tracking.loop_inverse = 1.0 / (1.0 - closed * tracking_loop_gain(filters, target, dead))
    for actuator, limit, rate, lsb in (
        (table.actuator_1, target.limit_1, target.rate_1, target.lsb_1),
        (table.actuator_2, target.limit_2, target.rate_2, target.lsb_2),
    ):
        actuator.limit = _on_grid(limit, lsb)
        actuator.slew, actuator.lsb = rate * target.tick_s, lsb


def _on_grid(limit: float, lsb: float) -> float:
    """The largest command that the frame carries within ``limit``."""
    if not (lsb > 0.0 and math.isfinite(limit)):
        return limit
    return math.floor(limit / lsb * (1.0 + 1e-12)) * lsb


def _fill_estimator(
    estimator: EstimatorConstants, target: Target, filters: Filters, dead: tuple[int, int]
) -> None:
    """F1 with its delays, 1 + Q."""
    _fill_filter(estimator.channel_1, filters.estimator_1)
    _fill_filter(estimator.channel_2, filters.estimator_2)
    _fill_filter(estimator.one_plus_q, filters.one_plus_q)
    _fill_filter(estimator.measurement, filters.measurement)
    if target.latency_ticks + dead[1] == 0:
        estimator.feedthrough_2 = filters.estimator_2.feedthrough
    estimator.one_plus_q_feedthrough = filters.one_plus_q.feedthrough
    estimator.latency_ticks = target.latency_ticks
    estimator.shown_ticks_1, estimator.shown_ticks_2 = (
        target.latency_ticks + ticks for ticks in dead
    )


def _fill_compensator(
    table: Table, design: ContinuousDesign, target: Target, filters: Filters, loop_gain: float
) -> None:
    """F̂ and what it gets."""
    compensator = table.compensator
    _fill_filter(compensator.filter, filters.compensator)
    compensator.feedthrough = filters.compensator.feedthrough
    compensator.loop_inverse = 1.0 / (1.0 - loop_gain)
    compensator.reference_share = design.tracking is None
    compensator.on_confirmation = target.on_confirmation
    table.bumpless_transfer.slowest_pace = target.tick_s / SLOWEST_TRANSFER_S
    table.bumpless_transfer.haste = HASTE


def _fill_decision(table: Table, target: Target, white: Whitening) -> None:
    """Thresholds for a loss in d̂ and for the return."""
    decision, test = table.decision, table.sequential_test
    decision.confirm = max(target.evidence(target.false_alarms_per_hour), LEAST_EVIDENCE)
    decision.recover = RECOVER * decision.confirm
    decision.certain = CERTAIN * decision.confirm
    suspect = max(target.evidence(target.suspicions_per_hour), LEAST_EVIDENCE)
    decision.suspect = min(suspect, decision.confirm)
    decision.horizon = HORIZON_S / target.tick_s
    decision.shown = white.energy(round(decision.horizon))
    table.loss_model.share_variance = SHARE_VARIANCE
    table.loss_model.doubt = DOUBT
    table.loss_model.least_doubt = LEAST_DOUBT if target.mismatch.cars else 0.0
    table.loss_model.moment = MOMENT
    table.loss_model.follow = target.tick_s / max(FOLLOW_S, FOLLOW_TICKS * target.tick_s)
    test.share = SHARE
    test.restart = RESTART
    test.freshness = FRESHNESS
    test.needed = decision.confirm
    test.promising = decision.suspect
    test.deviations = DEVIATIONS if target.mismatch.cars else NEVER


def _fill_mismatch(
    table: Table, design: ContinuousDesign, target: Target, white: Whitening
) -> None:
    """Effect of other cars and noise on d̂."""
    constants, other, cars = table.mismatch, table.other_cars, target.mismatch.cars
    if len(cars) > MAX_DIRECTIONS:
        raise ParameterError(f"mismatch: {len(cars)} other cars; must be at most {MAX_DIRECTIONS}")
    other.n = len(cars)
    other.scale = 1.0 / STEP
    rule = RULE_ERROR[target.estimator] ** 2
    constants.n = LOSS_STATES + (len(cars) + 1 if cars or rule else 0)
    model = _factors(design, target)
    for place, car in zip(other.cars, cars, strict=False):
        factors = sampled_over(car, model, target.estimator, target.tick_s)
        _fill_filter(place.channel_1, factors.numerators[0])
        _fill_filter(place.channel_2, factors.numerators[1])
        _fill_filter(place.measurement, factors.denominator)
    constants.prior = MISMATCH_VARIANCE
    slow, fast = _memory(target, MISMATCH_S), _memory(target, REMAINDER_S)
    last = LOSS_STATES + len(cars)
    for i in range(LOSS_STATES, last):
        constants.forgetting[i] = min(1.0 - slow, MOST_FORGOTTEN)
        constants.growth[i] = (1.0 - slow**2) * MISMATCH_VARIANCE
    constants.forgetting[last] = min(1.0 - fast, MOST_FORGOTTEN)
    constants.growth[last] = 1.0 - fast**2
    constants.motion = (REMAINDER_S / target.tick_s) ** 2
    constants.beyond = BEYOND * MISMATCH_VARIANCE
    constants.white = WHITE
    constants.rule = rule
    constants.fading = _memory(target, BEYOND_S) ** 2
    constants.noise = white.variance
    _fill_filter(constants.whitener, white.sections)
    slow_z = np.exp(1j * np.array([target.tick_s / REMAINDER_S]))
    constants.remainder_shown = abs(white.sections(slow_z)[0])


def _memory(target: Target, time_constant_s: float) -> float:
    """Factor per tick of a memory that fades with ``time_constant_s``."""
    return math.exp(-target.tick_s / time_constant_s)
