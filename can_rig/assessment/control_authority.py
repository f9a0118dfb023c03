"""Whether X_diff can carry what the lost torque carried: the actuator's limit and the tires'.

With the torque lost the column turns free, so the front tires carry no lateral force in a steady
bend (3.4), and all of m a_y is the rear axle's: Y_r = m a_y, and X_diff = 2 l_r Y_r/d_r from (3.3),
which is a_y/G2(0); D* = a_y where nothing turns any more (3.8). Both share the friction of the rear
tires: √(X_diff² + Y_r²) ≤ μ m g l_f/(l_f + l_r). The simulated linear car knows nothing of it; a
nonlinear one slides.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np

from can_rig.frames.network import Network
from can_rig.plant.nonlinear_car import car_of
from can_rig.scenario.build import continuous_plant, target
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario


@dataclass(frozen=True)
class Authority:
    """What X_diff has to give after the loss of the torque, and what it can.

    Attributes:
        reference_mps2: largest |r| of the scenario.
        needed_n: |X_diff| that holds it.
        limit_n: the actuator's, or its frame's.
        tires_n: what friction leaves beside the lateral force of that bend.
        carries_mps2: the largest |D*| that limit and tires can hold.
        friction: μ.
    """

    reference_mps2: float
    needed_n: float
    limit_n: float
    tires_n: float
    carries_mps2: float
    friction: float

    @property
    def available_n(self) -> float:
        """The smaller of the two."""
        return min(self.limit_n, self.tires_n)

    @property
    def enough(self) -> bool:
        """Whether the loss can be carried at all."""
        return self.reference_mps2 <= self.carries_mps2

    def __str__(self) -> str:
        can = "enough" if self.enough else "NOT ENOUGH"
        return (
            f"authority: {can}: |r| = {self.reference_mps2:.3g} m/s² without the torque takes "
            f"{self.needed_n:.0f} N of X_diff; its limit is {self.limit_n:.0f} N, the tires leave "
            f"{self.tires_n:.0f} N (μ = {self.friction:g}): up to {self.carries_mps2:.3g} m/s²"
        )

    def as_dict(self) -> dict[str, float | bool]:
        """For JSON."""
        return {**asdict(self), "enough": self.enough}


def authority(scenario: Scenario, network: Network) -> Authority | None:
    """The authority of ``scenario``'s X_diff; None where the plant is no car."""
    if not scenario.model.is_car:
        return None
    car = car_of(scenario.plant)
    force_per_mps2 = 1.0 / abs(continuous_plant(scenario.plant).g2.dc_gain)
    wanted = float(np.abs(reference(scenario)).max())
    limit_n = float(target(scenario, network).limit_2)
    sideways = car.m * wanted
    return Authority(
        reference_mps2=wanted,
        needed_n=force_per_mps2 * wanted,
        limit_n=limit_n,
        tires_n=math.sqrt(max(car.grip_r**2 - sideways**2, 0.0)),
        carries_mps2=min(limit_n / force_per_mps2, car.grip_r / math.hypot(force_per_mps2, car.m)),
        friction=scenario.plant.friction,
    )
