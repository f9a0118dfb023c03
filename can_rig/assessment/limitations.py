"""Limits of any controller: zeros and poles, control authority, the least deviation.

The modelled plant's zeros and poles give lines of ``can-rig check``.

The healthy loop has the zeros of G1. After the loss the loop closes through G2: the zeros of G2 and
the longer of the two delays limit the loop too.

Control authority: whether X_diff can replace the lost torque within its limit and the tires'.

With the torque lost the steering column turns freely, so in a steady bend the front tires carry no
lateral force (3.4) and the rear axle carries all of m a_y: Y_r = m a_y, and X_diff = 2 l_r Y_r/d_r
from (3.3), which is a_y/G2(0); D* = a_y once the yaw rate is steady (3.8). Both share the friction
of the rear tires: √(X_diff² + Y_r²) ≤ μ m g l_f/(l_f + l_r). The linear car ignores this limit; a
nonlinear car slides.

The least deviation of D* after a loss, for any controller.

No controller can react before the loss shows. The loss reduces D* by

    δ(k+1) = Φ δ(k) + Γ (left - 1) u(k)

and is known after the first tick on a sensor without noise. With noise, the best test decides: when
the expected log-likelihood ratio Σ δ²/(2 σ²) has reached the threshold of the allowed false alarms
(Basseville and Nikiforov 1993, 8.2; the moment of the loss is taken as known, which favours no
controller). The reaction acts n + 1 ticks later. The least deviation is therefore the largest |δ|
until then, with the sent commands u: a controller with a larger command after the loss makes the
loss show sooner.
"""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from can_rig.drawing.names import names_of, with_unit
from can_rig.plant.frameless import with_files
from can_rig.plant.nonlinear_car import car_of
from can_rig.scenario.build import continuous_plant, network_of, target
from can_rig.scenario.fault_settings import CHANNELS, FaultSettings
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.reference import reference
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import SampledPlant, follow_plant, sample
from firmware_model.compiled import compiled
from firmware_model.design.factors import Limitations, limitations, unstable
from firmware_model.design.zpk import Roots, ZeroPoleGain
from firmware_model.law.structs import FloatArray

MENTIONED = 1.01
"""Smallest relevant peak of |T|."""


def plant_limitations(scenario: Scenario) -> dict[str, Limitations]:
    """Of the loop ``healthy`` and ``faulted``, and of the ``compensation`` by itself."""
    plant = continuous_plant(scenario.model)
    poles, (first, second) = unstable(plant.g1), (_right(plant.g1), _right(plant.g2))
    latency_s = scenario.latency_ticks * scenario.tick_s
    first_s, second_s = (latency_s + dead_time_s for dead_time_s in plant.path_dead_times_s)
    return {
        "healthy": limitations(first, poles, first_s),
        "faulted": limitations((*first, *second), poles, max(first_s, second_s)),
        "compensation": limitations(second, ()),
    }


def describe(scenario: Scenario, found: dict[str, Limitations]) -> Iterator[str]:
    """A line for each reason; no line for a stable plant with minimum phase."""
    output, lost, other = names_of(scenario.plant)
    healthy, faulted, compensation = (found[key] for key in found)
    if continuous_plant(scenario.model).integrates:
        yield (
            f"plant: integrates: to hold {output.said} takes no {lost.short}, and a loss shows "
            "once there is some again"
        )
    if swinging := [pole.imag for pole in healthy.poles if pole.real == 0.0 < pole.imag]:
        listed = ", ".join(f"{omega:.3g}" for omega in swinging)
        yield f"plant: swings: nothing damps the motion of {output.said} at {listed} rad/s"
    if growing := tuple(pole for pole in healthy.poles if pole.real > 0.0):
        doubles_s = math.log(2.0) / max(pole.real for pole in growing)
        peak = ""
        if faulted.complementary > MENTIONED:
            peak = (
                f"; for any controller |T| peaks at {healthy.complementary:.3g} or more, "
                f"{faulted.complementary:.3g} after the loss"
            )
        yield (
            f"plant: unstable: poles at {_listed(growing)} double a motion of {output.said} "
            f"every {doubles_s:.2g} s{peak}"
        )
    if healthy.zeros:
        yield (
            f"plant: zeros from {lost.said} at {_listed(healthy.zeros)}: for any controller "
            f"{_bandwidth('a deviation', healthy)}"
        )
    if compensation.zeros:
        yield (
            f"plant: zeros from {other.said} at {_listed(compensation.zeros)}: for any "
            f"compensation {_bandwidth('a loss', compensation)}"
        )
    if faulted.zeros and faulted.poles:
        yield (
            f"plant: with zeros and poles as these |S| peaks at {healthy.sensitivity:.3g} or more, "
            f"{faulted.sensitivity:.3g} after the loss"
        )


def _bandwidth(what: str, found: Limitations) -> str:
    if found.halving_rad_per_s == 0.0:
        return f"{what} cannot be halved at any frequency without being doubled at another"
    return (
        f"{what} can be halved up to {found.halving_rad_per_s:.3g} rad/s at most, "
        "or it is more than doubled elsewhere"
    )


def _right(g: ZeroPoleGain) -> Roots:
    return tuple(zero for zero in g.zeros if zero.real > 0)


def _listed(roots: Roots) -> str:
    words = [
        f"{root.real:.3g}" if root.imag == 0.0 else f"{root.real:.3g} ± {root.imag:.3g}j"
        for root in roots
        if root.imag >= 0.0
    ]
    return f"{', '.join(words)} rad/s"


def without_roots(found: Limitations) -> dict[str, float]:
    """The bounds for JSON, without the roots, because JSON has no complex numbers."""
    values = asdict(found)
    return {key: value for key, value in values.items() if key not in {"zeros", "poles"}}


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


@remembered(4, by=lambda scenario: with_files(scenario.undisturbed))
def control_authority(scenario: Scenario) -> ControlAuthority | None:
    """The control authority of X_diff in ``scenario``; None for a plant other than a car."""
    if not scenario.plant.is_car:
        return None
    car = car_of(scenario.plant)
    force_per_mps2 = 1.0 / abs(continuous_plant(scenario.plant).g2.dc_gain)
    wanted = float(np.abs(reference(scenario)).max())
    limit_n = float(target(scenario, network_of(scenario)).limit_2)
    lateral_n = car.m * wanted
    return ControlAuthority(
        reference_mps2=wanted,
        needed_n=force_per_mps2 * wanted,
        limit_n=limit_n,
        tires_n=math.sqrt(max(car.grip_r**2 - lateral_n**2, 0.0)),
        carries_mps2=min(limit_n / force_per_mps2, car.grip_r / math.hypot(force_per_mps2, car.m)),
        friction=scenario.plant.friction,
    )


def short_authority(scenario: Scenario) -> Iterator[str]:
    """A line for a plant other than a car whose second input cannot hold the reference."""
    output, lost, other = names_of(scenario.plant)
    wanted = float(np.abs(reference(scenario)).max())
    limit = float(target(scenario, network_of(scenario)).limit_2)
    held = abs(continuous_plant(scenario.plant).g2.dc_gain) * limit
    if not scenario.plant.is_car and held < wanted:
        yield (
            f"control authority: NOT ENOUGH: without {lost.said} {other.said} holds {output.said} "
            f"up to {with_unit(f'{held:.3g}', output.unit)} at its limit of "
            f"{with_unit(f'{limit:.3g}', other.unit)}, and |r| is up to "
            f"{with_unit(f'{wanted:.3g}', output.unit)}"
        )


@dataclass(frozen=True)
class Unavoidable:
    """What no controller can avoid.

    Attributes:
        detection_ticks: from the loss to the earliest knowledge.
        deviation_mps2: largest |deviation| of D* until detection and the commands' delay.
    """

    detection_ticks: int
    deviation_mps2: float


def unavoidable(
    scenario: Scenario, commands: FloatArray, fault: FaultSettings | None = None
) -> Unavoidable | None:
    """For a dead actuator, None: the scenario's loss. None where it never shows.

    ``commands`` reach the lost channel from the loss on, shape (ticks,). For a plant class, whose Φ
    is unknown, the linear car with equal parameters supplies Φ.
    """
    tick_s, fault = scenario.tick_s, fault or scenario.loss
    plant = _immediate(scenario.plant, tick_s)
    lost = np.zeros(2)
    lost[CHANNELS.index(fault.place)] = fault.left - 1.0
    gamma, sent = plant.gamma * lost, np.nan_to_num(commands)
    pole, needed = _needed(scenario)
    found, largest = _found(plant.phi, gamma, plant.c, sent, pole, needed, scenario.latency_ticks)
    return Unavoidable(found, largest) if found else None


def can_be_told(scenario: Scenario, deviation_mps2: FloatArray) -> bool:
    """Whether the best test expects to tell this deviation, shape (ticks,), from noise."""
    pole, needed = _needed(scenario)
    shown = np.nan_to_num(deviation_mps2)
    return bool(((shown - pole * np.append(0.0, shown[:-1])) ** 2).sum() > needed)


def _needed(scenario: Scenario) -> tuple[float, float]:
    """The pole of the noise, and the sum of squares, whitened, that confirms a loss."""
    place = target(scenario, None)
    per_tick = 2.0 * (
        place.noise_rms * place.noise_rms * (1.0 - place.noise_pole**2)
        + place.resolution * place.resolution / 12.0
    )
    return place.noise_pole, place.evidence(place.false_alarms_per_hour) * per_tick


@remembered(4)
def _immediate(settings: PlantSettings, tick_s: float) -> SampledPlant:
    """The plant without dead times; a loss follows its actuator's dead time."""
    plant = continuous_plant(settings)
    return sample(replace(plant, dead_times_s=(0.0, 0.0), sensor_dead_time_s=0.0), tick_s)


@compiled
def _found(
    phi: Any, gamma: Any, c: Any, commands: Any, pole: float, needed: float, latency: int
) -> tuple[int, float]:
    """The tick of detection, 0: never; the largest |δ| until the reaction."""
    missing = np.zeros(len(phi))
    found, largest, shown, before = 0, 0.0, 0.0, 0.0
    for k in range(len(commands)):
        now = abs(follow_plant(phi, gamma, c, missing, commands[k], commands[k]))
        largest = max(largest, now)
        shown += (now - pole * before) ** 2
        before = now
        if found == 0 and shown > needed:
            found = k + 1
        if found > 0 and k + 1 >= found + latency:
            return found, largest
    return 0, largest
