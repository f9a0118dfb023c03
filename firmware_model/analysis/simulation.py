"""The loop without frames: ``step``, the links between ``step`` and a plant, and the plant.

The effects of a bus are inputs of the loop: the arriving commands, the sensor's errors, the grid of
D*. The actuator's limits act on an arriving command, then dead time and lag; a fault acts on the
input of the lag. So the loop returns the signals of a run on a bus, bit for bit, in a fraction of
the time. A linear plant runs compiled as a whole; for any other the same ``tick`` alternates with
the plant's own ``follow``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from firmware_model.analysis import hardware
from firmware_model.analysis.loop import (
    ACTING_1,
    COMMAND_1,
    COMMAND_2,
    ESTIMATE,
    EVIDENCE,
    MEASURED,
    OUTPUT,
    REACHED_1,
    ROWS,
    carry,
    measure,
    run_changing,
    run_hearing,
    run_ticks,
    tick,
)
from firmware_model.analysis.sampled_plant import AnyPlant, SampledPlant, follow
from firmware_model.law import controller as law
from firmware_model.law.layout import State, Table, precision_of, table_type
from firmware_model.law.schedule import Constants, State as BlendState, change_first_speed
from firmware_model.law.structs import BoolArray, FloatArray, Records, copied, zeroed
from firmware_model.law.supervision.further_sensors import hear_first
from firmware_model.law.supervision.knowledge import saved_in


@dataclass(frozen=True)
class Trace:
    """One value a tick, each of shape (ticks,)."""

    time_s: FloatArray
    reference: FloatArray
    measurement: FloatArray
    """The plant's output y, before its sensor."""
    measured: FloatArray
    """y as the controller gets it: by the sensor, with bias and noise, on the grid of its frame."""
    command_1: FloatArray
    command_2: FloatArray
    fault_estimate: FloatArray
    fault_state: NDArray[np.int64]
    mode: NDArray[np.int64]
    verdict: NDArray[np.int64]
    """Whose fault it is: a ``Verdict``."""
    evidence: FloatArray
    """The log-likelihood ratio of a loss, or of the return of a lost channel."""

    @property
    def error(self) -> FloatArray:
        """e = r - y (3.41)."""
        return self.reference - self.measurement


Vectors = tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]


@runtime_checkable
class LoopPlant(AnyPlant, Protocol):
    """A plant that advances together with the loop, in compiled code."""

    def run_loop(
        self,
        loop: Callable[..., tuple[float, float]],
        begin: int,
        end: int,
        output: tuple[float, float],
    ) -> tuple[float, float]:
        """Advance loop and plant from the loop's tick ``begin`` to ``end``.

        ``loop`` is ``loop.run_changing`` with the first argument given;
        ``output`` and the result are those of ``follow``.
        """


@runtime_checkable
class SensedPlant(AnyPlant, Protocol):
    """A plant with further sensors, which somebody hears tick by tick."""

    def sense(self, told: tuple[float, float]) -> None:
        """Read the sensors of this tick, before the controller's step.

        ``told`` is what each actuator was told in the tick before.
        """


class Hears(Protocol):
    """Who hears the further sensors."""

    def samples(self) -> Iterable[tuple[int, float, float]]:
        """The samples of this tick, for ``further_sensors.hear``; asked once a tick."""

    def restart(self) -> None:
        """The controller begins again, as after power-up."""


@runtime_checkable
class HearsAll(Protocol):
    """Who hears the further sensors of a ``SampledPlant``, whose every frame arrives."""

    def samples_of(self, ticks: int) -> Any:
        """What happens to the sensors in the next ticks, for ``loop.run_hearing``.

        Returns:
            What stays the same: sensor and number of each sample that ``further_sensors.hear``
            takes (n, 2), in the order of the calls; the channel of each echo (r,); the number
            modulo which a frame has the tick of its sample (r,), 1: not at all; the constants of
            ``sense``.
            What changes in place: the memory of ``sense``, the readings (r,), and room for the
            told commands, the values, the ticks of the samples and the states of ``sense``.
            The first tick of the run. The bias and the noise (ticks, r), and the faults (ticks, r,
            ``DISTORTION``) or (1, r, ``DISTORTION``).
        """


class AnyController(Protocol):
    """A controller in place of the control law, at rest when it is given to ``simulate``."""

    @property
    def latency_ticks(self) -> int:
        """Whole ticks from a sample until its commands act."""

    def answer(
        self, reference: float, measurement: float, speed: float
    ) -> tuple[float, float, float, int, int, int]:
        """One tick: both commands, d̂, mode, fault state and verdict, as ``firmware.Answer``.

        ``speed`` is not a number in a loop without a changing speed.
        """

    def restart(self) -> None:
        """Begin again, as after power-up."""


class Simulation:
    """A loop that starts from rest and advances on request.

    Args:
        controller: the table from ``tables.build`` for the plant's tick, whose latency is the
            loop's; or a controller of another kind.
        plant: the car, not necessarily the table's design car.
        reference: (ticks,).
        tick_s: seconds; a ``SampledPlant`` knows it.
        effectiveness: (ticks, 2), effectiveness of each actuator; default all ones. A zero is the
            thesis's fault: the channel's input is gone, the plant and the lag keep their state.
        noise: (ticks,), added to the controller's measurement; default none.
        bias: (ticks,), added before the noise; default none.
        arrives: (ticks, 2), whether the command of a tick reaches the actuator; default always.
        hold_ticks: ticks without a command during which an actuator holds the last command; then
            the actuator applies zero.
        limits: (2, 2), the actuators' own, a row a channel: largest magnitude of a command, largest
            change in a tick.
        faults: (ticks, 3, ``DISTORTION``), of channels and sensor; see ``hardware``. Default none.
        schedule: for a plant whose speed changes, from ``schedules.schedule``. Default none.
        speed: (ticks,), speed signal of the controller.
        resolution: of the sensor; 0: none.
        frames: (3, ``GRID``), frames of both commands and of the measurement; see ``hardware``.
        keeps_states: whether ``plant_states`` records the states of a ``SampledPlant``.
        at_rest: (1,), the controller's first state, also after a restart; None: at rest.
        hears: hears the further sensors. Default: the law hears none. ``HearsAll`` only with a
            ``SampledPlant``.
        restarts: in ascending order, the first tick without power, the tick at whose begin the
            controller starts again, and whether the state saved before survives.
    """

    def __init__(
        self,
        controller: Table | AnyController,
        plant: SampledPlant | AnyPlant,
        reference: FloatArray,
        *,
        tick_s: float | None = None,
        effectiveness: FloatArray | None = None,
        noise: FloatArray | None = None,
        bias: FloatArray | None = None,
        arrives: BoolArray | None = None,
        hold_ticks: int = 0,
        limits: FloatArray = hardware.NO_LIMITS,
        faults: FloatArray = hardware.NO_FAULTS,
        schedule: Constants | None = None,
        speed: FloatArray | None = None,
        resolution: float = 0.0,
        frames: FloatArray = hardware.EXACT_FRAMES,
        keeps_states: bool = False,
        at_rest: Records[State] | None = None,
        hears: Hears | HearsAll | None = None,
        restarts: Sequence[tuple[int, int, bool]] = (),
    ) -> None:
        self.ticks = ticks = len(reference)
        self.done = 0
        """Ticks that the controller has done; the plant is as far, unless it has failed."""
        self.inputs: Vectors = (
            np.asarray(reference, dtype=np.float64),
            np.zeros(ticks) if bias is None else bias,
            np.zeros(ticks) if noise is None else noise,
            np.ones((ticks, 2)) if effectiveness is None else effectiveness,
            np.ones((ticks, 2), dtype=np.bool_) if arrives is None else arrives,
        )
        self._plant = plant
        self._signals = np.full((ROWS, ticks), np.nan)
        self._states = np.zeros((3, ticks), dtype=np.int64)
        ours = isinstance(controller, np.generic)  # a record, which is a scalar of numpy
        self._other: AnyController | None = None if ours else cast("AnyController", controller)
        table = cast("Table", controller if ours else np.zeros((), table_type())[()])
        state = law.init(table) if at_rest is None else at_rest
        self._table, self._at_rest = table, state
        self._latency_ticks = int(
            table.estimator.latency_ticks if self._other is None else self._other.latency_ticks
        )
        self._hears_all = hears if isinstance(hears, HearsAll) else None
        self._hears = None if isinstance(hears, HearsAll) else hears
        self._restarts = tuple(restarts)
        fixed = cast("Records[Table]", np.asarray(table).reshape(1))
        own = state.view(np.uint8).copy().view(state.dtype)  # a copy field by field is slow
        self._loop = (
            fixed if schedule is None else copied(table),  # changed later
            cast("Records[State]", own),
            self.inputs,
            (float(resolution), frames),
            (np.zeros(2), np.zeros(2, dtype=np.int64), hold_ticks, np.zeros(3), limits, faults),
            *(self._signals, self._states),
        )
        changes = schedule is not None or self._other is not None
        self._speed = speed.tolist() if changes and speed is not None else None
        if schedule is not None:
            blending = zeroed(BlendState, precision_of(table))
            self._speeds = (copied(schedule), blending, *self._loop[:2])
        self._output = (0.0, 0.0)  # output of the plant at rest, and the sensor's reading
        self._memory: Any = ()
        self.plant_states = np.zeros((0, 0))
        """(ticks, n), at the beginning of each tick, where they are kept."""
        if isinstance(plant, SampledPlant):
            self._memory, tick_s = plant.memory, plant.tick_s
            self.plant_states = np.zeros((ticks if keeps_states else 0, len(plant.c)))
        assert tick_s is not None
        self.tick_s = tick_s

    def run(self, until: int | None = None) -> None:
        """Advance up to the tick ``until``; None: to the end. Errors of the plant pass through."""
        end = self.ticks if until is None else min(until, self.ticks)
        for off, on, survives in self._restarts:
            if survives and self.done <= off < end and self._other is None:
                self._run(off)
                self._saved = saved_in(self._loop[1][0])
            if self.done <= on < end:
                self._run(on)
                self._restart(survives)
        self._run(end)

    def _restart(self, survives: bool) -> None:
        """Put the controller at rest; a plant that changes its speed says so again."""
        if self._other is not None:
            self._other.restart()
            return
        if self._hears is not None:
            self._hears.restart()
        tables, states, *_ = self._loop
        states.view(np.uint8)[...] = self._at_rest.view(np.uint8)
        if survives:
            states[0].supervision.saved = self._saved
        if self._speed is not None:
            tables[0] = self._table
            self._speeds[1].view(np.uint8)[...] = 0

    def _run(self, end: int) -> None:
        if end <= self.done:
            return
        plant, output = self._plant, self._output
        ours = self._other is None and self._hears is None
        if isinstance(plant, SampledPlant) and self._hears_all is not None:
            of_plant = plant.constants, self._memory, plant.readings.constants
            samples = self._hears_all.samples_of(end - self.done)
            self._output = run_hearing(self._loop, self.done, end, *output, *of_plant, samples)
            self.done = end
        elif isinstance(plant, SampledPlant) and ours:
            of_plant = plant.constants, self._memory, self.plant_states
            self._output = run_ticks(self._loop, self.done, end, *output, *of_plant)
            self.done = end
        elif isinstance(plant, LoopPlant) and ours and self._speed is None:
            loop = partial(run_changing, self._loop)
            self._output = plant.run_loop(loop, self.done, end, output)
            self.done = end
        effectiveness, sensed = self.inputs[3], plant if isinstance(plant, SensedPlant) else None
        while self.done < end:
            k = self.done
            if sensed is not None:
                sensed.sense(self._told(k - 1))
            u1, u2 = self._tick(k)
            self.done += 1
            left = effectiveness[k].tolist()
            if isinstance(plant, SampledPlant):
                if len(self.plant_states):
                    self.plant_states[k] = self._memory[0]
                self._output = follow(plant.constants, self._memory, k, u1, u2, *left)
            else:
                self._output = plant.follow(u1, u2, *left)

    def _tick(self, k: int) -> tuple[float, float]:
        other = self._other
        if other is None:
            if self._speed is not None:
                change_first_speed(*self._speeds, self._speed[k])
            if self._hears is not None:
                for sample in self._hears.samples():
                    hear_first(*self._loop[:2], *sample)
            return tick(*self._loop, k, *self._output)
        _, _, inputs, grid, actuators, signals, states = self._loop
        measured = measure(inputs, grid, actuators, signals, k, *self._output)
        speed = math.nan if self._speed is None else self._speed[k]
        command_1, command_2, estimate, mode, fault_state, verdict = other.answer(
            inputs[0].item(k), measured, speed
        )
        signals[COMMAND_1, k], signals[COMMAND_2, k], signals[ESTIMATE, k] = (
            command_1, command_2, estimate,
        )  # fmt: skip
        states[:, k] = fault_state, mode, verdict
        return carry(other.latency_ticks, inputs, grid, actuators, signals, k)

    def _told(self, k: int) -> tuple[float, float]:
        sent = k - self._latency_ticks
        if sent < 0:
            return 0.0, 0.0
        return self._signals.item(ACTING_1, sent), self._signals.item(ACTING_1 + 1, sent)

    def go_on_from(self, other: Simulation) -> None:
        """Copy the position of ``other``: a loop of the same table, ``SampledPlant`` and length.

        The inputs of both loops must agree up to the position, and the law hears no sensor.
        """
        self._loop[1][0] = other._loop[1][0]
        for own, its in zip(self._changing, other._changing, strict=True):
            own[...] = its
        self.done, self._output = other.done, other._output

    def move_on(
        self, keep: int, inputs: Vectors, faults: FloatArray, speed: FloatArray | None
    ) -> None:
        """Drop all done ticks but the last ``keep``, which become the first ticks.

        Args:
            keep: at least the largest delay of a command or a reading, in ticks.
            inputs: ``self.inputs`` of the ticks from there on, as many as before.
            faults: likewise; see ``Simulation``.
            speed: likewise; None for a constant speed.
        """
        gone = self.done - keep
        self._restarts = tuple((off - gone, on - gone, its) for off, on, its in self._restarts)
        self.done = keep
        for own, its in zip(self.inputs, inputs, strict=True):
            own[...] = its
        _, _, _, _, (*_, own_faults), signals, states = self._loop
        own_faults[...] = faults
        for rows in (signals, states):
            rows[:, :keep] = rows[:, gone : gone + keep]
        signals[:, keep:] = np.nan
        if self._speed is not None and speed is not None:
            self._speed = speed.tolist()
        for ring in self._memory[2:]:  # indexed by the tick, modulo its length
            ring[...] = np.roll(ring, -gone, axis=0)

    @property
    def _changing(self) -> tuple[Any, ...]:
        """Every array that a tick changes, but for the controller."""
        _, _, _, _, (held, silent, _, reached, *_), signals, states = self._loop
        return held, silent, reached, signals, states, *self._memory, self.plant_states

    @property
    def trace(self) -> Trace:
        """What has been done; not a number from there on."""
        signals, states = self._signals, self._states
        return Trace(
            time_s=self.tick_s * np.arange(self.ticks, dtype=np.float64),
            reference=self.inputs[0],
            measurement=signals[OUTPUT],
            measured=signals[MEASURED],
            command_1=signals[COMMAND_1],
            command_2=signals[COMMAND_2],
            fault_estimate=signals[ESTIMATE],
            fault_state=states[0],
            mode=states[1],
            verdict=states[2],
            evidence=signals[EVIDENCE],
        )

    @property
    def reached(self) -> FloatArray:
        """(2, ticks), what reached the actuators, within their limits."""
        return self._signals[REACHED_1 : REACHED_1 + 2]


def simulate(
    controller: Table | AnyController,
    plant: SampledPlant | AnyPlant,
    reference: FloatArray,
    **inputs: Any,
) -> Trace:
    """Run the loop from rest to the end, a tick for each reference sample; see ``Simulation``."""
    simulation = Simulation(controller, plant, reference, **inputs)
    simulation.run()
    return simulation.trace
