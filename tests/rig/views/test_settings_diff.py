"""Which settings two runs differ in, and what the runs are called beside each other."""

import json
from pathlib import Path

import numpy as np
import pytest

from can_rig.results.run_folder import Outcome, finish
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.views.diff import SettingDifference, compare, differing_settings
from can_rig.views.pictures import difference_page
from can_rig.views.signal_table import SignalTable, read_table, titles
from tests.helpers import asked, on_a_bus


def keys(a: list[str], b: list[str]) -> dict[str, tuple[object, object]]:
    found = differing_settings(load("default", a), load("default", b))
    return {setting.key: (setting.a, setting.b) for setting in found}


def test_every_key_that_differs_is_listed_once_with_both_values():
    assert keys([], []) == {}
    assert keys(["tick_s=0.002"], []) == {"tick_s": (0.002, 0.001)}
    assert keys(["fault.for_s=2.0", "design.alpha=3"], ["fault.kind=none"]) == {
        "design.alpha": (3, 2),
        "fault.kind": ("actuator-dead", "none"),
        "fault.for_s": (2.0, None),
    }


def test_a_model_that_follows_the_plant_is_not_listed_beside_it():
    assert list(keys(["plant.speed_mps=12.0"], [])) == ["plant.speed_mps"]
    assert list(keys(["model.speed_mps=12.0"], [])) == ["model.speed_mps"]
    both = keys(["plant.speed_mps=12.0", "model.speed_mps=11.0"], [])
    assert list(both) == ["plant.speed_mps", "model.speed_mps"]


def test_the_name_and_description_of_a_scenario_are_no_settings():
    found = differing_settings(load("thesis-step"), load("thesis-sine"))
    assert {setting.key for setting in found} == {"reference.kind"}
    assert str(found[0]) == "reference.kind: step → sine"
    assert str(SettingDifference("fault.for_s", 0.25, None)) == "fault.for_s: 0.25 → none"


def test_titles_are_as_long_as_tells_the_paths_apart():
    def named(label: str, scenario: str | None = None) -> SignalTable:
        known = None if scenario is None else load(scenario)
        return SignalTable(label, np.zeros(0, dtype=np.int64), {}, known)

    a, b = named("runs/first", "default"), named("runs/second", "noisy")
    assert titles(a, b) == ("first (default)", "second (noisy)")
    assert titles(named("x/run/bus.log"), named("y/run/bus.log")) == (
        str(Path("x/run/bus.log")), str(Path("y/run/bus.log")),
    )  # fmt: skip
    assert titles(a, a) == ("runs/first (default)", "runs/first (default)")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    for name, change in (
        ("a", ()),
        ("later", ("fault.at_s=0.06", "plant.sensor.noise_mps2=0.001")),
    ):
        scenario = load("chapter-2", ["duration_s=0.1", "fault.at_s=0.05", *change])
        (folder / name).mkdir()
        log = folder / name / "bus.log"
        on_a_bus(scenario, log)
        finish(folder / name, scenario, network_of(scenario), Outcome("local"))
    return folder


def test_diff_lists_them_in_the_table_and_in_json(runs):
    done = asked("diff", runs / "a", runs / "later")
    assert done.returncode == 1
    rows = [line.split() for line in done.stdout.splitlines()]
    assert ["fault.at_s", "0.05", "0.06"] in rows
    assert ["plant.sensor.noise_mps2", "0", "0.001"] in rows
    values = json.loads(asked("diff", runs / "a", runs / "later", "--json").stdout)
    assert {"key": "fault.at_s", "a": 0.05, "b": 0.06} in values["settings"]
    assert len(values["settings"]) == 2
    log = runs / "a" / "bus.log"
    unknown = asked("diff", runs / "a", log, "--scenario", "chapter-2", "--json")
    assert json.loads(unknown.stdout)["settings"] is None


@pytest.mark.filterwarnings("error")
def test_the_picture_names_runs_settings_and_signals(runs):
    """And has the units of the network, which for chapter 2 are none."""
    a, b = (read_table(runs / name, load("default")) for name in ("a", "later"))
    page = difference_page(a, b, compare(a, b, {}))
    (legend,) = page.legends
    assert [text.get_text() for text in legend.get_texts()] == [
        "a (chapter-2)",
        "later (chapter-2)",
    ]
    assert legend.get_title().get_text().splitlines() == [
        "plant.sensor.noise_mps2: 0 → 0.001",
        "fault.at_s: 0.05 → 0.06",
    ]
    assert {"output y", "input 2"} <= {axis.get_ylabel() for axis in page.axes[::2]}
