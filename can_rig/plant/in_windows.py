"""The loop without frames of a run of any length, in memory that does not grow with it.

A window of ticks goes along with the run: what happens from outside is worked out for its ticks,
and of what is done it keeps what a late command or reading looks back on.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from can_rig.frames.network import Network
from can_rig.plant.changing_car import linear_plant, plant_of
from can_rig.plant.frameless import Inputs, Outside, UntilItFails, law_of, simulation
from can_rig.plant.sensor import NoiseColumns
from can_rig.plant.witnesses import PlantRead
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.analysis.sampled_plant import SampledPlant
from firmware_model.analysis.simulation import Simulation
from firmware_model.law.structs import FloatArray

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
        self._outside = Outside(scenario, network)
        self._noise = NoiseColumns.of(scenario)
        self._looks_back = scenario.latency_ticks + self._outside.latest_ticks + 1
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
        return self._outside.during(window, noise)


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
