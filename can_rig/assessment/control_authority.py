"""Control authority: whether X_diff can replace the lost torque within its limit and the tires'.

With the torque lost the steering column turns freely, so in a steady bend the front tires carry no
lateral force (3.4) and the rear axle carries all of m a_y: Y_r = m a_y, and X_diff = 2 l_r Y_r/d_r
from (3.3), which is a_y/G2(0); D* = a_y once the yaw rate is steady (3.8). Both share the friction
of the rear tires: √(X_diff² + Y_r²) ≤ μ m g l_f/(l_f + l_r). The linear car ignores this limit; a
nonlinear car slides.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from can_rig.frames.network import Network
from can_rig.plant.frameless import undisturbed_with_files
from can_rig.plant.nonlinear_car import car_of
from can_rig.scenario.build import continuous_plant, target
from can_rig.scenario.reference import reference
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario


@dataclass(frozen=True)
class ControlAuthority:
    """The X_diff needed after a loss of the torque, and the X_diff available.

    Attributes:
        reference_mps2: largest |r| of the scenario.
        needed_n: |X_diff| to hold D* in a steady bend.
        limit_n: largest |X_diff| of the actuator, or of its frame.
        tires_n: largest |X_diff| within the friction beside the bend's lateral force.
        carries_mps2: the largest |D*| sustainable within limit and tires.
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
        """The largest |X_diff| within both limit and tires in the bend."""
        return min(self.limit_n, self.tires_n)

    @property
    def enough(self) -> bool:
        """Whether r can be held without the torque."""
        return self.reference_mps2 <= self.carries_mps2

    def __str__(self) -> str:
        can = "enough" if self.enough else "NOT ENOUGH"
        return (
            f"control authority: {can}: to hold |r| = {self.reference_mps2:.3g} m/s² without the "
            f"torque takes {self.needed_n:.0f} N of X_diff; its limit is {self.limit_n:.0f} N, the "
            f"tires leave {self.tires_n:.0f} N (μ = {self.friction:g}), enough for "
            f"{self.carries_mps2:.3g} m/s²"
        )

    def as_dict(self) -> dict[str, float | bool]:
        """For JSON."""
        return {**asdict(self), "enough": self.enough}


def _what_it_follows_from(scenario: Scenario, _: Network) -> Iterator[object]:
    return undisturbed_with_files(scenario)


@remembered(4, by=_what_it_follows_from)
def control_authority(scenario: Scenario, network: Network) -> ControlAuthority | None:
    """The control authority of X_diff in ``scenario``; None for a plant other than a car."""
    if not scenario.plant.is_car:
        return None
    car = car_of(scenario.plant)
    force_per_mps2 = 1.0 / abs(continuous_plant(scenario.plant).g2.dc_gain)
    wanted = float(np.abs(reference(scenario)).max())
    limit_n = float(target(scenario, network).limit_2)
    lateral_n = car.m * wanted
    return ControlAuthority(
        reference_mps2=wanted,
        needed_n=force_per_mps2 * wanted,
        limit_n=limit_n,
        tires_n=math.sqrt(max(car.grip_r**2 - lateral_n**2, 0.0)),
        carries_mps2=min(limit_n / force_per_mps2, car.grip_r / math.hypot(force_per_mps2, car.m)),
        friction=scenario.plant.friction,
    )
