"""A candidate of ``can-rig tune``: noise, and response to a loss of the torque."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from can_rig.assessment.tuning.box import Car, is_stable, loops
from can_rig.assessment.tuning.refusals import Refusal
from can_rig.assessment.unavoidable import unavoidable
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_design, continuous_plant, slowness, target
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import DesignSettings, Scenario
from firmware_model.analysis.margins import noise_gain, peak_sensitivity
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.factors.coprime import unstable
from firmware_model.discretisation.tables import build
from firmware_model.errors import DesignError
from firmware_model.target.structs import FloatArray, Record

Values = tuple[float, int, float, int]  # τ, α, τ_q, α_q

E6 = (1.0, 1.5, 2.2, 3.3, 4.7, 6.8)  # preferred numbers, a factor of about 1.5 apart
E12 = (1.0, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2)
TAU_TICKS = (0.1, 10.0)  # smallest and largest of the grid, in ticks
RESPONSE_TICKS, RESPONSE_S = (
    20.0,
    0.05,
)  # largest lag of D* behind the reference, α_q τ_q: the longer
OF_ZERO = 0.05, 2.0  # and where a zero lies right of the axis at z: of 1/|z|, which F̂ cannot beat
RESPONSE_OF_ZERO = 10.0  # nor can C
HELD = 10.0  # times as slow where C has to hold the plant, in spite of all delays
ORDERS, TRACKING_ORDERS = 2, 3  # upwards from the smallest value that the car allows

BEFORE_S, AFTER_S = 2.0, 2.0  # the loss; multiplied by ``slowness`` for a plant other than a car
NOISE_SIGMAS = 3.0  # noise in a command that must fit below the limit
DECAYED = 0.5  # largest part of the peak in the last quarter of a transient that decays


@dataclass(frozen=True)
class Tuning:
    """One candidate and what it achieves.

    Attributes:
        design: its keys; the scenario supplies the rest.
        peak_mps2: largest deviation from the fault-free run after the loss.
        unavoidable_mps2: what no controller avoids; see ``unavoidable``.
        noise_to_torque: rms of the torque command for D* noise of rms 1 m/s², N m per m/s².
        noise_to_force: the same for X_diff, N per m/s²; each in the worse of the two states.
        torque_peak_nm: over the whole run, the first step of the reference included.
        torque_after_nm, force_after_n: largest commands from the loss on.
        within_limits: the peaks plus ``NOISE_SIGMAS`` of the noise stay below the limits.
        delay_margin_ticks: of the worst car of the box; None where it was not computed.
    """

    design: DesignSettings
    peak_mps2: float
    unavoidable_mps2: float
    noise_to_torque: float
    noise_to_force: float
    torque_peak_nm: float
    torque_after_nm: float
    force_after_n: float
    within_limits: bool
    delay_margin_ticks: int | None = None

    @property
    def peak_ratio(self) -> float:
        """The peak relative to the unavoidable deviation."""
        return self.peak_mps2 / self.unavoidable_mps2

    @property
    def changes(self) -> dict[str, float]:
        """The scenario keys of this tuning, for ``can_rig.run``."""
        keys = ("tau_s", "alpha", "tau_q_s", "alpha_q")
        return {f"design.{key}": getattr(self.design, key) for key in keys}


def grid(scenario: Scenario) -> list[Values]:
    """τ, α, τ_q, α_q of every candidate; round numbers between multiples of the tick."""
    car, tick_s = continuous_plant(scenario.model), scenario.tick_s
    least, least_q = car.g2.relative_degree, car.g1.relative_degree
    right = [abs(zero) for g in (car.g1, car.g2) for zero in g.zeros if zero.real > 0.0]
    zero_s = 1.0 / min(right) if right else 0.0
    slowest_s = max(RESPONSE_TICKS * tick_s, RESPONSE_S, RESPONSE_OF_ZERO * zero_s)
    slowest_s *= HELD if unstable(car.g1) else 1.0
    low_s, high_s = (max(n * tick_s, m * zero_s) for n, m in zip(TAU_TICKS, OF_ZERO, strict=True))
    return [
        (tau_s, alpha, tau_q_s, alpha_q)
        for alpha_q in range(least_q, least_q + TRACKING_ORDERS)
        for tau_q_s, tau_s, alpha in product(
            _round_numbers(E12, max(tick_s, low_s), slowest_s / alpha_q),
            _round_numbers(E6, low_s, high_s),
            range(least, least + ORDERS),
        )
    ]


def with_tuning(scenario: Scenario, values: Values) -> Scenario:
    """``scenario`` with these τ, α, τ_q, α_q."""
    tau_s, alpha, tau_q_s, alpha_q = values
    chosen = replace(scenario.design, tau_s=tau_s, alpha=alpha, tau_q_s=tau_q_s, alpha_q=alpha_q)
    return replace(scenario, design=chosen)


def assess(
    scenario: Scenario,
    values: Values,
    cars: Iterable[Car],
    spare_ticks: int,
) -> Tuning | Refusal:
    """Steps 1 and 2 for one candidate: its tuning, or the failed test."""
    scenario, tick_s = with_tuning(scenario, values), scenario.tick_s
    cars = list(cars)
    try:
        table = trusting_table(scenario)
    except (DesignError, ScenarioError):
        return Refusal.DESIGN
    if not is_stable(table, cars, tick_s, spare_ticks):
        return Refusal.NOMINAL_SPARE if is_stable(table, cars, tick_s, 0) else Refusal.NOMINAL
    states = loops(table, cars[0], tick_s)
    own = loops(table, cars[-1], tick_s)  # the scenario's plant, which can-rig check judges
    if max(peak_sensitivity(loop)[0] for loop in own) > scenario.budget.peak_sensitivity:
        return Refusal.THIN
    noise_1, noise_2 = (max(noise_gain(loop, answer) for loop in states) for answer in (0, 1))
    if not math.isfinite(noise_1 + noise_2):
        return Refusal.NOISE
    return _lose_torque(scenario, table, (noise_1, noise_2))


def _lose_torque(scenario: Scenario, table: Record, noise: tuple[float, float]) -> Tuning | Refusal:
    """The loss during a settled step, or of a plant that integrates in the scenario's drive."""
    tick_s, car = scenario.tick_s, continuous_plant(scenario.plant)
    loss, drive = _loss_in_its_drive(scenario) if car.integrates else _loss_in_a_step(scenario)
    left = np.ones((len(drive), 2))
    left[loss:, 0] = 0.0
    plant = sample(car, tick_s)
    healthy = simulate(table, plant, drive)
    lost = simulate(table, plant, drive, effectiveness=left)
    deviation = np.abs(lost.measurement - healthy.measurement)[loss:]
    peak = float(deviation.max())
    if not (math.isfinite(peak) and deviation[-len(deviation) // 4 :].max() <= DECAYED * peak):
        return Refusal.TRANSIENT
    bound = unavoidable(scenario, lost.command_1[loss - scenario.latency_ticks :])
    torque, force = np.abs(lost.command_1), np.abs(lost.command_2)
    torque_after, force_after = float(torque[loss:].max()), float(force[loss:].max())
    tail = NOISE_SIGMAS * scenario.model.sensor.noise_mps2
    limits = target(scenario, None)
    room_1 = limits.limit_1 - tail * noise[0] - torque_after
    room_2 = limits.limit_2 - tail * noise[1] - force_after
    return Tuning(
        design=scenario.design,
        peak_mps2=peak,
        unavoidable_mps2=math.inf if bound is None else bound.deviation_mps2,
        noise_to_torque=noise[0],
        noise_to_force=noise[1],
        torque_peak_nm=float(torque.max()),
        torque_after_nm=torque_after,
        force_after_n=force_after,
        within_limits=bool(room_1 > 0.0 and room_2 > 0.0),
    )


def _loss_in_its_drive(scenario: Scenario) -> tuple[int, FloatArray]:
    """The tick of the scenario's loss, and its reference (ticks,)."""
    loss = round(scenario.loss.at_s / scenario.tick_s)
    return min(loss, scenario.ticks - 1), reference(scenario)


def _loss_in_a_step(scenario: Scenario) -> tuple[int, FloatArray]:
    """The tick of the loss, and the reference (ticks,)."""
    slow = slowness(scenario)
    loss = round(BEFORE_S * slow / scenario.tick_s)
    ticks = loss + round(AFTER_S * slow / scenario.tick_s)
    return loss, np.full(ticks, scenario.reference.amplitude_mps2)


def trusting_table(scenario: Scenario) -> Record:
    """The controller's table without frames, whose decision trusts the model.

    The drive before a loss decides the time of detection with another car; the tuning decides the
    response.

    Raises:
        ScenarioError, DesignError: a failing design or discretisation.
    """
    return build(continuous_design(scenario), target(scenario, None))


def _round_numbers(series: Iterable[float], low: float, high: float) -> list[float]:
    """``series`` in every decade, within ``low``..``high``."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    numbers = [float(f"{number}e{decade}") for decade in decades for number in series]
    return [number for number in numbers if low * (1 - 1e-9) <= number <= high * (1 + 1e-9)]
