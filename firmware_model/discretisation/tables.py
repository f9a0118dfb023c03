"""A continuous design, discretised at a tick, as the constant table that ``step`` runs from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.targets import EstimatorRule, Target
from firmware_model.discretisation.tustin import tustin, tustin_held, zoh
from firmware_model.errors import DesignError, ParameterError
from firmware_model.target.layout import table_type
from firmware_model.target.structs import MAX_LATENCY_TICKS, MAX_SECTIONS, Record

ESTIMATOR_RULES: dict[EstimatorRule, Callable[[ZeroPoleGain, float], Sections]] = {
    "tustin": tustin,
    "tustin-held": tustin_held,
    "zoh": zoh,
}

LOSS_MEMORY_S = 0.05  # of the lost share: some time constants of w, 1/17.7 s for this car
CHANGE_MEMORY_S = 0.02  # shorter: less of a motion is left; longer: more of a loss
PEAK_MEMORY_S = 0.6  # other cars ring on for as long after the command
CONFIRMED_MEMORY_S = 1.0  # of the confirmed share; a recovery is detected in half of that
PROBE_PERIODS = 2  # the half phase of ``probe`` goes once around
PROBE_SHARE = 0.4  # missing that confirms; a car that is 20 % off looks like 0.3 at 10 rad/s


@dataclass(frozen=True)
class Filters:
    """The discretised filters of the control law, for whoever wants to look at them."""

    tracking: Sections
    estimator_1: Sections
    estimator_2: Sections
    one_plus_q: Sections
    compensator: Sections


def discretise(design: ContinuousDesign, target: Target) -> Filters:
    """Each filter of ``design`` as second-order sections at the target's tick.

    Raises:
        DesignError: a tick out of range, or a filter of too high an order for the fixed layout.
    """
    tick_s, prewarp = target.tick_s, target.prewarp_rad_per_s
    rule = ESTIMATOR_RULES[target.estimator]
    nothing, unity = ZeroPoleGain.constant(0.0), ZeroPoleGain.constant(1.0)
    g1, g2 = design.plant.g1, design.plant.g2
    filters = Filters(
        tracking=tustin(design.tracking or unity, tick_s, prewarp),
        estimator_1=rule(g1, tick_s),
        estimator_2=rule(g2, tick_s),
        one_plus_q=tustin(design.estimator.one_plus_q, tick_s),
        compensator=tustin(design.compensator or nothing, tick_s, prewarp),
    )
    for name, sections in vars(filters).items():
        if len(sections.coefficients) > MAX_SECTIONS:
            raise ParameterError(
                f"{name}: order {2 * len(sections.coefficients)} is more than the "
                f"{2 * MAX_SECTIONS} that the controller's layout holds; lower alpha or alpha_q"
            )
    return filters


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

    With any delay of u2, by the bus or by a dead time, there is no such loop.
    """
    if delay_ticks > 0:
        return 0.0
    return (
        filters.compensator.feedthrough
        * filters.estimator_2.feedthrough
        * filters.one_plus_q.feedthrough
    )


def build(design: ContinuousDesign, target: Target) -> Record:
    """The table of ``design`` on ``target``: a read-only record of ``layout.table_type``.

    Raises:
        DesignError: what ``discretise`` refuses, or an algebraic loop gain of 1 or more, for
            which saturation has no one answer.
    """
    filters = discretise(design, target)
    dead = dead_ticks(design, target)
    loop_gain = algebraic_loop_gain(filters, target.latency_ticks + dead[1])
    if not loop_gain < 1.0:
        raise DesignError(
            f"the algebraic loop d̂ → u2 → d̂ has gain {loop_gain:.3g} at tick_s = "
            f"{target.tick_s:g}: must be below 1; a held-input estimator has no such loop"
        )
    tables = np.zeros(1, table_type(target.precision))
    table = tables[0]
    _fill_loop(table, design, target, filters)
    _fill_estimator(table.estimator, target, filters, dead)
    _fill_compensator(table, design, target, filters, loop_gain)
    _fill_decision(table, target)
    if target.probe > 0.0:
        _fill_probe(table.probe, target, filters, target.latency_ticks + dead[0])
    tables.flags.writeable = False
    return tables[0]


def _fill_filter(cascade: Record, sections: Sections) -> None:
    cascade.n = len(sections.coefficients)
    cascade.coefficients[: cascade.n] = sections.coefficients


def _fill_loop(table: Record, design: ContinuousDesign, target: Target, filters: Filters) -> None:
    """Reference shaper, C, actuators."""
    closed = design.tracking is not None
    shaper, tracking = table.reference_shaper, table.tracking
    shaper.enabled = closed and math.isfinite(target.reference_acceleration)
    shaper.acceleration = target.reference_acceleration * target.tick_s**2
    _fill_filter(tracking.filter, filters.tracking)
    tracking.feedback = closed
    tracking.integrates = closed
    tracking.conditioning = 1.0 / filters.tracking.feedthrough
    tracking.steady_command = 1.0 / design.plant.g1.dc_gain if closed else 1.0
    for actuator, limit, rate, lsb in (
        (table.actuator_1, target.limit_1, target.rate_1, target.lsb_1),
        (table.actuator_2, target.limit_2, target.rate_2, target.lsb_2),
    ):
        actuator.limit, actuator.slew, actuator.lsb = limit, rate * target.tick_s, lsb


def _fill_estimator(
    estimator: Record, target: Target, filters: Filters, dead: tuple[int, int]
) -> None:
    """F1 with its delays, 1 + Q."""
    _fill_filter(estimator.channel_1, filters.estimator_1)
    _fill_filter(estimator.channel_2, filters.estimator_2)
    _fill_filter(estimator.one_plus_q, filters.one_plus_q)
    if target.latency_ticks + dead[1] == 0:
        estimator.feedthrough_2 = filters.estimator_2.feedthrough
    estimator.one_plus_q_feedthrough = filters.one_plus_q.feedthrough
    estimator.latency_ticks = target.latency_ticks
    estimator.dead_ticks_1, estimator.dead_ticks_2 = dead


def _fill_compensator(
    table: Record, design: ContinuousDesign, target: Target, filters: Filters, loop_gain: float
) -> None:
    """F̂ and what it gets."""
    compensator = table.compensator
    _fill_filter(compensator.filter, filters.compensator)
    compensator.feedthrough = filters.compensator.feedthrough
    compensator.loop_inverse = 1.0 / (1.0 - loop_gain)
    compensator.reference_share = design.tracking is None
    compensator.on_confirmation = target.on_confirmation
    memory = _memory(target, LOSS_MEMORY_S)
    table.loss_model.memory = memory
    least = float(np.finfo(np.float64).tiny)  # a tick of minutes leaves nothing
    table.bumpless_transfer.slowest_pace = -math.log(max(memory, least))


def _fill_decision(table: Record, target: Target) -> None:
    """When d̂ is a loss, and when it no longer is."""
    threshold, decision = table.adaptive_threshold, table.decision
    threshold.threshold = target.threshold
    threshold.model_share = target.model_share
    threshold.clear_ratio = target.clear_ratio
    threshold.change_memory = _memory(target, CHANGE_MEMORY_S)
    threshold.peak_memory = _memory(target, PEAK_MEMORY_S)
    decision.confirm_ticks = target.confirm_ticks
    decision.clear_ticks = target.clear_ticks
    decision.share_memory = _memory(target, CONFIRMED_MEMORY_S)


def _fill_probe(probe: Record, target: Target, filters: Filters, delay_ticks: int) -> None:
    """Whole ticks for two periods, so the frequency moves a little; G1 there, delays included."""
    ticks = round(PROBE_PERIODS * 2.0 * math.pi / (target.probe_rad_per_s * target.tick_s))
    half = np.exp(2j * math.pi / ticks)  # once around in a probe: two periods of the whole phase
    response = filters.estimator_1(half**2) * half ** (-2 * delay_ticks)
    probe.ticks = ticks
    probe.amplitude = 0.5 * target.probe
    probe.least_share = PROBE_SHARE
    probe.response = response.real, response.imag
    probe.rotation = half.real, half.imag


def _memory(target: Target, time_constant_s: float) -> float:
    """What a tick leaves of a memory that fades with ``time_constant_s``."""
    return math.exp(-target.tick_s / time_constant_s)
