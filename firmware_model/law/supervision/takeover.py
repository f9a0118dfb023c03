"""Takeover: a controller that begins while the plant moves.

After power-up the memories of the law say that the plant is at rest. D* may say otherwise: then the
plant was driven before, or still is. C would answer the difference with a jump, and the decision
would take the difference for a fault. So the law begins

1. in the settled state for ``level``, the part of y that the reference wants too: an actuator that
   still holds its command gets about the same command. Where the actuators are known to be at rest,
   ``level`` is zero;
2. with an observer of the remaining motion m = y - G1 u1 - G2 u2. m is a free response of G1, since
   no command of this controller causes m. The observer corrects m while ``listening``, and predicts
   m from then on. C and F1 work on y - m afterwards; until then the prediction stands in for
   y - m, C is a feedforward, and the decision waits;
3. with a reference that leads from the motion to r:

       w (r - m) + (1 - w) level,   w = s³ (10 - 15 s + 6 s²),   s = elapsed/returning

   w is the polynomial of least jerk (Flash and Hogan, J. Neurosci. 5 (1985) 1688).

The estimate of m has an error. The decision takes no error within its variance for a fault.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output, settle
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SECTIONS, FloatArray, Struct

BEGUN, UNKNOWN, AT_REST = 0, 1, 2
"""Values of ``pending``: begun already; the plant may move; likewise, with actuators at rest."""


class Constants(Struct):
    """Constants."""

    enabled: Annotated[int, "1", "0: m is unknown, and the law begins at rest", (0, 1)]
    least: Annotated[float, "y", "largest difference from the settled state that noise explains"]
    gain: Annotated[FloatArray, "1", "of the observer, a row a section", (MAX_SECTIONS, 2)]
    listening: Annotated[float, "tick", "ticks with a correction of m"]
    returning: Annotated[float, "tick", "ticks until the reference is r - m"]
    lasting: Annotated[float, "tick", "ticks until m has faded"]
    doubt: Annotated[float, "y²", "variance of m due to noise, after ``listening``"]
    doubted: Annotated[float, "1", "variance of m due to the model, over the largest m²"]


class State(Struct):
    """State."""

    motion: Annotated[biquad.State, "y", "state of G1 for m"]
    pending: Annotated[int, "1", "how the first tick with both inputs begins"]
    active: Annotated[int, "1", "1: the takeover has not ended"]
    level: Annotated[float, "y", "output of the settled state at the begin"]
    shown: Annotated[float, "y", "m of this tick"]
    error: Annotated[float, "y", "y - m - G1 u1 - G2 u2 of this tick"]
    largest: Annotated[float, "y", "largest |m| so far"]
    elapsed: Annotated[float, "tick", "ticks since the begin"]


@firmware
def wanted_level(reference: float, y: float) -> float:
    """The part of ``y`` that the ``reference`` wants too."""
    zero = real(0.0, y)
    if reference > zero:
        return min(max(y, zero), reference)
    return max(min(y, zero), reference)


@firmware
def begin_takeover(g1: biquad.Constants, own: State, level: float, remaining: float) -> None:
    """Begin with the law in the settled state for ``level``; ``remaining``: y less ``level``.

    At first m is the motion of a plant that was held at ``remaining`` until now.
    """
    own.active = 1
    own.level = level
    held = settle(g1, own.motion, real(1.0, level))
    share = remaining / held if held != 0.0 else real(0.0, level)
    for i in range(g1.n):
        for j in range(2):
            own.motion.accumulators[i, j] *= share


@firmware
def show_motion(g1: biquad.Constants, own: State) -> None:
    """Compute m of this tick; zero where no takeover is going on."""
    own.shown = 0.0
    if own.active:
        own.shown = output(g1, own.motion, real(0.0, own.level))
        own.largest = max(own.largest, abs(own.shown))


@firmware
def led_reference(constants: Constants, own: State, reference: float) -> float:
    """The reference of C in this tick: ``reference`` where no takeover is going on."""
    if own.active == 0:
        return reference
    one = real(1.0, reference)
    s = min(own.elapsed / constants.returning, one)
    w = s * s * s * (real(10.0, s) - s * (real(15.0, s) - real(6.0, s) * s))
    led: float = w * (reference - own.shown) + (one - w) * own.level
    return led


@firmware
def listens(constants: Constants, own: State) -> bool:
    """Whether the observer still corrects m."""
    listening: bool = own.active == 1 and own.elapsed < constants.listening
    return listening


@firmware
def advance_motion(constants: Constants, g1: biquad.Constants, own: State) -> None:
    """A tick on, corrected by ``own.error``; the takeover ends when m has faded."""
    if own.active == 0:
        return
    advance(g1, own.motion, real(0.0, own.level))
    if own.elapsed < constants.listening:
        for i in range(g1.n):
            for j in range(2):
                own.motion.accumulators[i, j] += constants.gain[i, j] * own.error
    own.error = 0.0
    own.elapsed += real(1.0, own.level)
    if own.elapsed >= constants.lasting:
        end_takeover(own)


@firmware
def doubt(constants: Constants, own: State) -> float:
    """The variance of the error of m after ``listening``."""
    variance: float = constants.doubt + constants.doubted * own.largest * own.largest
    return variance


@firmware
def end_takeover(own: State) -> None:
    """Nothing of the motion before the begin is left."""
    own.motion.accumulators[:] = 0.0
    own.active = 0
    own.level = own.shown = own.error = own.largest = own.elapsed = 0.0
