"""The tracking controller u1 = C(r - y) of (3.32), without wind-up.

Where the actuator cannot follow, C goes on from the error that would have asked for what the
actuator can do (conditioning: Hanus, Kinnaert and Henrotte, Automatica 23 (1987) 729).
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.filters import biquad
from firmware_model.target.filters.biquad import advance, settle, settle_integrator
from firmware_model.target.structs import Field, Record

CONSTANTS = (
    Field("filter", "u1/y", "C; 1 in the open loop", biquad.CONSTANTS),
    Field("feedback", "1", "1: C works on r - y; 0, the open loop: on r"),
    Field("conditioning", "y/u1", "1/C(z → ∞): the error for what saturation took off a command"),
    Field("steady_command", "u1/y", "command 1 for a settled reference of 1"),
    Field("integrates", "1", "1: C has an integrator", "int32"),
)
STATE = (Field("filter", "u1", "state of C", biquad.STATE),)


@firmware
def track(constants: Record, state: Record, error: float, asked: float, possible: float) -> None:
    """Advance C by the ``error`` for which it ``asked``, less what is not ``possible``."""
    realisable = error + (possible - asked) * constants.conditioning
    advance(constants.filter, state.filter, realisable)


@firmware
def settle_tracking(constants: Record, state: Record, reference: float, command: float) -> None:
    """The steady state at ``reference``, where C answers ``command``."""
    if constants.integrates:
        settle_integrator(constants.filter, state.filter, command)
    else:
        settle(constants.filter, state.filter, reference)
