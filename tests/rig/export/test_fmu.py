"""The exported FMU: in FMPy, in the rig bit for bit, and built again from its own sources."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

import can_rig
from can_rig.errors import ExportError, LogError
from can_rig.export.fmu import write_fmu
from can_rig.results.run_folder import LOG
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from firmware_model.firmware import Firmware
from tests.helpers import asked
from tests.rig.export.shared import STRICT, run

SAME = (
    "reference", "measurement", "command_1", "command_2", "fault_estimate", "mode", "fault_state",
    "verdict",
)  # fmt: skip
SHORT: dict[str, object] = {"duration_s": 0.6, "fault.at_s": 0.3}
CASES: dict[str, tuple[str, dict[str, object]]] = {
    "double": ("default", SHORT),
    "single": ("default", {**SHORT, "design.precision": "float32"}),
    "drive": ("drive-cycle", SHORT),
    "pendulum": ("pendulum", SHORT),
}
REFERENCES = {name: at for at, name in enumerate(("reference", "measurement"), 1)}
COMMANDS = [4, 5]


@pytest.mark.parametrize("case", CASES)
def test_the_rig_runs_it_bit_for_bit(case: str, tmp_path: Path) -> None:
    ours = can_rig.load_scenario(*CASES[case])
    path = write_fmu(ours, tmp_path, force=False)
    assert validate_fmu(str(path)) == []
    variables = {name: name for name in SAME}
    if ours.drive.is_given:
        variables["speed_mps"] = "speed_mps"
    fmu = {"controller": {"kind": f"fmu:{path}", "variables": variables}}
    runs = [can_rig.run(ours), can_rig.run(ours, fmu, allow_unstable=True)]
    logs = [(each.folder / LOG).read_bytes() for each in runs]
    assert logs[0] == logs[1]
    assert (runs[1].table.columns["mode"] == 1).any()


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fmu(can_rig.load_scenario("default"), tmp_path_factory.mktemp("fmu"), force=False)


def instance_of(path: Path, folder: Path) -> FMU3Slave:
    model = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), str(folder))
    return FMU3Slave(
        guid=model.instantiationToken,
        unzipDirectory=str(folder),
        modelIdentifier=model.coSimulation.modelIdentifier,
    )


def started(fmu: Any) -> Any:
    fmu.instantiate()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu


def test_a_step_of_several_ticks_holds_the_inputs(exported: Path, tmp_path: Path) -> None:
    scenario = can_rig.load_scenario("default")
    one, many = (started(instance_of(exported, tmp_path / name)) for name in ("one", "many"))
    firmware = Firmware(controller_table(scenario, network_of(scenario)))
    firmware.reset(0.0)
    for at, (reference, measured) in enumerate(np.random.default_rng(1).standard_normal((50, 2))):
        for fmu in (one, many):
            fmu.setFloat64([*REFERENCES.values()], [reference, measured])
        for tick in range(3):
            one.doStep(0.003 * at + 0.001 * tick, 0.001)
            said = firmware.step(reference, measured)
        many.doStep(0.003 * at, 0.003)
        assert one.getFloat64(COMMANDS) == many.getFloat64(COMMANDS) == [*said[:2]]
    with pytest.raises(FMICallException):
        one.doStep(1.0, 0.0004)
    one.reset()
    assert one.getFloat64(COMMANDS) == [0.0, 0.0]
    for fmu in (one, many):
        fmu.terminate()
        fmu.freeInstance()


def test_the_sources_within_build_without_a_warning(exported: Path, tmp_path: Path) -> None:
    fmpy.extract(str(exported), str(tmp_path))
    build = Xml.parse(tmp_path / "sources" / "buildDescription.xml").getroot()
    units = [each.get("name") for each in build.iter("SourceFile")]
    flags = [*STRICT, "-fPIC", "-shared", "-ffp-contract=off", "-lm", "-o", tmp_path / "again.so"]
    run("cc", *(tmp_path / "sources" / str(unit) for unit in units), *flags)
    assert {"fmu.c", "firmware.c", "controller.c"} <= set(units)


def test_the_same_controller_is_the_same_file(exported: Path, tmp_path: Path) -> None:
    again = write_fmu(can_rig.load_scenario("default"), tmp_path / "new" / "folder", force=False)
    assert again.read_bytes() == exported.read_bytes()
    with zipfile.ZipFile(again) as fmu:
        text = fmu.read("modelDescription.xml").decode()
    assert 'unit="N m"' in text


def test_it_is_refused_in_one_line(exported: Path) -> None:
    with pytest.raises(LogError, match="exists; choose another"):
        write_fmu(can_rig.load_scenario("default"), exported.parent, force=False)
    with pytest.raises(ExportError, match="cannot be made"):
        write_fmu(can_rig.load_scenario("default"), exported / "below", force=False)
    done = asked("export", "default", "--fmu", "--evidence", "--out", exported.parent)
    assert done.returncode == 2
    assert "--fmu and --evidence do not go together" in done.stderr
    done = asked("export", "default", "--fmu", "--force", "--out", exported.parent)
    assert done.returncode == 0, done.stderr
