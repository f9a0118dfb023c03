"""The file behind a scenario's name, and the error for a missing file."""

from pathlib import Path

import pytest

from can_rig.errors import ScenarioError
from can_rig.scenario.loading import load


def test_no_such_scenario():
    with pytest.raises(ScenarioError, match="did you mean thesis-step"):
        load("thesis-stp")
    with pytest.raises(ScenarioError, match="shipped ones: chapter-2"):
        load("zzzzzz")
    with pytest.raises(ScenarioError, match="no such scenario and no such file"):
        load("none.toml")


@pytest.mark.parametrize("name", [".", "/dev/null"])
def test_what_is_there_but_no_file_is_said_to_be_none(name):
    with pytest.raises(
        ScenarioError, match=f"^scenario {name}: not a file; must be a TOML file or a ship"
    ):
        load(name)


def test_a_file_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("seed = 7\n", encoding="utf-8-sig")
    assert load(str(path)).seed == 7


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that cannot be read")
def test_a_file_that_cannot_be_read():
    with pytest.raises(ScenarioError, match=r"not readable as TOML: .*Input/output error"):
        load("/proc/self/mem")


@pytest.mark.parametrize(
    ("text", "line"),
    [('[plant]\nkind = "fmu:"\n', "plant.kind = 'fmu:': must be .*fmu:FILE.fmu"),
     ('[fault]\nkind = "sensor-biased"\nvalue = 0.5\n',
      "fault.value = 0.5: has no effect for 'sensor-biased'; must be fault.bias_mps2"),
     ('[fault]\nkind = "sensor-biased"\nchannel = "yaw-rate"\nvalue = 0.5\n',
      "fault.value = 0.5: has no effect for 'sensor-biased'; must be fault.offset"),
     ('[[fault]]\nkind = "actuator-dead"\nvalue = 0.5\n', "must be fault.0.left"),
     ('[reference]\nkind = "csv"\nfile = ""\n', "reference.file: must name the CSV file")],
)  # fmt: skip
def test_a_file_without_a_name_is_not_the_scenarios_folder(tmp_path, text, line):
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(ScenarioError, match=line):
        load(str(tmp_path / "x.toml"))


def test_a_csv_is_found_beside_its_scenario_or_from_where_one_is(tmp_path):
    (tmp_path / "x.toml").write_text('[reference]\nkind = "csv"\nfile = "r.csv"\n')
    assert load(str(tmp_path / "x.toml")).reference.file == str(tmp_path / "r.csv")
    scenario = load(str(tmp_path / "x.toml"), ["reference.file=here.csv"])
    assert scenario.reference.file == "here.csv"


def test_a_biased_further_sensor_reads_too_much_by_the_offset_in_the_file(tmp_path):
    (tmp_path / "mine.toml").write_text(
        '[[fault]]\nkind = "sensor-biased"\nchannel = "yaw-rate"\noffset = 0.05\n'
        '[[sensor]]\nmeasures = "yaw-rate"\n'
    )
    assert load(str(tmp_path / "mine.toml")).faults[0].bias == 0.05
