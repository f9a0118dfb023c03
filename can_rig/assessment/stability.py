"""``can-rig check``: stability of a scenario's loop, its margins, and a stable alternative.

The margins describe the linear loop: limits, frames and the fault's time have no influence. The
check covers the loop before and after the fault, healthy and with the channel dead, also for a
scenario without a fault: the controller's purpose is to survive the loss. ``drives`` looks for the
effects of limits, noise and other cars. Missing and corrupted frames come to the same as a dead
actuator: nothing is applied. For a plant class, the loop uses the linear car with the class's
parameters.

The decision on d̂ has figures too: the time to find a loss, and losses never found. The evidence
for a loss grows with the square of the lost torque's effect, over the variance of the unknown:
noise, rounding, and cars of ``budget.box`` (the firmware's ``supervision``). The evidence's
mean, equal to a drive without noise, gives the usual time of confirmation: with noise, half of the
losses take longer, one in a hundred about a fifth longer.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice, product
from typing import Any, Final

import numpy as np

from can_rig.assessment.drives import Drives, Finding, box_findings, own_findings
from can_rig.assessment.limitations import (
    ControlAuthority,
    control_authority,
    describe,
    plant_limitations,
    short_authority,
    without_roots,
)
from can_rig.assessment.network_notes import frame_notes, signal_notes
from can_rig.drawing.names import names_of, with_unit
from can_rig.errors import ScenarioError
from can_rig.plant.frameless import linear_law_of
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import continuous_design, continuous_plant, network_of, slowness, target
from can_rig.scenario.controls import controller_table
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import BudgetSettings, Scenario
from firmware_model.analysis.margins import (
    HEALTHY,
    Margins,
    is_stable_in,
    largest_latency_survived,
    law_in,
    margins,
    margins_of,
)
from firmware_model.analysis.sampled_loop import sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.factors import Limitations, unstable
from firmware_model.discretisation.rules import RULE_NAMES
from firmware_model.law.status import FaultState

ALWAYS: Final[dict[str, Callable[[Margins], str]]] = {
    "spectral radius": lambda m: f"{m.spectral_radius:.5f}",
    "slowest, rad/s": lambda m: f"{m.slowest_rad_per_s:.4g}",
    "its damping": lambda m: f"{m.slowest_damping:.3f}",
}
"""Figures of any loop."""

IF_STABLE: Final[dict[str, Callable[[Margins], str]]] = {
    "delay, ticks": lambda m: _or_any(m.delay_margin_ticks),
    "delay, ms": lambda m: _or_any(m.delay_margin_s, 1e3),
    "gain margin": lambda m: f"{m.gain_margin:.4g}",
    "peak |S|": lambda m: f"{m.peak_sensitivity:.3f}",
    "u1 / noise": lambda m: f"{m.noise_to_command_1:.3g}",
    "u2 / noise": lambda m: f"{m.noise_to_command_2:.3g}",
}
"""Margins, and the rms of each command for white measurement noise of rms 1."""


def table_rows(states: Iterable[tuple[str, Margins]]) -> Iterator[tuple[str, ...]]:
    """A heading with the names of the states, then a row for each figure.

    "-" stands for the missing figures of an unstable loop, "any" for an unlimited margin.
    """
    named = list(states)
    yield "", *(name for name, _ in named)
    for label, form in ALWAYS.items():
        yield label, *(form(margins) for _, margins in named)
    for label, form in IF_STABLE.items():
        yield label, *(form(margins) if margins.stable else "-" for _, margins in named)


def thin_margins(budget: BudgetSettings, states: Iterable[tuple[str, Margins]]) -> Iterator[str]:
    """A part of a sentence for each margin of a stable state below ``budget``.

    With a peak |S| of 5, L keeps a fifth of the distance to -1: a gain error of 20 %, or a phase
    error of 11°, can make the loop unstable.
    """
    for name, figures in states:
        if not figures.stable:
            continue
        peak, spare = figures.peak_sensitivity, figures.delay_margin_ticks
        if peak > budget.peak_sensitivity:
            yield (
                f"{name}: the peak |S| is {peak:.4g} and must be at most "
                f"{budget.peak_sensitivity:g} (budget.peak_sensitivity)"
            )
        if spare is not None and spare < budget.spare_ticks:
            yield (
                f"{name}: the spare ticks of delay are {spare} and must be at least "
                f"{budget.spare_ticks} (budget.spare_ticks)"
            )


def finite_or_null(value: Any) -> Any:
    """``value`` with None in place of every infinite number or nan."""
    if isinstance(value, dict):
        return {key: finite_or_null(inner) for key, inner in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _or_any(value: float | None, scale: float = 1.0) -> str:
    return "any" if value is None else f"{scale * value:.4g}"


AFTER_S = 5.0  # time limit for finding the loss; multiplied by ``slowness`` of a plant


@dataclass(frozen=True)
class DecisionFigures:
    """Figures of the decision with the modelled car.

    Attributes:
        expected_delay_s: from this scenario's loss of the torque to its confirmation; None: later
            than ``AFTER_S``, or after the end of the run.
        noise_mps2: rms of D* outside every model: noise and rounding.
        least_torque_nm: steady |torque| whose loss shows within a second; d̂ is N1 u1 then, or
            the part of N1 u1 that the scenario's fault takes away.
    """

    expected_delay_s: float | None
    noise_mps2: float
    least_torque_nm: float

    def describe(self, scenario: Scenario) -> Iterator[str]:
        """A line on the loss, and a line on the plants beside the model."""
        budget, (output, lost, _) = scenario.budget, names_of(scenario.plant)
        delay, left = self.expected_delay_s, _left(scenario)
        part = f"{1.0 - left:.0%} of " if left > 0.0 else ""
        found = "is not found" if delay is None else f"is confirmed after {_for_people(delay)}"
        yield (
            f"decision: the loss of {part}{lost.said} in this drive {found} on average "
            f"(noise and rounding {with_unit(f'{self.noise_mps2:.2g}', output.unit)} rms, at most "
            f"{budget.false_alarms_per_hour:g} false alarms an hour); a steady |{lost.short}| "
            f"below {with_unit(f'{self.least_torque_nm:.2g}', lost.unit)} cannot be told"
        )
        others = f"other {scenario.plant.noun}s"
        if budget.box > 0.0:
            yield f"{others}: within ±{budget.box:.0%} of the model are not taken for a loss"
        else:
            yield (
                f"{others}: none (budget.box = 0): one that is not the model may be taken for a "
                "loss, and for its end, again and again"
            )


def _for_people(time_s: float) -> str:
    return f"{time_s:.3g} s" if time_s >= 1.0 else f"{time_s * 1e3:.3g} ms"


def decision_figures(scenario: Scenario) -> DecisionFigures:
    """Compute the figures of ``scenario`` from a single drive without noise.

    Raises:
        ScenarioError: a design that cannot be made.
    """
    network, plant = network_of(scenario), continuous_plant(scenario.model)
    table = controller_table(scenario, network)
    n1, _ = plant.coprime(scenario.design.tau_q_s).numerators
    lost = round(scenario.loss.at_s / scenario.tick_s)
    ticks = min(scenario.ticks, lost + round(AFTER_S * slowness(scenario) / scenario.tick_s))
    left = np.ones((ticks, 2))
    left[lost:, 0] = _left(scenario)
    drive = reference(replace(scenario, duration_s=max(ticks, 1) * scenario.tick_s))[:ticks]
    run = simulate(table, sample(plant, scenario.tick_s), drive, effectiveness=left)
    confirmed = run.fault_state[lost:] == FaultState.CONFIRMED
    found = np.flatnonzero(confirmed & ~confirmed[:1])  # none that stands from before
    heard = target(scenario, network)
    shows = math.sqrt(float(table.decision.confirm / table.decision.shown * table.mismatch.noise))
    return DecisionFigures(
        expected_delay_s=float(found[0]) * scenario.tick_s if len(found) else None,
        noise_mps2=math.hypot(heard.noise_rms, heard.resolution / math.sqrt(12.0)),
        least_torque_nm=shows / abs(n1.dc_gain) / (1.0 - _left(scenario)),
    )


def _left(scenario: Scenario) -> float:
    """The remaining share of the torque after the scenario's fault; 0 for another kind of fault."""
    its = scenario.loss.kind == "actuator-dead" and scenario.loss.place == CHANNELS[0]
    return scenario.loss.left if its else 0.0


Effectiveness = tuple[float, float]
"""Remaining effect of the torque and the force difference, 1 healthy and 0 dead."""

DEAD: dict[str, Effectiveness] = {"torque": (0.0, 1.0), "force-difference": (1.0, 0.0)}
PARTLY_LOST = (0.75, 0.5, 0.25)  # remaining share of the torque channel
FASTER = 0.05  # tau_s over tau_q_s, tried for an unstable plant
TUNINGS_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)  # tried for tau_s = tau_q_s


@dataclass(frozen=True)
class StabilityCheck:
    """Margins of a scenario's loop in every relevant state.

    ``partly_lost`` has the margins by remaining share of the torque channel; ``false_alarm`` has
    the margins of a healthy car with a compensating controller, None for an always compensating
    controller. Neither decides whether the scenario counts as stable. ``decision`` is None for a
    controller of another kind than the rig's own law.
    """

    scenario: Scenario
    healthy: Margins
    faulted: Margins
    partly_lost: dict[float, Margins]
    false_alarm: Margins | None
    decision: DecisionFigures | None
    control_authority: ControlAuthority | None
    limitations: dict[str, Limitations]
    findings: list[Finding]

    def __repr__(self) -> str:
        return f"<check of {self.scenario.name}: {self.verdict}>"

    @property
    def linear_stable(self) -> bool:
        """Whether the linear loop is stable before and after the fault."""
        return self.healthy.stable and self.faulted.stable

    @property
    def thin_margins(self) -> list[str]:
        """The linear loop's margins below ``budget``, before or after the fault."""
        return list(thin_margins(self.scenario.budget, islice(self.states, 2)))

    @property
    def stable(self) -> bool:
        """Linear stability without thin margins; calm drives with limits, noise and other cars."""
        return self.linear_stable and not self.findings and not self.thin_margins

    @property
    def states(self) -> Iterator[tuple[str, Margins]]:
        """Name and margins of each state."""
        yield from zip(_both_ends(self.scenario), (self.healthy, self.faulted), strict=True)
        for left, figures in self.partly_lost.items():
            yield f"{names_of(self.scenario.plant).command_1.short} {left:.0%}", figures
        if self.false_alarm is not None:
            yield "false alarm", self.false_alarm

    @property
    def notes(self) -> Iterator[str]:
        """A line each: the source of the margins, the plant's limits, the decision and so on."""
        scenario = self.scenario
        if scenario.plant.is_own:
            stands_for = "car with its parameters" if scenario.plant.is_car else "plant by numbers"
            yield f"margins: of the linear {stands_for}, not of {scenario.plant.kind}"
        if scenario.sensors and not scenario.controller.is_ours:
            yield "margins: of the controller without what the further sensors say"
        yield from describe(scenario, self.limitations)
        if self.healthy.stable and self.decision is not None:
            yield from self.decision.describe(scenario)
            yield _isolation(scenario)
        if scenario.controller.is_ours and scenario.design.supervision == "none":
            yield "decision: none; design.supervision = 'none'"
        if self.control_authority is not None:
            yield str(self.control_authority)
        yield from short_authority(scenario)
        yield from self.network_notes

    @property
    def network_notes(self) -> Iterator[str]:
        """What to know of the frames; nothing of the rig's own."""
        network = network_of(self.scenario)
        yield from frame_notes(network)
        ends = [margins for margins in (self.healthy, self.faulted) if margins.stable]
        noise = [(each.noise_to_command_1, each.noise_to_command_2) for each in ends]
        largest_1, largest_2 = (max(each) for each in zip(*noise or [(0.0, 0.0)], strict=True))
        yield from signal_notes(self.scenario, network, (largest_1, largest_2))

    @property
    def verdict(self) -> str:
        """One line: stable, or the unstable state and a stable alternative."""
        unstable = [(name, figures) for name, figures in self.states if not figures.stable]
        if not unstable and self.findings:
            more = f" (and {len(self.findings) - 1} more)" if len(self.findings) > 1 else ""
            return f"not calm: {self.findings[0]}{more}"
        if not unstable:
            if self.thin_margins:
                return f"thin margin: {'; '.join(self.thin_margins)}"
            return "stable: healthy, and with a channel dead or partly lost; every drive is calm"
        names = ", ".join(name for name, _ in unstable)
        if not self.scenario.controller.is_ours:
            return f"unstable: {names}"
        if self.linear_stable:
            return f"stable healthy and with {_channel(self.scenario)} dead, but not: {names}"
        return _reason(self.scenario, unstable[0][0], unstable[0][1].spectral_radius)

    def as_dict(self) -> dict[str, Any]:
        """For JSON, where null stands for infinity and NaN."""
        values = {
            "scenario": self.scenario.name,
            "stable": self.stable,
            "findings": [asdict(finding) for finding in self.findings],
            "thin_margins": self.thin_margins,
            "network": list(self.network_notes),
            "healthy": asdict(self.healthy),
            "faulted": asdict(self.faulted),
            "partly_lost": {f"{left:g}": asdict(m) for left, m in self.partly_lost.items()},
            "false_alarm": None if self.false_alarm is None else asdict(self.false_alarm),
            "decision": None if self.decision is None else asdict(self.decision),
            "control_authority": self.control_authority and self.control_authority.as_dict(),
            "limitations": {key: without_roots(found) for key, found in self.limitations.items()},
        }
        return {key: finite_or_null(value) for key, value in values.items()}


def check_stability(
    scenario: Scenario, on_car: Callable[[int, int], None] = lambda done, of: None
) -> StabilityCheck:
    """The margins of the scenario's loop in every state, its decision and control authority.

    ``on_car`` is told how many cars have been driven, and of how many.

    Raises:
        ScenarioError: a failing design or discretisation, a class without the plant's methods.
    """
    if scenario.plant.is_own:
        SimulatedPlant(scenario)  # refuses what a run refuses
    plant, ours = continuous_plant(scenario.plant), None
    decides = scenario.controller.is_ours and scenario.design.supervision == "full"
    margins_with: Callable[[Effectiveness], Margins]
    if scenario.controller.is_ours:
        ours = controller_table(scenario, None)
        margins_with = partial(margins, ours, plant, scenario.tick_s)
    else:
        margins_with = partial(margins_of, linear_law_of(scenario), plant, scenario.tick_s)

    healthy, faulted = margins_with(HEALTHY), margins_with(DEAD[scenario.loss.channel])

    def without_drives() -> StabilityCheck:
        return StabilityCheck(
            scenario=scenario,
            healthy=healthy,
            faulted=faulted,
            partly_lost={left: margins_with((left, 1.0)) for left in PARTLY_LOST},
            false_alarm=(
                margins(ours, plant, scenario.tick_s, confirmed=1.0)
                if ours is not None and ours.compensator.on_confirmation
                else None
            ),
            decision=decision_figures(scenario) if decides else None,
            control_authority=control_authority(scenario),
            limitations=plant_limitations(scenario),
            findings=[],
        )

    findings: list[Finding] = []
    with ThreadPoolExecutor(1) as beside:  # while cars drive, a core has time
        check = beside.submit(without_drives)
        if healthy.stable and faulted.stable:
            drives = Drives(scenario)
            findings = own_findings(drives) + box_findings(drives, on_car)
        return replace(check.result(), findings=findings)


def refuse_unstable(
    scenario: Scenario, on_answer: Callable[[int], None] = lambda number: None
) -> None:
    """Raise unless the loop is stable before the fault and after it, and bears its limits.

    ``on_answer`` is called after each answer of a controller of one's own, with its number.

    Raises:
        ScenarioError: the unstable state and a stable alternative; D* within the limits.
    """
    if not scenario.controller.is_ours:
        _refuse_unstable_peer(scenario, on_answer)
        return
    table, plant = controller_table(scenario, None), continuous_plant(scenario.plant)
    for name, left in _every_end(scenario).items():
        loop = sampled_loop(law_in(table, left), plant, scenario.tick_s, left)
        radius = loop.spectral_radius()
        if not radius < 1.0:
            reason = _reason(scenario, name, radius)
            said = f"scenario {scenario.name}: {reason}"
            raise ScenarioError(f"{said}; --allow-unstable runs it as it is")
    for finding in own_findings(Drives(scenario)):
        if not finding.false_alarm:
            raise ScenarioError(
                f"scenario {scenario.name}: not calm: {finding}; can-rig check says more, "
                "can-rig tune looks for a calmer design, --allow-unstable runs it as it is"
            )


def _refuse_unstable_peer(scenario: Scenario, on_answer: Callable[[int], None]) -> None:
    """Refuse a controller of one's own whose healthy loop is unstable.

    What the controller makes of a loss is what a run is to show, and a controller that is not
    linear has no such figure.
    """
    try:
        law = linear_law_of(scenario, on_answer)
    except ScenarioError:
        return
    radius = sampled_loop(law, continuous_plant(scenario.plant), scenario.tick_s).spectral_radius()
    if not radius < 1.0:
        raise ScenarioError(
            f"scenario {scenario.name}: controller.kind = {scenario.controller.kind!r}: unstable "
            f"(healthy): the spectral radius is {radius:.4f} and must be below 1; "
            "--allow-unstable runs it as it is"
        )


def stable_tuning(scenario: Scenario) -> str | None:
    """The fastest tau_s = tau_q_s of ``TUNINGS_S`` that is stable before and after each fault.

    The peak |S| is at most ``budget.peak_sensitivity``, and ``budget.spare_ticks`` of further
    delay, at least one tick, leave the loop stable. For an unstable plant, tau_s is ``FASTER``
    times tau_q_s: C must hold the plant through F̂. Each time constant is tried with the scenario's
    estimator first, then with every other rule. Returns the tuning as options, or None without a
    stable tuning.
    """
    share = FASTER if unstable(continuous_plant(scenario.model).g1) else 1.0
    plant, states = continuous_plant(scenario.plant), tuple(_every_end(scenario).values())
    own, most = scenario.design.estimator, scenario.budget.peak_sensitivity
    spare = range(1, max(1, scenario.budget.spare_ticks) + 1)
    rules = [own, *(rule for rule in RULE_NAMES if rule != own)]
    for tau_s, rule in product(TUNINGS_S, rules):
        chosen = replace(scenario.design, tau_s=share * tau_s, tau_q_s=tau_s, estimator=rule)
        other = replace(scenario, design=chosen)
        try:
            design, place = continuous_design(other), target(other, None)
        except ScenarioError:  # too fast for the sensor's filter
            continue
        steady = is_stable_in(design, place, plant, states, 0.0, most)
        if steady and all(is_stable_in(design, place, plant, states, ticks) for ticks in spare):
            keys = [f"design.tau_s={share * tau_s:g}", f"design.tau_q_s={tau_s:g}"]
            keys += [f"design.estimator={rule}"] if rule != own else []
            return " ".join(f"--set {key}" for key in keys)
    return None


def _reason(scenario: Scenario, state: str, radius: float) -> str:
    """The reason for instability in ``state``, with a stable latency and a stable tuning."""
    unstable_as = f"unstable ({state}): the spectral radius is {radius:.4f} and must be below 1"
    held = scenario.design.compensation != "off" or state == "healthy"
    if not held and unstable(continuous_plant(scenario.plant).g1):
        return f"{unstable_as}; nothing holds it then with design.compensation = 'off'"
    longest = largest_latency_survived(
        continuous_design(scenario),
        target(scenario, None),
        continuous_plant(scenario.plant),
        tuple(_every_end(scenario).values()),
    )
    survived = "no latency_ticks" if longest is None else f"latency_ticks up to {longest}"
    tuning = stable_tuning(scenario) or f"no tau_q_s up to {TUNINGS_S[-1]:g}"
    return f"{unstable_as}; this tuning is stable with {survived}; {tuning} works"


def _isolation(scenario: Scenario) -> str:
    lost = names_of(scenario.plant)[1]
    other = f"another {scenario.plant.noun}"
    told = f"the evidence tells either actuator, the sensor and {other} apart"
    alike = f"a steady {lost.short} offset or a slow drift of the sensor may look like"
    return f"isolation: {told}; {alike} a partial loss"


def _channel(scenario: Scenario) -> str:
    """The fault's channel: for a car its key, for other plants its name."""
    if scenario.plant.is_car:
        return str(scenario.loss.channel)
    return names_of(scenario.plant)[1 + CHANNELS.index(scenario.loss.channel)].short


def _both_ends(scenario: Scenario) -> dict[str, Effectiveness]:
    dead = DEAD[scenario.loss.channel]
    return {"healthy": HEALTHY, f"{_channel(scenario)} dead": dead}


def _every_end(scenario: Scenario) -> dict[str, Effectiveness]:
    """Healthy, and with the channel of ``scenario.loss`` and of each fault's loss dead."""
    ends = _both_ends(scenario)
    for fault in scenario.faults:
        if fault.loses_a_channel:
            ends |= _both_ends(replace(scenario, fault=(fault,)))
    return ends
