"""An independent monitor: the last look at the commands, by another structure than the law.

The monitor shares no memory, filter or function with the law (level 2 of the E-Gas concept). The
monitor only takes away: the force difference, or both commands. What is taken away stays away until
``reset``. Three checks:

- **Commands.** A command that is no number, or beyond range or rate of its actuator, is the work of
  a damaged law: both commands go to zero.
- **Astray.** The *range* holds all references of the last seconds. y far outside the range and off
  straight ahead stops the car, if the commands are the cause: two equal lags with gain and slowest
  pole of the car, a model of the monitor's own, must show a motion equally far on the same side. So
  a gust, a faulty sensor or a stuck motor, against which the commands work, stops no car.
- **Swinging.** y swings out of the range to alternate sides while the commands are large enough to
  cause the swings: a limit cycle, growing or sustained, for which no reference asks. The force
  difference goes first. If the swings go on, or the force difference is zero, the torque goes too.

Ranges of healthy cars: y of a car in the box of the design leaves the range by ``doubt`` times the
largest reference at most. Wind, road and noise add less than ``swing``, and no alternating swings.

A repeated y is no news: the sensor may be frozen. The monitor then waits. Commands of zero cause no
motion: meanwhile the range holds y too, so a takeover or a standby begins without a swing.
"""

from __future__ import annotations

import math
from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import Struct

COMPENSATION_OFF, SWINGING, ASTRAY, BAD_COMMAND = 10, 11, 12, 13
"""Values of ``reason``, as in ``status.Verdict``."""


class Constants(Struct):
    """Constants."""

    enabled: Annotated[int, "1", "0: the monitor takes nothing away", (0, 1)]
    limit_1: Annotated[float, "u1", "largest magnitude of a command 1"]
    limit_2: Annotated[float, "u2", "largest magnitude of a command 2"]
    slew_1: Annotated[float, "u1/tick", "largest change of command 1 in a tick"]
    slew_2: Annotated[float, "u2/tick", "largest change of command 2 in a tick"]
    gain_1: Annotated[float, "y/u1", "steady motion of a command 1"]
    gain_2: Annotated[float, "y/u2", "steady motion of a command 2"]
    lag: Annotated[float, "1/tick", "share of the rest of a motion that a lag follows in a tick"]
    forgetting: Annotated[float, "1/tick", "share of the range forgotten in a tick"]
    doubt: Annotated[float, "1", "motion of healthy cars outside the range, over the reference"]
    swing: Annotated[float, "y", "least swing of a limit cycle"]
    still: Annotated[float, "y", "largest y of a car that goes straight on"]
    astray: Annotated[float, "y", "least distance of a car astray from the range"]
    most_swings: Annotated[float, "1", "swings in a row until something is taken away"]
    patience: Annotated[float, "tick", "longest time between swings in a row"]


class State(Struct):
    """State."""

    reason: Annotated[int, "1", "why something is taken away; 0: nothing is"]
    sent_1: Annotated[float, "u1", "command 1 of the last tick"]
    sent_2: Annotated[float, "u2", "command 2 of the last tick"]
    low: Annotated[float, "y", "lower end of the range"]
    high: Annotated[float, "y", "upper end of the range"]
    heard: Annotated[float, "y", "last y"]
    caused: Annotated[float, "y", "first lag of the motion that the commands cause"]
    motion: Annotated[float, "y", "second lag"]
    side: Annotated[float, "1", "side of the last swing: -1, 1; 0: none"]
    swings: Annotated[float, "1", "swings in a row"]
    powerless: Annotated[float, "tick", "ticks in a row in which large commands moved no car"]
    since: Annotated[float, "tick", "ticks since y was outside"]


@firmware
def clear_monitor(own: State) -> None:
    """Give everything back, for a car at rest or settled."""
    own.reason = 0
    own.sent_1 = own.sent_2 = own.low = own.high = own.heard = 0.0
    own.caused = own.motion = own.side = own.swings = own.since = own.powerless = 0.0


@firmware
def outside(value: float, low: float, high: float) -> float:
    """Signed distance of ``value`` from the range; 0 inside."""
    distance: float = value - min(max(value, low), high)
    return distance


@firmware
def possible(command: float, before: float, limit: float, slew: float) -> float:
    """``command`` as range and rate allow; ``before`` where the command is no number."""
    if not math.isfinite(command):
        return before
    allowed: float = min(max(command, before - slew), before + slew)
    return min(max(allowed, -limit), limit)


@firmware
def follow_range(table: Constants, own: State, reference: float, y: float) -> None:
    """Widen the range to this reference, or forget a little of the range."""
    if own.sent_1 == 0.0 and own.sent_2 == 0.0 and math.isfinite(y):
        own.low, own.high = y, y
    if math.isfinite(reference):
        own.low = min(reference, own.low + table.forgetting * (reference - own.low))
        own.high = max(reference, own.high + table.forgetting * (reference - own.high))


@firmware
def count_swings(table: Constants, own: State, distance: float, least: float) -> None:
    """Count alternating swings of y, ``distance`` outside the range and ``least`` or more."""
    own.since += real(1.0, own.since)
    if own.since > table.patience:
        own.swings = own.side = 0.0
    strong = abs(table.gain_1 * own.sent_1) + abs(table.gain_2 * own.sent_2)
    if abs(distance) > least and strong > least:
        side = real(1.0, distance)
        if distance < 0.0:
            side = -side
        if side != own.side:
            own.swings += real(1.0, own.since)
            own.side = side
        own.since = 0.0


@firmware
def judge_motion(table: Constants, own: State, y: float) -> None:
    """Find out whether y is astray or swings."""
    reach = table.doubt * max(abs(own.low), abs(own.high))
    zero = real(0.0, y)
    low, high = min(own.low, zero), max(own.high, zero)
    beyond, caused = outside(y, low, high), outside(own.motion, low, high)
    far = min(abs(beyond), abs(caused)) > table.astray + reach
    if far and beyond * caused > 0.0:
        own.reason = ASTRAY
    count_swings(table, own, outside(y, own.low, own.high), table.swing + reach)
    if own.swings >= table.most_swings and own.reason < SWINGING:
        torque_alone = own.reason == COMPENSATION_OFF or own.sent_2 == 0.0
        own.reason = COMPENSATION_OFF
        if torque_alone:
            own.reason = SWINGING
        own.swings = 0.0


@firmware
def judge_effect(table: Constants, own: State, reference: float, y: float) -> None:
    """Count the ticks in which a car goes straight on, whatever commands and reference ask for."""
    reach = table.doubt * max(abs(own.low), abs(own.high))
    own.powerless += real(1.0, own.powerless)
    caused = outside(own.motion, own.low, own.high)
    if abs(caused) <= table.astray + reach or abs(y) >= table.still:
        own.powerless = 0.0
    if abs(reference - y) <= table.swing + reach:
        own.powerless = 0.0


@firmware
def watch(
    table: Constants, own: State, reference: float, y: float, command_1: float, command_2: float
) -> tuple[float, float]:
    """Return the commands of this tick, less what has to be taken away.

    Args:
        table: the constants.
        own: the state; changed in place.
        reference: r of this tick; not finite: missing.
        y: the measurement of this tick, likewise.
        command_1: the command of the law to channel 1.
        command_2: the command of the law to channel 2.
    """
    before_1, before_2 = own.sent_1, own.sent_2
    if before_1 == 0.0 and before_2 == 0.0 and math.isfinite(command_1 + command_2):
        before_1, before_2 = command_1, command_2  # a takeover goes on with acting commands
    allowed_1 = possible(command_1, before_1, table.limit_1, table.slew_1)
    allowed_2 = possible(command_2, before_2, table.limit_2, table.slew_2)
    if own.reason == 0 and (allowed_1 != command_1 or allowed_2 != command_2):
        own.reason = BAD_COMMAND
    own.caused += table.lag * (table.gain_1 * own.sent_1 + table.gain_2 * own.sent_2 - own.caused)
    own.motion += table.lag * (own.caused - own.motion)
    follow_range(table, own, reference, y)
    if math.isfinite(y) and y != own.heard:
        own.heard = y
        judge_motion(table, own, y)
        judge_effect(table, own, reference, y)
    if table.enabled == 0:
        own.reason = 0
    zero = real(0.0, y)
    if own.reason > 0:
        allowed_2 = possible(zero, own.sent_2, table.limit_2, table.slew_2)
    if own.reason > COMPENSATION_OFF:
        allowed_1 = possible(zero, own.sent_1, table.limit_1, table.slew_1)
    own.sent_1, own.sent_2 = allowed_1, allowed_2
    if table.enabled == 0:
        allowed_1, allowed_2 = command_1, command_2
    return allowed_1, allowed_2
