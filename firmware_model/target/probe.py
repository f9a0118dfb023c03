"""A small torque probe: what d̂ alone cannot say, whether it is the torque that is lost.

A biased D* makes some d̂, a car that is not the modelled one too. But only a torque that does not
reach the wheels leaves what *it* would have done in d̂. So before a suspected loss is confirmed the
motor is told to add two periods of a sine that swells and fades, a sin ωkT (1 - cos ½ωkT)/2, and d̂
and w (what d̂ is if the torque is lost; ``decision``) are compared at its frequency, where over
whole periods a constant is silent:

    share = Re(D W*)/|W|²,  D = Σ d̂ exp(-jωk T),  W = Σ w exp(-jωk T)

1 for a dead motor, 1 - left for one that has lost a part, 0 for a bias, ΔG1/G1 for another car. C
is told beforehand what the probe will do to D* by the model, G1 delayed by the latency, so that it
lets the probe pass and does not fight it.

Only half of the phase, φ = ½ωkT, is kept: sin ωkT = 2 sin φ cos φ, cos ωkT = cos² φ - sin² φ. No
constant takes part in the arithmetic, which so stays in the table's own precision.
"""

from __future__ import annotations

from firmware_model.compiled import firmware
from firmware_model.target.layout import Record


@firmware
def begin(state: Record) -> None:
    """Start a probe with the next tick."""
    state.probe_at = 1
    state.probe_cos = 1.0
    state.probe_sin = 0.0
    state.probe_heard[:] = 0.0


@firmware
def phase(state: Record) -> tuple[float, float, float]:
    """cos ωkT, sin ωkT, and 1 - cos ½ωkT, the swell."""
    cos, sin = state.probe_cos, state.probe_sin
    return cos * cos - sin * sin, sin * cos + sin * cos, cos * cos + sin * sin - cos


@firmware
def probe_torque(table: Record, state: Record) -> float:
    """What is added to command 1 in this tick."""
    _, sin, swell = phase(state)
    added: float = table.probe_amplitude * swell * sin
    return added


@firmware
def probe_response(table: Record, state: Record) -> float:
    """What the probe adds to D* in this tick if the torque acts; as if it swelled slowly."""
    cos, sin, swell = phase(state)
    turned = table.probe_gain[0] * sin + table.probe_gain[1] * cos
    response: float = table.probe_amplitude * swell * turned
    return response


@firmware
def listen(table: Record, state: Record, estimate: float, expected: float) -> bool:
    """Take in d̂ and w of this tick, and turn the phase; whether the probe is over."""
    cos, sin, _ = phase(state)
    state.probe_heard[0] += estimate * cos
    state.probe_heard[1] += estimate * sin
    state.probe_heard[2] += expected * cos
    state.probe_heard[3] += expected * sin
    cos, sin = state.probe_cos, state.probe_sin
    state.probe_cos = table.probe_turn[0] * cos - table.probe_turn[1] * sin
    state.probe_sin = table.probe_turn[1] * cos + table.probe_turn[0] * sin
    state.probe_at += 1
    over: bool = state.probe_at > table.probe_ticks
    return over


@firmware
def share_heard(state: Record) -> float:
    """The part of the torque that the probe has found lost; ends the probe."""
    state.probe_at = 0
    heard = state.probe_heard
    size = heard[2] * heard[2] + heard[3] * heard[3]
    share: float = size - size
    if size > 0.0:
        share = (heard[0] * heard[2] + heard[1] * heard[3]) / size
    return share
