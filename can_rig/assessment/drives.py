"""Drives before a run: whether the loop bears its limits, its noise and other cars.

A margin is of the linear loop. Only a drive shows the effects of a limited actuator, a noisy sensor
or a car of the box. The scenario's reference is therefore driven, without frames but with every
other part of a run, healthy first and then with a lost channel. A drive fails where

    the controller confirms a false loss, or D* stays away for more than ``RETURN_S`` from the
    unlimited modelled car's D*: the loop swings between its limits, or rests far from a feasible
    demand.

The times suit a car, and grow for a slower plant.

Other cars are the vertices of the budget's box and random cars from its inside.
"""

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product
from typing import Final

import numpy as np

from can_rig.drawing.names import CAR, Names, names_of, with_unit
from can_rig.plant.frameless import Inputs, frameless, frameless_loop, inputs_of
from can_rig.scenario.box import in_box, uncertain
from can_rig.scenario.build import continuous_plant, network_of, slowness, target
from can_rig.scenario.controls import controller_table
from can_rig.scenario.fault_settings import CHANNELS, Channel, FaultSettings
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import LimitSettings, Scenario
from firmware_model.analysis.simulation import Simulation, Trace
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray

RETURN_S = 2.0  # within which D* must be back
HEALTHY_S, LOST_S = 4.0, 3.0 + RETURN_S  # of a drive; what is away after 3 s has time to return
FEWEST_TICKS = 400  # of either, where a tick is long
TOGETHER_S = 0.5  # a shorter return of D* still counts as away
AWAY = 0.1  # of the largest reference, beside the noise
NOISE_SIGMAS = 8.0
DRAWN = 8  # cars from the inside of the box
LOSSES: Final[Mapping[str, tuple[Channel, float]]] = {
    "torque dead": ("torque", 0.0),
    "torque 50%": ("torque", 0.5),
    "force-difference dead": ("force-difference", 0.0),
}
"""The channel of each kind of loss, and its remaining share; for any plant, in a car's words."""


@dataclass(frozen=True)
class Finding:
    """What is wrong in a drive.

    Attributes:
        car: which one, in words.
        false_alarm: a confirmed loss without a loss; False: D* stays away.
        text: what happens, and when.
    """

    car: str
    false_alarm: bool
    text: str

    def __str__(self) -> str:
        return f"{self.car}: {self.text}"


class Drives:
    """Drives of one scenario; the table and where D* should go are computed once."""

    def __init__(self, scenario: Scenario) -> None:
        tick_s = scenario.tick_s
        slow = slowness(scenario)
        healthy, lost = (max(round(s * slow / tick_s), FEWEST_TICKS) for s in (HEALTHY_S, LOST_S))
        self.scenario = scenario
        self._scenario = replace(scenario, fault=(), duration_s=(healthy + lost) * tick_s)
        self._network = network_of(scenario)
        self._lost = healthy
        self._return_s, self._together_s = RETURN_S * slow, TOGETHER_S * slow
        self._known: dict[str, Inputs] = {}

    @cached_property
    def _law(self) -> Scheduled | None:
        if not self._scenario.controller.is_ours:
            return None
        return Scheduled(None, controller_table(self._scenario, self._network))

    @cached_property
    def _goal(self) -> FloatArray:
        free = self._with(self.scenario.model)
        if not free.controller.is_class:  # a class may compute with its limits
            free = replace(free, limits=LimitSettings())
        return frameless(free.noise_free).measurement

    def _with(self, plant: PlantSettings) -> Scenario:
        """The scenario with ``plant``, which is pushed as the scenario's own, if the form fits."""
        own, pushes = self.scenario.plant, self.scenario.disturbance
        if plant.kind == own.kind and len(plant.a or ()) == len(own.a or ()):
            plant = replace(plant, e=plant.e or own.e, gw=plant.gw or own.gw)
        elif not plant.is_car:
            pushes = ()
        return replace(self._scenario, plant=plant, disturbance=pushes)

    @cached_property
    def _away(self) -> float:
        sensor = self.scenario.plant.sensor
        return AWAY * float(np.abs(self._goal).max()) + NOISE_SIGMAS * sensor.noise_mps2

    def at_start(self, plant: PlantSettings, loss: str) -> Simulation:
        """The drive of ``plant`` that ends with the loss ``loss`` of ``LOSSES``, at rest."""
        driven = self._with(plant)
        return frameless_loop(driven, self._network, self._law, self._inputs(loss))

    def findings(self, car: str, plant: PlantSettings, loss: str) -> Iterator[Finding]:
        """The failures of ``plant`` in a drive that ends with a loss of ``LOSSES``."""
        yield from self.judged(car, plant, loss, to_the_end(self.at_start(plant, loss)))

    def judged(self, car: str, plant: PlantSettings, loss: str, trace: Trace) -> Iterator[Finding]:
        """The failures of ``plant`` in this drive."""
        tick_s = self._scenario.tick_s
        alarms = np.flatnonzero(trace.fault_state[: self._lost] == FaultState.CONFIRMED)
        if len(alarms):
            yield Finding(car, True, f"false alarm after {alarms[0] * tick_s:.3g} s")
        distance = np.abs(trace.measurement - self._goal)
        phases = [("healthy", slice(0, self._lost))]
        names = names_of(self._scenario.plant)
        if self._returns(plant, loss):
            phases.append((_said(loss, names), slice(self._lost, None)))
        for state, phase in phases:
            away = self._longest_away_s(distance[phase])
            if away > self._return_s:
                failed = np.flatnonzero(np.isnan(distance))
                if plant.is_own and len(failed):
                    at = f"{failed[0] * tick_s:.4g} s"
                    yield Finding(car, False, f"{state}: {plant.kind} fails at {at}")
                    return
                last = distance[phase][-round(1.0 / tick_s) :]
                largest = f"{float(np.nanmax(last, initial=0.0)):.3g}"
                yield Finding(
                    car,
                    False,
                    f"{state}: {names.output.name} is away from where it should be for {away:.3g} "
                    f"s, by up to {with_unit(largest, names.output.unit)} in the last second",
                )
                return

    def _inputs(self, loss: str) -> Inputs:
        """The inputs of a drive that ends with ``loss``; the sensor is the scenario's own."""
        if loss not in self._known:
            channel, left = LOSSES[loss]
            at_s = self._lost * self._scenario.tick_s
            fault = FaultSettings("actuator-dead", channel, at_s, left=left)
            self._known[loss] = inputs_of(replace(self._scenario, fault=(fault,)), self._network)
        return self._known[loss]

    def _returns(self, plant: PlantSettings, loss: str) -> bool:
        """Whether D* should come back after ``loss``."""
        if self._scenario.design.compensation == "off":
            return LOSSES[loss][0] != "torque"
        gain = abs(continuous_plant(plant).g2.dc_gain)
        demand = float(np.abs(self._goal[self._lost :]).max())
        return demand <= gain * target(self._scenario, self._network).limit_2

    def _longest_away_s(self, distance: FloatArray) -> float:
        """The longest time with D* away, or back only briefly."""
        tick_s = self._scenario.tick_s
        away = np.flatnonzero(~(distance <= self._away))
        if len(away) == 0:
            return 0.0
        pieces = np.split(away, np.flatnonzero(np.diff(away) * tick_s > self._together_s) + 1)
        return max(float(piece[-1] - piece[0] + 1) for piece in pieces) * tick_s


def to_the_end(loop: Simulation) -> Trace:
    """Run the drive to its end; return the trace."""
    loop.run()
    return loop.trace


def _said(loss: str, names: Names) -> str:
    """``loss`` by the words of a car, or by the name of the channel."""
    if names.output == CAR.output:
        return loss
    channel, left = LOSSES[loss]
    lost = names[1 + CHANNELS.index(channel)].short
    return f"{lost} {left:.0%}" if left else f"{lost} dead"


def own_findings(drives: Drives) -> list[Finding]:
    """The failures of the scenario's plant, for every kind of loss."""
    scenario = drives.scenario
    if not scenario.design.feedback:
        return []
    label = f"this {scenario.plant.noun}"
    found = (drives.findings(label, scenario.plant, loss) for loss in LOSSES)
    return list({str(finding): finding for each in found for finding in each}.values())


def box_findings(
    drives: Drives, on_car: Callable[[int, int], None] = lambda done, of: None
) -> list[Finding]:
    """The failures of other cars of the budget's box after a loss of the torque.

    While some cars drive, compiled and without the interpreter's lock, the next car is made. Few
    drive at once, because the trace of a drive with a short tick is large.
    """
    scenario, loss = drives.scenario, "torque dead"
    if not scenario.design.feedback or scenario.plant.is_own:
        return []
    found: list[Finding] = []
    cars, most = list(box_cars(scenario)), os.cpu_count() or 1
    driven: deque[Future[Trace]] = deque()
    with ThreadPoolExecutor(most) as beside:
        ahead = iter(cars)
        for done, (label, car) in enumerate(cars, 1):
            for _, other in islice(ahead, most + 1 - len(driven)):
                driven.append(beside.submit(to_the_end, drives.at_start(other, loss)))
            found += drives.judged(label, car, loss, driven.popleft().result())
            on_car(done, len(cars))
    return found


def box_cars(scenario: Scenario) -> Iterator[tuple[str, PlantSettings]]:
    """Vertices of the budget's box around the model, then cars from its inside, with labels.

    All cars have the limits and the sensor of the scenario's plant.
    """
    budget, plant = scenario.budget, scenario.plant
    late = budget.actuator_box if scenario.model.torque_actuator.lags else 0.0
    keys = tuple(uncertain(plant)) if budget.box > 0.0 else ()
    size = len(keys) + (late > 0.0)
    if size == 0:
        return
    vertices = np.array(list(product((-1.0, 1.0), repeat=size)))
    drawn = np.random.Generator(np.random.PCG64(scenario.seed)).uniform(-1.0, 1.0, (DRAWN, size))
    for place in np.concatenate([vertices, drawn]):
        shares = {key: budget.box * float(x) for key, x in zip(keys, place, strict=False)}
        labels = [f"{key} {share:+.0%}" for key, share in shares.items()]
        lags = late * float(place[-1])
        if late > 0.0:
            labels.append(f"lags {lags:+.0%}")
        yield ", ".join(labels), in_box(plant, shares, lags)
