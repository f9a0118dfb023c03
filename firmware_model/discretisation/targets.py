"""The target of a design: all settings of the controller besides the continuous design."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from firmware_model.design.actuator_dynamics import Stage
from firmware_model.design.mismatch import TRUSTED, Mismatch
from firmware_model.discretisation.rules import RULE_NAMES, Rule
from firmware_model.errors import ParameterError
from firmware_model.law.structs import MAX_LATENCY_TICKS, Precision

HOUR_S = 3600.0

RANGES: tuple[tuple[str, Callable[[float], bool], str], ...] = (
    ("latency_ticks", lambda x: 0 <= x <= MAX_LATENCY_TICKS, f"0 to {MAX_LATENCY_TICKS}"),
    ("limit_1 limit_2 rate_1 rate_2 reference_acceleration", lambda x: x > 0.0, "above 0"),
    ("false_alarms_per_hour suspicions_per_hour", lambda x: 0.0 < x < math.inf,
     "finite and above 0"),
    ("lsb_1 lsb_2 noise_rms disturbance resolution safe_stop_s blind_s",
     lambda x: 0.0 <= x < math.inf, "finite and 0 or above"),
    ("noise_pole", lambda x: 0.0 <= x < 1.0, "0 or above, below 1"),
)  # fmt: skip
"""Of the numbers of a target: which mean something, and in words."""


@dataclass(frozen=True)
class Reporting:
    """An actuator that reports its output.

    Attributes:
        actuator: from its command to its output.
        noise_rms: rms of the report's noise, resolution included, in the unit of the command.
    """

    actuator: Stage
    noise_rms: float = 0.0


@dataclass(frozen=True)
class Witness:
    """Yaw rate and lateral acceleration as a witness of D*.

    Attributes:
        lateral_weight: d, the weight of the lateral acceleration.
        speed_mps: V, of the design.
        lag_s: of both sensors.
        noise_rms: rms of the noise in D* made of both, resolutions included.
        doubt: share by which V may be off; 0: the speed is measured.
        makes: there is no sensor of D*, and the law measures what both sensors make.
    """

    lateral_weight: float
    speed_mps: float
    lag_s: float = 0.0
    noise_rms: float = 0.0
    doubt: float = 0.0
    makes: bool = False


@dataclass(frozen=True)
class Target:
    """The target of the design: all settings of the table besides the continuous design.

    Attributes:
        tick_s: sampling period, seconds.
        latency_ticks: whole ticks from the sample of the measurement until the command computed
            from it acts on the plant; 0 is the thesis's ideal.
        estimator: discretisation rule of F1; F̂ and C always use Tustin's rule.
        limit_1, limit_2: largest magnitude of a command, in its own unit.
        rate_1, rate_2: largest change of a command in a second.
        reference_acceleration: largest second derivative of C's reference; C follows a faster
            reference with a delay (``reference_shaper``).
        lsb_1, lsb_2: resolution of a command in the frame; 0 for none.
        noise_rms: rms of a healthy measurement's noise, resolution included; noise without the
            colour of ``noise_pole`` counts as white.
        noise_pole: a of coloured noise, n(k) = a n(k-1) + white; 0 for white noise.
        disturbance: rms change of a healthy measurement within a second by wind, road or drift, in
            the measurement's unit; 0 for a plant that only its commands move.
        gust: largest change of a healthy measurement by wind or road within ``GUST_S``, in the
            measurement's unit; up to there an echo that denies a loss is believed. 0: from d̂
            alone, a loss may be confirmed at any time.
        resolution: step of the measurement, bus rounding included.
        mismatch: cars different from the model; the default trusts the model.
        false_alarms_per_hour: losses confirmed by chance, at most.
        suspicions_per_hour: false suspicions, at most.
        on_confirmation: compensate from the confirmed loss on, with the modelled effect of the lost
            channel's commands, instead of always with d̂ (the thesis).
        supervised: decide on faults, and act on the verdict; otherwise the thesis's law alone.
        safe_stop_s: time from the verdict "both actuators lost" to zero commands; 0: the commands
            go on.
        blind_s: longest time without an input; then the commands go to zero in the same time.
        monitor: whether the monitor may take commands away.
        doubt: motion of healthy cars beyond the reference, as a share of the reference.
        motion_limit: largest motion that the tires can hold, in the measurement's unit.
        prewarp_rad_per_s: frequency at which C and F̂ keep their continuous response exactly.
        echoes: both actuators, whose outputs the law hears; None: an actuator reports nothing.
        witness: yaw rate and lateral acceleration, which the law hears; None: the law does not.
        precision: of every number in the table and the state.
    """

    tick_s: float
    latency_ticks: int = 0
    estimator: Rule = "tustin"
    limit_1: float = math.inf
    limit_2: float = math.inf
    rate_1: float = math.inf
    rate_2: float = math.inf
    reference_acceleration: float = math.inf
    lsb_1: float = 0.0
    lsb_2: float = 0.0
    noise_rms: float = 0.0
    noise_pole: float = 0.0
    disturbance: float = 0.0
    gust: float = 0.0
    resolution: float = 0.0
    mismatch: Mismatch = TRUSTED
    false_alarms_per_hour: float = 0.001
    suspicions_per_hour: float = 3600.0
    on_confirmation: bool = False
    supervised: bool = True
    safe_stop_s: float = 0.0
    blind_s: float = 1.0
    monitor: bool = True
    doubt: float = 0.0
    motion_limit: float = math.inf
    prewarp_rad_per_s: float | None = None
    echoes: tuple[Reporting, Reporting] | None = None
    witness: Witness | None = None
    precision: Precision = "float64"

    def __post_init__(self) -> None:
        if self.estimator not in RULE_NAMES:
            rules = ", ".join(RULE_NAMES)
            raise ParameterError(f"estimator = {self.estimator!r}: must be one of {rules}")
        for names, means_something, wanted in RANGES:
            for name in names.split():
                if not means_something(value := getattr(self, name)):
                    raise ParameterError(f"{name} = {value:g}: must be {wanted}")

    def evidence(self, per_hour: float) -> float:
        """The log-likelihood ratio that chance exceeds ``per_hour`` times an hour at most.

        One candidate begins a tick, and exceeds h with a chance of e^-h (``likelihood_ratio``).
        """
        return math.log(HOUR_S / (self.tick_s * per_hour))
