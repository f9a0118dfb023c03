"""``can-rig check``: whether a scenario's loop is stable, by how much, and what would make it so.

The loop is linear here: limits, frames and the fault's time do not count. Both ends of the fault
count, the healthy loop and the one that the dead channel leaves, whether or not the scenario has a
fault: the loss is what the controller is for. Missing and corrupted frames come to the same: the
actuator applies nothing. A plant that is a class is loaded, and the loop is that of the linear car
with its parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, get_args

from can_rig.assessment.control_authority import Authority, authority
from can_rig.assessment.threshold_budget import Budget, budget
from can_rig.errors import ScenarioError
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import (
    continuous_design,
    continuous_plant,
    controller_table,
    network_of,
    target,
)
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import (
    HEALTHY,
    Margins,
    is_stable_in,
    largest_latency_survived,
    law_in,
    margins,
)
from firmware_model.analysis.sampled_loop import sampled_loop
from firmware_model.discretisation.targets import EstimatorRule

Effectiveness = tuple[float, float]
DEAD: dict[str, Effectiveness] = {"torque": (0.0, 1.0), "force-difference": (1.0, 0.0)}
PARTLY_LOST = (0.75, 0.5, 0.25)  # what is left of the torque channel
TUNINGS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # tried for tau_s = tau_q_s
# delay and gain are margins; u1, u2 are rms for white measurement noise of rms 1
FIGURES: dict[str, Callable[[Margins], str]] = {
    "spectral radius": lambda m: f"{m.spectral_radius:.5f}",
    "slowest, rad/s": lambda m: f"{m.slowest_rad_per_s:.4g}",
    "its damping": lambda m: f"{m.slowest_damping:.3f}",
    "delay, ticks": lambda m: _or_any(m.delay_margin_ticks),
    "delay, ms": lambda m: _or_any(m.delay_margin_s, 1e3),
    "gain margin": lambda m: f"{m.gain_margin:.4g}",
    "peak |S|": lambda m: f"{m.peak_sensitivity:.3f}",
    "u1 / noise": lambda m: f"{m.noise_to_command_1:.3g}",
    "u2 / noise": lambda m: f"{m.noise_to_command_2:.3g}",
}
SPARE_TICKS = (0, 1)  # extra delays that a tuning must survive to be called one that works


@dataclass(frozen=True)
class Check:
    """Margins of a scenario's loop in every state that matters.

    ``partly_lost`` has the margins by what is left of the torque channel, ``false_alarm`` those of
    a whole car whose controller compensates a loss all the same, where it does so on confirmation
    alone. Both are there to be seen and do not decide.
    """

    scenario: Scenario
    healthy: Margins
    faulted: Margins
    partly_lost: dict[float, Margins]
    false_alarm: Margins | None
    budget: Budget
    authority: Authority | None

    @property
    def stable(self) -> bool:
        """Stable before the fault and after it."""
        return self.healthy.stable and self.faulted.stable

    @property
    def states(self) -> Iterator[tuple[str, Margins]]:
        """What a person calls each state, and its margins."""
        yield from zip(_both_ends(self.scenario), (self.healthy, self.faulted), strict=True)
        for left, figures in self.partly_lost.items():
            yield f"torque {left:.0%}", figures
        if self.false_alarm is not None:
            yield "false alarm", self.false_alarm

    @property
    def notes(self) -> Iterator[str]:
        """What does not decide, a line each: whose margins, the threshold's budget, who carries."""
        scenario = self.scenario
        if scenario.plant.is_class:
            yield f"margins: of the linear car with its parameters, not of {scenario.plant.kind}"
        if self.healthy.stable:
            gain = continuous_plant(scenario.model).g1.dc_gain
            yield from self.budget.describe(scenario.design, scenario.budget.box, gain)
            yield _isolation(scenario.design.probe_nm)
        if self.authority is not None:
            yield str(self.authority)

    @property
    def verdict(self) -> str:
        """One line."""
        unstable = [(name, figures) for name, figures in self.states if not figures.stable]
        if not unstable:
            return "stable: healthy, and with a channel dead or partly lost"
        names = ", ".join(name for name, _ in unstable)
        if self.stable:
            return f"stable healthy and with {self.scenario.fault.channel} dead, but not: {names}"
        name, figures = unstable[0]
        return _reason(self.scenario, name, figures.spectral_radius)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, which knows neither infinity nor NaN: null."""
        values = {
            "scenario": self.scenario.name,
            "stable": self.stable,
            "healthy": asdict(self.healthy),
            "faulted": asdict(self.faulted),
            "partly_lost": {f"{left:g}": asdict(m) for left, m in self.partly_lost.items()},
            "false_alarm": None if self.false_alarm is None else asdict(self.false_alarm),
            "decision": {
                "threshold_mps2": self.scenario.design.fault_threshold_mps2,
                "threshold_share": self.scenario.design.fault_threshold_share,
                **asdict(self.budget),
                "budget": self.budget.total,
            },
            "authority": None if self.authority is None else self.authority.as_dict(),
        }
        return {key: _finite(value) for key, value in values.items()}


def check(scenario: Scenario) -> Check:
    """The margins of the scenario's loop.

    Raises:
        ScenarioError: a design that cannot be made or discretised, a class that is no plant.
    """
    if scenario.plant.is_class:
        SimulatedPlant(scenario)  # refused as before a run
    table, plant = controller_table(scenario, None), continuous_plant(scenario.plant)
    network = network_of(scenario)

    def with_left(effectiveness: Effectiveness) -> Margins:
        return margins(table, plant, scenario.tick_s, effectiveness)

    return Check(
        scenario=scenario,
        healthy=with_left(HEALTHY),
        faulted=with_left(DEAD[scenario.fault.channel]),
        partly_lost={left: with_left((left, 1.0)) for left in PARTLY_LOST},
        false_alarm=(
            margins(table, plant, scenario.tick_s, confirmed=1.0)
            if table.compensator.on_confirmation
            else None
        ),
        budget=budget(scenario, network),
        authority=authority(scenario, network),
    )


def refuse_unstable(scenario: Scenario) -> None:
    """Raise unless the loop is stable before the fault and after it.

    Raises:
        ScenarioError: which state is unstable and what would work; a design that cannot be made.
    """
    table, plant = controller_table(scenario, None), continuous_plant(scenario.plant)
    for name, left in _both_ends(scenario).items():
        loop = sampled_loop(law_in(table, left), plant, scenario.tick_s, left)
        radius = loop.spectral_radius()
        if not radius < 1.0:
            reason = _reason(scenario, name, radius)
            raise ScenarioError(
                f"scenario {scenario.name}: {reason}; --allow-unstable runs it as it is"
            )


def working_tuning(scenario: Scenario) -> str | None:
    """The fastest tau_s = tau_q_s that is stable before and after the fault with a tick to spare.

    As the options that choose it; the scenario's own estimator is tried first. None if none is.
    """
    plant, states = continuous_plant(scenario.plant), tuple(_both_ends(scenario).values())
    own = scenario.design.estimator
    rules = [own, *(rule for rule in get_args(EstimatorRule) if rule != own)]
    for tau_s, rule in product(TUNINGS_S, rules):
        chosen = replace(scenario.design, tau_s=tau_s, tau_q_s=tau_s, estimator=rule)
        other = replace(scenario, design=chosen)
        design, place = continuous_design(other), target(other, None)
        if all(is_stable_in(design, place, plant, states, spare) for spare in SPARE_TICKS):
            keys = [f"design.tau_s={tau_s:g}", f"design.tau_q_s={tau_s:g}"]
            keys += [f"design.estimator={rule}"] if rule != own else []
            return " ".join(f"--set {key}" for key in keys)
    return None


def _reason(scenario: Scenario, state: str, radius: float) -> str:
    """What is wrong with the loop in ``state``, and two ways out of it."""
    most = largest_latency_survived(
        continuous_design(scenario),
        target(scenario, None),
        continuous_plant(scenario.plant),
        tuple(_both_ends(scenario).values()),
    )
    survived = "no latency_ticks" if most is None else f"latency_ticks up to {most}"
    tuning = working_tuning(scenario) or f"no tau_s = tau_q_s up to {TUNINGS_S[-1]:g}"
    return (
        f"unstable ({state}): spectral radius {radius:.4f}, below 1 is right; "
        f"this tuning survives {survived}; {tuning} works"
    )


def table_rows(result: Check) -> Iterator[tuple[str, ...]]:
    """A heading with the states, then one row a figure; what an unstable loop has none of: "-"."""
    yield "", *(name for name, _ in result.states)
    for label, form in FIGURES.items():
        always = label in {"spectral radius", "slowest, rad/s", "its damping"}
        cells = (form(m) if always or m.stable else "-" for _, m in result.states)
        yield label, *cells


def _or_any(value: float | None, scale: float = 1.0) -> str:
    return "any" if value is None else f"{scale * value:.4g}"


def _isolation(probe_nm: float) -> str:
    if probe_nm > 0.0:
        return (
            f"isolation: a loss is confirmed only where a torque probe of {probe_nm:g} N m goes "
            "unanswered; a biased D* stays suspected"
        )
    return (
        "isolation: none: a D* that is biased by more than the threshold is taken for a loss; "
        "design.probe_nm, a small torque probe, would tell"
    )


def _both_ends(scenario: Scenario) -> dict[str, Effectiveness]:
    channel = scenario.fault.channel
    return {"healthy": HEALTHY, f"{channel} dead": DEAD[channel]}


def _finite(value: Any) -> Any:
    """``value`` with None for every number in it that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
