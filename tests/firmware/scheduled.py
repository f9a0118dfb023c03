"""The thesis's car behind lags, designed for several speeds."""

import math
from dataclasses import replace

import numpy as np

from firmware_model.design.actuator_dynamics import IDEAL, Stage, actuated
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.mismatch import Mismatch
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.discretisation.schedules import AtSpeed, Scheduled, schedule
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.layout import precision_of
from firmware_model.law.schedule import State, change_speed
from firmware_model.law.structs import zeroed

TICK_S = 1e-3
LAGS = (Stage(0.005), Stage(0.015), IDEAL)
SPEEDS = (12.0, 13.2, 14.5)
TARGET = Target(TICK_S, latency_ticks=1, estimator="zoh", on_confirmation=True)
SPECIFICATION = DesignSpecification(tau_s=0.002, alpha=2, tau_q_s=0.015, alpha_q=3)


def car(speed_mps: float, stages: tuple[Stage, Stage, Stage] = LAGS, mass: float = 1.0) -> Plant:
    heavier = replace(TABLE_3_2, speed_mps=speed_mps, mass_kg=mass * TABLE_3_2.mass_kg)
    return actuated(steer_by_wire(heavier), *stages)


def scheduled(
    speeds: tuple[float, ...] = SPEEDS,
    target: Target = TARGET,
    cars: int = 0,
    stages: tuple[Stage, Stage, Stage] = LAGS,
    specification: DesignSpecification = SPECIFICATION,
) -> Scheduled:
    """Designs at ``speeds`` that know ``cars`` other cars, each lighter than the one before."""
    designs = []
    for speed in speeds:
        others = tuple(car(speed, stages, math.exp(-0.02 * (i + 1))) for i in range(cars))
        known = Mismatch(tuple((other.g1, other.g2) for other in others))
        made = design(car(speed, stages), specification)
        designs.append(AtSpeed(speed, made, replace(target, mismatch=known), others))
    return schedule(designs)


class Blended:
    """A working table with its state, and the record of the blending."""

    def __init__(self, of: Scheduled) -> None:
        self.schedule = of.schedule
        self.table = np.array([of.table])[0]
        self.state = controller.init(self.table)[0]
        self.own = zeroed(State, precision_of(of.table))[0]

    def to(self, speed: float) -> None:
        change_speed(self.schedule, self.own, self.table, self.state, speed)
