"""The continuous loop of Figs. 2.1 and 3.4, solved by a path that the firmware has no part in.

Nothing here is discretised, factored or multiplied out: the loop is assembled from A, B, C with
python-control and advanced by exact matrix exponentials, tick by tick, however stiff it is.

* A filter q/G with q = 1/(1+τs)^α needs no zeros of G: with relative degree ρ,
  (1+τs)^ρ G has the state space (A, b, c(I+τA)^ρ, τ^ρ cA^(ρ-1)b), whose feedthrough is not zero,
  so it is inverted by exchanging input and output.
* C = Q/(1 - Q G1) of (3.32) stays what it is, u1 = Q(r - y + G1 u1), with stable parts only.
* The reference comes from an oscillator of its own, so no input is interpolated.
* The fault takes the plant's input away and leaves its state: a phase with another B goes on from
  the state in which the phase before it ended.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import control
import numpy as np
from scipy import linalg

from can_rig.errors import ScenarioError
from can_rig.plant.faults import CHANNELS
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario
from firmware_model.design.plants import Plant
from firmware_model.target.structs import FloatArray

OUTPUTS = ("r", "y", "u1", "u2", "d", "g1u1", "g2u2")
StateSpace = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


@dataclass(frozen=True)
class Solution:
    """The continuous loop at the ticks of a run, each of shape (ticks,), in the plant's units.

    ``model_1`` and ``model_2`` are L⁻¹[G1 u1] and L⁻¹[G2 u2]: what the commands would give.
    """

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    command_1: FloatArray
    command_2: FloatArray
    fault_estimate: FloatArray
    model_1: FloatArray
    model_2: FloatArray

    @property
    def error(self) -> FloatArray:
        """e = r - y (3.41)."""
        return self.reference - self.measurement


def solve(scenario: Scenario) -> Solution:
    """The exact response of the continuous loop at every tick of ``scenario``.

    Limits, latency and noise are the sampled loop's own and not part of it.

    Raises:
        ScenarioError: a fault or a reference that has no continuous counterpart here, or a design
            whose continuous filters are improper or unstable.
    """
    oscillator, initial, out = _reference(scenario)
    time_s = np.arange(scenario.ticks, dtype=np.float64) * (scenario.tick_ns * 1e-9)
    signals = np.empty((len(OUTPUTS), scenario.ticks))
    x = np.empty(0)
    phases = _phases(scenario)
    for (start_s, left), (end_s, _) in pairwise([*phases, (math.inf, (1.0, 1.0))]):
        a, b, c, d = closed_loop(scenario, left)
        n = len(a)
        joined = np.block([[a, b @ out], [np.zeros((len(oscillator), n)), oscillator]])
        answers = np.hstack([c, d @ out])
        if not len(x):
            x = np.concatenate([np.zeros(n), initial])
        # Half a nanosecond: a tick that is meant to be at the switch is after it.
        inside = np.flatnonzero((time_s >= start_s - 5e-10) & (time_s < end_s - 5e-10))
        now_s = start_s
        if len(inside):
            x = linalg.expm(joined * (time_s[inside[0]] - start_s)) @ x
            phi = linalg.expm(joined * (scenario.tick_ns * 1e-9))
            for k in inside:
                signals[:, k] = answers @ x
                before, x = x, phi @ x
            x, now_s = before, float(time_s[inside[-1]])
        if end_s < math.inf:
            x = linalg.expm(joined * (end_s - now_s)) @ x
    return Solution(time_s, *signals)


def closed_loop(scenario: Scenario, left: tuple[float, float]) -> StateSpace:
    """The loop from r to ``OUTPUTS`` as A, B, C, D, with ``left`` of each actuator's effect.

    Raises:
        ScenarioError: a filter that is improper or unstable.
    """
    car, model = continuous_plant(scenario.plant), continuous_plant(scenario.model)
    chosen = scenario.design
    closed = scenario.model.closed_loop
    blocks = [
        control.ss(car.a, car.b * left, car.c, 0.0, inputs=["u1", "u2"], outputs=["y"]),
        control.ss(model.a, model.b[:, :1], model.c, 0.0, inputs=["u1"], outputs=["g1u1"]),
        control.ss(model.a, model.b[:, 1:], model.c, 0.0, inputs=["u2"], outputs=["g2u2"]),
        # Theorem 2.3.2: d̂ = G1 u1 + G2 u2 - y
        control.summing_junction(["g1u1", "g2u2", "-y"], "d"),
        control.summing_junction(["f"] if closed else ["f", "r"], "u2"),
    ]
    if chosen.compensation == "off":
        blocks.append(control.ss([], [], [], 0.0, inputs=["d"], outputs=["f"]))
    else:
        compensator = lag_over(model, 1, chosen.tau_s, chosen.alpha)  # (3.29)
        blocks.append(control.ss(*compensator, inputs=["d"], outputs=["f"]))
    if closed:
        q = lag_over(model, 0, chosen.tau_q_s, chosen.alpha_q)  # (3.33)
        blocks.append(control.summing_junction(["r", "-y", "g1u1"], "w"))
        blocks.append(control.ss(*q, inputs=["w"], outputs=["u1"]))
    else:
        blocks.append(control.summing_junction(["r"], "u1"))
    blocks.append(control.summing_junction(["r"], "r_out"))
    outlist = ["r_out", *OUTPUTS[1:]]
    loop = control.interconnect(blocks, inplist=["r"], outlist=outlist, outputs=list(OUTPUTS))
    return loop.A, loop.B, loop.C, loop.D


def lag_over(plant: Plant, channel: int, tau_s: float, alpha: int) -> StateSpace:
    """1/((1+τs)^α G) of one channel (0, 1) of ``plant`` as A, B, C, D; τ in seconds.

    Raises:
        ScenarioError: α below the relative degree of G, or a zero of G in the right half plane.
    """
    a, b, c = plant.a, plant.b[:, channel : channel + 1], plant.c
    markov, degree = c, 1
    while abs((markov @ b).item()) <= 1e-12 * np.linalg.norm(markov) * np.linalg.norm(b):
        markov, degree = markov @ a, degree + 1
    if alpha < degree:
        raise ScenarioError(
            f"design: 1/((1+τs)^{alpha} G{channel + 1}) is improper; an order of at least "
            f"{degree} is right"
        )
    c_lead = c @ np.linalg.matrix_power(np.eye(len(a)) + tau_s * a, degree)
    inverse = 1.0 / (tau_s**degree * (markov @ b))
    filtered = (a - b @ inverse @ c_lead, b @ inverse, -inverse @ c_lead, inverse)
    if np.linalg.eigvals(filtered[0]).real.max() >= 0.0:
        raise ScenarioError(
            f"design: G{channel + 1} has a zero in the right half plane; the continuous loop is "
            "solved for minimum-phase cars only"
        )
    result = control.ss(*filtered)
    for _ in range(alpha - degree):
        result = control.ss(-1.0 / tau_s, 1.0, 1.0 / tau_s, 0.0) * result
    return result.A, result.B, result.C, result.D


def _reference(scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """An oscillator ẇ = Sw, r = ow that makes the reference: S, w(0), o."""
    settings = scenario.reference
    if settings.kind == "step":
        return np.zeros((1, 1)), np.array([settings.amplitude_mps2]), np.ones((1, 1))
    if settings.kind != "sine":
        raise ScenarioError(
            f"reference.kind = {settings.kind!r}: step or sine is right for the continuous loop"
        )
    omega = settings.frequency_rad_per_s
    turning = np.array([[0.0, omega], [-omega, 0.0]])
    return turning, np.array([0.0, settings.amplitude_mps2]), np.array([[1.0, 0.0]])


def _phases(scenario: Scenario) -> list[tuple[float, tuple[float, float]]]:
    """When each phase starts and what is left of each actuator's effect in it."""
    fault, healthy = scenario.fault, (1.0, 1.0)
    if fault.kind == "none":
        return [(0.0, healthy)]
    if fault.kind != "actuator-dead":
        raise ScenarioError(
            f"fault.kind = {fault.kind!r}: actuator-dead is right for the continuous loop, "
            "which has no frames"
        )
    dead = (fault.left, 1.0) if CHANNELS.index(fault.channel) == 0 else (1.0, fault.left)
    phases = [(0.0, healthy), (fault.at_s, dead)] if fault.at_s > 0.0 else [(0.0, dead)]
    if fault.for_s is not None:
        phases.append((fault.at_s + fault.for_s, healthy))
    return phases
