"""A continuous design, discretised at a tick, as the constant table that ``step`` runs from."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tustin import tustin, tustin_held, zoh
from firmware_model.errors import DesignError, ParameterError
from firmware_model.target.layout import (
    MAX_LATENCY_TICKS,
    MAX_SECTIONS,
    Precision,
    Record,
    RecordArray,
    table_type,
)

EstimatorRule = Literal["tustin", "tustin-held", "zoh"]
ESTIMATOR_RULES: dict[EstimatorRule, Callable[[ZeroPoleGain, float], Sections]] = {
    "tustin": tustin,
    "tustin-held": tustin_held,
    "zoh": zoh,
}


SHARE_MEMORY_S = 0.05  # of how much is lost: some time constants of w, 1/17.7 s for this car
CHANGE_MEMORY_S = 0.02  # shorter: less of a motion is left; longer: more of a loss
MOST_MEMORY_S = 0.6  # other cars ring on for as long after the command
FOUND_MEMORY_S = 1.0  # of the loss that was found; a recovery is told in half of that
PROBE_PERIODS = 2  # the half phase of ``probe`` goes once around
PROBE_SHARE = 0.4  # lost that confirms; a car that is 20 % off looks like 0.3 at 10 rad/s


@dataclass(frozen=True)
class Target:
    """Where the design runs: everything about the table that is not the continuous design.

    Attributes:
        tick_s: sampling period, seconds.
        latency_ticks: whole ticks from the sample of the measurement until the command computed
            from it acts on the plant; 0 is the thesis's ideal.
        estimator: how F1 is discretised; F̂ and C are always Tustin's.
        limit_1, limit_2: largest magnitude of a command, in its own unit.
        rate_1, rate_2: largest change of a command in a second.
        reference_acceleration: largest second derivative of the reference that C follows; a faster
            reference is followed later (``governor``).
        lsb_1, lsb_2: grid of a command as its frame carries it; 0 for none.
        threshold: |d̂| above it is a suspected fault.
        model_share: of what channel 1 does, this share may show as d̂ without a fault, because the
            car is not the model; 0 trusts the model (``suspicion``).
        confirm_ticks: ticks in a row above the threshold that confirm it.
        clear_ticks: ticks in a row in which the channel has to look well to be cleared.
        clear_ratio: share of the d̂ of a loss that has to be above the threshold, with |d̂| below
            it, for the channel to be taken to work again.
        on_confirmation: compensate from the confirmed loss on, with what the lost channel's own
            commands would have done, instead of always and with d̂ (the thesis).
        probe: amplitude of the sine, in the unit of command 1, that has to be missing in the
            measurement before a loss is confirmed; 0 for none.
        probe_rad_per_s: its frequency.
        prewarp_rad_per_s: frequency at which C and F̂ keep their continuous response exactly.
        precision: of every number in the table and the state.
    """

    tick_s: float
    latency_ticks: int = 0
    estimator: EstimatorRule = "tustin"
    limit_1: float = math.inf
    limit_2: float = math.inf
    rate_1: float = math.inf
    rate_2: float = math.inf
    reference_acceleration: float = math.inf
    lsb_1: float = 0.0
    lsb_2: float = 0.0
    threshold: float = math.inf
    model_share: float = 0.0
    confirm_ticks: int = 1
    clear_ticks: int = 1
    clear_ratio: float = 0.25
    on_confirmation: bool = False
    probe: float = 0.0
    probe_rad_per_s: float = 10.0
    prewarp_rad_per_s: float | None = None
    precision: Precision = "float64"

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATOR_RULES:
            rules = ", ".join(ESTIMATOR_RULES)
            raise ParameterError(f"estimator = {self.estimator!r}: one of {rules} is right")
        if not 0 <= self.latency_ticks <= MAX_LATENCY_TICKS:
            raise ParameterError(
                f"latency_ticks = {self.latency_ticks}: 0 to {MAX_LATENCY_TICKS} is right"
            )
        for name in (
            "limit_1",
            "limit_2",
            "rate_1",
            "rate_2",
            "reference_acceleration",
            "threshold",
        ):
            if not getattr(self, name) > 0.0:
                raise ParameterError(f"{name} = {getattr(self, name):g}: above 0 is right")
        for name in ("lsb_1", "lsb_2", "model_share"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ParameterError(f"{name} = {getattr(self, name):g}: 0 or above is right")
        if not 0.0 <= self.clear_ratio < 1.0:
            raise ParameterError(f"clear_ratio = {self.clear_ratio:g}: 0 to below 1 is right")
        if not 0.0 <= self.probe < math.inf:
            raise ParameterError(f"probe = {self.probe:g}: 0 (none) or above is right")
        if self.probe and not 0.0 < self.probe_rad_per_s * self.tick_s <= math.pi / 4:
            raise ParameterError(
                f"probe_rad_per_s = {self.probe_rad_per_s:g}: above 0, up to an eighth of the "
                f"sampling frequency, {math.pi / 4 / self.tick_s:g}, is right"
            )
        for name in ("confirm_ticks", "clear_ticks"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} = {getattr(self, name)}: 1 or more is right")


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


def algebraic_loop_gain(filters: Filters, latency_ticks: int) -> float:
    """Gain of the loop d̂ → u2 → d̂ within one tick: F̂, G2 and 1 + Q at z → ∞; T/(2τ+T) for α = 1."""
    if latency_ticks > 0:
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
    loop_gain = algebraic_loop_gain(filters, target.latency_ticks)
    if not loop_gain < 1.0:
        raise DesignError(
            f"the algebraic loop d̂ → u2 → d̂ has gain {loop_gain:.3g} at tick_s = "
            f"{target.tick_s:g}; below 1 is right: a held-input estimator has none"
        )
    table = np.zeros(1, table_type(target.precision))
    for name, sections in vars(filters).items():
        n = len(sections.coefficients)
        table[name][0, :n] = sections.coefficients
        table[f"{name}_n"] = n
    feedback = design.tracking is not None
    table["feedback"] = feedback
    table["integrates"] = feedback
    table["reference_to_2"] = not feedback
    table["steady_1"] = 1.0 / design.plant.g1.dc_gain if feedback else 1.0
    table["estimator_feedthrough_2"] = (
        0.0 if target.latency_ticks > 0 else filters.estimator_2.feedthrough
    )
    table["compensator_feedthrough"] = filters.compensator.feedthrough
    table["q_feedthrough"] = filters.one_plus_q.feedthrough
    table["conditioning"] = 1.0 / filters.tracking.feedthrough
    table["slew_1"] = target.rate_1 * target.tick_s
    table["slew_2"] = target.rate_2 * target.tick_s
    table["slew_reference"] = target.reference_acceleration * target.tick_s**2
    table["governs"] = feedback and math.isfinite(target.reference_acceleration)
    table["loop_inverse"] = 1.0 / (1.0 - loop_gain)
    for name in (
        *("limit_1", "limit_2", "lsb_1", "lsb_2"),
        *("threshold", "model_share", "clear_ratio"),
    ):
        table[name] = getattr(target, name)
    if target.probe > 0.0:
        add_probe(table, target, filters)
    table["share_memory"] = math.exp(-target.tick_s / SHARE_MEMORY_S)
    table["found_memory"] = math.exp(-target.tick_s / FOUND_MEMORY_S)
    table["change_memory"] = math.exp(-target.tick_s / CHANGE_MEMORY_S)
    table["most_memory"] = math.exp(-target.tick_s / MOST_MEMORY_S)
    table["latency_ticks"] = target.latency_ticks
    table["confirm_ticks"] = target.confirm_ticks
    table["clear_ticks"] = target.clear_ticks
    table["on_confirmation"] = target.on_confirmation
    table.flags.writeable = False
    return table[0]


def add_probe(table: RecordArray, target: Target, filters: Filters) -> None:
    """Whole ticks for two periods, so the frequency moves a little; G1 there, latency included."""
    ticks = round(PROBE_PERIODS * 2.0 * math.pi / (target.probe_rad_per_s * target.tick_s))
    half = np.exp(2j * math.pi / ticks)  # once around in a probe: two periods of the whole phase
    answer = filters.estimator_1(half**2) * half ** (-2 * target.latency_ticks)
    table["probe_amplitude"] = 0.5 * target.probe
    table["probe_gain"] = answer.real, answer.imag
    table["probe_turn"] = half.real, half.imag
    table["probe_ticks"] = ticks
    table["probe_share"] = PROBE_SHARE
