"""Where a design runs: everything about the controller that is not its continuous design."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from firmware_model.errors import ParameterError
from firmware_model.target.structs import MAX_LATENCY_TICKS, Precision

EstimatorRule = Literal["tustin", "tustin-held", "zoh"]


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
            reference is followed later (``reference_shaper``).
        lsb_1, lsb_2: grid of a command as its frame carries it; 0 for none.
        threshold: |d̂| above it is a suspected fault.
        model_share: of what channel 1 does, this share may show as d̂ without a fault, because the
            car is not the model; 0 trusts the model (``adaptive_threshold``).
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
        if self.estimator not in get_args(EstimatorRule):
            rules = ", ".join(get_args(EstimatorRule))
            raise ParameterError(f"estimator = {self.estimator!r}: must be one of {rules}")
        if not 0 <= self.latency_ticks <= MAX_LATENCY_TICKS:
            raise ParameterError(
                f"latency_ticks = {self.latency_ticks}: must be 0 to {MAX_LATENCY_TICKS}"
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
                raise ParameterError(f"{name} = {getattr(self, name):g}: must be above 0")
        for name in ("lsb_1", "lsb_2", "model_share"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ParameterError(
                    f"{name} = {getattr(self, name):g}: must be finite and 0 or above"
                )
        if not 0.0 <= self.clear_ratio < 1.0:
            raise ParameterError(f"clear_ratio = {self.clear_ratio:g}: must be 0 or above, below 1")
        if not 0.0 <= self.probe < math.inf:
            raise ParameterError(f"probe = {self.probe:g}: must be 0 (none) or above, and finite")
        if self.probe and not 0.0 < self.probe_rad_per_s * self.tick_s <= math.pi / 4:
            raise ParameterError(
                f"probe_rad_per_s = {self.probe_rad_per_s:g}: must be above 0 and at most an "
                f"eighth of the sampling frequency, {math.pi / 4 / self.tick_s:g} rad/s"
            )
        for name in ("confirm_ticks", "clear_ticks"):
            if getattr(self, name) < 1:
                raise ParameterError(f"{name} = {getattr(self, name)}: must be 1 or more")
