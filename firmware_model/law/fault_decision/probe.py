"""A small torque probe: the probe distinguishes a lost torque from other causes of d̂.

A biased D* sensor causes a d̂; a car different from the model does too. But only a lost torque
leaves the *probe's* effect in d̂. So before a suspected loss is confirmed the motor adds two
periods of a windowed sine, a sin ωkT (1 - cos ½ωkT)/2, and d̂ is compared with w (d̂ of a lost
torque; ``likelihood_ratio``) at the probe's frequency, where over whole periods a constant cancels:

    share = Re(D W*)/|W|²,  D = Σ d̂ exp(-jωk T),  W = Σ w exp(-jωk T)

1 for a dead motor, 1 - left for a weak motor, 0 for a bias, ΔG1/G1 for another car. C works on y
minus the modelled effect of u1 with the probe, so C does not fight the probe.

Only half of the phase, φ = ½ωkT, is kept: sin ωkT = 2 sin φ cos φ, cos ωkT = cos² φ - sin² φ.
"""

from __future__ import annotations

from typing import Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import FloatArray, Struct


class Constants(Struct):
    """Constants."""

    ticks: Annotated[int, "tick", "duration of a probe; 0: none"]
    amplitude: Annotated[float, "u1", "half of a, the amplitude of the sine"]
    least_share: Annotated[float, "1", "least missing part of the torque for a confirmed loss"]
    rotation: Annotated[FloatArray, "1", "of φ in a tick: cosine, sine", (2,)]


class State(Struct):
    """State."""

    tick: Annotated[int, "tick", "tick of the running probe, from 1 on; 0: no probe"]
    cosine: Annotated[float, "1", "cos φ"]
    sine: Annotated[float, "1", "sin φ"]
    correlation: Annotated[FloatArray, "y", "Re D, -Im D, Re W, -Im W", (4,)]


@firmware
def begin_probe(state: State) -> None:
    """Start a probe with the next tick."""
    state.tick = 1
    state.cosine = 1.0
    state.sine = 0.0
    state.correlation[:] = 0.0


@firmware
def phase(state: State) -> tuple[float, float, float]:
    """cos ωkT, sin ωkT, and the window 1 - cos ½ωkT."""
    cos, sin = state.cosine, state.sine
    cosine, sine = cos * cos - sin * sin, sin * cos + sin * cos
    window = cos * cos + sin * sin - cos
    return cosine, sine, window


@firmware
def probe_torque(constants: Constants, state: State) -> float:
    """The probe's addition to command 1 in this tick."""
    _, sin, window = phase(state)
    torque: float = constants.amplitude * window * sin
    return torque


@firmware
def correlate(constants: Constants, state: State, estimate: float, lost: float) -> bool:
    """Add d̂ and w of this tick and turn the phase; return whether the probe is over."""
    cos, sin, _ = phase(state)
    correlation = state.correlation
    correlation[0] += estimate * cos
    correlation[1] += estimate * sin
    correlation[2] += lost * cos
    correlation[3] += lost * sin
    cos, sin = state.cosine, state.sine
    state.cosine = constants.rotation[0] * cos - constants.rotation[1] * sin
    state.sine = constants.rotation[1] * cos + constants.rotation[0] * sin
    state.tick += 1
    over: bool = state.tick > constants.ticks
    return over


@firmware
def end_probe(state: State) -> float:
    """End the probe and return the missing part of the torque."""
    state.tick = 0
    d, w = state.correlation[:2], state.correlation[2:]
    power = w[0] * w[0] + w[1] * w[1]
    share = real(0.0, power)
    if power > 0.0:
        share = (d[0] * w[0] + d[1] * w[1]) / power
    return share
