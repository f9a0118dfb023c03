"""The further sensors of a run, tick by tick and for many ticks at once.

Every loop takes the same compiled ``sense``, so each says the same bits.
"""

import math
import struct
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from can import Message

from can_rig.controllers.protocol import samples_in
from can_rig.frames.codec import Hearing, MessageCodec, Transmitter
from can_rig.frames.network import Network
from can_rig.plant.faults.frame_faults import SENSOR_PLACE, FrameFaults
from can_rig.plant.faults.plant_faults import FaultsByTick, PlantFaults
from can_rig.plant.sensor import NoiseColumns
from can_rig.scenario.build import network_of
from can_rig.scenario.sensor_settings import ECHOES, HEARD, MEASURED, SAMPLE_TICKS
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.hardware import GRID, frame_of
from firmware_model.analysis.sampled_plant import AnyPlant
from firmware_model.analysis.witnesses import HEALTHY, NOT_SENT, VALID, sense
from firmware_model.law.structs import FloatArray

KEPT_TICKS: Final = 8192
"""For which a loop keeps what the sensors have said."""

BLOCK_TICKS: Final = 1024
"""Ticks for which noise is drawn ahead."""

NOISE: Final = 1 << 20
"""Tells the generators of the sensors from those of turbulence."""


class Said(NamedTuple):
    """What one sensor's frame says."""

    sensor: int
    """Its number among the scenario's."""
    value: float
    sample_tick: int
    valid: bool


class PlantRead(AnyPlant, Protocol):
    """A plant whose further sensors are read."""

    @property
    def witnesses(self) -> FloatArray:
        """(sensors,), readings at this tick, without errors."""


class Senses:
    """Noise, faults and constants of the further sensors of a scenario."""

    def __init__(self, scenario: Scenario, codecs: Sequence[MessageCodec]) -> None:
        self._sensors = scenario.sensors
        self._noise = [
            NoiseColumns(
                np.random.SeedSequence(
                    scenario.seed, spawn_key=(NOISE, MEASURED.index(each.measures))
                ),
                each.noise_rms,
                each.lag_s,
                scenario.tick_s,
            )
            for each in self._sensors
        ]
        timing = [each.timing(scenario.tick_s) for each in self._sensors]
        self.delays: Final = [delay for _, _, delay in timing]
        self.echoed: Final = [
            ECHOES.index(each.measures) if each.measures in ECHOES else 0 for each in self._sensors
        ]
        """The channel whose command a lying echo says."""
        self.constants: Final[Any] = (
            np.array(timing, np.int64).reshape(len(timing), 3),
            np.array([each.step for each in self._sensors]),
            np.array([frame_row(codec) for codec in codecs]).reshape(len(timing), GRID),
        )

    def __len__(self) -> int:
        return len(self._sensors)

    def noise(self, ticks: int) -> FloatArray:
        """(ticks, sensors), of the next ones."""
        columns = [each.next(ticks) for each in self._noise]
        return np.stack(columns, axis=1) if columns else np.zeros((ticks, 0))

    def noise_by_tick(self) -> Iterator[FloatArray]:
        """(sensors,), of the next tick, without an end."""
        while True:
            yield from self.noise(BLOCK_TICKS)

    def memory(self, latest_ticks: int) -> Any:
        """The memory of ``sense`` at rest, for readings late by faults of at most these ticks."""
        r = len(self)
        length = max(self.delays, default=0) + latest_ticks + 1
        return np.zeros((length, r)), np.zeros(r), np.zeros(r, np.int64)


class SensesByTick:
    """What the further sensors say, tick by tick.

    Args:
        scenario: the run.
        codecs: the sensors' frames.
        faults: those of the run.
    """

    def __init__(
        self, scenario: Scenario, codecs: Sequence[MessageCodec], faults: FaultsByTick
    ) -> None:
        self._senses = Senses(scenario, codecs)
        self._memory = self._senses.memory(faults.latest_ticks)
        r = len(self._senses)
        self._values, self._samples = np.zeros(r), np.zeros(r, np.int64)
        self._states = np.zeros(r, np.int64)
        self._faults, self._noise = faults, self._senses.noise_by_tick()
        if r:  # compiles before the first tick
            nothing = np.zeros(r)
            sense(
                0, nothing, nothing, nothing, nothing, np.tile(HEALTHY, (r, 1)),
                self._senses.constants, self._senses.memory(faults.latest_ticks), self._values,
                self._samples, self._states,
            )  # fmt: skip

    def take(self, tick: int, truth: FloatArray, told: tuple[float, float]) -> list[Said]:
        """What the frames of ``tick`` say; ``tick`` is one more in every call.

        Args:
            tick: from 0 on.
            truth: (sensors,), readings without errors.
            told: the commands that a lying echo says instead.
        """
        now = self._faults.at(tick)
        echoed = np.array([told[channel] for channel in self._senses.echoed])
        sense(
            tick, truth, echoed, now.bias_of_witnesses, next(self._noise), now.rows_of_witnesses,
            self._senses.constants, self._memory, self._values, self._samples, self._states,
        )  # fmt: skip
        return [
            Said(each, self._values.item(each), self._samples.item(each), state == VALID)
            for each, state in enumerate(self._states.tolist())
            if state != NOT_SENT
        ]


class SensorFrames:
    """The frames of the further sensors on the bus.

    Args:
        network: of the run. The last sensor of a message sends the values of all its sensors.
        faults: of the frames.
    """

    def __init__(self, network: Network, faults: FrameFaults) -> None:
        self._senders = [Transmitter(codec) for codec in network.witnesses]
        self._places = sorted({place for place in network.senders if place > SENSOR_PLACE})
        self._faults = faults

    def of(self, said: Sequence[Said], tick: int) -> list[Message]:
        """The frames of a tick in which the sensors say this."""
        own = {
            SENSOR_PLACE + 1 + each.sensor: self._senders[each.sensor].frame(
                each.value if each.valid or self._senders[each.sensor].codec.modes else math.nan,
                tick, int(each.valid), 0, each.sample_tick % SAMPLE_TICKS,
            )
            for each in said
        }  # fmt: skip
        return [
            frame
            for place in self._places
            for frame in self._faults.on_the_wire(own.get(place), place, tick)
        ]


def hearing_of(scenario: Scenario, network: Network) -> Hearing:
    """The receivers of the further sensors' frames."""
    timings = [each.timing(scenario.tick_s) for each in scenario.sensors]
    names = [each.usual.column for each in scenario.sensors]
    return Hearing(network.witnesses, timings, names)


class Sensed:
    """A plant in a loop without a bus, whose further sensors somebody hears."""

    def __init__(self, scenario: Scenario, network: Network, plant: PlantRead) -> None:
        self._plant, self._tick = plant, 0
        codecs = network.witnesses
        self._senses = SensesByTick(scenario, codecs, FaultsByTick(scenario))
        self._frames = SensorFrames(network, FrameFaults(scenario, network))
        self._powered_up = partial(hearing_of, scenario, network)
        self.witnesses, self.follow = plant.witnesses, plant.follow
        """See ``ActuatedPlant``."""
        self.sent: Final[deque[list[Message]]] = deque(maxlen=KEPT_TICKS)
        """The frames of the last ticks."""
        self.restart()

    def restart(self) -> None:
        """Who hears the sensors begins again."""
        self._hearing = self._powered_up()

    def sense(self, told: tuple[float, float]) -> None:
        """See ``SensedPlant``."""
        said = self._senses.take(self._tick, self._plant.witnesses, told)
        self.sent.append(self._frames.of(said, self._tick))
        self._tick += 1

    def samples(self) -> list[tuple[int, float, float]]:
        """See ``Hears``."""
        return samples_in(self.heard())

    def heard(self) -> Mapping[str, float]:
        """What a controller hears at this tick, once; see ``Hearing``."""
        tick = self._tick - 1
        for message in self.sent[-1]:
            self._hearing.take(message, tick)
        return self._hearing.end_tick(tick)


def all_samples_arrive(scenario: Scenario) -> bool:
    """Whether no fault acts on a frame of a further sensor."""
    senders, places = network_of(scenario).senders, scenario.places
    return not any(
        each.acts_on_frames and senders[places.index(each.place)] > SENSOR_PLACE
        for each in scenario.faults
    )


class AllSamples:
    """The further sensors of a linear plant that the rig's own law hears; see ``HearsAll``."""

    def __init__(self, scenario: Scenario, codecs: Sequence[MessageCodec]) -> None:
        self._senses, self._faults = Senses(scenario, codecs), PlantFaults(scenario)
        sensors, r = [each.measures for each in scenario.sensors], len(scenario.sensors)
        heard = [
            (sensors.index(each), number) for number, each in enumerate(HEARD, 1) if each in sensors
        ]
        self._fixed = (
            np.array(heard, np.int64),
            np.array(self._senses.echoed, np.int64),
            np.array([SAMPLE_TICKS if codec.modes else 1 for codec in codecs]),
            self._senses.constants,
        )
        self._now = (
            self._senses.memory(self._faults.latest_ticks),
            *(np.zeros(r) for _ in range(3)),
            *(np.zeros(r, np.int64) for _ in range(2)),
        )
        self._done = 0

    def samples_of(self, ticks: int) -> Any:
        """See ``HearsAll``."""
        its = range(self._done, self._done + ticks)
        self._done = its.stop
        bias, faults = self._faults.of_witnesses(its)
        return self._fixed, self._now, its.start, bias, self._senses.noise(ticks), faults


def frame_row(codec: MessageCodec) -> FloatArray:
    """The row of a frame in ``hardware``."""
    bits = 8 * struct.calcsize(codec.float_format) if codec.float_format else 0
    return frame_of(codec.lsb, codec.minimum, codec.maximum, bits)
