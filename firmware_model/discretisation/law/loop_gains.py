"""The discretised filters of the law, the delays around them, and the loops within one tick."""

from __future__ import annotations

from dataclasses import dataclass

from firmware_model.design.continuous_design import ContinuousDesign
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from firmware_model.target.structs import MAX_LATENCY_TICKS


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
