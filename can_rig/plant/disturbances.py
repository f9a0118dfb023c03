"""The world of a run, tick by tick: wind, banked roads, slippery patches, kicks on the column.

All inputs are straight lines between two ticks, by definition, and a run begins in a calm world.
Any window of a run has the values that the whole run has, so a long run is computed in pages.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from can_rig.plant.sensor import coloured
from can_rig.scenario.disturbance_settings import PUSH, DisturbanceSettings
from can_rig.scenario.driving import WORLD_COLUMNS, SpeedProfile, speed_profile
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.changing_plant import FRONT_FRICTION, REAR_FRICTION, WORLD_ROW
from firmware_model.law.structs import FloatArray

FORCE, MOMENT, BANK, KICK = range(4)
"""The places of ``vehicle.WORLD`` in a row."""

BLOCK: Final = 4096
"""Ticks of a page, and of turbulence with a random generator of its own."""

AT: Final = {**{name: at for at, name in enumerate(WORLD_COLUMNS)}, PUSH: FORCE}
"""The place of each input in a row of the world."""

CALM: Final[FloatArray] = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0])


def inputs_of(settings: PlantSettings) -> list[str]:
    """The inputs of an FMU by which the world pushes, of those in ``AT``."""
    return [each for each in AT if each in settings.variables]


class Disturbances:
    """The disturbances of a scenario, and those that a recorded drive brings.

    Raises:
        ScenarioError: an invalid drive; turbulence needs the speed.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._tick_ns = scenario.tick_ns
        self._is_car = scenario.plant.is_car
        self._parts = [
            (each, Turbulence(scenario, number) if each.kind == "turbulence" else None)
            for number, each in enumerate(scenario.disturbance)
            if each.kind != "none"
        ]
        self._drive = speed_profile(scenario) if scenario.drive.is_given else None
        brought = self._drive.world if self._drive else {}
        self.is_calm = not (self._parts or brought)
        """Whether nothing ever pushes, on a dry road."""
        self._page_at, self._page = -1, np.zeros((0, WORLD_ROW))

    def during(self, tick: int) -> FloatArray:
        """(2, ``WORLD_ROW``), the world at ``tick`` and at the next, for ticks in any order."""
        first = tick - tick % BLOCK
        if first != self._page_at:
            self._page_at, self._page = first, self.at(range(first, first + BLOCK + 1))
        return self._page[tick - first : tick - first + 2]

    def report(self, tick: int) -> dict[str, float]:
        """The world at ``tick``, by column."""
        now = self.during(tick)[0].tolist()
        return dict(zip(WORLD_COLUMNS, now, strict=True)) if self._is_car else {PUSH: now[AT[PUSH]]}

    def at(self, ticks: range) -> FloatArray:
        """(len(ticks), ``WORLD_ROW``), the world at consecutive ``ticks`` from 0 on.

        A row has the values of ``WORLD_COLUMNS``; ``PUSH`` is in the place of the side force.
        """
        rows = np.tile(CALM, (len(ticks), 1))
        for each, turbulence in self._parts:
            share = level(each, ticks, self._tick_ns)
            if each.kind in {"gust", "turbulence"}:
                force = (each.force_n or 0.0) * share
                if turbulence is not None:
                    force = (each.intensity_n or 0.0) * share * turbulence.at(ticks)
                rows[:, FORCE] += force
                rows[:, MOMENT] += (each.arm_m or 0.0) * force
            elif each.kind == PUSH:
                rows[:, AT[PUSH]] += (each.size or 0.0) * share
            elif each.kind == "bank":
                rows[:, BANK] += math.atan((each.bank_percent or 0.0) / 100.0) * share
            elif each.kind == "steering-kick":
                rows[:, KICK] += (each.torque_nm or 0.0) * share
            else:
                for place, factor in ((FRONT_FRICTION, each.front), (REAR_FRICTION, each.rear)):
                    if factor is not None:
                        rows[:, place] *= 1.0 + (factor - 1.0) * share
        if self._drive is not None:
            now = np.arange(ticks.start, ticks.stop, dtype=np.float64)
            _bring(self._drive, now * (self._tick_ns * 1e-9), rows)
        if ticks.start == 0:
            rows[:1] = CALM
        return rows


def _bring(drive: SpeedProfile, time_s: FloatArray, rows: FloatArray) -> None:
    """Add the world of a recorded drive at ``time_s`` to ``rows``."""
    for name in drive.world:
        place, values = AT[name], drive.world_at(name, time_s)
        if place in (FRONT_FRICTION, REAR_FRICTION):
            rows[:, place] *= values
        else:
            rows[:, place] += values


def level(disturbance: DisturbanceSettings, ticks: range, tick_ns: int) -> FloatArray:
    """(len(ticks),), 0..1: how far the disturbance has risen, or not yet fallen.

    A disturbance without a ramp acts at the ticks from its begin to before its end, as faults do.
    """
    begin_ns, end_ns = disturbance.span_ns
    now_ns = np.arange(ticks.start, ticks.stop, dtype=np.int64) * tick_ns
    if disturbance.ramp == 0.0:
        return ((now_ns >= begin_ns) & (now_ns < end_ns)).astype(np.float64)
    ramp_ns = disturbance.ramp * 1e9
    rising = np.minimum(now_ns - begin_ns, end_ns - now_ns) / ramp_ns
    risen = np.clip(rising, 0.0, 1.0)
    if disturbance.shape == "ramp":
        return risen
    return 0.5 - 0.5 * np.cos(np.pi * risen)


class Turbulence:
    """Wind of rms 1 through which the car drives, as noise of first order.

        n(k) = p n(k-1) + √(1 - p²) w(k),   p = e^(-V T/L),   w white with rms 1

    at the speed V, for the wind's length L: exact at the ticks, and of rms 1 at every speed. In a
    standing car the wind stays.

    Args:
        scenario: the run.
        number: of the disturbance; each number has a wind of its own.
    """

    def __init__(self, scenario: Scenario, number: int) -> None:
        self._seed, self._number = scenario.seed, number
        self._profile = speed_profile(scenario) if scenario.drive.is_given else None
        self._speed_mps, self._tick_s = scenario.plant.speed_mps, scenario.tick_ns * 1e-9
        self._length_m = scenario.disturbance[number].length_m or 1.0
        self._last: list[float] = []  # of each block that was computed
        self._held, self._values = -1, np.zeros(0)

    def at(self, ticks: range) -> FloatArray:
        """(len(ticks),), at consecutive ``ticks`` from 0 on."""
        found = np.zeros(len(ticks))
        at = ticks.start
        while at < ticks.stop:
            block = at // BLOCK
            end = min(ticks.stop, (block + 1) * BLOCK)
            values = self._block(block)
            found[at - ticks.start : end - ticks.start] = values[
                at - block * BLOCK : end - block * BLOCK
            ]
            at = end
        return found

    def _block(self, block: int) -> FloatArray:
        while len(self._last) < block:
            self._compute(len(self._last))
        if self._held != block:
            self._compute(block)
        return self._values

    def _compute(self, block: int) -> None:
        source = np.random.SeedSequence(self._seed, spawn_key=(self._number, block))
        drawn = np.random.Generator(np.random.PCG64(source)).standard_normal(BLOCK)
        if self._profile is None:
            memory = np.full(BLOCK, math.exp(-self._speed_mps * self._tick_s / self._length_m))
        else:
            ticks = np.arange(block * BLOCK, (block + 1) * BLOCK, dtype=np.float64)
            speeds = self._profile(ticks * self._tick_s)
            memory = np.exp(-speeds * self._tick_s / self._length_m)
        if block == 0:
            memory[0] = 0.0  # a stationary start
        last = coloured(drawn, memory, self._last[block - 1] if block else 0.0)
        self._held, self._values = block, drawn
        if block == len(self._last):
            self._last.append(last)
