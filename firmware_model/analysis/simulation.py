"""The sampled loop without a bus: ``step`` against the exactly sampled plant, in one array pass.

What the rig does with frames this does with floats, so a difference between the two is the bus.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_model.analysis.sampled_plant import SampledPlant, follow_plant, measure_plant
from firmware_model.compiled import firmware
from firmware_model.target import controller
from firmware_model.target.adaptive_threshold import least_model_share
from firmware_model.target.structs import FloatArray, Record


@dataclass(frozen=True)
class Trace:
    """One value a tick, each of shape (ticks,)."""

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    command_1: FloatArray
    command_2: FloatArray
    fault_estimate: FloatArray
    fault_state: NDArray[np.int64]
    share_shown: FloatArray
    """The least ``model_share`` for which d̂ stays below the adaptive threshold."""

    @property
    def error(self) -> FloatArray:
        """e = r - y (3.41)."""
        return self.reference - self.measurement


def simulate(
    table: Record,
    plant: SampledPlant,
    reference: FloatArray,
    *,
    effectiveness: FloatArray | None = None,
    noise: FloatArray | None = None,
) -> Trace:
    """Run the loop from rest, one tick for each reference sample.

    Args:
        table: from ``tables.build``, for the plant's tick; its latency is the loop's.
        plant: the car, which need not be the one the table was designed for.
        reference: (ticks,).
        effectiveness: (ticks, 2), what is left of each actuator; default all ones. A zero is the
            thesis's fault: the channel's input is gone, the plant keeps its state.
        noise: (ticks,), added to what the controller measures; default none.
    """
    ticks = len(reference)
    if effectiveness is None:
        effectiveness = np.ones((ticks, 2))
    if noise is None:
        noise = np.zeros(ticks)
    signals = np.zeros((5, ticks))
    fault_state = np.zeros(ticks, dtype=np.int64)
    _run(
        table,
        controller.init(table)[0],
        (plant.phi, plant.gamma, plant.c, plant.rest),
        (np.asarray(reference, dtype=np.float64), effectiveness, noise),
        signals,
        fault_state,
    )
    return Trace(
        time_s=plant.tick_s * np.arange(ticks, dtype=np.float64),
        reference=np.asarray(reference, dtype=np.float64),
        measurement=signals[0],
        command_1=signals[1],
        command_2=signals[2],
        fault_estimate=signals[3],
        fault_state=fault_state,
        share_shown=signals[4],
    )


@firmware
def _run(
    table: Record, state: Record, plant: Any, inputs: Any, signals: Any, fault_state: Any
) -> None:
    phi, gamma, c, x = plant
    reference, effectiveness, noise = inputs
    latency = table.estimator.latency_ticks
    y = measure_plant(c, x)
    for k in range(len(reference)):
        controller.step(table, state, reference[k], y + noise[k])
        signals[0, k] = y
        signals[1, k] = state.command_1
        signals[2, k] = state.command_2
        signals[3, k] = state.fault_estimate
        signals[4, k] = least_model_share(table.adaptive_threshold, state.adaptive_threshold)
        fault_state[k] = state.fault_state
        if k >= latency:  # until then the plant rests
            u1 = effectiveness[k, 0] * signals[1, k - latency]
            u2 = effectiveness[k, 1] * signals[2, k - latency]
            y = follow_plant(phi, gamma, c, x, u1, u2)
