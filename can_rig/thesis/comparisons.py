"""The curves of the thesis's Figs. 2.2-2.4, 3.5 and 3.6, by the firmware and in continuous time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from can_rig.assessment.resolve import load
from can_rig.errors import ScenarioError
from can_rig.plant.faults import ActuatorFault
from can_rig.scenario.build import continuous_plant, controller_table, network_of
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from can_rig.thesis.continuous import Solution, solve
from firmware_model.analysis.sampled_plant import SampledPlant, advance_plant, measure_plant, sample
from firmware_model.analysis.simulation import simulate
from firmware_model.target.structs import FloatArray

START_S = 0.02  # of a closed loop, shown enlarged
OPEN_LOOP = "chapter-2"  # the shipped scenario of Fig. 2.4
#: keys that may change without making it another figure
SETTINGS = ("tick_s", "duration_s", "latency_ticks", "design.", "limits.", "plant.", "fault.at_s")


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
    """The curves of one figure and the run that they come from."""

    figure: str
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
        """The same from the loss on; None where nothing is lost."""
        fault = self.scenario.fault
        after = np.abs(curve.difference[self.time_s >= fault.at_s])
        return float(after.max()) if fault.kind != "none" and len(after) else None


def compare(settings: Sequence[str] = ()) -> list[Comparison]:
    """Every figure's curves; ``settings`` as ``--set`` has them.

    Raises:
        ScenarioError: a bad setting, or one that would make it another figure.
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
    """One run of the firmware and the continuous loop beside it."""

    scenario: Scenario
    sampled: Solution
    continuous: Solution

    def curve(self, name: str, of: Callable[[Solution], FloatArray]) -> Curve:
        return Curve(name, of(self.sampled), of(self.continuous))


def both(scenario: Scenario) -> _Loop:
    """The firmware with the limits and the LSBs of its target, and the continuous loop."""
    car = sample(continuous_plant(scenario.plant), scenario.tick_s)
    fault = ActuatorFault(scenario)
    trace = simulate(
        controller_table(scenario, network_of(scenario)),
        car,
        reference(scenario),
        effectiveness=np.array([fault.effectiveness(tick) for tick in range(scenario.ticks)]),
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
        _response(car, acting[0], nothing),
        _response(car, nothing, acting[1]),
    )
    return _Loop(scenario, sampled, solve(scenario))


def _response(car: SampledPlant, u1: FloatArray, u2: FloatArray) -> FloatArray:
    """The plant's response to commands held from tick to tick: L⁻¹[G1 u1] + L⁻¹[G2 u2]."""
    x, y = car.rest, np.empty(len(u1))
    for k in range(len(y)):
        y[k] = measure_plant(car.c, x)
        advance_plant(car.phi, car.gamma, x, u1[k], u2[k])
    return y


def _compared(figure: str, caption: str, loop: _Loop, *curves: Curve) -> Comparison:
    unit = network_of(loop.scenario).feedback.unit.replace("^2", "²")
    return Comparison(figure, caption, unit, loop.scenario, loop.continuous.time_s, curves)


def _fig_2_2(settings: Sequence[str]) -> Comparison:
    loop = both(load(OPEN_LOOP, settings).healthy)
    caption = "$\\hat d$ and $G_1 u_1$ while the plant is healthy"
    return _compared("2.2", caption, loop, *_estimate_and_channel(loop))


def _fig_2_3(settings: Sequence[str]) -> Comparison:
    scenario = load(OPEN_LOOP, settings)
    loop = both(replace(scenario, fault=replace(scenario.fault, at_s=0.0)))
    caption = "$\\hat d$ and $G_1 u_1$, channel 1 lost from the start"
    return _compared("2.3", caption, loop, *_estimate_and_channel(loop))


def _fig_2_4(settings: Sequence[str]) -> Comparison:
    loop = both(load(OPEN_LOOP, settings))
    caption = f"$y$ and $G_2 u_2$, channel 1 lost at {loop.scenario.fault.at_s:g} s"
    y = loop.curve("y", lambda s: s.measurement)
    return _compared("2.4", caption, loop, y, loop.curve("G2 u2", lambda s: s.model_2))


def _fig_3_5(settings: Sequence[str]) -> Comparison:
    return _error("3.5", "thesis-step", "$r = 1$ m/s²", settings)


def _fig_3_6(settings: Sequence[str]) -> Comparison:
    return _error("3.6", "thesis-sine", "$r = \\sin 5t$ m/s²", settings)


def _estimate_and_channel(loop: _Loop) -> tuple[Curve, Curve]:
    estimate = loop.curve("d̂", lambda s: s.fault_estimate)
    return estimate, loop.curve("G1 u1", lambda s: s.model_1)


def _error(figure: str, name: str, signal: str, settings: Sequence[str]) -> Comparison:
    """The thesis drew its figures from the printed coefficients: the ``published`` car."""
    chosen = [f"plant.variant={variant}" for variant in ("published", "physics")]
    loops = [both(load(name, [*settings, variant])) for variant in chosen]
    lost = f"steering motor lost at {loops[0].scenario.fault.at_s:g} s"
    curves = [loop.curve(f"e, {loop.scenario.plant.variant}", lambda s: s.error) for loop in loops]
    # While healthy e = (1 - q̂) r for every car, so one curve is enough.
    start = solve(replace(loops[0].scenario, tick_s=START_S / 1000, duration_s=START_S))
    caption = f"error $e = r - y$ for {signal}, {lost}"
    comparison = _compared(figure, caption, loops[0], *curves)
    return replace(comparison, start=(start.time_s, start.error))


MAKERS = {"2.2": _fig_2_2, "2.3": _fig_2_3, "2.4": _fig_2_4, "3.5": _fig_3_5, "3.6": _fig_3_6}
