"""Cars, targets and tables that several of these tests look at."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import Channels, Mismatch, principal_mismatch
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.law.structs import FloatArray, Records
from firmware_model.law.supervision.covariance import MAX_DIRECTIONS, MAX_STATES
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
    own, command_2 = state.hypotheses, state.other_cars.command_2
    weigh_signatures(
        table, own.signatures, state.mismatch, state.echoes, command_2, own.verdict, innovation
    )
    keep_before(own.signatures, state.sequential_test.candidate.age)


def tick_on(table: Any, state: Any) -> None:
    """From that tick to the next."""
    own, command_2 = state.hypotheses.signatures, state.other_cars.command_2
    advance_signatures(table, own, state.echoes, command_2)
