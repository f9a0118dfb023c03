"""The compensator u2 = r2 + F̂ d̂ of (2.37), with the algebraic loop through d̂ solved.

With a Tustin estimator at zero latency this tick's d̂ depends on this tick's u2, which depends on
this tick's d̂: F̂ is biproper and Tustin's G2 feeds through, with loop gain T/(2τ+T) for the
thesis's design. A factor known at design time solves the loop exactly, also under saturation: for a
loop gain below 1 the saturated solution of the linear loop is the solution of the saturated loop.
With a held-input estimator, or any latency, the gain is 0.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.law.core import biquad
from firmware_model.law.structs import Struct


class Constants(Struct):
    """Constants."""

    filter: Annotated[biquad.Constants, "u2/y", "F̂"]
    feedthrough: Annotated[float, "u2/y", "of F̂ to the same tick"]
    loop_inverse: Annotated[float, "1", "1/(1 - gain of the algebraic loop)"]
    reference_share: Annotated[float, "u2/y", "of the reference, that goes to channel 2 directly"]
    on_confirmation: Annotated[int, "1", "1: F̂ acts on a confirmed loss; 0: on d̂", (0, 1)]


class State(Struct):
    """State."""

    filter: Annotated[biquad.State, "u2", "state of F̂"]
