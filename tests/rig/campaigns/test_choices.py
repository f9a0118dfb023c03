"""Choices, several scenarios, values that depend on others, and the tables of the report."""

import re
import shlex
from collections import Counter
from itertools import combinations
from typing import Any

import pytest
from scipy.stats import chi2

from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.requirements import Requirement
from can_rig.campaigns.rows import require_tables, requirements_of, run_row, schema
from can_rig.campaigns.settings import campaign_of, read_campaign, shipped
from can_rig.campaigns.statistics import ALWAYS_SHOWN, cross, parts_by_name, summarise
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import load
from can_rig.scenario.sensor_settings import MEASURED
from tests.helpers import refuses

OFFSET = {"kind": "actuator-offset", "offset": {"range": [10.0, 50.0], "either_sign": True}}
LATE = {"kind": "actuator-late", "late_ticks": {"range": [0.01, 0.05], "per": "tick_s"}}
CHOICES = {"fault.0": {"nothing": {"kind": "none"}, "offset": OFFSET, "late": LATE}}
NAMES = ["default", "chassis-can"]


def planned(**values: Any) -> Plan:
    return plan(campaign_of("some", {"runs": 600, "choices": CHOICES, **values}))


def test_each_scenario_and_alternative_has_its_share_whatever_the_others_are():
    made = planned(scenario=NAMES)
    values = [made.values_of(run) for run in range(600)]
    pairs = Counter((each["scenario"], each["fault.0"]) for each in values)
    assert len(pairs) == 6
    assert min(pairs.values()) > 65  # of 100, less 3.8 sigmas
    offsets = [float(each["fault.0.offset"]) for each in values if "fault.0.offset" in each]
    assert all(10.0 <= abs(offset) <= 50.0 for offset in offsets)
    assert 0.35 < sum(offset < 0.0 for offset in offsets) / len(offsets) < 0.65


def test_a_time_is_as_many_ticks_as_the_scenario_has_of_it():
    made = planned(scenario=NAMES)
    for run in range(60):
        values = made.values_of(run)
        if values["fault.0"] != "late":
            continue
        tick_s = made.base_of(values).scenario.tick_s
        late_s = made.scenario_of(run).faults[0].late_ticks * tick_s
        assert 0.01 <= late_s <= 0.05 + tick_s  # rounded up


@pytest.mark.parametrize("name", ["default", "chassis-can"])
def test_the_command_of_a_run_is_its_scenario(name):
    made = plan(read_campaign("double-faults", scenario=[name]))
    for run in range(25):
        values = made.values_of(run)
        words = shlex.split(made.base_of(values).command_with(made.changes_of(run, values)))
        again = load(words[2], [word for word in words if "=" in word])
        assert made.scenario_of(run) == again


def test_a_table_over_scenarios_serves_one_scenario_too():
    made = plan(read_campaign("faults", scenario=["no-compensation"], runs=1))
    assert made.settings.tables["scenarios"].rows == "scenario"
    require_tables(made)
    row = run_row(made, requirements_of(made), 0, made.values_of(0))
    assert row["scenario"] == "no-compensation"
    assert "scenario" in schema(made).names


@pytest.mark.parametrize("name", ["faults", "double-faults", "restarts", "weather"])
def test_every_alternative_of_the_shipped_campaigns_is_in_its_bounds(name):
    made = plan(read_campaign(name))  # checks each once
    kinds = {fault.kind for run in range(300) for fault in made.scenario_of(run).fault}
    assert len(kinds) > (15 if "faults" in name else 0)


def test_a_second_fault_comes_after_the_first_and_a_loss_meanwhile_in_the_outage():
    made = plan(read_campaign("double-faults"))
    for run in range(100):
        one, other = made.scenario_of(run).fault
        assert one.at_s <= other.at_s <= one.at_s + 2.0 + 1e-6
    made = plan(read_campaign("restarts"))
    meanwhile = 0
    for run in range(100):
        outage, fault = made.scenario_of(run).fault
        values = made.values_of(run)
        assert outage.for_s is not None
        if str(values["fault.1"]).endswith("meanwhile"):
            meanwhile += 1
            assert outage.at_s - 1e-6 <= fault.at_s <= outage.at_s + outage.for_s + 1e-6
        elif values["fault.1"] != "nothing":
            assert 0.3 - 1e-6 <= outage.at_s - fault.at_s <= 1.5 + 1e-6
    assert meanwhile > 10


def test_a_grid_has_each_scenario_with_each_alternative_at_each_point():
    choices = {"fault.0": {"nothing": {"kind": "none"}, "dead": {"kind": "actuator-dead"}}}
    made = plan(campaign_of("some", {
        "sampling": "grid", "scenario": NAMES, "choices": choices,
        "axes": {"plant.mass_kg": {"values": [1300.0, 1400.0, 1500.0]}},
    }))  # fmt: skip
    assert made.runs == 12
    found = {tuple(sorted(made.values_of(run).items())) for run in range(12)}
    assert len(found) == 12
    for one, other in combinations([dict(each) for each in found], 2):
        assert one != other
    assert Counter(dict(each)["scenario"] for each in found) == dict.fromkeys(NAMES, 6)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"scenario": []}, "scenario = []: must have at least one scenario"),
        ({"scenario": ["default", "nowhere"]}, "scenario nowhere: no such scenario"),
        ({"scenario": [3]}, "scenario.0 = 3: must be a valid string"),
        ({"choices": {"fault.0": {}}}, "choices.fault.0: must have at least one alternative"),
        ({"choices": {"fault.0": 3}}, "choices.fault.0 = 3: must be a table"),
        ({"choices": {"fault.0": {"x": 3}}}, "choices.fault.0.x = 3: must be a table"),
        ({"choices": {"fault.1": "fault.0"}}, "choices.fault.1 = 'fault.0': must be alternatives"),
        ({"choices": {"fault.0": {"x": {"kind": "dead"}}}}, "must be one of"),
        ({"choices": {"fault.0": {"x": {"knd": "none"}}}}, "knd: unknown key; did you mean kind?"),
        ({"choices": {"fauld.0": {"x": {"kind": "none"}}}}, "fauld: unknown key; did you mean"),
        ({"choices": {"fault.7": {"x": {"kind": "none"}}}},
         'campaign some: fault.7.kind="none": must be a key of fault.0 or fault.1'),
        ({"choices": {"fault.0": {"x": {"kind": ["none"]}}}},
         "choices.fault.0.x.kind = ['none']: must be a table, as { values = ['none'] }"),
        ({"axes": {"seed": {"values": [[1]]}}},
         "axes.seed.values.0 = [1]: must be a number, a text, true or false"),
        ({"axes": {"seed": {"range": [1, 2, 3]}}},
         "axes.seed.range = [1, 2, 3]: must have at most 2 values"),
        ({"choices": {"fault.0": {"x": {"kind": {"vales": ["none"]}}}}}, "vales: unknown key; did"),
        ({"choices": {"fault.0": {"x": {"at_s": {"range": [1.0, 2.0], "points": 3}}}}},
         "choices.fault.0.x.at_s.points: must not be set in a choice"),
        ({"axes": {"fault.0.kind": {"values": ["none"]}}},
         "axes.fault.0.kind: must not stand beside the same key of a choice"),
        ({"axes": {"fault.at_s": {"range": [1.0, 2.0]}}}, "fault.at_s: must have a number, as"),
        ({"axes": {"duration_s": {"values": [4.0], "plus": "fault.0.kind"}}},
         "plus = 'fault.0.kind': must be a key with a number"),
        ({"axes": {"duration_s": {"values": [4.0], "plus": "nothing"}}},
         "plus = 'nothing': must be a key with a number in each run; there it is None"),
        ({"axes": {"duration_s": {"values": [4.0], "per": "latency_ticks"}},
          "settings": {"latency_ticks": 0}}, "per = 'latency_ticks': must not be 0"),
        ({"axes": {"duration_s": {"values": [4.0], "plus": "fault.0.at_s"},
                   "fault.0.at_s": {"values": [4.0], "plus": "tick_s"}}},
         "fault.0.at_s: must be a key whose value depends on no other key"),
        ({"axes": {"reference.kind": {"values": ["step"], "either_sign": True}}},
         "values: 'step': must be a number beside either_sign"),
        ({"sampling": "grid", "runs": None}, 'offset: must be one value for sampling = "grid"'),
        ({"tables": {"t": {}}}, "tables.t.rows: must be set"),
        ({"tables": {"t": {"rows": "fault.0", "colums": "verdict"}}}, "colums: unknown key; did"),
        ({"tables": {"t": {"rows": "verdikt"}}}, "tables.t.rows = 'verdikt': must be a metric, or"),
        ({"tables": {"t": {"rows": "fault.0", "columns": "x"}}}, "tables.t.columns = 'x': must be"),
        ({"tables": {"t": {"rows": "fault.0", "metrics": ["verdict"]}}},
         "tables.t.metrics: 'verdict': must be a metric that is a number"),
    ],
)  # fmt: skip
def test_what_makes_no_campaign_is_named_in_a_line(values, line):
    with refuses(line):
        require_tables(planned(**values))


def test_a_campaign_begins_from_a_shipped_one(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text('extends = "restarts"\nruns = 7\n[settings]\nplant.speed_mps = 12.0\n')
    mine, base = read_campaign(str(file)), read_campaign("restarts")
    assert (mine.runs, mine.name, mine.choices) == (7, "mine", base.choices)
    assert mine.settings == {**base.settings, "plant": {"speed_mps": 12.0}}
    for text, line in (
        ('extends = "restart"', "extends = 'restart': must be a shipped campaign"),
        ("extends = 3", "extends = 3: must be the name of a campaign"),
    ):
        file.write_text(text)
        with pytest.raises(ScenarioError, match=re.escape(line)):
            read_campaign(str(file))
    assert "double-faults" in shipped()


def test_no_requirement_is_about_words():
    with pytest.raises(ScenarioError, match="verdict: no such metric"):
        from can_rig.campaigns.rows import requirements_of

        requirements_of(planned(requirements={"said": "verdict == 1"}))


COLUMNS: dict[str, list[Any]] = {
    "run": [0, 1, 2, 3, 4], "simulated_s": [3600.0] * 5, "false_alarms": [0, 1, 2, None, 0],
    "command": list("abcde"), "fault.0": ["late", "nothing", "late", "offset", "late"],
    "verdict": ["NOTHING", "NOTHING", "TORQUE_LOST", None, "NOTHING"],
    "astray_m": [0.1, 0.2, 0.9, None, 0.4],
    "passed.near": [True, True, False, None, False], "margin.near": [0.5, 0.4, -2.0, None, -0.1],
}  # fmt: skip


def test_a_table_counts_each_run_once():
    near = Requirement("near", "astray_m <= 0.3", ["astray_m"])
    tables = {"t": {"rows": "fault.0", "columns": "verdict", "metrics": ["astray_m"]}}
    found = cross("t", planned(tables=tables).settings, [near], COLUMNS)
    assert [row.name for row in found.rows] == ["nothing", "offset", "late"]  # as in the file
    assert sum(row.runs for row in found.rows) == 5
    assert sum(sum(row.counts.values()) for row in found.rows) == 5
    late = found.rows[2]
    assert late.counts == {"NOTHING": 2, "TORQUE_LOST": 1}
    assert (late.hours, late.false_alarms) == (3.0, 2)
    assert (late.rates[0].passed, late.rates[0].failed) == (1, 2)
    worst = late.worst["near"]
    assert (worst.run, worst.margin, worst.values) == (2, -2.0, {"astray_m": 0.9})
    assert worst.command == "c"
    assert (late.spreads[0].median, late.spreads[0].greatest) == (0.4, 0.9)
    assert found.rows[1].worst == {} and found.rows[1].spreads == []


def test_false_alarms_an_hour_are_of_the_hours_in_which_one_can_begin():
    """Of four hours the torque is lost in two, and one more has no count."""
    names = ("run", "command", "false_alarms", "simulated_s", "fault.0")
    columns = {name: COLUMNS[name] for name in names}
    healthy = {"torque_healthy_s": [1800.0, 1800.0, 1800.0, 3600.0, 1800.0]}
    shown = {name: [None] * 5 for name in ("failure", "margin", *ALWAYS_SHOWN)}
    found = summarise(planned(runs=5), [], columns | healthy | shown)
    alarms = found.false_alarms
    assert (found.hours, alarms["hours"], alarms["per_hour"]) == (5.0, 2.0, 1.5)
    assert alarms["high"] == pytest.approx(chi2.ppf(0.975, 8) / 2.0 / 2.0)


def test_many_numbers_are_eight_rows_and_few_are_their_own():
    names = parts_by_name([float(value) for value in range(80)])
    assert Counter(Counter(names).values()) == {10: 8}
    assert names[0] == "0 to 9" and names[79] == "70 to 79"
    assert parts_by_name([2, None, 3, 2]) == ["2", "-", "3", "2"]
    assert parts_by_name([True, False]) == ["True", "False"]


def test_faults_of_further_sensors_are_drawn_where_the_scenario_has_the_sensor():
    made = plan(read_campaign("faults", scenario=["default", "cluster"]))
    places: dict[str, set[str | None]] = {"default": set(), "cluster": set()}
    for run in range(400):
        values = made.values_of(run)
        (fault,) = made.scenario_of(run).fault
        places[str(values["scenario"])] |= {fault.channel, fault.other}
    assert places["default"] & {*MEASURED} == set()
    assert places["cluster"] >= {*MEASURED}
