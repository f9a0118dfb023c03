"""The car behind its actuators and its sensor: lags, dead times, limits, noise, resolution."""

from typing import Any

import numpy as np
import pytest

from can_rig.logs.columns import TRUE_OUTPUT
from can_rig.plant.actuated_plant import ActuatedLinearPlant
from can_rig.plant.actuators import FollowedCommand
from can_rig.plant.changing_car import plant_of
from can_rig.plant.sensor import FilteredSamples, NoiseColumns
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.loading import load
from firmware_model.design.actuator_dynamics import Stage

LINEAR = "tests.rig.plant.linear:LinearPlant"
LAGS = [
    "plant.torque_actuator.lag_s=0.005",
    "plant.torque_actuator.dead_time_s=0.0014",
    "plant.force_difference_actuator.natural_frequency_rad_per_s=80",
    "plant.force_difference_actuator.damping=0.7",
    "plant.force_difference_actuator.dead_time_s=0.0023",
    "plant.sensor.corner_hz=18",
    "plant.sensor.dead_time_s=0.0037",
]


NOISY = ("plant.sensor.noise_mps2=0.03", "plant.sensor.corner_hz=18")


def settings(*changes, name="thesis-step"):
    return load(name, ["fault.kind=none", *changes])


def driven(scenario, commands, left=(1.0, 1.0)):
    """D* of the car, what the sensor reads, and the reports, for a pair of commands a tick."""
    plant = plant_of(scenario)
    found, reports = [], []
    for pair in commands:
        reports.append(plant.report(*pair, *left))
        found.append(plant.follow(*pair, *left))
    return np.array(found), reports


def commands_of(ticks, hold=20, seed=5):
    draw = np.random.default_rng(seed).normal(0.0, [40.0, 1500.0], (ticks // hold + 1, 2))
    return np.repeat(draw, hold, axis=0)[:ticks].tolist()


@pytest.mark.parametrize("tick_s", [0.001, 0.01])
def test_a_class_behind_the_same_stages_is_the_linear_plant(tick_s):
    """To the error of steps that are half a millisecond long."""
    own = [*LAGS, f"tick_s={tick_s}"]
    commands = commands_of(round(1.0 / tick_s), hold=round(0.02 / tick_s))
    exact, said = driven(settings(*own), commands)
    near, told = driven(settings(*own, f"plant.kind={LINEAR}"), commands)
    assert np.abs(near - exact).max() < 2e-4 * np.abs(exact).max()
    names = ("applied_torque_nm", "applied_force_difference_n", "yaw_rate_rad_per_s", TRUE_OUTPUT)
    for name in names:
        ours, theirs = ([report[name] for report in reports] for reports in (said, told))
        assert np.abs(np.subtract(ours, theirs)).max() < 2e-4 * np.abs(ours).max(), name


def test_what_acts_is_the_command_through_dead_time_and_lag():
    """A step at t = 0: nothing until the dead time is over, then 1 - e^(-t/τ)."""
    for kind in ("steer-by-wire", LINEAR):
        _, reports = driven(settings(*LAGS, f"plant.kind={kind}"), [(10.0, 0.0)] * 40)
        time_s = np.maximum(0.001 * np.arange(40) - 0.0014, 0.0)
        torque = [report["applied_torque_nm"] for report in reports]
        np.testing.assert_allclose(torque, 10.0 * (1.0 - np.exp(-time_s / 0.005)), atol=1e-12)


def test_without_a_lag_a_dead_time_shows_as_it_is():
    late = ["plant.torque_actuator.dead_time_s=0.0015"]
    for kind in ("steer-by-wire", LINEAR):
        pairs = [(1.0, 5.0), (2.0, 6.0), (3.0, 7.0), (4.0, 8.0)]
        _, reports = driven(settings(*late, f"plant.kind={kind}"), pairs, left=(1.0, 0.5))
        assert [report["applied_torque_nm"] for report in reports] == [0.0, 0.0, 1.0, 2.0]
        forces = [report["applied_force_difference_n"] for report in reports]
        assert forces == [2.5, 3.0, 3.5, 4.0]


def test_a_dead_actuator_fades_with_its_lag_and_does_not_wait():
    """What is still in its dead time is lost too."""
    for kind in ("steer-by-wire", LINEAR):
        scenario = settings(*LAGS, f"plant.kind={kind}")
        plant = plant_of(scenario)
        for _ in range(200):
            plant.follow(10.0, 0.0, 1.0, 1.0)
        torque = []
        for _ in range(20):
            torque.append(plant.report(10.0, 0.0, 0.0, 1.0)["applied_torque_nm"])
            plant.follow(10.0, 0.0, 0.0, 1.0)
        expected = 10.0 * np.exp(-0.001 * np.arange(20) / 0.005)
        np.testing.assert_allclose(torque, expected, rtol=1e-9)


def test_limits_of_the_plant_take_off_what_is_too_much_or_too_fast():
    own = ["plant.torque_actuator.limit_nm=25", "plant.torque_actuator.rate_nm_per_s=10000"]
    own += ["plant.force_difference_actuator.limit_n=500"]
    own += ["plant.force_difference_actuator.rate_n_per_s=400000"]
    plant = SimulatedPlant(settings(*own))
    signals = [plant.advance(tick, 100.0, -900.0) for tick in range(4)]
    signals += [plant.advance(4 + tick, -100.0, 400.0) for tick in range(2)]
    assert [s["applied_torque_nm"] for s in signals] == [10.0, 20.0, 25.0, 25.0, 15.0, 5.0]
    force_n = [-400.0, -500.0, -500.0, -500.0, -100.0, 300.0]
    assert [s["applied_force_difference_n"] for s in signals] == force_n


def test_the_sensor_reads_in_steps_of_its_resolution():
    plant = SimulatedPlant(settings("plant.sensor.resolution_mps2=0.05"))
    fine = SimulatedPlant(settings())
    coarse = set()
    for tick in range(300):
        for each in (plant, fine):
            each.advance(tick, 40.0, 0.0)
        coarse.add(plant.measure())
        assert abs(plant.measure() - fine.measure()) <= 0.025 + 1e-12
    assert len(coarse) > 3
    np.testing.assert_allclose(np.array(sorted(coarse)) / 0.05 % 1.0 % 1.0, 0.0, atol=1e-9)


def test_noise_is_as_coloured_as_the_filter_and_has_its_rms_behind_it():
    drawn = NoiseColumns.of(settings(*NOISY)).next(200_000)
    p = np.exp(-2.0 * np.pi * 18.0 * 0.001)
    assert drawn.std() == pytest.approx(0.03, rel=0.03)
    for lag in (1, 5):
        correlation = np.corrcoef(drawn[lag:], drawn[:-lag])[0, 1]
        assert correlation == pytest.approx(p**lag, abs=0.02)
    first = [NoiseColumns.of(settings(*(f"seed={s}", *NOISY))).next(1) for s in range(400)]
    assert np.std(first) == pytest.approx(0.03, rel=0.15)  # from the first tick on


def test_means_of_a_followed_command_keep_its_impulse():
    """Whatever the parts: their sum is the integral, here of a lag after one command."""
    until = 0.001 * np.arange(1, 11) - 0.0003
    behind = {0.0: until, 0.004: until - 0.004 * (1.0 - np.exp(-until / 0.004))}
    for lag_s, integral in behind.items():
        for parts in (1, 2, 7):
            actuator = FollowedCommand(Stage(lag_s, dead_time_s=0.0003), 0.001, parts)
            means = [np.mean(actuator.follow(5.0, 1.0)) for _ in range(10)]
            np.testing.assert_allclose(np.cumsum(means) * 0.001, 5.0 * integral, rtol=1e-9)


@pytest.mark.parametrize("lag_s", [0.02, 0.0])
@pytest.mark.parametrize("dead_time_s", [0.002, 0.0])
def test_filtered_samples_are_exact_for_a_straight_line(lag_s, dead_time_s):
    """A ramp after a lag: t - τ (1 - e^(-t/τ)), and later by the dead time."""
    step_s = 0.001
    sensor = FilteredSamples(Stage(lag_s, dead_time_s=dead_time_s), step_s)
    found = [sensor.next(step_s * k) for k in range(1, 60)]
    time_s = np.maximum(step_s * np.arange(1, 60) - dead_time_s, 0.0)
    behind_s = lag_s * (1.0 - np.exp(-time_s / lag_s)) if lag_s else 0.0
    np.testing.assert_allclose(found, time_s - behind_s, atol=1e-12)


def test_samples_late_by_a_part_of_a_step_lie_between_two():
    sensor = FilteredSamples(Stage(0.0, dead_time_s=0.00125), 0.001)
    assert [sensor.next(value) for value in (4.0, 8.0, 8.0)] == [0.0, 3.0, 7.0]


@pytest.mark.parametrize("rms", [0.0, 1.0, 0.02])
@pytest.mark.parametrize("lag", [[], ["plant.sensor.corner_hz=40"], ["plant.sensor.corner_hz=1e5"]])
def test_noise_of_a_run_is_drawn_as_tick_by_tick(rms, lag):
    """White too where the filter remembers next to nothing."""
    scenario = settings("duration_s=0.05", "seed=5", f"plant.sensor.noise_mps2={rms}", *lag)
    drawn, all_at_once = NoiseColumns.of(scenario), NoiseColumns.of(scenario).next(50)
    assert all_at_once.tolist() == [float(drawn.next(1)[0]) for _ in range(50)]
    assert all_at_once.any() == (rms > 0.0)
    if rms and "plant.sensor.corner_hz=40" not in lag:
        white = rms * np.random.Generator(np.random.PCG64(5)).standard_normal(50)
        assert all_at_once.tolist() == white.tolist()


@pytest.mark.parametrize(
    "own", [[], ["latency_ticks=1"], LAGS, LAGS[1:2], [LAGS[1], LAGS[4]], ["plant.kind=chapter-2"]]
)
def test_reports_of_a_whole_run_are_those_of_its_ticks(own):
    """In pieces, the first of which ends before the dead times do."""
    name = "chapter-2" if "plant.kind=chapter-2" in own else "thesis-step"
    scenario = settings(*own[: 0 if name == "chapter-2" else None], name=name)
    plant = ActuatedLinearPlant(scenario.plant, scenario.tick_s)
    commands = np.array(commands_of(30, hold=1))
    left = np.where(np.arange(30)[:, None] < 17, 1.0, [0.25, 0.5])
    states, output, reports, last = [], [], [], 0.0
    for pair, share in zip(commands, left, strict=True):
        states.append(plant.memory[0].copy())
        output.append(last)
        reports.append(plant.report(*pair, *share))
        last, _ = plant.follow(*pair, *share)
    columns = [
        plant.report_columns(np.array(output), np.array(states), commands.T, left, ticks)
        for ticks in (range(2), range(2, 20), range(20, 30))
    ]
    for signal in reports[0]:
        found = np.concatenate([piece[signal] for piece in columns])
        assert found.tolist() == [report[signal] for report in reports], signal
    assert all(piece.keys() == reports[0].keys() for piece in columns)


def test_a_column_has_no_negative_zero_as_no_frame_has():
    plant = ActuatedLinearPlant(settings().plant, 0.001)
    states, left, reached = np.zeros((3, 4)), np.ones((3, 2)), np.full((2, 3), -0.0)
    columns = plant.report_columns(np.zeros(3), states, reached, left, range(3))
    assert not np.signbit(columns["applied_torque_nm"]).any()


# --- a plant class: its steps, and its inputs ----------------------------------------------------

CLASS = f"plant.kind={LINEAR}"
COUNTING = "plant.kind=tests.rig.plant.test_actuated_plant:Counting"
EQUAL_LAGS = [
    "plant.torque_actuator.lag_s=0.005",
    "plant.force_difference_actuator.lag_s=0.005",
    "plant.sensor.corner_hz=31.830988618379067",  # of 5 ms too
]


class Counting:
    """Notes its steps, and answers with their number."""

    def __init__(self, settings: Any) -> None:
        self.reset()

    def reset(self) -> None:
        self.steps: list[tuple[float, float, float]] = []

    def advance(self, dt_s: float, torque_nm: float, force_difference_n: float) -> float:
        self.steps.append((dt_s, torque_nm, force_difference_n))
        return float(len(self.steps))

    def signals(self) -> dict[str, float]:
        longest_s = max((dt_s for dt_s, *_ in self.steps), default=0.0)
        return {"steps": float(len(self.steps)), "longest_s": longest_s}


def actuated(*settings: str, tick_s: float = 1e-3) -> Any:
    return plant_of(load("thesis-step", ["fault.kind=none", f"tick_s={tick_s}", *settings]))


@pytest.mark.parametrize(
    ("settings", "tick_s", "steps"),
    [([], 1e-3, 1), ([], 5e-3, 1), *(([one], 1e-3, 2) for one in EQUAL_LAGS),
     (EQUAL_LAGS[:2], 1e-3, 2), (EQUAL_LAGS, 1e-3, 2), (EQUAL_LAGS, 5e-4, 1),
     (EQUAL_LAGS, 1.1e-3, 3), (EQUAL_LAGS, 6e-3, 12)],
)  # fmt: skip
def test_a_tick_is_one_step_or_as_many_as_are_short(settings, tick_s, steps):
    """At most half a millisecond, where anything lags."""
    plant = actuated(COUNTING, *settings, tick_s=tick_s)
    before = plant.report(0.0, 0.0, 1.0, 1.0)
    assert (before["steps"], before[TRUE_OUTPUT]) == (0.0, 0.0)  # it is at rest
    output, _ = plant.follow(1.0, 1.0, 1.0, 1.0)
    after = plant.report(1.0, 1.0, 1.0, 1.0)
    assert (after["steps"], after[TRUE_OUTPUT], output) == (steps, steps, steps)
    assert after["longest_s"] == pytest.approx(tick_s / steps)


def test_the_sensor_is_late_and_the_car_is_not():
    plant = actuated(COUNTING, "plant.sensor.dead_time_s=0.0015")
    assert [plant.follow(0.0, 0.0, 1.0, 1.0) for _ in range(3)] == [(2, 0), (4, 1), (6, 3)]
