"""The world of a run: its shapes, its windows, and the car in it, in every loop."""

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from can_rig.errors import ScenarioError
from can_rig.plant.changing_car import plant_of
from can_rig.plant.disturbances import BLOCK, CALM, Disturbances
from can_rig.plant.frameless import UntilItFails, frameless_loop
from can_rig.plant.nonlinear_car import NonlinearCar
from can_rig.plant.protocol import require_world
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import WORLD_COLUMNS
from can_rig.scenario.loading import load
from can_rig.scenario.plant_settings import PlantSettings
from firmware_model.analysis.simulation import LoopPlant
from tests.firmware.analysis.world import Integrated
from tests.helpers import on_a_bus, on_no_bus

FORCE, MOMENT, BANK, KICK, FRONT, REAR = range(6)
PUSH = "disturbance={kind='push', size=0.7, at_s=0.05, for_s=0.2, ramp_s=0.03}"
TURBULENT = "disturbance=[{kind='turbulence', at_s=0, ramp_s=0, intensity_n=300, length_m=20}]"


def world(*settings: str) -> Disturbances:
    return Disturbances(load("ideal", ["duration_s=40", "fault.kind=none", *settings]))


shapes = st.sampled_from(["ramp", "one-minus-cosine"])


@given(
    shape=shapes,
    begin=st.integers(1, 900),
    ramp=st.integers(0, 400),
    flat=st.integers(1, 500),
    force_n=st.floats(-2000.0, 2000.0),
    arm_m=st.floats(-2.0, 2.0),
)
def test_the_impulse_of_a_gust_is_its_force_by_its_time_less_one_ramp(
    shape, begin, ramp, flat, force_n, arm_m
):
    """At ticks on its corners a straight line between ticks loses nothing of a ramp."""
    made = world(
        "disturbance.kind=gust", f"disturbance.shape={shape}", f"disturbance.at_s={begin / 1e3!r}",
        f"disturbance.for_s={(2 * ramp + flat) / 1e3!r}", f"disturbance.ramp_s={ramp / 1e3!r}",
        f"disturbance.force_n={force_n!r}", f"disturbance.arm_m={arm_m!r}",
    )  # fmt: skip
    rows = made.at(range(3000))
    impulse = 1e-3 * np.sum(0.5 * (rows[1:, FORCE] + rows[:-1, FORCE]))
    assert impulse == pytest.approx(force_n * (ramp + flat) / 1e3, rel=1e-6, abs=1e-9)
    assert np.abs(rows[:, FORCE]).max() == pytest.approx(abs(force_n), rel=1e-12)
    assert np.abs(rows[:, MOMENT] - arm_m * rows[:, FORCE]).max() <= 1e-12 * abs(arm_m * force_n)
    assert (rows[: begin + (ramp > 0), FORCE] == 0).all()
    assert (rows[begin + 2 * ramp + flat :, FORCE] == 0).all()


@pytest.mark.parametrize("shape", ["ramp", "one-minus-cosine"])
def test_a_flank_is_a_line_or_half_a_cosine(shape):
    rows = world(
        "disturbance.kind=steering-kick", "disturbance.torque_nm=8", "disturbance.at_s=1",
        "disturbance.for_s=2", "disturbance.ramp_s=0.4", f"disturbance.shape={shape}",
    ).at(range(4000))[:, KICK]  # fmt: skip
    assert rows[[1000, 1200, 1400, 2600, 2800, 3000]] == pytest.approx([0, 4, 8, 8, 4, 0])
    quarter = 2.0 if shape == "ramp" else 8.0 * (1 - math.cos(math.pi / 4)) / 2
    assert rows[[1100, 2900]] == pytest.approx([quarter, quarter])


def test_without_a_ramp_a_cosine_fills_its_time_and_a_line_takes_0_3_s():
    kick = ["disturbance.kind=steering-kick", "disturbance.torque_nm=1", "disturbance.at_s=1"]
    cosine = world(*kick, "disturbance.for_s=2", "disturbance.shape=one-minus-cosine")
    time_s = np.arange(2001) / 1e3
    gust = 0.5 - 0.5 * np.cos(math.pi * time_s)
    assert np.abs(cosine.at(range(1000, 3001))[:, KICK] - gust).max() < 1e-12
    line = world(*kick).at(range(3000))[:, KICK]
    assert line[[1150, 1300, 2999]] == pytest.approx([0.5, 1.0, 1.0])


def test_pushes_add_up_and_frictions_multiply():
    rows = world(
        "disturbance=[{kind='friction', at_s=0, front=0.5}, {kind='bank', bank_percent=8}, "
        "{kind='friction', at_s=0, front=0.6, rear=0.4}, {kind='bank', bank_percent=-3},"
        "{kind='none', at_s=0}]"
    ).at(range(10_000))  # fmt: skip
    assert rows[0] == pytest.approx(CALM)  # a run begins in a calm world
    assert rows[-1] == pytest.approx([0, 0, math.atan(0.08) - math.atan(0.03), 0, 0.3, 0.4])


@pytest.mark.parametrize("speed", [3.0, 25.0])
def test_turbulence_has_its_rms_and_its_corner_at_every_speed(speed):
    """Within four standard errors of so many correlated samples."""
    ticks = 400_000
    made = world(TURBULENT, "duration_s=400", f"plant.speed_mps={speed}")
    force = made.at(range(1, ticks))[:, FORCE]
    memory = math.exp(-speed * 1e-3 / 20.0)
    error = math.sqrt(2.0 / (ticks * (1 - memory**2) / (1 + memory**2)))
    assert np.mean(force**2) == pytest.approx(300.0**2, rel=4 * error)
    lag = round(20.0 / speed * 1e3)  # a time constant
    correlated = np.mean(force[lag:] * force[:-lag]) / np.mean(force**2)
    assert correlated == pytest.approx(memory**lag, abs=4 * error)


def test_turbulence_blows_at_the_first_tick_as_later():
    """Over 60 seeds; four standard errors of a mean square are 73 %."""
    first = [world(TURBULENT, f"seed={seed}").at(range(2))[1, FORCE] for seed in range(60)]
    assert np.mean(np.square(first)) == pytest.approx(300.0**2, rel=0.73)


def test_turbulence_follows_the_speed_of_a_drive():
    """A drive of constant speed gives the bits of that speed; a standing car's wind stays."""
    drive = world(TURBULENT, "drive.speed_mps=10").at(range(9000))
    assert np.abs(drive - world(TURBULENT, "plant.speed_mps=10").at(range(9000))).max() < 1e-9


def test_seeds_and_numbers_give_other_turbulence():
    two = TURBULENT.replace("}]", "}, {kind='none'}]")
    second = TURBULENT.replace("[{", "[{kind='none'}, {")
    found = [world(each).at(range(500))[:, FORCE] for each in (TURBULENT, two, second)]
    found.append(world(TURBULENT, "seed=1").at(range(500))[:, FORCE])
    assert (found[0] == found[1]).all()
    for other in found[2:]:
        assert abs(np.corrcoef(found[0][1:], other[1:])[0, 1]) < 0.99


ALL = (
    "disturbance=[{kind='turbulence', at_s=0.01, intensity_n=300, length_m=5, arm_m=0.3}, "
    "{kind='bank', at_s=0.02, bank_percent=5}, {kind='friction', at_s=0.05, front=0.5, rear=0.8}, "
    "{kind='steering-kick', at_s=0.1, for_s=0.1, torque_nm=3}, "
    "{kind='gust', at_s=0.03, for_s=0.2, force_n=400, shape='one-minus-cosine'}]"
)
DRY = ALL.replace("friction', at_s=0.05, front=0.5, rear=0.8", "none'")


@given(st.lists(st.integers(0, 3 * BLOCK), min_size=2, max_size=6))
def test_windows_are_parts_of_the_whole(cuts):
    """In any order, each from a world that has computed nothing yet or much."""
    whole, used = world(ALL).at(range(3 * BLOCK)), world(ALL)
    for begin, end in pairwise(cuts):
        some = range(min(begin, end), max(begin, end))
        assert (used.at(some) == whole[some.start : some.stop]).all()
        assert (world(ALL).at(some) == whole[some.start : some.stop]).all()
    for tick in cuts:
        if tick < 3 * BLOCK - 1:
            assert (used.during(tick) == whole[tick : tick + 2]).all()


# --- in the loops ---------------------------------------------------------------------------------

SHORT = ["duration_s=0.3", "fault.at_s=0.15", "plant.sensor.noise_mps2=0.01"]


def recorded(folder: Path, name: str, *settings: str) -> list[tuple[bytes, bytes]]:
    """The log and the plant's signals, from two nodes in a process and from none."""
    scenario = load(name, settings)
    found = []
    for way in (on_a_bus, on_no_bus):
        log = folder / f"{way.__name__}.log"
        way(scenario, log)
        found.append((log.read_bytes(), log.with_suffix(".plant.csv").read_bytes()))
    return found


@pytest.mark.parametrize(
    ("name", "settings"),
    [("default", [DRY]), ("default", [ALL]), ("drive-cycle", [ALL, "reference.kind=step"]),
     ("nonlinear-car", [ALL]), ("two-masses", [PUSH, "plant.e=[0, 0, 1.5, 0]"]),
     ("chapter-2", [PUSH, "plant.gw={zeros=[-1], poles=[-2, [-1, 3]], gain=4}"])],
)  # fmt: skip
def test_with_and_without_a_bus_it_is_the_same_world(tmp_path, name, settings):
    nodes, columns = recorded(tmp_path, name, *SHORT, *settings)
    assert nodes == columns
    header = nodes[1].splitlines()[0].decode().split(",")
    assert set(WORLD_COLUMNS) <= set(header) or "push" in header


@pytest.mark.parametrize("settings", [[DRY], [ALL]])
def test_a_compiled_loop_has_the_bits_of_ticks_one_by_one(settings):
    """Also where the loop stops within a page of the world."""
    scenario = load("default", [*SHORT, "duration_s=9", *settings])
    network = network_of(scenario)
    compiled, one_by_one = (frameless_loop(scenario, network) for _ in range(2))
    assert isinstance(compiled._plant, LoopPlant)
    one_by_one._plant = UntilItFails(plant_of(scenario))
    for until in (100, BLOCK, 5000, 9000):
        compiled.run(until)
    one_by_one.run()
    for name, values in vars(compiled.trace).items():
        np.testing.assert_array_equal(values, getattr(one_by_one.trace, name), err_msg=name)


@pytest.mark.parametrize("settings", [[DRY], [ALL], [ALL, "drive.speed_mps=10"]])
def test_the_car_of_a_scenario_is_that_of_the_equations(settings):
    """Uncontrolled, against the ODE solver with the matrices of ``test_world``'s proof."""
    scenario = load("ideal", [*SHORT, *settings])
    plant, rows = plant_of(scenario), Disturbances(scenario).at(range(151))
    given = np.array([20.0, 300.0]) * np.sin(np.arange(150) / 20.0)[:, None]
    found, reports = [], []
    for u in given.tolist():
        reports.append(plant.report(*u, 1.0, 1.0))
        found.append(plant.follow(*u, 1.0, 1.0))
    p = scenario.plant
    solved = Integrated(p, p.stages, 1e-3, given, rows, lambda _: p.speed_mps, 1e-9)
    expected = solved.answers()
    assert np.abs(np.array(found) - expected).max() < 1e-6 * np.abs(expected).max()
    x = solved.state(0.1)
    force = solved.accelerometer(0.1, x)
    assert reports[100]["specific_force_mps2"] == pytest.approx(force, rel=1e-5)
    own = p.speed_mps * (solved.rates(0.1, x, given[100])[0] + x[1])
    assert reports[100]["lateral_acceleration_mps2"] == pytest.approx(own, rel=1e-5)
    assert [reports[100][name] for name in WORLD_COLUMNS] == rows[100].tolist()


def test_the_nonlinear_car_gets_the_world_in_every_step_of_a_tick():
    """Behind lags a tick has several steps; without commands a single long step."""
    settings = [ALL, *SHORT, "plant.torque_actuator.lag_s=0.01", "tick_s=0.002"]
    scenario = load("nonlinear-car", settings)
    plant, alone = plant_of(scenario), NonlinearCar(scenario.plant)
    world_of = Disturbances(scenario)
    for tick in range(100):
        around = np.hstack([world_of.during(tick), np.full((2, 1), scenario.plant.speed_mps)])
        expected = alone.advance(0.002, 0.0, 0.0, around)
        assert plant.follow(0.0, 0.0, 1.0, 1.0)[0] == pytest.approx(expected, rel=1e-6, abs=1e-9)
    assert abs(expected) > 0.01


# --- what is refused ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["disturbance.force_n=3"], r"disturbance.kind: must be set"),
        (["disturbance=3"], r"disturbance = 3: must be a table, or several"),
        (["disturbance.kind=gust"], r"disturbance.force_n: must be set for 'gust'"),
        (["disturbance.kind=friction"], r"disturbance.front: must be set for 'friction'"),
        (["disturbance.kind=turbulence", "disturbance.intensity_n=3"],
         r"disturbance.length_m: must be set for 'turbulence'"),
        (["disturbance.kind=gust", "disturbance.force_n=3", "disturbance.front=0.4"],
         r"disturbance.front = 0.4: says nothing of 'gust'; must be force_n or arm_m"),
        (["disturbance.kind=bank", "disturbance.bank_percent=3", "disturbance.arm_m=1"],
         r"disturbance.arm_m = 1: says nothing of 'bank'; must be bank_percent"),
        (["disturbance.kind=gust", "disturbance.force_n=3", "disturbance.for_s=1",
          "disturbance.ramp_s=0.6"], r"disturbance.ramp_s = 0.6: must be at most 0.5, half of for"),
        (["disturbance.0.kind=bank", "disturbance.0.bank_percent=2", "disturbance.1.kind=bank"],
         r"disturbance.1.bank_percent: must be set for 'bank'"),
        (["disturbance.2.kind=bank"], r"must be a key of disturbance.0 or disturbance.1"),
        (["disturbance=[3]"], r"disturbance.0 = 3: must be a table"),
        (["disturbance={kind='friction', front=0.5, force_n=3}"],
         r"disturbance.force_n = 3: says nothing of 'friction'; must be front or rear"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_in_one_line(settings, said):
    with pytest.raises(ScenarioError, match=said) as caught:
        load("default", settings)
    assert "\n" not in str(caught.value)


def test_a_plant_that_nothing_can_push_is_refused():
    gust = ["disturbance.kind=gust", "disturbance.force_n=3"]
    push = ["disturbance.kind=push", "disturbance.size=3"]
    with pytest.raises(ScenarioError, match=r"disturbance.kind = 'gust': must be push for plant.k"):
        load("chapter-2", gust)
    with pytest.raises(ScenarioError, match=r"disturbance.kind = 'push': must be gust, turbulenc"):
        load("default", push)
    with pytest.raises(ScenarioError, match=r"plant.gw: must be set for a disturbance of plant.ki"):
        load("chapter-2", push)
    with pytest.raises(ScenarioError, match=r"model.e: must be plant.e; the controller knows no "):
        load("two-masses", ["model.e=[1, 0, 0, 0]"])
    with pytest.raises(ScenarioError, match=r"plant.e: must not be set for kind = 'transfer-funct"):
        load("chapter-2", ["plant.e=[1]"])
    with pytest.raises(ScenarioError, match=r"plant.e: has length 1: must have 4, as many as a ha"):
        load("two-masses", ["plant.e=[1]"])
    with pytest.raises(ScenarioError, match=r"unstable poles of Gw: 0.01 rad/s: must be none, or "):
        plant_of(load("chapter-2", [*push, "plant.gw={zeros=[], poles=[0.01], gain=1}"]))
    other = "plant.kind=tests.rig.plant.linear:LinearPlant"
    with pytest.raises(ScenarioError, match=r"LinearPlant': advance must have a fourth argument w"):
        plant_of(load("default", [*gust, other]))
    names = dict.fromkeys(("input_1", "input_2", "output", "side_force_n"), "name")
    fmu = PlantSettings(kind="fmu:car.fmu", variables=names)
    require_world(fmu, load("default", gust).disturbances)
    with pytest.raises(ScenarioError, match=r"'gust': plant.variables.yaw_moment_nm must be set, "):
        require_world(fmu, load("default", [*gust, "disturbance.arm_m=0.3"]).disturbances)


def test_a_disturbance_that_never_occurs_is_noted():
    gust = ["disturbance.kind=gust", "disturbance.force_n=3", "disturbance.at_s=50"]
    (note,) = load("default", [*gust, "fault.kind=none"]).notes
    assert note == "note: the disturbance (gust at 50 s) never occurs: the run ends at 20 s"
