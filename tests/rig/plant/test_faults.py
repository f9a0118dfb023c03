"""Faults of actuators and sensor: the right place, the right ticks, and what each kind does."""

import math

import hypothesis
import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.errors import RigError
from can_rig.frames.operator_frames import Command
from can_rig.plant.faults.injection import injected, require_possible
from can_rig.plant.faults.plant_faults import FaultsByTick, PlantFaults
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.fault_settings import MAX_LATE_TICKS
from can_rig.scenario.loading import load
from can_rig.thesis.continuous import solve
from firmware_model.analysis.hardware import HEALTHY

CHANNELS = ["torque", "force-difference"]
SHORT = ["duration_s=1", "fault.at_s=0.005", "fault.for_s=0.003"]  # ticks 5, 6, 7
WINDOW = range(5, 8)
TICKS = range(12)
TIMING = ["tick_s=0.001", "duration_s=0.02", "fault.at_s=0.005", "fault.for_s=0.01"]


@pytest.mark.parametrize(
    "kind", ["actuator-dead", "sensor-biased", "sensor-drift", "actuator-stuck"]
)
@given(
    at=st.floats(0.0, 0.06),
    lasts=st.none() | st.floats(1e-4, 0.05),
    every=st.integers(1, 4),
    tick_s=st.sampled_from([0.001, 0.0004, 0.0033]),
    first=st.integers(0, 30),
)
@hypothesis.settings(max_examples=25)
def test_part_of_a_run_is_what_the_whole_has_there(kind, at, lasts, every, tick_s, first):
    settings = [f"fault.at_s={at!r}", f"fault.every={every}", "fault.drift_per_s=0.5"]
    settings += [] if lasts is None else [f"fault.for_s={lasts!r}"]
    settings += [f"tick_s={tick_s}", "duration_s=0.05", f"fault.kind={kind}"]
    scenario = load("thesis-step", settings)
    faults, whole, part = PlantFaults(scenario), range(60), range(first, 60)
    for of in (faults.left, faults.bias, faults.rows):
        np.testing.assert_array_equal(of(part), of(whole)[first:])
    now = FaultsByTick(scenario).at(first)
    assert now.left == tuple(faults.left(whole)[first])
    assert now.bias == faults.bias(whole)[first]


@pytest.mark.parametrize("channel", CHANNELS)
@given(left=st.floats(0, 1, exclude_max=True))
@hypothesis.example(left=0.0)
def test_a_loss_leaves_its_share_in_its_window(channel, left):
    settings = [*SHORT, "fault.kind=actuator-dead", f"fault.channel={channel}"]
    faults = PlantFaults(load("thesis-step", [*settings, f"fault.left={left!r}"]))
    lost = [left, 1.0] if channel == "torque" else [1.0, left]
    assert faults.left(TICKS).tolist() == [lost if t in WINDOW else [1.0, 1.0] for t in TICKS]


@pytest.mark.parametrize("channel", CHANNELS)
def test_the_continuous_loop_knows_a_partial_loss_too(channel):
    """By the plant's own equations: what is left of the commands is all that moves the car."""
    settings = ["fault.kind=actuator-dead", f"fault.channel={channel}", "fault.left=0.25"]
    scenario = load("thesis-step", [*settings, "fault.at_s=0", "duration_s=2"])
    run, car = solve(scenario), continuous_plant(scenario.plant)
    left = [0.25, 1.0] if channel == "torque" else [1.0, 0.25]
    steady = -car.c @ np.linalg.solve(car.a, car.b * left) @ [run.command_1[-1], run.command_2[-1]]
    assert run.measurement[-1] == pytest.approx(steady.item(), rel=1e-3)


def test_losses_that_overlap_leave_the_product():
    half = [*SHORT, "fault.kind=actuator-dead", "fault.left=0.5"]
    other = ["fault.1.kind=actuator-dead", "fault.1.left=0.25", "fault.1.at_s=0.006"]
    left = PlantFaults(load("thesis-step", [*half, *other])).left(TICKS)[:, 0]
    assert left.tolist() == [1.0] * 5 + [0.5] + [0.125] * 2 + [0.25] * 4


def applied(*settings, commands):
    """What acts on the car of ``commands`` of the torque."""
    scenario = load("thesis-step", [*TIMING, *settings])
    plant = SimulatedPlant(scenario)
    return [plant.advance(k, u, 0.0)["applied_torque_nm"] for k, u in enumerate(commands)]


RAMP = [float(k) for k in range(1, 21)]  # a command of its own at every tick
SINCE = [k / 1000 for k in range(10)]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["kind=actuator-stuck"], [5.0] * 10),
        (["kind=actuator-stuck", "value=-3"], [-3.0] * 10),
        (["kind=actuator-offset", "offset=2.5"], [u + 2.5 for u in RAMP[5:15]]),
        (["kind=actuator-drift", "drift_per_s=100"],
         [u + 100 * t for u, t in zip(RAMP[5:15], SINCE, strict=True)]),
        (["kind=actuator-oscillating", "amplitude=4", "frequency_rad_per_s=300"],
         [u + 4 * math.sin(300 * t) for u, t in zip(RAMP[5:15], SINCE, strict=True)]),
        (["kind=actuator-rate-limited", "rate_per_s=500"], [5.0 + 0.5 * k for k in range(1, 11)]),
        (["kind=actuator-late", "late_ticks=3"], RAMP[2:12]),
        (["kind=actuator-dead", "left=0.5"], [u / 2 for u in RAMP[5:15]]),
    ],
)  # fmt: skip
def test_what_an_actuator_makes_of_its_commands(settings, expected):
    """Each kind by hand; before and after it, the command itself."""
    found = applied(*(f"fault.{each}" for each in settings), commands=RAMP)
    assert found[:5] == RAMP[:5]
    assert found[5:15] == pytest.approx(expected, abs=1e-12)
    assert found[15:] == RAMP[15:]


def test_a_fault_of_every_third_tick_lets_the_others_pass():
    found = applied("fault.kind=actuator-stuck", "fault.value=0", "fault.every=3", commands=RAMP)
    assert found == [0.0 if k in (5, 8, 11, 14) else u for k, u in enumerate(RAMP)]


def test_faults_act_in_their_order():
    stuck_first = ["fault.kind=actuator-stuck", "fault.value=1", "fault.1.kind=actuator-offset"]
    offset_first = ["fault.kind=actuator-offset", "fault.offset=7", "fault.1.kind=actuator-stuck"]
    when = ["fault.1.at_s=0.005", "fault.1.for_s=0.01"]
    assert applied(*stuck_first, *when, "fault.1.offset=7", commands=RAMP)[7] == 8.0
    assert applied(*offset_first, *when, "fault.1.value=1", commands=RAMP)[7] == 1.0


def test_an_offset_does_not_take_an_actuator_beyond_its_limit():
    limit = "plant.torque_actuator.limit_nm=8"
    found = applied(limit, "fault.kind=actuator-offset", "fault.offset=50", commands=RAMP)
    assert found[5:15] == [8.0] * 10


def measured(*settings):
    """Readings of a driven car, with and without the fault."""
    scenario = load("thesis-step", [*TIMING, *settings])
    plant, healthy = SimulatedPlant(scenario), SimulatedPlant(scenario.healthy)
    said, car = [], []
    for tick in range(20):
        said.append(plant.measure())
        car.append(healthy.measure())
        for each in (plant, healthy):
            each.advance(tick, 10.0, 100.0)
    return np.array(said), np.array(car)


SWING = [0.25 * math.sin(300 * t) for t in SINCE]


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (["kind=sensor-biased", "bias_mps2=-0.25"], lambda y: y[5:15] - 0.25),
        (["kind=sensor-drift", "drift_per_s=-4"], lambda y: y[5:15] - 4 * np.array(SINCE)),
        (["kind=sensor-oscillating", "amplitude=0.25", "frequency_rad_per_s=300"],
         lambda y: y[5:15] + np.array(SWING)),
        (["kind=sensor-dead"], lambda y: 0 * y[5:15]),
        (["kind=sensor-dead", "left=0.5"], lambda y: y[5:15] / 2),
        (["kind=sensor-stuck"], lambda y: y[[4] * 10]),
        (["kind=sensor-stuck", "value=1.5"], lambda y: np.full(10, 1.5)),
        (["kind=sensor-late", "late_ticks=4"], lambda y: y[1:11]),
        (["kind=sensor-rate-limited", "rate_per_s=0.001"],
         lambda y: y[4] + 1e-6 * np.arange(1, 11)),
    ],
)  # fmt: skip
def test_what_a_sensor_makes_of_the_car(settings, expected):
    said, car = measured(*(f"fault.{each}" for each in settings))
    assert (np.diff(car[4:16]) > 1e-5).all()  # or the comparison would show nothing
    np.testing.assert_array_equal(said[:5], car[:5])
    np.testing.assert_allclose(said[5:15], expected(car), rtol=1e-12, atol=1e-15)
    np.testing.assert_array_equal(said[16:], car[16:])


@pytest.mark.parametrize("kind", ["sensor-biased", "sensor-stuck", "frames-missing"])
def test_a_fault_of_the_sensor_loses_no_channel(kind):
    scenario = load("thesis-step", [f"fault.kind={kind}", "fault.channel=sensor"])
    assert not any(fault.loses_a_channel for fault in scenario.faults)


def by_tick(*settings, **changing):
    return FaultsByTick(load("thesis-step", [*SHORT, *settings]), **changing)


def test_ticks_may_be_asked_for_in_any_order():
    faults = by_tick("fault.kind=actuator-dead")
    for tick in (4, 5, 9, 6, 2000, 7, 8):
        assert faults.at(tick).left == ((0.0, 1.0) if tick in WINDOW else (1.0, 1.0))
        assert faults.at(tick).rows is None


def test_faults_that_change_do_so_from_the_next_tick_on():
    """Rows are there from the start: what is late later on needs the commands from before."""
    faults = by_tick("fault.kind=none", changing=True)
    now = faults.at(5)
    assert (now.left, now.bias) == ((1.0, 1.0), 0.0)
    np.testing.assert_array_equal(now.rows, np.tile(HEALTHY, (3, 1)))
    assert faults.latest_ticks == MAX_LATE_TICKS
    for kind in ("actuator-dead", "actuator-stuck"):
        scenario = load("thesis-step", [*SHORT, f"fault.kind={kind}"])
        faults.change(scenario)
        assert faults.at(6).left == tuple(PlantFaults(scenario).left(range(6, 7))[0])
    assert not np.array_equal(faults.at(6).rows, now.rows, equal_nan=True)


def test_what_an_actuator_adds_is_no_bias_of_d():
    scenario = load("thesis-step", [*SHORT, "fault.kind=actuator-offset", "fault.offset=3"])
    assert not PlantFaults(scenario).bias(TICKS).any()


# --- injected during a run -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (Command("INJECT", "sensor-drift", "sensor"), "its value is drift_per_s; .* must be set"),
        (Command("INJECT", "actuator-dead", "torque", 2.0), "left = 2.0: must be less than 1"),
        (Command("INJECT", "frames-missing", "torque", 1.0), "has no value"),
        (Command("INJECT", "actuator-late", "torque", 2.4), "must be a whole number of ticks"),
        (Command("INJECT", "actuator-dead", "sensor"), "must be torque or force-difference"),
        (Command("INJECT", "actuator-dead", "torque", 0.0, 60.0), "must be 0.1 to 25.5 s"),
        (Command("INJECT", "actuator-dead", "torque", 0.0, 0.15), "must be a multiple of 0.1 s"),
        (Command("INJECT", "sensor-biased", "sensor", 0.0004), "must be 0 or at least 0.001"),
        (Command("MOVE_REFERENCE", value=math.nan), "value nan: must be -8388.607 to 8388.607"),
        (Command("MOVE_REFERENCE", value=1e9), "must be -8388.607 to 8388.607"),
        (Command("PACE", value=-1.0), "must be above 0"),
        (Command("STEP", value=0.0), "must be a whole number of ticks, 1 at least"),
    ],
)
def test_what_no_frame_or_no_node_could_do_is_refused(command, why):
    with pytest.raises(RigError, match=why):
        require_possible(command)


def test_what_is_possible_is_injected():
    command = Command("INJECT", "actuator-late", "torque", 3.0, 25.5)
    require_possible(command)
    fault = injected(command, 7, 1_000_000)
    assert (fault.late_ticks, fault.at_s, fault.for_s) == (3, 0.007, 25.5)
    assert injected(command._replace(value=0.0), 7, 1_000_000) is None
    assert injected(command._replace(place="sensor"), 7, 1_000_000) is None
