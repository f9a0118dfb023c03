"""One fault is a table, several are a list: from a file, from ``--set``, from Python, and back."""

import pytest
from hypothesis import given, strategies as st

from can_rig.campaigns.plan import Base
from can_rig.campaigns.settings import campaign_of
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import as_settings, load, load_run, value_in, written
from can_rig.views.diff import differing_settings

LIST = """
duration_s = 0.5
[[fault]]
kind = "sensor-drift"
at_s = 0.1
drift_per_s = 0.2
[[fault]]
kind = "actuator-dead"
channel = "force-difference"
left = 0.5
"""


@pytest.fixture
def several(tmp_path):
    file = tmp_path / "several.toml"
    file.write_text(LIST)
    return str(file)


def test_a_list_is_read_in_its_order(several):
    drift, dead = load(several).faults
    assert (drift.kind, drift.at_s, drift.drift_per_s) == ("sensor-drift", 0.1, 0.2)
    assert (dead.kind, dead.place, dead.left) == ("actuator-dead", "force-difference", 0.5)


def test_a_table_is_the_list_of_one():
    one = load("default", ["fault.at_s=3"])
    same = load("default", ["fault.0.at_s=3"])
    listed = load("default", ['fault=[{kind="actuator-dead", channel="torque", at_s=3}]'])
    assert one == same == listed
    assert isinstance(one.as_dict()["fault"], dict)


def test_a_setting_changes_the_fault_of_its_number(several):
    changed = load(several, ["fault.1.at_s=0.3", "fault.2.kind=frames-missing"])
    assert [fault.at_s for fault in changed.faults] == [0.1, 0.3, 10.0]
    assert [fault.kind for fault in changed.faults][2] == "frames-missing"
    two = load("default", ["fault.1.kind=sensor-stuck", "fault.1.at_s=12"])
    assert [fault.kind for fault in two.faults] == ["actuator-dead", "sensor-stuck"]


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("fault.at_s=3", r"--set fault.at_s=3: must be a key of fault.0, fault.1 or fault.2"),
        ("fault.4.at_s=3", r"--set fault.4.at_s=3: must be a key of fault.0, fault.1 or fault.2"),
        ("fault.1=3", r"--set fault.1=3: must be a key of fault.0, fault.1 or fault.2"),
        ("fault.1.at_s=-1", r"fault.1.at_s = -1: must be at least 0"),
        ("fault.1.att_s=1", r"fault.1.att_s: unknown key; did you mean at_s\?"),
        ("fault.1.kind=actuator-offset", r"fault.1.offset: must be set for 'actuator-offset'"),
        ("fault=3", r"fault = 3: must be a "),
        ("fault.0.kind=actuator-ded", r"must be one of 26 words, as 'actuator-dead'"),
    ],
)
def test_what_is_wrong_is_named_with_its_number(several, setting, said):
    with pytest.raises(ScenarioError, match=said):
        load(several, [setting])


def test_what_is_recorded_is_read_back(several):
    for scenario in (load(several), load("default"), load("default").healthy):
        again = load_run(scenario.as_dict())
        assert again.fault == scenario.fault


@given(at_s=st.floats(0, 1e6), left=st.floats(0, 1, exclude_max=True), late=st.integers(1, 1000))
def test_a_list_of_tables_from_python_is_exact(at_s, left, late):
    faults = [
        {"kind": "actuator-dead", "at_s": at_s, "left": left},
        {"kind": "sensor-late", "late_ticks": late},
    ]
    dead, slow = load("default", as_settings({"fault": faults})).faults
    assert (dead.at_s, dead.left, slow.late_ticks) == (at_s, left, late)


def test_an_axis_may_be_of_any_fault(several):
    scenario, default = load(several).as_dict(), load("default").as_dict()
    assert value_in(scenario, "fault.0.drift_per_s") == 0.2
    base = Base(campaign_of("some", {"scenario": several, "runs": 1}), written(several))
    assert base.has("fault.1.left")
    assert not base.has("fault.2.left")
    assert not base.has("fault.left")
    assert value_in(default, "fault.0.at_s") == value_in(default, "fault.at_s") == 10


def test_a_difference_names_the_fault(several):
    (found,) = differing_settings(load(several), load(several, ["fault.1.left=0.25"]))
    assert str(found) == "fault.1.left: 0.5 → 0.25"


def test_a_fault_that_never_occurs_is_noted_among_others(several):
    (note,) = load(several).notes
    assert note == "note: the fault (actuator-dead at 10 s) never occurs: the run ends at 0.5 s"
