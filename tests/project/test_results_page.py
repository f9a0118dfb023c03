"""docs/results.md has every column of signals.csv, every key of run.json and every metric."""

import json
import re
from typing import Any

import pytest
from scenario_keys import unit

from can_rig.logs.columns import EVIDENCE, ON_THE_BUS as COLUMNS, SPEED, VERDICT
from can_rig.plant.actuated_plant import ActuatedLinearPlant
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.sensor_settings import USUAL
from tests.project.pages import table, text_of

RESULTS = text_of("docs/results.md")


@pytest.fixture(scope="module")
def summary(tmp_path_factory):
    """The run.json of a short run."""
    from click.testing import CliRunner

    from can_rig.cli.main import main

    folder = tmp_path_factory.mktemp("results") / "run"
    short = ["--set", "duration_s=0.05", "--in-process", "--out", str(folder)]
    done = CliRunner().invoke(main, ["run", "default", *short])
    assert done.exit_code == 0, done.output
    values: dict[str, Any] = json.loads((folder / "run.json").read_text("utf-8"))
    return values


def names(heading: str) -> list[str]:
    """The keys in the first column of a table."""
    return [name for cell, *_ in table(RESULTS, heading) for name in re.findall(r"`(\w+)`", cell)]


def test_columns_of_signals():
    car = ActuatedLinearPlant(PlantSettings(), 0.001)
    sensors = [each.column for each in USUAL.values()]
    reported = car.report(0.0, 0.0, 1.0, 1.0)
    assert names("column") == [*COLUMNS, *reported, SPEED, VERDICT, *EVIDENCE, *sensors]


def test_keys_of_run_json(summary):
    assert set(names("key")) == {*summary, "realtime"}


def test_metrics(summary):
    assert sorted(names("metric")) == sorted(summary["metrics"])


@pytest.mark.parametrize("heading", ["column", "metric"])
def test_units_are_those_of_the_names(heading):
    for row in table(RESULTS, heading):
        name = row[0].strip("`")
        assert row[1] == unit(name), name
