"""The controller as an FMU of FMI 3.0 for co-simulation, with C sources and a binary."""

from __future__ import annotations

import platform
import re
import zipfile
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree as Xml

from can_rig.drawing.names import names_of
from can_rig.errors import ExportError
from can_rig.export.application import BY_HAND, application, identity
from can_rig.export.compiler import FLAGS, built, host_compiler
from can_rig.export.law import numbers_of, parts_of, support
from can_rig.files import atomic
from can_rig.scenario.settings import Scenario

OF_THE_NODE: Final = {
    name for name in (*BY_HAND, "network.c") if name.startswith(("e2e", "frames", "ecu", "network"))
}
"""Files of an application that a controller without frames does not need."""

TYPES: Final = (
    "Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Boolean",
    "String", "Binary", "Clock",
)  # fmt: skip
REFUSED: Final = (
    *(f"{do}{kind}" for kind in TYPES for do in ("Get", "Set")), "SetInt32",
    "GetNumberOfVariableDependencies", "GetVariableDependencies", "GetFMUState", "SetFMUState",
    "FreeFMUState", "SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState",
    "GetDirectionalDerivative", "GetAdjointDerivative", "EnterConfigurationMode",
    "ExitConfigurationMode", "GetIntervalDecimal", "GetIntervalFraction", "GetShiftDecimal",
    "GetShiftFraction", "SetIntervalDecimal", "SetIntervalFraction", "SetShiftDecimal",
    "SetShiftFraction", "EvaluateDiscreteStates", "UpdateDiscreteStates", "EnterEventMode",
    "EnterStepMode", "GetOutputDerivatives", "EnterContinuousTimeMode", "CompletedIntegratorStep",
    "SetTime", "SetContinuousStates", "GetContinuousStateDerivatives", "GetEventIndicators",
    "GetContinuousStates", "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators",
    "GetNumberOfContinuousStates", "ActivateModelPartition",
)  # fmt: skip
"""Functions of the standard that need what the FMU lacks; they answer an error."""

CODES: Final = ("mode", "fault_state", "verdict")
FIRST_DAY: Final = (1980, 1, 1, 0, 0, 0)
"""The time stamp of every file: the same controller gives the same FMU."""


def write_fmu(scenario: Scenario, folder: Path, force: bool) -> Path:
    """Write ``FOLDER/SCENARIO.fmu``; returns the path.

    Raises:
        ScenarioError: the design fails.
        ExportError: no compiler, or a folder that cannot be made; as ``application``.
        LogError: the file exists and ``force`` is not given, or the file cannot be written.
    """
    node = application(scenario)
    name = re.sub(r"\W", "_", f"controller_{scenario.name}", flags=re.ASCII)
    token = identity(node).hex()
    sources = {file: text for file, text in node.items() if file not in OF_THE_NODE}
    sources["fmu.c"] = support(
        "fmu.c",
        parts_of(sources),
        scenario=scenario.name,
        tick=f"{scenario.tick_s * 1e3:g} ms",
        tick_s=repr(scenario.tick_s),
        token=token,
        **numbers_of(scenario.design.precision),
        refused="\n".join(f"ANSWERS(fmi3{function}, FMI_ERROR)" for function in REFUSED),
    )
    library = built(host_compiler(), (*FLAGS, "-fvisibility=hidden"), sources, ".so")
    path = folder / f"{scenario.name}.fmu"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(f"{folder}: cannot be made: {error.strerror}") from None
    with atomic(path, force=force) as part, zipfile.ZipFile(part, "w") as fmu:

        def add(file: str, content: str | bytes) -> None:
            entry = zipfile.ZipInfo(file, FIRST_DAY)
            fmu.writestr(entry, content, zipfile.ZIP_DEFLATED)

        add("modelDescription.xml", _description(scenario, name, token))
        add("sources/buildDescription.xml", _build_description(name, sorted(sources)))
        for file, text in sorted(sources.items()):
            add(f"sources/{file}", text)
        add(f"binaries/{platform.machine()}-linux/{name}.so", library.read_bytes())
    return path


def _description(scenario: Scenario, name: str, token: str) -> str:
    output, command_1, command_2 = names_of(scenario.plant)
    root = Xml.Element(
        "fmiModelDescription", fmiVersion="3.0", modelName=name, instantiationToken=token,
        description=f"The controller of scenario {scenario.name}", generationTool="can-rig",
    )  # fmt: skip
    tick = repr(scenario.tick_s)
    Xml.SubElement(
        root, "CoSimulation", modelIdentifier=name, fixedInternalStepSize=tick,
        canHandleVariableCommunicationStepSize="true",
    )  # fmt: skip
    units = Xml.SubElement(root, "UnitDefinitions")
    for unit in sorted({"s", "m/s", output.unit, command_1.unit, command_2.unit} - {""}):
        Xml.SubElement(units, "Unit", name=unit)
    Xml.SubElement(root, "DefaultExperiment", stepSize=tick, stopTime=repr(scenario.duration_s))
    variables = Xml.SubElement(root, "ModelVariables")
    Xml.SubElement(
        variables, "Float64", name="time", valueReference="0", causality="independent",
        variability="continuous", unit="s",
    )  # fmt: skip
    inputs = [("reference", output, f"wanted {output.name}"), ("measurement", output, output.name)]
    speed = output._replace(unit="m/s")
    if scenario.drive.is_given:
        inputs.append(("speed_mps", speed, "speed of the car"))
    for reference, (variable, signal, words) in enumerate(inputs, 1):
        start = repr(scenario.model.speed_mps) if variable == "speed_mps" else "0"
        Xml.SubElement(
            variables, "Float64", name=variable, valueReference=str(reference), causality="input",
            variability="discrete", start=start, description=words, **_unit(signal.unit),
        )  # fmt: skip
    structure = Xml.SubElement(root, "ModelStructure")
    outputs = [
        ("command_1", command_1.unit, command_1.name),
        ("command_2", command_2.unit, command_2.name),
        ("fault_estimate", output.unit, "fault estimate"),
        *((code, "", code.replace("_", " ")) for code in CODES),
    ]
    for reference, (variable, unit, words) in enumerate(outputs, 4):
        Xml.SubElement(
            variables, "Int32" if variable in CODES else "Float64", name=variable,
            valueReference=str(reference), causality="output", variability="discrete",
            description=words, **_unit(unit),
        )  # fmt: skip
        Xml.SubElement(structure, "Output", valueReference=str(reference))
    for reference in range(4, 4 + len(outputs)):
        Xml.SubElement(structure, "InitialUnknown", valueReference=str(reference))
    return _text(root)


def _unit(unit: str) -> dict[str, Any]:
    return {"unit": unit} if unit else {}


def _build_description(name: str, files: list[str]) -> str:
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    build = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    options = " ".join(each for each in FLAGS if each.startswith("-ff"))
    sources = Xml.SubElement(
        build, "SourceFileSet", language="C99", compiler="gcc", compilerOptions=options
    )
    for file in files:
        if file.endswith(".c"):
            Xml.SubElement(sources, "SourceFile", name=file)
    Xml.SubElement(build, "Library", name="m")
    return _text(root)


def _text(root: Xml.Element) -> str:
    Xml.indent(root)
    return Xml.tostring(root, "unicode", xml_declaration=True) + "\n"
