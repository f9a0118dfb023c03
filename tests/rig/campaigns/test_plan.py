"""What the runs of a campaign are: by their number and the campaign's seed, and nothing else."""

import pickle
from typing import Any

import numpy as np
import pytest

from can_rig.campaigns.plan import plan
from can_rig.campaigns.rows import requirements_of
from can_rig.campaigns.settings import campaign_of, read_campaign, shipped
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import load
from tests.helpers import refuses

MASS = {"plant.mass_kg": {"share": 0.2}}


def planned(**values: Any) -> Any:
    return plan(campaign_of("some", values))


def grid(**axes: Any) -> Any:
    return planned(sampling="grid", axes={k.replace("__", "."): v for k, v in axes.items()})


@pytest.mark.parametrize("name", shipped())
def test_every_shipped_campaign_can_run(name):
    made = plan(read_campaign(name))
    requirements_of(made)
    made.scenario_of(made.runs - 1)
    assert made.settings.description


def test_cars_are_the_81_corners_middles_and_the_model():
    made = plan(read_campaign("cars"))
    nominal = load("default")
    assert made.runs == 81
    cars = {tuple(made.values_of(run).values()) for run in range(81)}
    assert len(cars) == 81
    plant = nominal.plant
    for at, value in enumerate(
        (plant.mass_kg, plant.front_cornering_stiffness_n_per_rad,
         plant.rear_cornering_stiffness_n_per_rad, plant.speed_mps)
    ):  # fmt: skip
        assert sorted({car[at] for car in cars}) == pytest.approx([0.8 * value, value, 1.2 * value])
    for run in (0, 40, 80):
        assert made.scenario_of(run).model == nominal.model  # the design has not seen them


def test_a_redesign_believes_in_each_car():
    made = planned(runs=3, axes=MASS, redesign=True)
    scenario = made.scenario_of(1)
    assert scenario.model.mass_kg == scenario.plant.mass_kg == made.values_of(1)["plant.mass_kg"]
    kept = planned(runs=3, axes=MASS).scenario_of(1)
    assert kept.model.mass_kg == load("default").model.mass_kg != kept.plant.mass_kg


FREQUENCY = {"plant.torque_actuator.natural_frequency_rad_per_s": 200.0}
NO_LAG = {"plant.torque_actuator.lag_s": 0.0}


@pytest.mark.parametrize(
    ("scenario", "settings"), [("default", {}), ("ideal", {}), ("ideal", FREQUENCY)]
)
@pytest.mark.parametrize(
    ("key", "value", "other"), [("lag_s", 0.02, {}), ("natural_frequency_rad_per_s", 300.0, NO_LAG)]
)
def test_an_axis_over_a_lag_keeps_what_is_believed_of_it(scenario, settings, key, value, other):
    axes = {f"plant.torque_actuator.{key}": {"values": [value]}}
    if key == "lag_s" and settings:
        return  # one actuator has one lag
    made = planned(runs=1, axes=axes, scenario=scenario, settings={**settings, **other})
    changed = made.scenario_of(0)
    assert changed.model == made.base.scenario.model
    assert getattr(changed.plant.torque_actuator, key) == value


def test_repeats_of_a_grid_differ_in_their_seed_alone():
    made = planned(sampling="grid", repeats=3, axes={"latency_ticks": {"values": [1, 2]}})
    assert made.runs == 6
    assert [made.values_of(run)["latency_ticks"] for run in range(6)] == [1, 1, 1, 2, 2, 2]
    assert len({made.seed_of(run) for run in range(6)}) == 6


def test_points_of_a_whole_number_are_whole_and_each_there():
    made = grid(latency_ticks={"range": [0.0, 8.0], "points": 9})
    assert [made.values_of(run)["latency_ticks"] for run in range(9)] == list(range(9))
    drawn = planned(runs=4000, axes={"latency_ticks": {"range": [0.0, 3.0]}})
    counts = np.bincount([drawn.values_of(run)["latency_ticks"] for run in range(4000)])
    assert len(counts) == 4
    assert counts.min() > 900  # a quarter of 4,000, less 3.6 sigmas


@pytest.mark.parametrize("sampling", ["latin-hypercube", "sobol"])
def test_even_samplings_are_even(sampling):
    axes = {"fault.at_s": {"range": [2.0, 6.0]}, "fault.left": {"range": [0.0, 0.5]}}
    made = planned(runs=256, sampling=sampling, axes=axes)
    for key, (low, high) in {"fault.at_s": (2.0, 6.0), "fault.left": (0.0, 0.5)}.items():
        values = np.array([made.values_of(run)[key] for run in range(256)])
        cells = np.floor((values - low) / (high - low) * 256.0 - 1e-6).astype(int).clip(0)
        assert len(set(cells)) >= 250  # rounding moves some


def test_a_log_scale_has_as_much_in_each_decade():
    axes = {"plant.sensor.noise_mps2": {"range": [1e-4, 1e-1], "scale": "log"}}
    made = planned(runs=300, sampling="latin-hypercube", axes=axes)
    values = [made.values_of(run)["plant.sensor.noise_mps2"] for run in range(300)]
    assert np.histogram(np.log10(values), [-4, -3, -2, -1])[0].tolist() == [100, 100, 100]


def test_whole_numbers_have_the_scale_of_their_range_and_stay_within():
    axes = {"latency_ticks": {"range": [1.0, 63.0], "scale": "log"}}
    made = planned(runs=600, sampling="latin-hypercube", axes=axes)
    drawn = [made.values_of(run)["latency_ticks"] for run in range(600)]
    doubling = [1, 2, 4, 8, 16, 32, 64]  # as many in each, the end of the range included
    assert np.histogram(drawn, doubling)[0].tolist() == [100] * 6
    made = planned(runs=50, axes={"latency_ticks": {"range": [1.6, 3.4]}})
    assert {made.values_of(run)["latency_ticks"] for run in range(50)} == {2, 3}


def test_the_sign_of_a_whole_number_is_not_lost():
    axes = {"seed": {"range": [1.0, 9.0], "either_sign": True}}
    with refuses("seed = -"):
        made = planned(runs=20, axes=axes)
        [made.scenario_of(run) for run in range(20)]


def test_the_number_and_the_seed_decide_and_nothing_else():
    made, again = (planned(runs=50, seed=3, axes=MASS) for _ in range(2))
    backwards = [again.changes_of(run) for run in reversed(range(50))][::-1]
    assert [made.changes_of(run) for run in range(50)] == backwards
    assert pickle.loads(pickle.dumps(made)).changes_of(7) == made.changes_of(7)
    other = planned(runs=50, seed=4, axes=MASS)
    assert all(made.changes_of(run) != other.changes_of(run) for run in range(50))
    assert len({made.seed_of(run) for run in range(50)}) == 50
    longer = planned(runs=80, seed=3, axes=MASS)
    assert longer.seed_of(49) == made.seed_of(49)


def test_a_seed_of_one_s_own_stays():
    assert planned(runs=2, settings={"seed": 5}).scenario_of(1).seed == 5
    assert grid(seed={"values": [7, 8]}).scenario_of(1).seed == 8


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({}, 'runs: must be set where sampling = "random"'),
        ({"runs": 0}, "runs = 0: must be at least 1"),
        ({"runs": 3, "sampling": "grid"}, "runs = 3: must not be set for a grid, whose"),
        ({"runs": 3, "repeats": 2}, 'repeats = 2: must be 1 unless sampling = "grid"'),
        ({"runs": 3, "sampling": "sobbol"}, "sampling = 'sobbol': must"),
        ({"runs": 3, "axis": {}}, "axis: unknown key; did you mean axes?"),
        ({"runs": 3, "axes": {"plant.mass_kg": {}}}, "none set; must be exactly one"),
        ({"runs": 3, "axes": {"plant.mass_kg": {"share": 0.1, "range": [1.0, 2.0]}}},
         "range and share set; must be exactly one"),
        ({"runs": 3, "axes": {"plant.mass_kg": {"range": [2.0, 1.0]}}}, "must increase"),
        ({"runs": 3, "axes": {"plant.mass_kg": {"range": [0.0, 1.0], "scale": "log"}}},
         'scale = "log" needs numbers above 0'),
        ({"runs": 3, "axes": {"plant.mass_kg": {"share": 0.1, "points": 3}}},
         'points = 3: must not be set unless sampling = "grid"'),
        ({"sampling": "grid", "axes": MASS}, "must have points or values for"),
        ({"runs": 3, "axes": {"plant.mas_kg": {"range": [1.0, 2.0]}}}, "mas_kg: unknown key"),
        ({"runs": 3, "axes": {"plant.mas_kg": {"share": 0.1}}}, "mas_kg: unknown key"),
        ({"runs": 3, "axes": {"plant.mass_kg": {"shar": 0.1}}}, "shar: unknown key; did you mean"),
        ({"runs": 3, "axes": {"seed": {"share": 0.1}}}, "must be a number other than 0"),
        ({"runs": 3, "settings": {"tick": 1}}, "tick: unknown key"),
        ({"runs": 3, "scenario": "nowhere"}, "no such scenario"),
        ({"runs": 3, "axes": {"plant.sensor.corner_hz": {"range": [50.0, 99.0]}}},
         "model.sensor.corner_hz must be set"),
        ({"runs": 3, "axes": {"latency_ticks": {"range": [1.2, 1.8]}}},
         "axes.latency_ticks: 1.2 to 1.8: must have a whole number, as latency_ticks = 1 in the"),
        ({"runs": 3, "requirements": {"all": "false_alarms == 0"}}, "all: must have another name"),
    ],
)  # fmt: skip
def test_what_makes_no_campaign_is_named_in_a_line(values, line):
    with refuses(line):
        planned(**values)


def test_a_file_names_its_scenario_from_where_it_lies(tmp_path):
    (tmp_path / "mine.toml").write_text("duration_s = 0.3\n")
    (tmp_path / "many.toml").write_text('scenario = "mine.toml"\nruns = 2\n')
    made = plan(read_campaign(str(tmp_path / "many.toml"), ["fault.kind=none"], runs=5))
    assert (made.runs, made.base.scenario.duration_s, made.base.scenario.loss.kind) == (
        5,
        0.3,
        "none",
    )
    for text, line in (("runs = ", "not readable as TOML"), ('name = "x"', "named by its file"),
                       ("settings = 3\nruns = 1", "must be a table")):  # fmt: skip
        (tmp_path / "bad.toml").write_text(text)
        with pytest.raises(ScenarioError, match=line):
            read_campaign(str(tmp_path / "bad.toml"), ["seed=1"])
    with pytest.raises(ScenarioError, match=r"did you mean losses\?"):
        read_campaign("losse")


def test_a_lag_is_drawn_as_none_or_as_one_that_a_scenario_may_have():
    """Of 0 to 2 µs: half of the range is lags that no scenario takes."""
    axes = {"plant.torque_actuator.lag_s": {"range": [0.0, 2e-6]}}
    values = {"scenario": "thesis-step", "axes": axes, "runs": 1}
    made = plan(campaign_of("some", values))
    drawn = [made.values_at([u])["plant.torque_actuator.lag_s"] for u in (0.1, 0.3, 0.75)]
    assert drawn == [0.0, 1e-6, 1.5e-6]


def test_a_number_of_more_digits_than_python_reads_is_one_line():
    with pytest.raises(ScenarioError, match="must have at most 4300 digits"):
        load("thesis-step", [f"seed={'1' * 5001}"])
