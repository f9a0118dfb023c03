"""The loop without frames of a run of any length, in memory that does not grow with it.

A window of ticks goes along with the run: what happens from outside is worked out for its ticks,
and of what is done it keeps what a late command or reading looks back on.
"""

from collections.abc import Iterator
from typing import Final, TypeVar

import numpy as np

from can_rig.frames.frame_columns import quantised
from can_rig.frames.network import Network
from can_rig.plant.changing_car import linear_plant, plant_of
from can_rig.plant.faults.frame_faults import Delivery, delivery
from can_rig.plant.faults.plant_faults import PlantFaults
from can_rig.plant.frameless import Inputs, UntilItFails, law_of, simulation, with_replaced
from can_rig.plant.sensor import NoiseColumns
from can_rig.plant.witnesses import PlantRead
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.analysis.sampled_plant import SampledPlant
from firmware_model.analysis.simulation import Simulation
from firmware_model.law.structs import BoolArray, FloatArray

Values = TypeVar("Values", FloatArray, BoolArray)

BLOCK_TICKS: Final = 8192
"""Between two looks at what has been done."""

WINDOW_TICKS: Final = 8 * BLOCK_TICKS
"""A shorter run is one window."""


class LoopInWindows:
    """A scenario without a bus, at rest; see ``frameless``.

    Args:
        scenario: the run.
        network: its frames.
        plant: its plant, at rest.
        keeps_states: see ``Simulation``.

    Raises:
        ScenarioError: a scenario that cannot run.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        plant: SampledPlant | PlantRead,
        keeps_states: bool = False,
    ) -> None:
        self.ticks: Final = scenario.ticks
        self.first = 0
        """The tick that the columns of ``loop`` and ``inputs`` begin with."""
        self._scenario = scenario
        self._network = network
        self._reference = reference(scenario)
        self._speed = None if network.speed is None else speeds_at_ticks(scenario)
        self._delivery = delivery(scenario, network)
        self._faults = PlantFaults(scenario)
        self._noise = NoiseColumns.of(scenario)
        self._looks_back = scenario.latency_ticks + self._faults.latest_ticks + 1
        if isinstance(plant, SampledPlant):  # what waits in a dead time is reported as it acts
            self._looks_back += max(plant.dead_ticks) + 1
        window = range(min(self.ticks, WINDOW_TICKS + self._looks_back))
        self.inputs = inputs = self._inputs(window, np.empty(0), 0)
        self.loop: Final[Simulation] = simulation(
            scenario, network, plant, law_of(scenario, network), inputs, keeps_states
        )

    @property
    def done(self) -> int:
        """How many ticks are."""
        return self.first + self.loop.done

    def here(self, ticks: range) -> slice:
        """Where the columns have these ticks."""
        return slice(ticks.start - self.first, ticks.stop - self.first)

    def run(self) -> range:
        """Run some more ticks and return their range; ``loop`` holds all ticks still of use.

        Raises:
            RigError: a plant of one's own fails; ``done`` says when.
        """
        end = min(self.done + BLOCK_TICKS, self.ticks)
        if end > self.first + self.loop.ticks:
            drawn = self.inputs.noise[self.loop.done :]  # for ticks that are still to come
            self.first = self.done - self._looks_back
            window = range(self.first, self.first + self.loop.ticks)
            self.inputs = inputs = self._inputs(window, drawn, self._looks_back)
            self.loop.move_on(
                self._looks_back,
                (
                    inputs.reference, inputs.bias, inputs.noise, inputs.effectiveness,
                    inputs.delivery.used,
                ),
                inputs.faults,
                inputs.speed,
            )  # fmt: skip
            paged.let_go()
        begin = self.done
        self.loop.run(end - self.first)
        return range(begin, self.done)

    def _inputs(self, window: range, drawn: FloatArray, done: int) -> Inputs:
        """What happens in a window.

        Args:
            window: its ticks.
            drawn: the noise of the next ticks, as far as drawn before.
            done: the number of past ticks in the window; their noise is used up.
        """
        fresh = self._noise.next(len(window) - done - len(drawn))
        noise = np.concatenate([np.zeros(done), drawn, fresh])
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
        arriving = Delivery(sent, used, status, damage, replaced, of_run.rejected)
        speed = None
        if self._speed is not None and self._network.speed is not None:
            speed = quantised(self._network.speed, _part(self._speed, window))
        return Inputs(
            reference=quantised(self._network.reference, _part(self._reference, window)),
            effectiveness=self._faults.left(window),
            noise=noise,
            bias=self._faults.bias(window),
            delivery=arriving,
            faults=with_replaced(self._faults.rows(window), arriving, len(window)),
            speed=speed,
        )


def blocks_of(scenario: Scenario) -> Iterator[tuple[range, Simulation, slice]]:
    """A run without a bus, block by block: its ticks, and where the loop has them.

    A user's plant may fail in mid-run: from then on the measurement is not a number.

    Raises:
        ScenarioError: a scenario that cannot run.
    """
    of = linear_plant(scenario) or UntilItFails(plant_of(scenario))
    run = LoopInWindows(scenario, network_of(scenario), of)
    while run.done < run.ticks:
        ticks = run.run()
        yield ticks, run.loop, run.here(ticks)


def _part(values: Values, window: range) -> Values:
    """The rows of a window, which may go on behind the last one."""
    part = values[window.start : window.stop].copy()
    if len(part) < len(window):
        part = np.concatenate([part, np.repeat(part[-1:], len(window) - len(part), axis=0)])
    return part
