"""Loops for the tests of this room."""

import numpy as np

from firmware_model.analysis.margins import HEALTHY
from firmware_model.analysis.sampled_loop import SampledLoop, linear_controller, sampled_loop
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target

CAR = steer_by_wire()
PUBLISHED = design(CAR, DesignSpecification())
SLOW = design(CAR, DesignSpecification(tau_s=0.01, tau_q_s=0.02))


def loop_of(
    designed: ContinuousDesign,
    target: Target,
    left: tuple[float, float] = HEALTHY,
    late: float = 0.0,
) -> SampledLoop:
    law = linear_controller(build(designed, target))
    return sampled_loop(law, designed.plant, target.tick_s, left, late)


def scalar_loop(pole: float, feedback: float) -> SampledLoop:
    """x⁺ = pole x + feedback y_m, y = x."""
    b, h, d = np.array([[feedback, 0.0]]), np.zeros((3, 1)), np.zeros((3, 2))
    return SampledLoop(np.array([[pole]]), b, np.ones(1), h, d, 1.0)
