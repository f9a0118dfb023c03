"""The simulated plant against an ODE solver, and its actuators against what the issue says."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.integrate import solve_ivp

from can_rig.plant.actuators import Actuator
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.loading import load

HEALTHY = ["fault.kind=none"]
commands = st.one_of(st.none(), st.floats(-1e3, 1e3))


def outputs(settings, sequence, name="thesis-step"):
    """D* before each of ``sequence``'s pairs of commands, and after the last."""
    plant = SimulatedPlant(load(name, settings))
    measured = [plant.measure()]
    for tick, pair in enumerate(sequence):
        plant.advance(tick, *pair)
        measured.append(plant.measure())
    return np.array(measured)


def random_commands(count, seed=1):
    generator = np.random.default_rng(seed)
    return [tuple(pair) for pair in generator.normal(0.0, [300.0, 900.0], (count, 2)).tolist()]


@given(st.integers(0, 6), st.lists(commands, max_size=40))
def test_an_actuator_holds_so_many_ticks_then_applies_zero(hold_ticks, heard):
    actuator = Actuator(hold_ticks)
    for tick, command in enumerate(heard):
        since = heard[max(0, tick - hold_ticks) : tick + 1]
        expected = next((c for c in reversed(since) if c is not None), 0.0)
        assert actuator.hear(command) == expected


@pytest.mark.parametrize(("name", "tick_s"), [("thesis-step", 0.01), ("chapter-2", 0.05)])
def test_between_ticks_it_is_the_continuous_plant_under_held_commands(name, tick_s):
    sequence = random_commands(12)
    settings = [*HEALTHY, f"tick_s={tick_s}"]
    plant = continuous_plant(load(name, settings).plant)
    state, expected = np.zeros(len(plant.a)), [0.0]
    for pair in sequence:
        solution = solve_ivp(
            lambda _, x, u: plant.a @ x + plant.b @ u,
            (0.0, tick_s), state, args=(np.array(pair),), rtol=1e-11, atol=1e-13, method="DOP853",
        )  # fmt: skip
        state = solution.y[:, -1]
        expected.append((plant.c @ state).item())
    measured = outputs(settings, sequence, name)
    assert np.abs(measured - expected).max() < 1e-8 * np.abs(expected).max()


@pytest.mark.parametrize("latency", [1, 3, 64])
def test_latency_delays_by_whole_ticks_and_changes_nothing_else(latency):
    sequence = random_commands(100)
    now = outputs(HEALTHY, sequence)
    late = outputs([*HEALTHY, f"latency_ticks={latency}"], sequence)
    assert not late[: latency + 1].any()
    assert (late[latency:] == now[: len(now) - latency]).all()


@pytest.mark.parametrize(("channel", "dead"), [("torque", 0), ("force-difference", 1)])
@pytest.mark.parametrize("latency", [0, 2])
def test_a_dead_actuator_is_a_command_of_zero_where_it_acts(channel, dead, latency):
    sequence = random_commands(60)
    settings = ["fault.kind=actuator-dead", f"fault.channel={channel}", "fault.at_s=0.02"]
    settings += ["fault.for_s=0.01", f"latency_ticks={latency}"]
    masked = [list(pair) for pair in sequence]
    for tick in range(20 - latency, 30 - latency):  # sent earlier, lost on arrival
        masked[tick][dead] = 0.0
    expected = outputs([*HEALTHY, f"latency_ticks={latency}"], masked)
    assert (outputs(settings, sequence) == expected).all()
    assert (outputs(settings, sequence) != outputs(HEALTHY, sequence)).any()


def test_channels_are_held_one_by_one():
    sequence = [(5.0, 7.0), (None, 8.0), (None, None), (6.0, None)]
    expected = [(5.0, 7.0), (5.0, 8.0), (0.0, 8.0), (6.0, 0.0)]
    measured = outputs([*HEALTHY, "actuator.hold_s=0.001"], sequence)
    assert (measured == outputs(HEALTHY, expected)).all()


def test_noise_is_on_the_sensor_alone_white_and_from_the_seed():
    sequence, rms, count = random_commands(4000), 0.02, 4001
    noisy = [*HEALTHY, f"plant.sensor.noise_mps2={rms}"]
    noise = outputs([*noisy, "seed=1"], sequence) - outputs(HEALTHY, sequence)
    assert abs(noise.mean()) < 4 * rms / np.sqrt(count)
    assert noise.std() == pytest.approx(rms, rel=4 / np.sqrt(2 * count))
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 4 / np.sqrt(count)
    again, other = outputs([*noisy, "seed=1"], sequence), outputs([*noisy, "seed=2"], sequence)
    assert (again - outputs(HEALTHY, sequence) == noise).all()
    assert (other != again).all()


@pytest.mark.parametrize("hold_ticks", [43, 44])
def test_the_hold_is_a_whole_number_of_ticks_though_its_quotient_is_not(hold_ticks):
    """0.043 / 0.001 is 42.99999999999999: a command is held for 43 ticks all the same."""
    settings = [*HEALTHY, f"actuator.hold_s={hold_ticks / 1000}"]
    command, nothing, zero = (300.0, 900.0), (None, None), (0.0, 0.0)
    held = outputs(settings, [command] + [nothing] * (hold_ticks + 5))
    explicit = outputs(settings, [command] * (1 + hold_ticks) + [zero] * 5)
    np.testing.assert_array_equal(held, explicit)


def test_the_sensor_is_biased_from_its_first_sample_on():
    bias = ["fault.kind=sensor-biased", "fault.bias_mps2=0.5", "fault.at_s=0", "fault.for_s=0.001"]
    assert outputs(bias, [(0.0, 0.0)] * 2).tolist() == [0.5, 0.0, 0.0]
    later = [*bias, "fault.at_s=0.002"]
    assert outputs(later, [(0.0, 0.0)] * 4).tolist() == [0.0, 0.0, 0.5, 0.0, 0.0]


def test_faults_that_change_are_those_of_the_next_measurement():
    healthy = load("thesis-step", HEALTHY)
    biased = load(
        "thesis-step", ["fault.kind=sensor-biased", "fault.bias_mps2=0.5", "fault.at_s=0"]
    )
    plant = SimulatedPlant(healthy, changing=True)
    assert plant.measure() == 0.0
    plant.advance(0, 0.0, 0.0)
    plant.change_faults(biased)
    assert plant.measure() == 0.5


@pytest.mark.parametrize("kind", ["actuator-late", "sensor-late", "sensor-stuck"])
@pytest.mark.parametrize("latency", [0, 2])
def test_what_looks_back_before_the_run_finds_nothing(kind, latency):
    """``test_faults`` has the same kinds later in a run."""
    settings = [f"latency_ticks={latency}", "fault.at_s=0", "fault.channel=force-difference"]
    sequence, healthy = random_commands(60), [*HEALTHY, f"latency_ticks={latency}"]
    found = outputs([*settings, f"fault.kind={kind}", "fault.late_ticks=3"], sequence)
    if kind == "actuator-late":
        forces = [0.0] * 3 + [force for _, force in sequence]
        delayed = [(torque, force) for (torque, _), force in zip(sequence, forces, strict=False)]
        expected = outputs(healthy, delayed)
    else:
        read = outputs(healthy, sequence)
        expected = np.concatenate([np.zeros(3), read[:-3]]) if kind == "sensor-late" else 0.0 * read
    np.testing.assert_array_equal(found, expected)
