"""The curves of the thesis's Figs. 2.2-2.4, 3.5 and 3.6, by the firmware and in continuous time.

For any other scenario with a linear plant, Figs. 2.2-2.4 show the fault estimate and the
compensated loss.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from can_rig.drawing.names import names_of
from can_rig.errors import ScenarioError
from can_rig.plant.faults.plant_faults import PlantFaults
from can_rig.scenario.build import continuous_design, continuous_plant, network_of, require_ours
from can_rig.scenario.controls import controller_table
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import BUILT_IN
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from can_rig.thesis.continuous import Solution, solve
from firmware_model.analysis.sampled_plant import SampledPlant, advance_plant, measure_plant, sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.factors import unstable
from firmware_model.design.plants import Plant
from firmware_model.law.structs import FloatArray

START_S = 0.02  # of a closed loop, shown enlarged
OPEN_LOOP = "chapter-2"  # the shipped scenario of Fig. 2.4
SETTINGS = ("tick_s", "duration_s", "latency_ticks", "design.", "limits.", "plant.", "fault.at_s")
"""Keys, or the beginnings of keys, that keep the figure's identity."""


@dataclass(frozen=True)
class Curve:
    """One signal of a figure, sampled and continuous at the same ticks, each (ticks,)."""

    name: str
    sampled: FloatArray
    continuous: FloatArray

    @property
    def difference(self) -> FloatArray:
        """Sampled less continuous."""
        return self.sampled - self.continuous


@dataclass(frozen=True)
class Comparison:
    """The curves of a figure and their run."""

    figure: str
    """Number in the thesis, or the name of a scenario's picture."""
    caption: str
    unit: str
    scenario: Scenario
    time_s: FloatArray
    curves: tuple[Curve, ...]
    start: tuple[FloatArray, FloatArray] | None = None
    """Times and values of the first curve, continuous, in steps finer than a tick."""

    @property
    def size(self) -> float:
        """The largest value that the figure's continuous curves reach."""
        return max(float(np.abs(curve.continuous).max()) for curve in self.curves)

    def distance(self, curve: Curve) -> float:
        """Largest distance of the sampled from the continuous curve."""
        return float(np.abs(curve.difference).max())

    def distance_after_loss(self, curve: Curve) -> float | None:
        """The same after the loss; None without a loss."""
        after = np.abs(curve.difference[self.time_s >= self.scenario.loss.at_s])
        return float(after.max()) if self.scenario.faults and len(after) else None


def compare(settings: Sequence[str] = ()) -> list[Comparison]:
    """Every figure's curves; ``settings`` as in ``--set``.

    Raises:
        ScenarioError: a bad setting, or a setting that changes the figure's identity.
    """
    for setting in settings:
        key = setting.partition("=")[0].strip()
        if key in {"plant.kind", "plant.variant"} or not key.startswith(SETTINGS):
            raise ScenarioError(
                f"--set {setting}: the figures keep the thesis's own {key}; must be one of "
                f"{', '.join(s.rstrip('.') for s in SETTINGS)}"
            )
    return [make(settings) for make in MAKERS.values()]


@dataclass(frozen=True)
class _Loop:
    """One run of the firmware, and the continuous loop beside the run."""

    scenario: Scenario
    sampled: Solution
    continuous: Solution

    def curve(self, name: str, of: Callable[[Solution], FloatArray]) -> Curve:
        return Curve(name, of(self.sampled), of(self.continuous))


def both(scenario: Scenario) -> _Loop:
    """The firmware with the limits and the LSBs of its target, and the continuous loop."""
    car = sample(continuous_plant(scenario.plant), scenario.tick_s)
    n1, n2 = continuous_design(scenario).factors.numerators
    factors = sample(Plant.from_transfer_functions("N1, N2", n1, n2), scenario.tick_s)
    trace = simulate(
        controller_table(scenario, network_of(scenario)),
        car,
        reference(scenario),
        effectiveness=PlantFaults(scenario).left(range(scenario.ticks)),
    )
    nothing = np.zeros(scenario.ticks)
    late = scenario.latency_ticks
    acting = [
        np.concatenate([nothing[:late], command])[: scenario.ticks]
        for command in (trace.command_1, trace.command_2)
    ]
    sampled = Solution(
        trace.time_s,
        trace.reference,
        trace.measurement,
        trace.command_1,
        trace.command_2,
        trace.fault_estimate,
        _response(factors, acting[0], nothing),
        _response(factors, nothing, acting[1]),
    )
    return _Loop(scenario, sampled, solve(scenario))


def _response(plant: SampledPlant, u1: FloatArray, u2: FloatArray) -> FloatArray:
    """The response to commands held between ticks."""
    x, after, y = plant.rest, plant.rest, np.empty(len(u1))
    for k in range(len(y)):
        y[k] = measure_plant(plant.c, x)
        advance_plant(plant.phi, plant.gamma, x, after, u1[k], u2[k])
    return y


def compare_scenario(name: str, settings: Sequence[str] = ()) -> list[Comparison]:
    """The same curves of any scenario: d̂ healthy, d̂ lost from the start, the loss of its fault.

    Raises:
        ScenarioError: a plant that is a class, has a dead time or changes its speed, or a reference
            or a fault without a continuous counterpart; as ``load``.
    """
    scenario = load(name, settings)
    _refuse_unlike(scenario)
    return [
        _healthy("healthy", scenario),
        _lost_from_the_start("lost", scenario),
        _compensated("loss", scenario),
    ]


def _refuse_unlike(scenario: Scenario) -> None:
    """Raise unless the plant is A, B, C from begin to end, as the continuous loop has it."""
    require_ours(scenario, "figures beside the continuous loop")
    plant, whose = scenario.plant, f"scenario {scenario.name}:"
    if plant.is_own:
        raise ScenarioError(
            f"{whose} plant.kind = {plant.kind!r}: must be linear for figures, "
            f"{', '.join(BUILT_IN)}"
        )
    if scenario.drive.is_given:
        raise ScenarioError(f"{whose} drive: must not be given for figures, which have one speed")
    if any(continuous_plant(plant).path_dead_times_s):
        raise ScenarioError(
            f"{whose} plant: dead times of actuators and sensor must be 0 for figures, whose "
            "continuous loop has none"
        )


def _compared(figure: str, caption: str, loop: _Loop, *curves: Curve) -> Comparison:
    unit = names_of(loop.scenario.plant).output.unit
    return Comparison(figure, caption, unit, loop.scenario, loop.continuous.time_s, curves)


def _healthy(figure: str, scenario: Scenario) -> Comparison:
    return _estimated(figure, "while the plant is healthy", both(scenario.healthy))


def _lost_from_the_start(figure: str, scenario: Scenario) -> Comparison:
    fault = replace(scenario.loss, kind="actuator-dead", channel=CHANNELS[0], at_s=0.0)
    loop = both(replace(scenario, fault=(fault,)))
    return _estimated(figure, "channel 1 lost from the start", loop)


def _estimated(figure: str, when: str, loop: _Loop) -> Comparison:
    """d̂ beside the demand on channel 1: G1 u1, or N1 u1 for an unstable plant."""
    factor = "N" if unstable(continuous_plant(loop.scenario.model).g1) else "G"
    caption = f"$\\hat d$ and ${factor}_1 u_1$, {when}"
    estimate = loop.curve("d̂", lambda s: s.fault_estimate)
    return _compared(
        figure, caption, loop, estimate, loop.curve(f"{factor}1 u1", lambda s: s.model_1)
    )


def _compensated(figure: str, scenario: Scenario) -> Comparison:
    """The error of a closed loop; an open loop shows y beside G2 u2."""
    loop = both(scenario)
    losses = [
        f"channel {1 + CHANNELS.index(fault.place)} lost at {fault.at_s:g} s"
        for fault in scenario.faults
    ]
    lost = ", ".join(losses) or "nothing lost"
    if scenario.design.feedback:
        error = loop.curve("e", lambda s: s.error)
        return _compared(figure, f"error $e = r - y$, {lost}", loop, error)
    y, model_2 = loop.curve("y", lambda s: s.measurement), loop.curve("G2 u2", lambda s: s.model_2)
    return _compared(figure, f"$y$ and $G_2 u_2$, {lost}", loop, y, model_2)


def _error(figure: str, name: str, signal: str, settings: Sequence[str]) -> Comparison:
    """The thesis drew its figures from the printed coefficients: the ``published`` car."""
    chosen = [f"plant.variant={variant}" for variant in ("published", "physics")]
    loops = [both(load(name, [*settings, variant])) for variant in chosen]
    lost = f"steering motor lost at {loops[0].scenario.loss.at_s:g} s"
    curves = [loop.curve(f"e, {loop.scenario.plant.variant}", lambda s: s.error) for loop in loops]
    # While healthy e = (1 - q̂) r for every car, so one curve is enough.
    start = solve(replace(loops[0].scenario, tick_s=START_S / 1000, duration_s=START_S))
    caption = f"error $e = r - y$ for {signal}, {lost}"
    comparison = _compared(figure, caption, loops[0], *curves)
    return replace(comparison, start=(start.time_s, start.error))


MAKERS: dict[str, Callable[[Sequence[str]], Comparison]] = {
    "2.2": lambda settings: _healthy("2.2", load(OPEN_LOOP, settings)),
    "2.3": lambda settings: _lost_from_the_start("2.3", load(OPEN_LOOP, settings)),
    "2.4": lambda settings: _compensated("2.4", load(OPEN_LOOP, settings)),
    "3.5": lambda settings: _error("3.5", "thesis-step", "$r = 1$ m/s²", settings),
    "3.6": lambda settings: _error("3.6", "thesis-sine", "$r = \\sin 5t$ m/s²", settings),
}
"""The thesis's figures by number, from ``--set`` changes."""
