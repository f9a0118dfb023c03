"""The tracking controller u1 = C (r - y) of (3.32), in a form that no limit can make oscillate.

C = Q/(1 - Q G1) is the filter Q = q̂/G1 fed with the part of y outside the model:

    u1 = Q (r - y + G1 u1)

G1 u1 comes from the estimator: the limited and rounded command, with the delay of the bus. So as
long as the car equals the model, y - G1 u1 is the disturbance, whatever the limits of the actuator:
limits of magnitude and rate are outside the loop (internal model control: Garcia and Morari, Ind.
Eng. Chem. Process Des. Dev. 21 (1982) 308). Another car closes the loop only by the difference from
the model. The gain of Q G1 is 1 at zero frequency: the integrator.

After a loss channel 2 closes the loop. The shortfall of channel 2, G2 (asked - possible), is
subtracted from the model's output: so the limits of channel 2 are outside the loop too.

For an unstable plant the model is N1, and a filter R of the command stabilises the plant:
u1 = Q (r - y + N1 u1) + R u1 (``design.continuous_design``). Then limits have to stay in the loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.core import biquad
from firmware_model.law.core.biquad import advance, output
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_SHOWN_TICKS, FloatArray, Struct

if TYPE_CHECKING:
    from firmware_model.law.core import estimator


class Constants(Struct):
    """Constants."""

    filter: Annotated[biquad.Constants, "u1/y", "Q; 1 in the open loop"]
    feedback: Annotated[float, "1", "1: Q works on r - y + G1 u1; 0, the open loop: on r"]
    stabiliser: Annotated[biquad.Constants, "1", "R; no section where the plant is stable"]
    excuses_limits: Annotated[float, "1", "1: make-up of shortfalls; 0: unstable plant"]
    loop_inverse: Annotated[float, "1", "1/(1 - gain of the loop u1 → G1 u1 → u1 within a tick)"]


class State(Struct):
    """State."""

    filter: Annotated[biquad.State, "u1", "state of Q"]
    stabiliser: Annotated[biquad.State, "u1", "state of R"]
    error: Annotated[float, "y", "r - y + G1 u1 of the last tick with inputs"]
    delay: Annotated[FloatArray, "y", "G2 (asked - possible) on its way", (MAX_SHOWN_TICKS,)]


@firmware
def missing_output(
    constants: estimator.Constants, own: State, model: estimator.State, shortfall_2: biquad.State
) -> float:
    """Return G2 (asked - possible) in the measurement of this tick."""
    if constants.shown_ticks_2 > 0:
        missing: float = own.delay[model.queue_2.index]
        return missing
    return output(constants.channel_2, shortfall_2, real(0.0, own.error))


@firmware
def asked_torque(constants: Constants, state: State, error: float) -> float:
    """Return u1 for ``error`` = r - y + G1 u1, with G1 u1 before this tick's command."""
    torque: float = output(constants.filter, state.filter, error)
    if constants.stabiliser.n > 0:
        torque += output(constants.stabiliser, state.stabiliser, real(0.0, torque))
    inverse: float = constants.loop_inverse
    return torque * inverse


@firmware
def track(constants: Constants, state: State, error: float, command: float) -> None:
    """Advance Q by ``error`` = r - y + G1 u1, this tick's command included as it was limited."""
    state.error = error
    advance(constants.filter, state.filter, error)
    if constants.stabiliser.n > 0:
        advance(constants.stabiliser, state.stabiliser, command)


@firmware
def track_on(constants: Constants, state: State, command: float) -> float:
    """Pass a tick without inputs as if C saw no change; return the command that C would ask for."""
    torque: float = advance(constants.filter, state.filter, state.error)
    if constants.stabiliser.n > 0:
        torque += advance(constants.stabiliser, state.stabiliser, command)
    return torque
