"""Constants of the monitor: from actuators, tires and car alone."""

from __future__ import annotations

import math
from collections.abc import Sequence

from firmware_model.design.factors import unstable
from firmware_model.design.plants import Plant
from firmware_model.discretisation.targets import Target
from firmware_model.law.monitor import Constants

SWING = 0.04  # of the largest motion that the tires can hold
ASTRAY = 0.15  # likewise: about the motion that a shipped channel 2 can hold at its limit
STILL = 0.015  # likewise: wind and road move no car farther
NOISE = 6.0  # deviations of the noise in a swing
RANGE_S = 2.0  # a reference is forgotten slowly, compared with the car
PATIENCE_S = 1.0  # half a period of the slowest limit cycle
MOST_SWINGS = 4.0  # a gust that begins and ends makes two, its echo a third
ROUNDING = 2.0, 1e-6  # of the law: steps of the frame, and a share in single precision


def fill_monitor(monitor: Constants, plant: Plant, target: Target) -> None:
    """Fill in the constants.

    Without known tires, and for a plant that does not rest without commands, the monitor bounds the
    commands alone.
    """
    monitor.enabled = target.monitor
    monitor.limit_1 = rounded_up(target.limit_1, target.lsb_1)
    monitor.limit_2 = rounded_up(target.limit_2, target.lsb_2)
    monitor.slew_1 = rounded_up(target.rate_1 * target.tick_s, target.lsb_1)
    monitor.slew_2 = rounded_up(target.rate_2 * target.tick_s, target.lsb_2)
    monitor.swing = monitor.astray = math.inf
    monitor.most_swings = MOST_SWINGS
    channels = plant.g1, plant.g2
    if any(unstable(each) or not math.isfinite(each.dc_gain) for each in channels):
        return
    monitor.gain_1, monitor.gain_2 = (each.dc_gain for each in channels)
    delay_s = max((1.0 / abs(pole) for pole in plant.g1.poles), default=0.0)
    delay_s += plant.path_dead_times_s[0] + target.latency_ticks * target.tick_s
    monitor.lag = share(0.5 * delay_s, target)
    monitor.forgetting = share(RANGE_S, target)
    monitor.doubt = target.doubt
    noise = NOISE * math.hypot(target.noise_rms, target.resolution)
    monitor.swing = max(SWING * target.motion_limit, noise)
    monitor.still = max(STILL * target.motion_limit, noise)
    monitor.astray = max(ASTRAY * target.motion_limit, noise)
    monitor.patience = math.ceil(PATIENCE_S / target.tick_s)


def rounded_up(limit: float, lsb: float) -> float:
    """The largest number that the law may round ``limit`` to."""
    steps, part = ROUNDING
    return limit * (1.0 + part) + steps * lsb


def share(time_s: float, target: Target) -> float:
    """The share of the way to a new input that a lag goes in a tick."""
    return -math.expm1(-target.tick_s / max(time_s, target.tick_s))


def widen_monitor(monitor: Constants, at_speeds: Sequence[Constants]) -> None:
    """One monitor for all speeds: the widest bounds, the largest gains, the shortest lag."""
    for name in ("swing", "astray", "lag"):
        monitor[name] = max(each[name] for each in at_speeds)
    for name in ("gain_1", "gain_2"):
        monitor[name] = max((each[name] for each in at_speeds), key=abs)
