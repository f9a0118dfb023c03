"""The effects of scheduled faults on the actuators and the sensors, for any part of a run.

Overlapping faults act in the scenario's order; a rate limit, and then a stuck last value, act after
all others. ``frame_faults`` has the faults of frames.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from can_rig.scenario.fault_settings import CHANNELS, MAX_LATE_TICKS, PLACES, SENSOR, FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.analysis import witnesses
from firmware_model.analysis.hardware import (
    ADDED,
    DISTORTION,
    GAIN,
    HEALTHY,
    HELD,
    LATE,
    NO_FAULTS,
    SLEW,
)
from firmware_model.law.structs import FloatArray

BLOCK_TICKS: Final = 1024
"""Block length for effects computed ahead in a tick-by-tick run."""

Added = Callable[[FaultSettings, FloatArray], FloatArray | float]
"""A fault's addition at times since its begin, in s."""


def _drift(fault: FaultSettings, since_s: FloatArray) -> FloatArray:
    return (fault.drift_per_s or 0.0) * since_s


def _oscillation(fault: FaultSettings, since_s: FloatArray) -> FloatArray:
    swing: FloatArray = np.sin(fault.frequency_rad_per_s * since_s)
    return (fault.amplitude or 0.0) * swing


ADDING: Final[dict[str, Added]] = {
    "actuator-offset": lambda fault, _: fault.offset or 0.0,
    "actuator-drift": _drift,
    "actuator-oscillating": _oscillation,
    "sensor-biased": lambda fault, _: fault.bias,
    "sensor-drift": _drift,
    "sensor-oscillating": _oscillation,
}
"""Kinds that add to the sensor's input, before noise and resolution."""

Distortion = Callable[[FaultSettings, FloatArray, float], None]
"""Changes the rows of ``hardware`` at a fault's ticks, in place; the last argument: the tick, s."""


def _scaled(rows: FloatArray, gain: float, added: FloatArray | float = 0.0) -> None:
    rows[:, GAIN] *= gain
    rows[:, ADDED] = gain * rows[:, ADDED] + added


def _stuck(fault: FaultSettings, rows: FloatArray, _: float) -> None:
    if fault.value is None:
        rows[:, HELD] = 1.0
    else:
        _scaled(rows, 0.0, fault.value)


def _rate_limited(fault: FaultSettings, rows: FloatArray, tick_s: float) -> None:
    rows[:, SLEW] = np.minimum(rows[:, SLEW], (fault.rate_per_s or 0.0) * tick_s)


def _late(fault: FaultSettings, rows: FloatArray, _: float) -> None:
    rows[:, LATE] += fault.late_ticks


def _marked(place: int) -> Distortion:
    """The effect that ``witnesses`` has at this place of a row."""

    def mark(_fault: FaultSettings, rows: FloatArray, _: float) -> None:
        rows[:, place] = 1.0

    return mark


DISTORTING: Final[dict[str, Distortion]] = {
    "actuator-stuck": _stuck,
    "actuator-rate-limited": _rate_limited,
    "actuator-late": _late,
    "sensor-dead": lambda fault, rows, _: _scaled(rows, fault.left),
    "sensor-stuck": _stuck,
    "sensor-rate-limited": _rate_limited,
    "sensor-late": _late,
    "sensor-scaled": lambda fault, rows, _: _scaled(rows, fault.gain or 0.0),
    "sensor-lying": _marked(witnesses.LIES),
    "sensor-invalid": _marked(witnesses.INVALID),
    "sensor-tick-stuck": _marked(witnesses.STANDING),
}
"""Other distorting kinds, apart from losses of an actuator and swapped sensors."""


class PlantFaults:
    """The faults in a scenario's actuators or sensors."""

    def __init__(self, scenario: Scenario) -> None:
        self._tick_ns, self._tick_s = scenario.tick_ns, scenario.tick_s
        self._sensors: list[str] = [each.measures for each in scenario.sensors]
        self._of_witnesses = [
            f for f in scenario.faults if f.place in self._sensors and not f.acts_on_frames
        ]
        self._dead = [f for f in scenario.faults if f.kind == "actuator-dead"]
        self._is_made = scenario.plant.sensor.is_made
        self._in_bias = [f for f in scenario.faults if f.kind in ADDING and f.place == SENSOR]
        self._in_rows = [
            f
            for f in scenario.faults
            if (f.kind in DISTORTING and f.place in PLACES)
            or (f.kind in ADDING and f.place in CHANNELS)
        ]

    @property
    def latest_ticks(self) -> int:
        """The longest delay of a command or a reading by these faults, in ticks."""
        return sum(
            fault.late_ticks
            for fault in (*self._in_rows, *self._of_witnesses)
            if fault.kind.endswith("-late")
        )

    def left(self, ticks: range) -> FloatArray:
        """(ticks, 2), the remaining share of each actuator: 1 healthy, ``fault.left`` dead."""
        left = np.ones((len(ticks), 2))
        for fault in self._dead:
            left[self._at(fault, ticks), CHANNELS.index(fault.place)] *= fault.left
        return left

    def bias(self, ticks: range) -> FloatArray:
        """(ticks,), the addition to D*, m/s²; nan in a car without a sensor of D*."""
        bias = np.full(len(ticks), math.nan if self._is_made else 0.0)
        for fault in self._in_bias:
            bias[self._at(fault, ticks)] += ADDING[fault.kind](fault, self._since_s(fault, ticks))
        return bias

    def rows(self, ticks: range) -> FloatArray:
        """(ticks, 3, ``DISTORTION``), the other distortions; (0, ...) in a run without any."""
        if not self._in_rows:
            return NO_FAULTS
        rows: FloatArray = np.tile(HEALTHY, (len(ticks), len(PLACES), 1))
        assert rows.shape[2] == DISTORTION
        for fault in self._in_rows:
            its = rows[self._at(fault, ticks), PLACES.index(fault.place)]
            if fault.kind in ADDING:
                _scaled(its, 1.0, ADDING[fault.kind](fault, self._since_s(fault, ticks)))
            else:
                DISTORTING[fault.kind](fault, its, self._tick_s)
        return rows

    def of_witnesses(self, ticks: range) -> tuple[FloatArray, FloatArray]:
        """What faults of further sensors do: an addition, and rows of ``witnesses``.

        Returns:
            (ticks, sensors), and (ticks, sensors, ``DISTORTION``), or (1, ...) without faults.
        """
        r = len(self._sensors)
        bias = np.zeros((len(ticks), r))
        rows = np.tile(witnesses.HEALTHY, (len(ticks) if self._of_witnesses else 1, r, 1))
        for fault in self._of_witnesses:
            at, sensor = self._at(fault, ticks), self._sensors.index(fault.place)
            if fault.other is not None:
                other = self._sensors.index(fault.other)
                rows[at, sensor, witnesses.SWAPPED], rows[at, other, witnesses.SWAPPED] = (
                    other, sensor,
                )  # fmt: skip
            elif fault.kind in ADDING:
                bias[at, sensor] += ADDING[fault.kind](fault, self._since_s(fault, ticks))
            else:
                DISTORTING[fault.kind](fault, rows[at, sensor], self._tick_s)
        return bias, rows

    def _at(self, fault: FaultSettings, ticks: range) -> slice:
        """The slice of ``ticks`` during which ``fault`` acts."""
        its = fault.ticks(self._tick_ns, ticks)
        if not its:
            return slice(0)
        return slice(its.start - ticks.start, its.stop - ticks.start, its.step)

    def _since_s(self, fault: FaultSettings, ticks: range) -> FloatArray:
        its = fault.ticks(self._tick_ns, ticks)
        since_ns = np.array(its, dtype=np.int64) * self._tick_ns - fault.span_ns[0]
        return np.multiply(since_ns, 1e-9, dtype=np.float64)


class Now(NamedTuple):
    """The effects of all faults in one tick; see ``PlantFaults``."""

    left: tuple[float, float]
    bias: float
    rows: FloatArray | None
    """None in a run without distortions."""
    bias_of_witnesses: FloatArray
    rows_of_witnesses: FloatArray


class FaultsByTick:
    """``PlantFaults`` tick by tick, computed for many ticks at once.

    Args:
        scenario: the scenario with the faults.
        changing: whether the faults may change during the run.
    """

    def __init__(self, scenario: Scenario, changing: bool = False) -> None:
        self._faults = PlantFaults(scenario)
        self._changing = changing
        self._block: list[Now] = []
        self._first = 0
        self.latest_ticks: Final = MAX_LATE_TICKS if changing else self._faults.latest_ticks
        """See ``PlantFaults``."""

    def change(self, scenario: Scenario) -> None:
        """Take the faults of ``scenario`` from the next requested tick on."""
        self._faults = PlantFaults(scenario)
        self._block = []

    def at(self, tick: int) -> Now:
        """The effects at ``tick``."""
        place = tick - self._first
        if not 0 <= place < len(self._block):
            self._first, place = tick, 0
            ticks = range(tick, tick + BLOCK_TICKS)
            rows = self._faults.rows(ticks)
            # a later delay fault needs the values before its begin
            if self._changing and not len(rows):
                rows = np.tile(HEALTHY, (len(ticks), len(PLACES), 1))
            bias_of_witnesses, rows_of_witnesses = self._faults.of_witnesses(ticks)
            self._block = [
                Now(*each)
                for each in zip(
                    map(tuple, self._faults.left(ticks).tolist()),
                    self._faults.bias(ticks).tolist(),
                    rows if len(rows) else [None] * len(ticks),
                    bias_of_witnesses,
                    list(rows_of_witnesses) * (len(ticks) // len(rows_of_witnesses)),
                    strict=True,
                )
            ]
        return self._block[place]
