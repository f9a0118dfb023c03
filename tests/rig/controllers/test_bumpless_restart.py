"""What a car does by itself, found from what was heard; and what r' promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from can_rig.assessment.resolve import load
from can_rig.controllers.bumpless_restart import RETURN_S, BumplessRestart, FreeMotion
from can_rig.controllers.protocol import LISTEN_S, Inputs
from can_rig.scenario.build import continuous_plant, controller_table, network_of
from firmware_model.analysis.sampled_plant import sample
from firmware_model.design.vehicle import VehicleParameters, vehicle_state_space
from firmware_model.firmware import Firmware

LSB = 1e-8
A, B, C = vehicle_state_space(VehicleParameters())
STATES = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4)


def free_dstar(x0, ticks, tick_s=0.001):
    """D* of the car of Table 3.2 from the state ``x0`` on, by scipy's matrix exponential."""
    phi, x, out = expm(A * tick_s), np.array(x0), []
    for _ in range(ticks):
        out.append((C @ x).item())
        x = phi @ x
    return np.array(out)


def scaled_to_one(x0):
    """The same motion, with a largest D* of 1 m/s²: what a car may still do after an outage."""
    largest = np.abs(free_dstar(x0, 500)).max()
    return np.array(x0) / largest if largest > 0.0 else np.array(x0)


def heard(measurement):
    return Inputs(np.nan, measurement)


def table_of(scenario):
    return controller_table(scenario, network_of(scenario))


@settings(max_examples=25)
@given(STATES)
def test_what_follows_is_predicted_from_fifty_milliseconds(x0):
    """From D* on the grid of its frame; the threshold of the default decision is 1e-5."""
    dstar = free_dstar(scaled_to_one(x0), 550)
    motion = FreeMotion(table_of(load("ideal")), 400)
    motion.fit(np.rint(dstar[:50] / LSB) * LSB, LSB**2 / 12)
    predicted = np.array([motion.advance() for _ in range(500)])
    assert np.abs(predicted - dstar[50:]).max() < 5e-6


def test_ticks_that_were_not_heard_are_left_out():
    dstar = free_dstar(scaled_to_one([1.0, -0.5, 0.2, 0.1]), 150)
    heard = dstar[:50].copy()
    heard[10:20] = heard[45:] = np.nan
    motion = FreeMotion(table_of(load("ideal")), 400)
    motion.fit(heard, LSB**2 / 12)
    assert [motion.advance() for _ in range(100)] == pytest.approx(dstar[50:], abs=5e-6)


@pytest.mark.parametrize("heard", [[], [np.nan] * 20, [0.0] * 20], ids=["none", "nan", "rest"])
def test_of_nothing_heard_comes_a_car_at_rest(heard):
    motion = FreeMotion(table_of(load("ideal")), 400)
    motion.fit(np.array(heard), LSB**2 / 12)
    assert not motion.sections.any()
    assert motion.advance() == 0.0


def test_noise_alone_is_not_taken_for_a_motion():
    """What is made of white noise around rest stays below three times the noise."""
    rms, motion = 0.005, FreeMotion(table_of(load("noisy")), 400)
    for seed in range(20):
        noise = rms * np.random.default_rng(seed).standard_normal(40)
        motion.fit(noise, rms**2)
        assert max(abs(motion.advance()) for _ in range(500)) < 3 * rms


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("since", [10, 100])
def test_how_far_off_the_motion_may_be_is_what_noise_makes_of_it(channel, since):
    """Of a bend of 1 m/s² that nothing holds since some ticks, over 200 runs of the noise."""
    rms, steady = 0.005, np.linalg.solve(A, -B[:, channel])
    dstar = free_dstar(steady / (C @ steady).item(), since + 440)[since:]
    draw, off = np.random.default_rng(0), []
    motion = FreeMotion(table_of(load("noisy")), 400)
    for _ in range(200):
        doubt = motion.fit(dstar[:40] + rms * draw.standard_normal(40), rms**2)
        off.append([motion.advance() for _ in range(400)] - dstar[40:])
    worst = np.sqrt(np.mean(np.square(off), axis=0)).max()
    assert 0.5 < worst / np.sqrt(doubt) < 2.0


@settings(max_examples=10)
@given(STATES)
def test_the_estimate_starts_at_zero_on_a_car_that_moves(x0):
    """F1 with no command of its own predicts the car: d̂ stays below the default threshold."""
    scenario = load("ideal")
    table = table_of(scenario)
    firmware = Firmware(table)
    restart = BumplessRestart(firmware, scenario, table, LSB)
    dstar = np.rint(free_dstar(scaled_to_one(x0), 60) / LSB) * LSB
    tick = 0
    while restart.listens:
        restart.hear(heard(dstar[tick]))
        tick += 1
    restart.start()
    # The first r' is the car's own motion, so C asks for next to nothing.
    answer = firmware.step(restart.reference(1.0), dstar[tick])
    assert abs(answer.fault_estimate) < 1e-6
    assert abs(answer.command_1) < 0.1
    assert abs(answer.command_2) < 1.0


@pytest.mark.parametrize("tick_s", [0.0005, 0.001, 0.005])
def test_listening_and_returning_take_the_time_that_they_say(tick_s):
    scenario = load("ideal", [f"tick_s={tick_s}"])
    table = table_of(scenario)
    restart = BumplessRestart(Firmware(table), scenario, table, LSB)
    ticks = 0
    while restart.listens:
        restart.hear(heard(0.0))
        ticks += 1
    assert ticks * tick_s == pytest.approx(LISTEN_S)
    restart.start()
    path = []
    while not restart.done:
        path.append(restart.reference(1.0))
    assert len(path) * tick_s == pytest.approx(RETURN_S, abs=1.1 * tick_s)
    assert path[0] == 0.0
    assert path[-1] == 1.0
    assert (np.diff(path) >= 0.0).all()
    slope = np.gradient(path, tick_s)
    assert slope.max() == pytest.approx(1.875 / RETURN_S, rel=0.01)  # of least jerk, at half time
    assert abs(slope[0]) < 0.02 * slope.max() * (tick_s / 0.0005) ** 2


def test_a_pendulum_that_falls_while_the_controller_listens_is_caught():
    scenario = load("pendulum", ["plant.sensor.noise_mps2=0"])
    table, plant = table_of(scenario), sample(continuous_plant(scenario.plant), scenario.tick_s)
    firmware = Firmware(table)
    restart = BumplessRestart(firmware, scenario, table, LSB)
    x, commands, angles = np.zeros(len(plant.c)), (0.0, 0.0), []
    x[0] = 0.01
    acting = commands
    for _ in range(3000):
        angles.append(float(plant.c @ x))
        if restart.listens:
            restart.hear(heard(angles[-1]))
            if not restart.listens:
                restart.start()
        else:
            r = 0.0 if restart.done else restart.reference(0.0)
            answer = firmware.step(r, angles[-1])
            commands = (answer.command_1, answer.command_2)
        x = plant.phi @ x + plant.gamma @ acting
        acting = commands
    assert np.abs(angles).max() < 0.05
    assert np.abs(angles[-100:]).max() < 1e-3
