"""The same bits compiled and interpreted, in both precisions, through every part of the law."""

import math
from typing import Any

import numpy as np
import pytest

from firmware_model.analysis.sampled_plant import follow_plant, sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.precision import real
from firmware_model.law.status import FaultState, Mode
from tests.firmware.both_ways import lines_compiled_and_interpreted
from tests.firmware.law.cases import other_cars

TICK_S, TICKS, LOST, BACK = 1e-3, 190, 70, 150
CAR = steer_by_wire()
PLANT = sample(CAR, TICK_S)
DESIGN = design(CAR, DesignSpecification(tau_s=0.002, tau_q_s=0.01))
LIMITED = {"limit_1": 300.0, "limit_2": 3000.0, "lsb_1": 1e-3, "lsb_2": 1e-2}
NOISE_RMS = 2e-4
COMPENSATING = {"on_confirmation": True, "noise_rms": 1e-3}
TARGETS: dict[str, dict[str, Any]] = {
    "thesis": {"estimator": "tustin", **LIMITED},
    "coloured noise": {"latency_ticks": 1, "mismatch": other_cars(1), "noise_pole": 0.5,
                       "resolution": 1e-3, **COMPENSATING},
    "all": {
        "latency_ticks": 2, "reference_acceleration": 60.0, "rate_1": 2e4, "rate_2": 1e5,
        "mismatch": other_cars(2), **COMPENSATING, **LIMITED,
    },
}  # fmt: skip


def records(name: str, precision: Any) -> list[bytes]:
    """The whole state after every tick: through a loss, a return, missing inputs, a reset."""
    target = Target(TICK_S, precision=precision, **{"estimator": "zoh", **TARGETS[name]})
    table = build(DESIGN, target)
    states, rng = controller.init(table), np.random.default_rng(8)
    state, x, y = states[0], PLANT.rest, 0.0
    after, modes = [], set()
    controller.reset(table, state, 0.25)
    for k in range(TICKS):
        reference = 0.25 if k < 40 else math.copysign(1.0, math.sin(0.03 * k))
        noise = NOISE_RMS * rng.standard_normal()
        told = math.nan if k == 50 else reference
        controller.step(table, state, told, math.nan if k in (110, 111, 112) else y + noise)
        after.append(states.tobytes())
        modes.add((int(state.mode), int(state.fault_state)))
        left = 0.0 if LOST <= k < BACK else 1.0
        u1, u2 = left * float(state.command_1), float(state.command_2)
        y = follow_plant(PLANT.phi, PLANT.gamma, PLANT.c, x, u1, u2)
    assert {mode for mode, _ in modes} == {Mode.RUN, Mode.BLIND}
    if "on_confirmation" in TARGETS[name]:
        assert FaultState.CONFIRMED in {fault for _, fault in modes}
    return after


CASES = [("thesis", "float64"), ("coloured noise", "float32"), ("all", "float64"),
         ("all", "float32")]  # fmt: skip


@pytest.mark.compiled
def test_compiled_and_interpreted_states_are_bit_identical():
    outputs = lines_compiled_and_interpreted(__file__)
    compiled, interpreted = outputs
    assert len(compiled) == len(interpreted) == len(CASES) * TICKS
    different = [
        f"{CASES[i // TICKS]}: tick {i % TICKS}"
        for i, (one, other) in enumerate(zip(compiled, interpreted, strict=True))
        if one != other
    ]
    assert different == []


if __name__ == "__main__":
    for case in CASES:
        for record in records(*case):
            print(record.hex())


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_number_takes_the_precision_of_the_table(kind):
    third = real(1.0 / 3.0, kind(7.0))
    assert third == kind(1.0 / 3.0)
    assert np.asarray(third * kind(1.0)).dtype == kind
