"""Echoes: the actuators report their outputs; commands and reports must agree.

An echo is an actuator's own report of its output. The law models the output of a healthy actuator
from the commands, so the error

    e = modelled output - echo

is the missing output of the actuator, whatever the fault: lost, late, stuck, oscillating, or
obedient to foreign commands. e adds G v to d̂, with v the command that a healthy actuator turns into
e: a signature with only its share unknown. An echo alone proves nothing, because an echo may be
wrong or repeat the command: the evidence comes from d̂ (``hypotheses``). Once the evidence is
enough, the law *believes* the echo: G v leaves d̂, and F̂ gets the missing output of actuator 1. A
believed echo that turns out to be wrong is found by the same signature with the opposite sign. An
echo is *doubted* once d̂ contradicts its e, until the next echo without a fault. An echo has *lied*
if it denied a loss that d̂ has confirmed, and does not end the loss.

A motor that still obeys, with an offset, a drift or a delay, can make up for its own error: C takes
over the part that F̂ carries, as fast as two lags in a row. A motor obeys if the changes of e differ
from the changes of the modelled output. At the limit of its command the motor has no reserve. By
the time the law believes the echo, C has made up for a slow error already, by the same two lags: F̂
begins without that part (``told_handed``). Below a quarter of the output an error is no fault, but
C makes up for the error all the same; a believed error is over below a sixteenth, or within noise.

Between two echoes e stays. An echo that stays away for long gives no information.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.core.estimator import waiting
from firmware_model.law.precision import real
from firmware_model.law.structs import (
    MAX_COUNTED,
    MAX_LATENCY_TICKS,
    MAX_SECTIONS,
    FloatArray,
    Records,
    Struct,
)
from firmware_model.law.supervision import candidate, whitener
from firmware_model.law.supervision.whitener import add_signal, settle_whitener, whiten

if TYPE_CHECKING:
    from firmware_model.law.core import estimator
    from firmware_model.law.layout import Table
    from firmware_model.law.supervision import mismatch


KEPT_TICKS = 64
ACTUATORS = 2
TORQUE, FORCE = 0, 1


class Actuator(Struct):
    """Constants of an actuator."""

    stage: Annotated[whitener.Constants, "1", "from its command to its output"]
    dead_ticks: Annotated[int, "tick", "its dead time", (0, MAX_LATENCY_TICKS)]
    least: Annotated[float, "command²", "fading sum of outputs that noise may hide"]
    lead: Annotated[float, "1", "change of v over change of e; 1 for v = e"]


class Constants(Struct):
    """Constants."""

    actuators: Annotated[Records[Actuator], "1", "both actuators", (ACTUATORS,)]
    wrong: Annotated[candidate.Limits, "1", "limits of the share of e in d̂ where e is believed"]
    longest: Annotated[
        int, "tick", "largest age of an echo that counts; 0: no actuator reports", (0, MAX_COUNTED)
    ]
    working: Annotated[int, "1", "echoes without a fault that end the belief", (0, MAX_COUNTED)]
    hand_over: Annotated[float, "1", "part of the distance per tick of a lag, from F̂ to C"]


class Echo(Struct):
    """What one actuator reports."""

    stage: Annotated[whitener.State, "command", "state of the actuator"]
    outputs: Annotated[FloatArray, "command", "ring of the modelled output", (KEPT_TICKS,)]
    error: Annotated[float, "command", "e"]
    before: Annotated[float, "command", "e of the tick before"]
    missing: Annotated[float, "command²", "fading Σ e · output over the echoes"]
    off: Annotated[float, "command²", "fading Σ e² over the echoes"]
    power: Annotated[float, "command²", "fading Σ output² over the echoes"]
    modelled: Annotated[float, "command", "modelled output at the sample of the last echo"]
    turned: Annotated[float, "command²", "e · output before - e before · output; 0: one share"]
    stray: Annotated[
        float,
        "command²",
        "fading Σ change of e · change of output, while faulty and e moves little",
    ]
    swing: Annotated[float, "command²", "fading Σ (change of output)², likewise"]
    good: Annotated[int, "1", "echoes without a fault, one after another"]
    left: Annotated[int, "tick", "for so long the last echo counts; 0: no echo"]
    believed: Annotated[int, "1", "1: e is known to be missing"]
    doubted: Annotated[int, "1", "1: d̂ has contradicted the fault that the echo shows"]
    lied: Annotated[int, "1", "1: the echo denied the loss that d̂ has confirmed"]
    known: Annotated[biquad.State, "y", "state of G driven by the believed v"]
    previous: Annotated[float, "y", "its output in the last tick"]
    told: Annotated[float, "y", "the same of v since the onset of its signature"]


class State(Struct):
    """State."""

    actuators: Annotated[Records[Echo], "1", "of both actuators", (ACTUATORS,)]
    index: Annotated[int, "1", "index of the newest output in the rings"]
    between: Annotated[float, "y", "what C has taken over, after the first lag"]
    handed: Annotated[float, "y", "the same after the second lag"]
    told_between: Annotated[float, "y", "what C does of an echo not believed, after the first lag"]
    told_handed: Annotated[float, "y", "the same after the second lag"]


@firmware
def take_echo(constants: Constants, state: State, which: int, echo: float, age: float) -> None:
    """Compare an echo of the actuator ``which`` with the modelled output at its sample's time."""
    own = state.actuators[which]
    index = (state.index + KEPT_TICKS - int(age)) % KEPT_TICKS
    modelled, half = own.outputs[index], real(0.5, echo)
    error = modelled - echo
    moved, keep = modelled - own.modelled, real(0.99, echo)
    change, two = error - own.error, real(2.0, echo)
    if abs(change) < two * abs(moved):  # otherwise e begins, or moves by itself
        own.stray = keep * own.stray + moved * change
        own.swing = keep * own.swing + moved * moved
    own.turned = error * own.modelled - own.error * modelled
    own.error, own.modelled = error, modelled
    own.missing = half * own.missing + modelled * error
    own.off = half * own.off + error * error
    own.power = half * own.power + modelled * modelled
    own.left = constants.longest
    healthy = real(16.0, echo) * own.off < own.power
    if healthy or own.good > 0:
        own.stray = own.swing = 0.0
        own.doubted = 0
    own.good = min(own.good + 1, MAX_COUNTED) if healthy else 0
    slight = real(256.0, echo) * own.off < own.power
    if works(own, constants.working) and (slight or own.off < constants.actuators[which].least):
        own.believed = 0


@firmware
def advance_echoes(
    table: Table, own: State, model: estimator.State, command_1: float, command_2: float, lost: bool
) -> None:
    """A tick on: compute the outputs of the next tick; call before ``advance_model``.

    ``lost``: whether a loss of channel 1 is confirmed.
    """
    constants, plant = table.echoes, table.estimator
    if constants.longest == 0:
        return
    torque, force = constants.actuators[TORQUE], constants.actuators[FORCE]
    waits_1 = plant.latency_ticks + torque.dead_ticks
    waits_2 = plant.latency_ticks + force.dead_ticks
    u1 = waiting(model.queue_1, plant.shown_ticks_1, waits_1, command_1)
    u2 = waiting(model.queue_2, plant.shown_ticks_2, waits_2, command_2)
    own.index = (own.index + 1) % KEPT_TICKS
    echo = own.actuators[TORQUE]
    advance_echo(torque, plant.channel_1, echo, u1, own.index)
    advance_echo(force, plant.channel_2, own.actuators[FORCE], u2, own.index)
    taken = real(0.0, u1)
    if obeys(torque, echo) and abs(u1) < table.actuator_1.limit:
        taken = echo.previous
    own.between += constants.hand_over * (taken - own.between)
    own.handed += constants.hand_over * (own.between - own.handed)
    told = real(0.0, u1)
    alone = echo.believed == 0 and not lost  # F̂ is at rest
    if alone and (echo.good > 0 or obeys(torque, echo)):
        told = echo.told
    own.told_between += constants.hand_over * (told - own.told_between)
    own.told_handed += constants.hand_over * (own.told_between - own.told_handed)


@firmware
def advance_echo(
    constants: Actuator, channel: biquad.Constants, own: Echo, command: float, index: int
) -> None:
    """A tick on: ``command`` acts on the actuator; its next output belongs at ``index``."""
    own.previous = advance(channel, own.known, believed_command(constants, own))
    own.before = own.error
    whiten(constants.stage, own.stage, command)
    own.outputs[index] = own.stage.memory[0, 0]
    if own.left > 0:
        own.left -= 1
    if own.left == 0:
        own.error = own.told = 0.0


@firmware
def missing_command(constants: Actuator, own: Echo) -> float:
    """Return v, a tick late: the missing command of an actuator of first order."""
    command: float = own.before + constants.lead * (own.error - own.before)
    return command


@firmware
def believed_command(constants: Actuator, own: Echo) -> float:
    """Return v where the echo is believed, otherwise 0."""
    command: float = real(0.0, own.error)
    if own.believed == 1:
        command = missing_command(constants, own)
    return command


@firmware
def known_output(constants: Actuator, channel: biquad.Constants, own: Echo) -> float:
    """The output that is known to be missing in y of this tick: G of the believed v."""
    missing: float = output(channel, own.known, believed_command(constants, own))
    return missing


@firmware
def believe(
    table: Table, known: mismatch.State, own: Echo, row: candidate.State, answer: biquad.State
) -> None:
    """Believe the echo from the onset of its signature on; a believed echo, no longer.

    Args:
        table: the constant table.
        known: of the car; changed in place.
        own: the echo.
        row: the fit of its signature to d̂.
        answer: the state of G that makes the signature.
    """
    sign = real(1.0, own.error)
    if own.believed == 1:
        sign = -sign
    for i in range(MAX_SECTIONS):
        for j in range(2):
            own.known.accumulators[i, j] += sign * answer.accumulators[i, j]
    for i in range(table.mismatch.n):
        known.theta[i] -= sign * row.explained[i]
    add_signal(table.mismatch.whitener, known.white.fading, sign, row.white)
    own.previous += sign * own.told
    own.believed = 1 - own.believed
    own.good = 0


@firmware
def says_lost(constants: Actuator, own: Echo) -> bool:
    """Whether the last echoes miss a quarter of the actuator's output, more than noise hides."""
    quarter, nine = real(0.25, own.power), real(9.0, own.power)
    shows = own.left > 0 and own.power > nine * constants.least  # so a quarter is clear of noise
    lost: bool = shows and own.missing > quarter * own.power
    return lost


@firmware
def contradicts_share(constants: Actuator, own: Echo, share: float) -> bool:
    """Whether the last echo shows a fault that a loss of ``share`` explains less than half."""
    rest, quarter = own.error - share * own.modelled, real(0.25, own.error)
    rest = rest * rest
    less = rest > quarter * own.error * own.error and rest > constants.least
    contradicts: bool = confesses(constants, own) and less
    return contradicts


@firmware
def told_share(constants: Actuator, own: Echo) -> float:
    """The lost share that the last two echoes report; 0 where e or its changes show no share."""
    none, quarter = real(0.0, own.error), real(0.25, own.error)
    if not abs(own.turned) < quarter * abs(own.error * own.modelled):
        return none
    rest = own.error * own.swing - own.stray * own.modelled
    if own.swing > constants.least and abs(rest) > quarter * abs(own.error) * own.swing:
        return none
    return min(max(own.error / own.modelled, none), real(1.0, own.error))


@firmware
def obeys(constants: Actuator, own: Echo) -> bool:
    """Whether a faulty actuator follows the changes of its commands, as far as noise lets one see.

    The changes of e of a dead or stuck actuator are those of the modelled output.
    """
    most = real(0.75, own.swing)
    follows: bool = own.swing > constants.least and own.stray < most * own.swing
    return follows


@firmware
def moves(constants: Actuator, own: Echo) -> bool:
    """Whether a faulty actuator obeys, seen in changes of its output of an eighth of e together."""
    most = real(64.0, own.swing) * own.swing
    seen: bool = obeys(constants, own) and own.error * own.error < most
    return seen


@firmware
def shows(constants: Actuator, own: Echo) -> bool:
    """Whether the last echoes show an error beyond noise, or the law believes the error.

    The noise of an echo explains nothing, however well the noise fits a large d̂ by chance.
    """
    shown: bool = own.believed == 1 or own.off > constants.least
    return shown


@firmware
def confesses(constants: Actuator, own: Echo) -> bool:
    """Whether the last echo shows a fault, more than noise."""
    shown: bool = own.left > 0 and own.good == 0 and own.off > constants.least
    return shown


@firmware
def denies(constants: Actuator, own: Echo) -> bool:
    """Whether the last echoes deny a loss of the actuator."""
    return own.left > 0 and own.believed == 0 and not says_lost(constants, own)


@firmware
def works(own: Echo, working: int) -> bool:
    """Whether so many echoes have reported a ``working`` actuator, one after another."""
    return own.left > 0 and working > 0 and own.good >= working


@firmware
def settle_echoes(constants: Constants, own: State, command_1: float, command_2: float) -> None:
    """The actuators have followed the present commands for long; no echo has come."""
    settle_echo(constants.actuators[TORQUE], own.actuators[TORQUE], command_1)
    settle_echo(constants.actuators[FORCE], own.actuators[FORCE], command_2)
    own.between = own.handed = own.told_between = own.told_handed = 0.0


@firmware
def settle_echo(constants: Actuator, own: Echo, command: float) -> None:
    """The actuator has followed ``command`` for long."""
    settle_whitener(constants.stage, own.stage, command)
    own.outputs[:] = own.modelled = command
    own.known.accumulators[:] = 0.0
    own.error = own.before = own.missing = own.off = own.power = own.previous = own.told = 0.0
    own.stray = own.swing = own.turned = 0.0
    own.good = own.left = own.believed = own.doubted = own.lied = 0
