"""Cars, targets and tables that several of these tests look at."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import Channels, Mismatch, principal_mismatch
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from firmware_model.law.structs import FloatArray, Records
from firmware_model.law.supervision.covariance import MAX_DIRECTIONS, MAX_STATES
from firmware_model.law.supervision.frozen import weigh_frozen
from firmware_model.law.supervision.signatures import (
    BIAS_ROW,
    DRIFT_ROW,
    FORCE_ROW,
    OFFSET_ROW,
    advance_signatures,
    keep_before,
    weigh_signatures,
)

NOMINAL = VehicleParameters()
CAR = steer_by_wire(NOMINAL)
TICK_S = 1e-3

DESIGN = design(CAR, DesignSpecification(tau_s=0.005, tau_q_s=0.02))
"""A compensation that is tame enough for noise and other cars."""

NEVER = {"confirm": math.inf, "recover": math.inf, "suspect": math.inf}
"""Numbers of a decision that is never taken."""


def car_at(place: FloatArray) -> VehicleParameters:
    """Mass, speed, front and rear tires up to 20 % off, at ``place`` in the box of -1..1."""
    names = (
        "mass_kg", "speed_mps", "front_cornering_stiffness_n_per_rad",
        "rear_cornering_stiffness_n_per_rad",
    )  # fmt: skip
    changes = {
        name: getattr(NOMINAL, name) * (1.0 + 0.2 * float(part))
        for name, part in zip(names, place, strict=False)
    }
    return VehicleParameters(**changes)


def channels_at(place: FloatArray) -> Channels:
    plant = steer_by_wire(car_at(place))
    return plant.g1, plant.g2


def other_cars(parameters: int = 3) -> Mismatch:
    return principal_mismatch(channels_at, parameters, 0.05, 1, MAX_DIRECTIONS)


def changed(table: Any, **numbers: dict[str, Any]) -> Records[Any]:
    """A copy, shape (1,), with other numbers: ``decision={"confirm": 4.0}``."""
    tables = np.zeros(1, table.dtype)
    tables[0] = table
    for part, values in numbers.items():
        for name, value in values.items():
            tables[part][name] = value
    return tables


def covariance_of(mismatch: Any) -> FloatArray:
    """P of its filter, from the factors."""
    factor = np.tril(mismatch.covariance.lower, -1) + np.eye(MAX_STATES)
    return np.asarray(factor * mismatch.covariance.variances @ factor.T)


def through(sections: Any, values: NDArray[Any]) -> NDArray[Any]:
    """Scipy's answer of a filter to ``values``."""
    return np.asarray(signal.sosfilt(sections.sos, values))


def late(values: NDArray[Any], ticks: int) -> NDArray[Any]:
    """``values`` so many ticks later, zero before."""
    return np.concatenate([np.zeros(ticks), values])[: len(values)]


ROW = {
    "torque_offset": OFFSET_ROW, "force_lost": FORCE_ROW,
    "sensor_biased": BIAS_ROW, "sensor_drifting": DRIFT_ROW,
}  # fmt: skip
"""The hypothesis of a fault."""


def weigh(table: Any, state: Any, innovation: float) -> None:
    """A tick of all signatures, with what ``state`` has of everything else."""
    own, command_2 = state.supervision.hypotheses, state.supervision.other_cars.command_2
    weigh_signatures(
        table,
        own.signatures,
        state.supervision.mismatch,
        state.supervision.echoes,
        command_2,
        own.verdict,
        innovation,
    )
    keep_before(own.signatures, state.supervision.sequential_test.candidate.age)


def tick_on(table: Any, state: Any) -> None:
    """From that tick to the next."""
    own, command_2 = state.supervision.hypotheses.signatures, state.supervision.other_cars.command_2
    advance_signatures(table, own, state.supervision.echoes, command_2)


def repeat(table: Any, state: Any, shown: float, expected: float) -> None:
    """A tick of the sensor that may be frozen."""
    own = state.supervision.hypotheses.frozen
    weigh_frozen(table, own, state.supervision.mismatch, state.measurement, shown, expected)


def with_one_onset(**changes: Any) -> Any:
    """A table whose hypotheses keep their onset."""
    table = changed(build(DESIGN, Target(TICK_S, 1, "zoh", noise_rms=0.01, **changes)))[0]
    numbers = table.hypotheses.signatures.candidate
    numbers.restart, numbers.lifetime = -math.inf, math.inf
    return table


def restarted_table(**changes: Any) -> Any:
    """Of a controller that may begin, or begin anew, while the car moves."""
    specification = DesignSpecification(tau_s=0.05, tau_q_s=0.02)
    known = {"mismatch": other_cars(2), "on_confirmation": True, **changes}
    return build(design(CAR, specification), Target(TICK_S, 1, "zoh", **known))


class Loop:
    """The model of the law with a sensor, in a sine; channel 1 works to a part."""

    plant = sample(CAR, TICK_S)

    def __init__(self, table: Any, noise_rms: float = 0.0) -> None:
        self.firmware = Firmware(table)
        self.working, self.bias = 1.0, 0.0
        self.state, self.acting, self.ticks = self.plant.rest, np.zeros(2), 0
        self.noise_rms, self.noise = noise_rms, np.random.default_rng(3)

    @property
    def reference(self) -> float:
        return float(np.sin(1.3 * self.ticks * TICK_S))

    @property
    def output(self) -> float:
        return float(self.plant.c @ self.state)

    def run(self, ticks: int) -> list[Any]:
        answers = []
        for _ in range(ticks):
            measured = self.output + self.bias + self.noise_rms * self.noise.standard_normal()
            answers.append(self.firmware.step(self.reference, measured))
            self.go_on(answers[-1])
        return answers

    def go_on(self, answer: Any) -> None:
        """A tick of the car, after which it gets the commands of ``answer``."""
        left = np.array([self.working, 1.0])
        self.state = self.plant.phi @ self.state + self.plant.gamma @ (left * self.acting)
        self.acting = np.array(answer[:2])
        self.ticks += 1
