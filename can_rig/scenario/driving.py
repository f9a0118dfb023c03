"""The inputs of a drive: the speed over time, and the designs at the speeds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from can_rig import paged
from can_rig.errors import ScenarioError
from can_rig.frames.network import Network
from can_rig.scenario.build import (
    continuous_design,
    controller_table,
    mismatch,
    other_plants,
    sources_of_table,
    target,
)
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.reference import over_time
from can_rig.scenario.remembered import remembered
from can_rig.scenario.settings import FASTEST_MPS, SLOWEST_MPS, DriveSettings, Scenario
from firmware_model.design.mismatch import Mismatch
from firmware_model.discretisation.schedules import AtSpeed, Scheduled, schedule
from firmware_model.errors import DesignError
from firmware_model.law.schedule import MAX_SPEEDS
from firmware_model.law.structs import FloatArray

ROUNDING = 1e-9  # relative, against refusing the fastest allowed rate


@dataclass(frozen=True)
class SpeedProfile:
    """Straight lines between (``time_s``, ``speed_mps``), shape (n,) each; end values hold."""

    time_s: FloatArray
    speed_mps: FloatArray

    def __call__(self, time_s: FloatArray) -> FloatArray:
        """The speed at ``time_s``, of any shape, m/s."""
        return np.interp(time_s, self.time_s, self.speed_mps)

    @property
    def range_mps(self) -> tuple[float, float]:
        """The lowest and the highest speed."""
        return float(self.speed_mps.min()), float(self.speed_mps.max())

    @property
    def fastest_change_mps2(self) -> float:
        """The largest rate of the speed, up or down."""
        rates = np.diff(self.speed_mps) / np.diff(self.time_s)
        return float(np.abs(rates).max(initial=0.0))


def speed_profile(scenario: Scenario) -> SpeedProfile:
    """The car's speed in a scenario with a drive.

    Raises:
        ScenarioError: an unreadable CSV, a speed out of bounds, or a speed that changes too fast.
    """
    drive = scenario.drive
    where = f"scenario {scenario.name}: drive"
    if drive.speed_mps is not None:
        return SpeedProfile(np.zeros(1), np.array([drive.speed_mps]))
    if drive.ramps:
        profile = SpeedProfile(*np.array(drive.ramps, dtype=np.float64).T)
    else:
        where += f".file = {drive.file!r}"
        profile = SpeedProfile(*over_time(drive.file, where, "speed_mps", scenario.duration_s))
        for speed in profile.range_mps:
            if not SLOWEST_MPS <= speed <= FASTEST_MPS:
                raise ScenarioError(
                    f"{where}: speed_mps = {speed:g}: must be {SLOWEST_MPS:g} to {FASTEST_MPS:g}"
                )
    fastest, most = profile.fastest_change_mps2, drive.speed_rate_max_mps2
    if fastest > most * (1.0 + ROUNDING):
        raise ScenarioError(
            f"{where}: the speed changes by {fastest:.4g} m/s²: must be at most "
            f"drive.speed_rate_max_mps2 = {most:g}"
        )
    return profile


def speeds_at_ticks(scenario: Scenario) -> FloatArray:
    """The speed at the start of every tick, shape (ticks,), m/s.

    Raises:
        ScenarioError: as ``speed_profile``.
    """
    profile, tick_s = speed_profile(scenario), scenario.tick_ns * 1e-9
    return paged.column(
        scenario.ticks, lambda rows: profile(np.arange(rows.start, rows.stop) * tick_s)
    )


RATIO = 1.12  # of neighbouring speeds: a blend is far closer to the right design than another car


def controls(scenario: Scenario, network: Network | None) -> Scheduled:
    """The controller of ``scenario`` on ``network`` (None: without frames).

    Raises:
        ScenarioError: a failing design or discretisation, an invalid drive.
    """
    if not scenario.drive.is_given:
        return Scheduled(None, controller_table(scenario, network))
    speeds = design_speeds(scenario)
    if len(speeds) == 1:
        return Scheduled(None, controller_table(frozen(scenario, speeds[0]), network))
    several = replace(scenario, design=replace(scenario.design, speeds_mps=speeds))
    return _scheduled(several, network)


def design_speeds(scenario: Scenario) -> tuple[float, ...]:
    """The design speeds of the controller, ascending.

    Raises:
        ScenarioError: see ``speed_profile``.
    """
    if scenario.design.speeds_mps:
        return scenario.design.speeds_mps
    slowest, fastest = speed_profile(scenario).range_mps
    steps = min(math.ceil(math.log(fastest / slowest) / math.log(RATIO) - 1e-9), MAX_SPEEDS - 1)
    return tuple(np.geomspace(slowest, fastest, steps + 1).tolist())


def frozen(scenario: Scenario, speed_mps: float) -> Scenario:
    """The scenario with car and design at one constant speed."""
    return replace(
        scenario,
        drive=DriveSettings(),
        plant=replace(scenario.plant, speed_mps=speed_mps),
        model=replace(scenario.model, speed_mps=speed_mps),
        design=replace(scenario.design, speeds_mps=None),
    )


def at_speed_of(scenario: Scenario, fault: FaultSettings) -> Scenario:
    """The scenario with the car's speed at the begin of ``fault``, for figures of a single speed.

    Raises:
        ScenarioError: see ``speed_profile``.
    """
    if not scenario.drive.is_given:
        return scenario
    speed = speed_profile(scenario)(np.array([fault.at_s]))
    return frozen(scenario, float(speed[0]))


@remembered(4, by=sources_of_table)
def _scheduled(scenario: Scenario, network: Network | None) -> Scheduled:
    speeds = scenario.design.speeds_mps or ()
    middle = mismatch(frozen(scenario, speeds[len(speeds) // 2]))
    try:
        return schedule([_at(frozen(scenario, speed), network, middle) for speed in speeds])
    except DesignError as error:
        raise ScenarioError(f"scenario {scenario.name}: design.speeds_mps: {error}") from None


def _at(scenario: Scenario, network: Network | None, middle: Mismatch) -> AtSpeed:
    """The design for one speed; the directions of other cars are common to all speeds."""
    others = tuple(other_plants(scenario)(place) for place in middle.places)
    cars = Mismatch(tuple((plant.g1, plant.g2) for plant in others))
    return AtSpeed(
        speed_mps=scenario.model.speed_mps,
        design=continuous_design(scenario),
        target=replace(target(scenario, network), mismatch=cars),
        others=others,
    )
