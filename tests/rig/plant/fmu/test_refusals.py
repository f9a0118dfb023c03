"""Refusals in a line each: no FMU, no binary for this machine, missing variables."""

import re
import zipfile
from pathlib import Path

import pytest

from can_rig.errors import ScenarioError
from can_rig.plant.protocol import load_plant
from can_rig.scenario.loading import load_values
from tests.rig.plant.fmu.building import TOKEN, build, description, pack

NAMES = {"input_1": "u1", "input_2": "u2", "output": "y"}


def line_of(plant: dict) -> str:
    """The line that refuses a run of ``plant``."""
    with pytest.raises(ScenarioError) as caught:
        settings = load_values("mine", {"plant": plant}).plant
        load_plant(settings.kind, settings)
    assert "\n" not in str(caught.value)
    return str(caught.value)


VARIABLES = {  # variables, parameters, line
    "no output": ({"output": ""}, {}, "scenario mine: plant.variables.output: must be set, as the"),
    "misspelt": ({"output": "Y"}, {}, "plant.variables.output = 'Y': the FMU has no such variable"),
    "misspelt, near": ({"input_1": "u11"}, {}, "plant.variables.input_1 = 'u11': .*; did you mean"),
    "no input": ({"input_2": "y"}, {},
     "input_2 = 'y': must be an input of the FMU, not an output;"),
    "no output but an input": ({"output": "u1"}, {},
     "output = 'u1': must be an output of the FMU, not an input"),
    "no output but a parameter": ({"output": "gain"}, {}, "an output of the FMU, not a parameter$"),
    "one for both": ({"input_2": "u1"}, {}, "must be another variable than input_1; it has"),
    "parameter": ({"input_1": "gain"}, {}, r"not a parameter; it has u1, u2, w$"),
    "whole": ({"output": "bounces"}, {},
     "'bounces': must be a floating-point number of the FMU, not an I"),
    "text": ({"name_": "name"}, {},
     "plant.variables.name_ = 'name': must be a number of the FMU, not"),
    "taken": ({"dstar_mps2": "y"}, {}, "'dstar_mps2' must be a name that no other column has, of"),
    "no name": ({"yaw rate": "y"}, {}, "plant.variables.yaw rate = 'y': 'yaw rate' must be a name"),
    "number": ({"y": 1}, {}, r"scenario mine: plant\.variables\.y = 1: must be a valid string"),
    "no parameter": ({}, {"gian": 1},
     "plant.parameters.gian = 1: .* no such variable; did you mean"),
    "far": ({}, {"mass": 1}, r"mass = 1: .*; it has gain, wall.at, switch_s, fail_s, on, name$"),
    "computed": ({}, {"y": 1.0},
     "y = 1.0: must be a parameter that can be set, not an output that"),
    "state": ({}, {"x[0]": 1.0}, r"x\[0\] = 1.0: must be a parameter that can be set, not a local"),
    "both": ({}, {"u1": 1.0}, "plant.variables.input_1 = 'u1': must not stand in plant.parameters"),
    "text for a number": ({}, {"gain": "2"},
     "plant.parameters.gain = '2': must be a number; it is"),
    "true for a number": ({}, {"gain": True}, "gain = True: must be a number; it is of type"),
    "number for true": ({}, {"on": 1}, "plant.parameters.on = 1: must be true or false; it is of"),
    "number for text": ({}, {"name": 1},
     "plant.parameters.name = 1: must be a text; it is of type"),
    "list": ({}, {"gain": [1]},
     r"plant.parameters.gain = \[1\]: must be a number, a text, true or"),
    "nested": ({}, {"wall": {"at": "x"}},
     "plant.parameters.wall.at = 'x': must be a number; it is"),
    "its own": ({}, {"name": "bad"},
     r"start: fmi\dSetString failed .*; the FMU says: no such name$"),
}  # fmt: skip


@pytest.mark.parametrize(("variables", "parameters", "line"), VARIABLES.values(), ids=VARIABLES)
def test_what_the_scenario_names_and_the_fmu_has_not(variables, parameters, line, cars):
    kind = f"fmu:{cars[3]}"
    plant = {"kind": kind, "variables": NAMES | variables, "parameters": parameters}
    assert re.search(line, line_of(plant))


CHANGES = {  # in the description of FMI 2, line
    "no XML": ({"<?xml": "<xml"}, "must be an FMU: "),
    "FMI 1": ({'"2.0"': '"1.0" modelIdentifier="x" numberOfContinuousStates="0"'},
     "is of FMI 1.0: must be of FMI 2 or 3$"),
    "FMI 4": ({'"2.0"': '"4.0"'}, "must be an FMU: Unsupported FMI version: 4.0$"),
    "no version": ({'fmiVersion="2.0"': ""},
     "must be an FMU: modelDescription.xml does not say of which"),
    "no variables": ({"ModelVariables>": "Other>"},
     "must be an FMU: modelDescription.xml: .*Other"),
    "other token": ({TOKEN: "{1}"}, "does not start: Failed to instantiate.*says: wrong token$"),
    "other library": ({'CoSimulation modelIdentifier="linear"': 'CoSimulation modelIdentifier="x"'},
     r"must have binaries/linux64/x\.so, and it has binaries for linux64; `fmpy co"),
    "neither": (
        {
            '<CoSimulation modelIdentifier="linear"/>': "",
            '<ModelExchange modelIdentifier="linear"/>': "",
        },
        "must be for co-simulation or",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def library(cars, tmp_path_factory):
    folder = tmp_path_factory.mktemp("library")
    with zipfile.ZipFile(cars[2]) as fmu:
        name = next(name for name in fmu.namelist() if name.endswith("linear.so"))
        return Path(fmu.extract(name, folder))


@pytest.mark.parametrize(("changes", "line"), CHANGES.values(), ids=CHANGES)
def test_a_description_that_does_not_fit(changes, line, library, tmp_path):
    path = pack(tmp_path / "car.fmu", 2, library, description(2, 4), changes)
    refused = line_of({"kind": f"fmu:{path}", "variables": NAMES})
    assert refused.startswith(f"plant.kind = 'fmu:{path}': ")
    assert re.search(line, refused)


def test_the_other_type_of_fmi(library, tmp_path):
    changes = {'<ModelExchange modelIdentifier="linear"/>': ""}
    path = pack(tmp_path / "car.fmu", 2, library, description(2, 4), changes)
    plant = {"kind": f"fmu:{path}", "variables": NAMES, "fmi_type": "model-exchange"}
    assert line_of(plant).startswith(
        "plant.fmi_type = 'model-exchange': must be co-simulation, for"
    )
    assert "must be 'co-simulation' or 'model-exchange'" in line_of(plant | {"fmi_type": "cs"})


FILES = {  # a name in the FMU and what is in it, line
    "no description": ({"a.txt": b""}, "must be an FMU: there is no modelDescription.xml in it$"),
    "no binary": ({"modelDescription.xml": None},
     r"linux64/linear\.so, and it has no binaries; `fmpy"),
    "Windows": ({"modelDescription.xml": None, "binaries/win64/linear.dll": b""},
     "it has binaries for win64;"),
    "no library": ({"modelDescription.xml": None, "binaries/linux64/linear.so": b"MZ"},
     "does not start: Failed to load shared library binaries/linux64/linear.so. binari"),
    "a path out of it": (
        {"modelDescription.xml": None, "binaries/linux64/linear.so": b"MZ", "/etc/x": b""},
        "does not start: it holds the path '/etc/x', which must stay in the FMU's folder$",
    ),
    "a path up and out of it": (
        {"modelDescription.xml": None, "binaries/linux64/linear.so": b"MZ", "a/../../x": b""},
        r"does not start: it holds the path 'a/\.\./\.\./x', which must stay",
    ),
    "more than fits": (
        {"modelDescription.xml": None, "binaries/linux64/linear.so": bytes(65 << 20)},
        "does not start: it unpacks to more than 64 MiB; at most 100 times its own size and 512",
    ),
    "a description that is larger": ({"modelDescription.xml": bytes(65 << 20)},
     "must be an FMU: modelDescription.xml is larger than 64 MiB$"),
    "many files": (
        {"modelDescription.xml": None, "binaries/linux64/linear.so": b"MZ"}
        | {f"{n}": b"" for n in range(10_000)},
        "does not start: it holds more than 10000 files$",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("files", "line"), FILES.values(), ids=FILES)
def test_a_file_that_does_not_fit(files, line, tmp_path):
    path = tmp_path / "car.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as fmu:
        for name, content in files.items():
            fmu.writestr(name, description(2, 4) if content is None else content)
    refused = line_of({"kind": f"fmu:{path}", "variables": NAMES})
    assert refused.startswith(f"plant.kind = 'fmu:{path}': ")
    assert re.search(line, refused)
    assert str(tmp_path / "temporary") not in refused


def test_no_file_no_zip_and_a_folder(tmp_path):
    (tmp_path / "car.fmu").write_bytes(b"PK but no more")
    for name, reason in (
        ("none.fmu", "there is no such file"),
        ("car.fmu", "must be an FMU: File is not a zip file"),
        ("temporary", "there is no such file"),
    ):
        refused = line_of({"kind": f"fmu:{tmp_path / name}", "variables": NAMES})
        assert refused.startswith(f"plant.kind = 'fmu:{tmp_path / name}': {reason}")


OTHERS = {
    "no file name": ({"kind": "fmu:"},
     "plant.kind = 'fmu:': must be steer-by-wire, .*fmu:FILE.fmu"),
    "no variables": ({"kind": "fmu:a.fmu"}, "plant.variables.input_1: must be set, as the name of"),
    "another kind": ({"variables": NAMES}, "variables: must not be set for kind = 'steer-by-wire'"),
    "a class": ({"kind": "a:B", "fmi_type": "co-simulation"},
     "fmi_type: must not .*; only fmu:FILE"),
    "half the numbers": ({"kind": "fmu:a.fmu", "variables": NAMES, "a": [[-1]]},
     "b: must be set for"),
    "two sorts": (
        {
            "kind": "fmu:a.fmu",
            "variables": NAMES,
            "a": [[-1]],
            "b": [[1, 1]],
            "c": [1],
            "g1": {"num": [1], "den": [1, 1]},
        },
        "g1: must not be set beside a, b, c for",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("plant", "line"), OTHERS.values(), ids=OTHERS)
def test_keys_that_do_not_fit_an_fmu(plant, line):
    assert re.search(line, line_of(plant))


def test_a_tick_that_its_own_fixed_step_does_not_divide(tmp_path, library):
    build(
        tmp_path / "fixed.fmu",
        3,
        [[-1.0]],
        [[1.0, 0.0]],
        [1.0],
        {"<CoSimulation ": '<CoSimulation fixedInternalStepSize="0.01" '},
    )
    own = {"kind": f"fmu:{tmp_path / 'fixed.fmu'}", "variables": NAMES}
    settings = load_values("x", {"plant": own}).plant
    plant = load_plant(settings.kind, settings)
    plant.advance(0.02, 1.0, 0.0)
    with pytest.raises(Exception, match=r"a step of 0\.015 s must be a multiple of 0\.01 s"):
        plant.advance(0.015, 1.0, 0.0)
