"""The shipped scenarios, driven: every loss is found, and no working channel is lost."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from can_rig.plant.frameless import frameless
from can_rig.scenario import shipped
from can_rig.scenario.box import CAR as UNCERTAIN, in_box
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import FaultState, Mode, Verdict

LATEST_S = 0.15  # of a confirmation: a third of what a driver takes to react
LATEST_OF_S = {"satellite": 0.6}  # it takes 0.25 s to move by what noise lets anybody see
L9 = ("0000", "0112", "0221", "1011", "1120", "1202", "2022", "2101", "2210")
"""Taguchi's orthogonal array: each pair of levels of any two of four factors, once."""


def alarms(scenario: Scenario) -> int:
    state = frameless(scenario.healthy).fault_state
    return int((state == FaultState.CONFIRMED).sum())


def confirmed_after_s(scenario: Scenario) -> float:
    trace = frameless(scenario)
    state = trace.fault_state
    at = round(scenario.loss.at_s / scenario.tick_s)
    assert not (state[:at] == FaultState.CONFIRMED).any()
    assert not (trace.verdict > Verdict.CANNOT_BE_TOLD).any()  # the monitor stops no drive
    return float(np.flatnonzero(state[at:] == FaultState.CONFIRMED)[0]) * scenario.tick_s


def stays_lost(states: NDArray[np.int64]) -> bool:
    """Whether what has once been confirmed stays so."""
    first = int(np.flatnonzero(states == FaultState.CONFIRMED)[0])
    return bool((states[first:] == FaultState.CONFIRMED).all())


@pytest.mark.parametrize("name", shipped())
def test_its_loss_is_found_and_its_healthy_drive_raises_no_alarm(name):
    scenario = load(name)
    assert alarms(scenario) == 0
    assert confirmed_after_s(scenario) <= LATEST_OF_S.get(name, LATEST_S)


def test_the_array_is_orthogonal():
    for i in range(4):
        for j in range(i):
            assert len({(row[i], row[j]) for row in L9}) == 9


@pytest.mark.parametrize("levels", L9)
@pytest.mark.parametrize("name", ["default", "noisy", "lane-change"])
def test_cars_that_are_20_percent_off_raise_no_alarm(name, levels):
    """All 81 of them: ``can-rig campaign cars``."""
    scenario = load(name, [] if name == "lane-change" else ["duration_s=11"])
    shares = {key: 0.2 * (int(level) - 1) for key, level in zip(UNCERTAIN, levels, strict=True)}
    car = replace(scenario, plant=in_box(scenario.plant, shares))
    assert car.model == scenario.model
    assert alarms(car) == 0
    assert confirmed_after_s(car) <= LATEST_S


@pytest.mark.parametrize("name", ["default", "chassis-can"])
def test_what_is_lost_stays_lost_whatever_the_noise(name):
    """And is made up for: without compensation D* would be 1 m/s² off."""
    scenario = load(name)
    at = round(scenario.loss.at_s / scenario.tick_s)
    for seed in range(15):
        trace = frameless(replace(scenario, seed=seed))
        after = trace.fault_state[at:]
        assert stays_lost(after), f"seed {seed}"
        assert np.abs(trace.error[-len(after) // 2 :]).max() < 0.1, f"seed {seed}"


@pytest.mark.parametrize("rear", [-0.2, 0.0, 0.2])
def test_half_of_the_torque_stays_lost_in_a_slow_car_with_soft_front_tires(rear):
    """Whose first ticks after the loss are clear, and show another share than the later ones."""
    scenario = load("partial-loss", ["duration_s=12"])
    shares = dict(zip(UNCERTAIN, (0.0, -0.2, rear, -0.2), strict=True))
    car = replace(scenario, plant=in_box(scenario.plant, shares))
    state = frameless(car).fault_state
    assert stays_lost(state[round(scenario.loss.at_s / scenario.tick_s) :])


def test_the_wltc_has_every_mode_and_a_loss_stays_known_through_its_stops():
    beside = ["fault.1.kind=frames-missing", "fault.1.channel=sensor", "fault.1.for_s=2"]
    scenario = load("wltc", ["fault.0.at_s=885", *beside, "fault.1.at_s=1100"])
    trace = frameless(scenario)
    mode, speed = trace.mode, speeds_at_ticks(scenario)
    assert (mode[speed < 1.89] == Mode.STANDBY).all()
    assert (mode[speed > 2.01] != Mode.STANDBY).all()
    missing = slice(110_000, 110_200)
    assert set(mode[missing].tolist()) == {Mode.BLIND, Mode.SAFE_STOP}
    assert np.isin(np.delete(mode, missing), (Mode.RUN, Mode.STANDBY)).all()
    assert not np.hypot(trace.command_1, trace.command_2)[speed == 0.0][-100:].any()
    assert stays_lost(trace.fault_state)
    starts = np.flatnonzero((mode[1:] == Mode.RUN) & (mode[:-1] == Mode.STANDBY)) + 1
    assert len(starts) == 8
    assert np.abs(np.diff(trace.command_1)[starts - 1]).max() < 1.0
