"""The search for the worst run: repeatable, gone on with, and better than chance."""

import json
import re
from statistics import fmean
from typing import Any

import numpy as np
import pytest

from can_rig.campaigns.execution import GENERATION, Search
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.report import write_report
from can_rig.campaigns.rows import read_columns, requirements_of
from can_rig.campaigns.settings import read_campaign
from can_rig.campaigns.statistics import found, summarise
from can_rig.errors import ScenarioError
from tests.rig.campaigns import running
from tests.rig.campaigns.running import ran, rows

BUDGET = 40
SEARCH: dict[str, Any] = {
    "axes": {"fault.left": {"range": [0.0, 0.9]},
             "plant.sensor.noise_mps2": {"range": [1e-4, 1e-2], "scale": "log"}},
    "requirements": {"small": "deviation_peak_after_fault_mps2 <= 1e-3", "calm": "suspicions == 0"},
    "runs": BUDGET, "search": "small",
}  # fmt: skip


def planned(**values: Any) -> Plan:
    return running.planned(**{**SEARCH, **values})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    return ran(tmp_path_factory.mktemp("search") / "one", planned())


def test_the_search_and_as_many_random_runs_share_a_table(done):
    table = rows(done)
    assert [row["run"] for row in table] == list(range(2 * BUDGET))
    assert [row["method"] for row in table] == ["search"] * BUDGET + ["random"] * BUDGET
    searched, drawn = table[:BUDGET], table[BUDGET:]
    # So few runs need not find the very worst one, but they gather where the margin is small.
    later = [row["margin.small"] for row in searched[BUDGET // 2 :]]
    assert fmean(later) < fmean(row["margin.small"] for row in drawn)
    some = planned()
    assert drawn[3]["fault.left"] == some.values_of(BUDGET + 3)["fault.left"]
    assert all(0.0 <= row["fault.left"] <= 0.9 for row in table)


def test_an_interruption_changes_nothing(done, tmp_path):
    assert (
        ran(tmp_path / "stopped", planned(), stops=2).table.read_bytes() == done.table.read_bytes()
    )


def test_the_report_is_of_the_random_runs_and_says_what_was_found(done):
    summary = write_report(done)
    assert summary.runs == 2 * BUDGET
    rate = summary.rates[0]
    assert rate.passed + rate.failed + rate.unknown == BUDGET
    columns = read_columns(done.table)
    assert summarise(done.plan, requirements_of(done.plan), columns) == summary
    assert [each.method for each in summary.found] == ["search", "random"]
    assert summary.found[0].least == min(columns["margin.small"][:BUDGET])
    least = min(margin for margin in columns["margin"] if margin is not None)
    assert summary.worst[0]["margin"] == least
    assert json.loads((done.path / "summary.json").read_text())["found"][1]["runs"] == BUDGET
    assert "least margin of small" in (done.path / "report.html").read_text("utf-8")


def test_a_run_that_the_search_alone_finds_counts_for_the_status(done):
    required = requirements_of(done.plan)
    columns = read_columns(done.table)
    alike = {name: [values[-1]] * len(values) for name, values in columns.items()}
    alike["margin"] = [0.5] * len(alike["margin"])
    assert summarise(done.plan, required, alike).passed
    for name, bad in (("margin", -0.5), ("failure", "no reference")):
        one = {**alike, name: [bad, *alike[name][1:]]}
        found = summarise(done.plan, required, one)
        assert not found.passed
        assert found.reasons == ({bad: 1} if name == "failure" else {})


@pytest.mark.parametrize("axes", [1, 2, 5])
def test_a_valley_is_found_by_the_margins_alone(axes):
    def margin(point: tuple[float, ...]) -> float:
        return sum((u - 0.83) ** 2 for u in point)

    search, again = Search(axes, seed=3), Search(axes, seed=3)
    before = np.random.get_state()[1].tolist()
    best = []
    for _ in range(40):
        points = search.ask()
        assert points == again.ask()
        assert len(points) == GENERATION
        assert all(0.0 <= u <= 1.0 and len(point) == axes for point in points for u in point)
        margins = [margin(point) for point in points]
        for each in (search, again):
            each.tell(margins)
        best.append(min(margins))
    assert min(best) < 1e-3
    assert np.random.get_state()[1].tolist() == before
    assert Search(axes, seed=4).ask() != Search(axes, seed=3).ask()


def test_runs_without_a_margin_and_flat_ground_do_not_end_it():
    search = Search(2, seed=0)
    for _ in range(40):
        assert len(search.ask()) == GENERATION
        search.tell([None, *[1.0] * (GENERATION - 1)])


def test_what_was_found_is_counted():
    one = found("search", [None, 0.5, -0.1, 0.2, -0.3])
    assert (one.runs, one.least, one.failed, one.first_failed) == (5, -0.3, 2, 3)
    assert found("random", [None, None]).least is None


@pytest.mark.parametrize(
    ("values", "line"),
    [({"search": "smal"}, "search = 'smal': must be a requirement, small or calm or all"),
     ({"axes": {}}, "must come with axes"), ({"requirements": {}}, "must come with a requirement"),
     ({"sampling": "sobol"}, 'must come with sampling = "random"')],
)  # fmt: skip
def test_what_cannot_be_searched_is_one_line(values, line):
    with pytest.raises(ScenarioError, match=re.escape(line)):
        planned(**values)


def test_a_grid_is_searched_between_its_ends():
    settings = read_campaign("cars", search="deviation", runs=10)
    assert (settings.sampling, plan(settings).runs) == ("random", 20)
    assert all(axis.points is None for axis in settings.axes.values())
