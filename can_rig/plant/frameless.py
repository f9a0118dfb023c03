"""A scenario without frames: one arithmetic loop in place of two nodes and a bus.

The signals equal those of a run on a lockstep bus bit for bit; a linear plant runs thousands of
times faster.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from can_rig.controllers.making import peer_of
from can_rig.controllers.protocol import NO_WITNESSES, Inputs as ControllerInputs, said
from can_rig.errors import RigError, ScenarioError
from can_rig.frames.codec import NO_DECISION
from can_rig.frames.frame_columns import quantised
from can_rig.frames.network import Network
from can_rig.plant.actuated_plant import ActuatedPlant
from can_rig.plant.actuators import actuator_limits
from can_rig.plant.changing_car import linear_plant, plant_of
from can_rig.plant.faults.frame_faults import Delivery, delivery
from can_rig.plant.faults.plant_faults import PlantFaults
from can_rig.plant.sensor import NoiseColumns
from can_rig.plant.witnesses import AllSamples, PlantRead, Sensed, frame_row
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.fault_settings import PLACES
from can_rig.scenario.reference import reference
from can_rig.scenario.remembered import state_of_file
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.hardware import BY, HEALTHY, REPLACED
from firmware_model.analysis.read_off import NotLinearError, read_off
from firmware_model.analysis.sampled_loop import LinearController
from firmware_model.analysis.sampled_plant import SampledPlant
from firmware_model.analysis.simulation import LoopPlant, Simulation, Trace
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.law import controller
from firmware_model.law.structs import BoolArray, FloatArray
from firmware_model.law.supervision.takeover import UNKNOWN

Values = TypeVar("Values", FloatArray, BoolArray)


@dataclass(frozen=True)
class Inputs:
    """The loop's inputs from outside, tick by tick; see ``simulation.Simulation``."""

    reference: FloatArray
    effectiveness: FloatArray
    noise: FloatArray
    bias: FloatArray
    delivery: Delivery
    faults: FloatArray
    speed: FloatArray | None
    """Speed of the car; None: no drive."""


def with_files(scenario: Scenario) -> Iterator[object]:
    """The sources of a run: its scenario, and the states of the files named there."""
    yield scenario
    for file in (scenario.reference.file, scenario.drive.file):
        yield from state_of_file(file)


class Outside:
    """What happens to the loop of a scenario from outside, independent of its car."""

    def __init__(self, scenario: Scenario, network: Network) -> None:
        self._network = network
        self._reference = reference(scenario)
        self._speed = None if network.speed is None else speeds_at_ticks(scenario)
        self._delivery = delivery(scenario, network)
        self._faults = PlantFaults(scenario)

    @property
    def latest_ticks(self) -> int:
        """See ``PlantFaults``."""
        return self._faults.latest_ticks

    def during(self, window: range, noise: FloatArray) -> Inputs:
        """The inputs of some ticks with their ``noise``; after its end, a run goes on as it was."""
        delivered = self._delivered(window)
        speed = None
        if self._speed is not None and self._network.speed is not None:
            speed = quantised(self._network.speed, _part(self._speed, window))
        return Inputs(
            reference=quantised(self._network.reference, _part(self._reference, window)),
            effectiveness=self._faults.left(window),
            noise=noise,
            bias=self._faults.bias(window),
            delivery=delivered,
            faults=self._rows(window, delivered),
            speed=speed,
        )

    def _rows(self, window: range, delivered: Delivery) -> FloatArray:
        """The rows of ``hardware`` with the values of other frames: for each window or for none."""
        rows = self._faults.rows(window)
        if self._delivery.replaced and not len(rows):
            rows = np.tile(HEALTHY, (len(window), len(PLACES), 1))
        for (tick, place), value in delivered.replaced.items():
            rows[tick, place, REPLACED], rows[tick, place, BY] = 1.0, value
        return rows

    def _delivered(self, window: range) -> Delivery:
        of_run = self._delivery
        at = of_run.damage[:, 0]
        damage = of_run.damage[(at >= window.start) & (at < window.stop)]
        damage[:, 0] -= window.start
        replaced = {
            (tick - window.start, place): value
            for (tick, place), value in of_run.replaced.items()
            if tick in window
        }
        sent, used, status = (
            _part(column, window) for column in (of_run.sent, of_run.used, of_run.status)
        )
        return Delivery(sent, used, status, damage, replaced, of_run.rejected)


def _part(values: Values, window: range) -> Values:
    """The rows of a window, which may go on beyond the last row."""
    part = values[window.start : window.stop].copy()
    if len(part) < len(window):
        part = np.concatenate([part, np.repeat(part[-1:], len(window) - len(part), axis=0)])
    return part


def inputs_of(scenario: Scenario, network: Network) -> Inputs:
    """The inputs of a whole run of ``scenario``."""
    ticks = scenario.ticks
    noise = NoiseColumns.of(scenario).next(ticks)
    return Outside(scenario, network).during(range(ticks), noise)


def frameless(
    scenario: Scenario, of: Scheduled | None = None, inputs: Inputs | None = None
) -> Trace:
    """Run ``scenario`` without a bus; round every signal like its frame.

    After an error in a plant class, every measured value is nan. ``of`` is the scenario's
    controller, ``inputs`` its inputs; callers pass known values to save time.

    Raises:
        ScenarioError: a scenario that cannot run.
    """
    loop = frameless_loop(scenario, network_of(scenario), of, inputs)
    loop.run()
    return loop.trace


def controller_inputs(scenario: Scenario) -> FloatArray:
    """Reference and measurement of each tick of the scenario's run, shape (ticks, 2).

    For designs blended by speed, the speed is a third column; each value is rounded as in its
    frame.

    Raises:
        ScenarioError: the scenario cannot run.
    """
    network = network_of(scenario)
    of, inputs = controls(scenario, network), inputs_of(scenario, network)
    trace = frameless(scenario, of, inputs)
    columns = [trace.reference, trace.measured]
    if of.schedule is not None:
        assert inputs.speed is not None
        columns.append(inputs.speed)
    return np.column_stack(columns)


def frameless_loop(
    scenario: Scenario, network: Network, of: Scheduled | None = None, inputs: Inputs | None = None
) -> Simulation:
    """The loop of ``frameless`` at rest, for a run of any length.

    Raises:
        ScenarioError: as ``frameless``.
    """
    return simulation(
        scenario,
        network,
        linear_plant(scenario) or until_it_fails(plant_of(scenario)),
        law_of(scenario, network) if of is None else of,
        inputs_of(scenario, network) if inputs is None else inputs,
    )


def simulation(
    scenario: Scenario,
    network: Network,
    plant: SampledPlant | PlantRead,
    of: Scheduled | None,
    inputs: Inputs,
    keeps_states: bool = False,
) -> Simulation:
    """``scenario`` without a bus, at rest; for the arguments see ``frameless``, ``Simulation``."""
    heard = bool(scenario.heard) if of is not None else bool(network.witnesses)
    hears: Sensed | AllSamples | None = None
    if heard:
        if isinstance(plant, SampledPlant):
            hears = AllSamples(scenario, network.witnesses)
        else:
            plant = hears = plant if isinstance(plant, Sensed) else Sensed(scenario, network, plant)
    at_rest = None
    if of is not None:
        at_rest = controller.init(of.table)
        at_rest["supervision"]["takeover"]["pending"] = UNKNOWN  # the plant may move already
    return Simulation(
        InLoop(scenario, plant) if of is None else of.table,
        plant,
        inputs.reference,
        tick_s=scenario.tick_s,
        effectiveness=inputs.effectiveness,
        noise=inputs.noise,
        bias=inputs.bias,
        arrives=inputs.delivery.used,
        faults=inputs.faults,
        schedule=None if of is None else of.schedule,
        speed=inputs.speed,
        hold_ticks=round(scenario.actuator.hold_s / scenario.tick_s),
        limits=actuator_limits(scenario.plant, scenario.tick_s),
        resolution=scenario.plant.sensor.resolution_mps2,
        frames=np.array(
            [frame_row(codec) for codec in (network.command_1, network.command_2, network.feedback)]
        ),
        keeps_states=keeps_states,
        at_rest=at_rest,
        hears=None if of is None else hears,
        restarts=[(each.start, each.stop, each.state_survives) for each in scenario.outages],
    )


def law_of(scenario: Scenario, network: Network | None) -> Scheduled | None:
    """The rig's own control law; None: the scenario has a controller of another kind.

    Raises:
        ScenarioError: see ``controls``.
    """
    return controls(scenario, network) if scenario.controller.is_ours else None


class InLoop:
    """A controller of another kind in the loop without frames; see ``AnyController``.

    Raises:
        ScenarioError: see ``peer_of``.
    """

    def __init__(self, scenario: Scenario, plant: object) -> None:
        self._senses = plant if isinstance(plant, Sensed) else None
        self.latency_ticks = scenario.latency_ticks
        """See ``AnyController``."""
        self._scenario = scenario
        self.restart()

    def restart(self) -> None:
        """See ``AnyController``."""
        self.peer = peer_of(self._scenario)
        if self._senses is not None:
            self._senses.restart()

    def answer(
        self, reference: float, measurement: float, speed: float
    ) -> tuple[float, float, float, int, int, int]:
        """See ``AnyController``."""
        heard = NO_WITNESSES if self._senses is None else self._senses.heard()
        answer = self.peer.step(ControllerInputs(reference, measurement, speed, heard))
        return answer.command_1, answer.command_2, *said(answer)


def linear_law_of(
    scenario: Scenario, on_answer: Callable[[int], None] = lambda number: None
) -> LinearController:
    """The matrices of the scenario's controller, of another kind than the rig's own law.

    ``on_answer`` is called after each answer, with its number.

    Raises:
        ScenarioError: a controller that is not linear around rest.
    """

    def respond(inputs: FloatArray) -> FloatArray:
        peer, answers = peer_of(scenario), []
        for number, (y, r) in enumerate(inputs.tolist()):
            answer = peer.step(ControllerInputs(r, y))
            answers.append((*answer[:2], answer.fault_estimate or 0.0))
            on_answer(number)
        return np.array(answers)

    try:
        return read_off(respond, scenario.latency_ticks)
    except NotLinearError as error:
        raise ScenarioError(
            f"controller.kind = {scenario.controller.kind!r}: has no margins: {error}"
        ) from None


def until_it_fails(plant: ActuatedPlant) -> PlantRead:
    """``plant`` with nan as its output from its first error on; a built-in car never fails."""
    return plant if isinstance(plant, LoopPlant) else UntilItFails(plant)


class UntilItFails:
    """A plant whose output is nan from its first error on."""

    def __init__(self, plant: ActuatedPlant) -> None:
        self._plant = plant
        self._failed = False
        self.witnesses = plant.witnesses
        """See ``ActuatedPlant``."""

    def follow(
        self, command_1: float, command_2: float, left_1: float, left_2: float
    ) -> tuple[float, float]:
        """See ``ActuatedPlant``."""
        if not self._failed:
            try:
                return self._plant.follow(command_1, command_2, left_1, left_2)
            except RigError:
                self._failed = True
        return np.nan, np.nan


def carried(
    trace: Trace, delivered: Delivery, rows: slice, network: Network
) -> dict[str, FloatArray]:
    """What the frames of some ticks of a loop say, by name, (ticks,) each.

    Args:
        trace: the loop's.
        delivered: which commands reach their actuators, and what has come in their place.
        rows: the ticks, with a start and a stop.
        network: the frames.
    """
    commands = [
        np.where(delivered.used[rows, channel], command[rows], np.nan) + 0.0
        for channel, command in enumerate((trace.command_1, trace.command_2))
    ]
    for (tick, place), value in delivered.replaced.items():
        if place < len(commands) and rows.start <= tick < rows.stop:
            commands[place][tick - rows.start] = value
    used = delivered.status[rows]
    said = {
        "reference_mps2": trace.reference[rows],
        "dstar_mps2": trace.measured[rows] + 0.0,  # a frame has no negative zero
        "torque_nm": commands[0],
        "force_difference_n": commands[1],
        "fault_estimate_mps2": np.where(
            used, quantised(network.status, trace.fault_estimate[rows]), np.nan
        ),
        "mode": np.where(used, trace.mode[rows], np.nan),
        "fault_state": np.where(
            used & (trace.verdict[rows] != NO_DECISION), trace.fault_state[rows], np.nan
        ),
    }
    if network.status.verdicts:
        verdict = trace.verdict[rows]
        said["verdict"] = np.where(used & (verdict < NO_DECISION), verdict, np.nan)
    return said
