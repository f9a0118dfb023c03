"""FMUs of FMI 2.0 and 3.0 for co-simulation, from one set of C sources."""

from __future__ import annotations

import hashlib
import platform
import re
import zipfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Final, NamedTuple
from xml.etree import ElementTree as Xml

from can_rig.errors import ExportError
from can_rig.export.compiler import FLAGS, built, host_compiler
from can_rig.export.law import NODE, support
from can_rig.scenario.settings import Scenario
from can_rig.storage.files import atomic

TYPES_3: Final = (
    "Float32", "Int8", "UInt8", "Int16", "UInt16", "UInt32", "Int64", "UInt64", "Boolean",
    "String", "Binary", "Clock",
)  # fmt: skip
REFUSED: Final = {
    "2": (
        *(f"{do}{kind}" for kind in ("Boolean", "String") for do in ("Get", "Set")),
        "GetFMUstate", "SetFMUstate", "FreeFMUstate", "SerializedFMUstateSize",
        "SerializeFMUstate", "DeSerializeFMUstate", "GetDirectionalDerivative",
        "SetRealInputDerivatives", "GetRealOutputDerivatives", "CancelStep", "GetStatus",
        "GetRealStatus", "GetIntegerStatus", "GetBooleanStatus", "GetStringStatus",
    ),
    "3": (
        *(f"{do}{kind}" for kind in TYPES_3 for do in ("Get", "Set")),
        "GetNumberOfVariableDependencies", "GetVariableDependencies", "GetFMUState", "SetFMUState",
        "FreeFMUState", "SerializedFMUStateSize", "SerializeFMUState", "DeserializeFMUState",
        "GetDirectionalDerivative", "GetAdjointDerivative", "EnterConfigurationMode",
        "ExitConfigurationMode", "GetIntervalDecimal", "GetIntervalFraction", "GetShiftDecimal",
        "GetShiftFraction", "SetIntervalDecimal", "SetIntervalFraction", "SetShiftDecimal",
        "SetShiftFraction", "EvaluateDiscreteStates", "UpdateDiscreteStates", "EnterEventMode",
        "EnterStepMode", "GetOutputDerivatives", "EnterContinuousTimeMode",
        "CompletedIntegratorStep", "SetTime", "SetContinuousStates",
        "GetContinuousStateDerivatives", "GetEventIndicators", "GetContinuousStates",
        "GetNominalsOfContinuousStates", "GetNumberOfEventIndicators",
        "GetNumberOfContinuousStates", "ActivateModelPartition",
    ),
}  # fmt: skip
"""Functions of a version that need what the FMUs lack; they answer an error."""
EVENTS: Final = (
    "GetBinary", "SetBinary", "GetClock", "SetClock", "EnterEventMode", "EnterStepMode",
    "UpdateDiscreteStates",
)  # fmt: skip
"""Functions that a node on a bus has nevertheless."""

KINDS_3: Final = {"Real": "Float64", "Integer": "Int32"}
"""Types of FMI 3.0 by those of FMI 2.0."""
TICKS: Final = "ticks since the sample; negative: no valid sample in this step"
FIRST_DAY: Final = (1980, 1, 1, 0, 0, 0)
"""The time stamp of every file: the same model gives the same FMU."""

BASE_UNITS: Final[dict[str, dict[str, str]]] = {
    "s": {"s": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s²": {"m": "1", "s": "-2"},
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N m": {"kg": "1", "m": "2", "s": "-2"},
}
"""Exponents of the SI units; a unit of the user's has none."""


class Variable(NamedTuple):
    """A variable of a model."""

    name: str
    causality: str
    words: str = ""
    unit: str = ""
    start: str | None = None
    kind: str = "Real"
    most: str | None = None
    attributes: Mapping[str, str] = {}


class Model(NamedTuple):
    """What becomes an FMU: ``name`` is a name in C, ``scenario`` gives tick and duration.

    ``sources`` lack the files of every FMU. The order of ``variables`` is: real inputs, real
    outputs, whole parameters, whole outputs, others.
    """

    name: str
    words: str
    scenario: Scenario
    sources: Mapping[str, str]
    parts: Collection[str]
    variables: Sequence[Variable]
    files: Mapping[str, str] = {}

    @property
    def is_node(self) -> bool:
        """Whether the model sends and receives frames in events, which FMI 2.0 lacks."""
        return NODE in self.parts

    @property
    def versions(self) -> tuple[str, ...]:
        """Of FMI."""
        return ("3",) if self.is_node else ("2", "3")


def name_of(part: str, scenario: Scenario) -> str:
    """The name of a scenario's model, as C and file systems allow."""
    return re.sub(r"\W", "_", f"{part}_{scenario.name}", flags=re.ASCII)


def write_fmus(model: Model, folder: Path, force: bool) -> list[Path]:
    """Write ``FOLDER/fmi2/NAME.fmu`` and ``FOLDER/fmi3/NAME.fmu``; returns the paths.

    Both have the same sources and the same library, with the functions of both versions. A node on
    a bus is of FMI 3.0 alone.

    Raises:
        ExportError: no compiler, or a folder that cannot be made.
        LogError: a file exists and ``force`` is not given, or a file cannot be written.
    """
    name, (sources, token) = model.name, _sources(model)
    library = built(host_compiler(), (*FLAGS, "-fvisibility=hidden"), sources, ".so").read_bytes()
    places = {"2": "linux64", "3": f"{platform.machine()}-linux"}
    paths = []
    for version in model.versions:
        path = folder / f"fmi{version}" / f"{name}.fmu"
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ExportError(f"{path.parent}: cannot be made: {error.strerror}") from None
        contents: dict[str, str | bytes] = {
            "modelDescription.xml": _description(version, model, token, sources),
            **{f"sources/{file}": text for file, text in sorted(sources.items())},
            f"binaries/{places[version]}/{name}.so": library,
            **model.files,
        }
        if version == "3":
            contents["sources/buildDescription.xml"] = _build_description(name, sources)
        with atomic(path, force=force) as part, zipfile.ZipFile(part, "w") as fmu:
            for file, content in contents.items():
                fmu.writestr(zipfile.ZipInfo(file, FIRST_DAY), content, zipfile.ZIP_DEFLATED)
        paths.append(path)
    return paths


def _sources(model: Model) -> tuple[dict[str, str], str]:
    """All sources of an FMU, and the token that binds the description to them."""
    reals = [each for each in model.variables if each.kind == "Real"]
    wholes = [each for each in model.variables if each.kind == "Integer"]
    inputs = [each for each in reals if each.causality == "input"]
    parameters = [each for each in model.variables if each.causality == "parameter"]
    token = hashlib.sha256(repr((model.variables, sorted(model.sources.items()))).encode())
    texts = {
        "model": model.name,
        "token": token.hexdigest()[:16],
        "tick_s": repr(model.scenario.tick_s),
        "latency": str(model.scenario.latency_ticks),
        "references": ", ".join(["TIME", *(each.name.upper() for each in model.variables)]),
        "first_output": str(1 + len(inputs)),
        "reals": str(1 + len(reals)),
        "parameters": str(1 + len(reals) + len(parameters)),
        "values": str(1 + len(reals) + len(wholes)),
    }
    for version in model.versions:
        left = [each for each in REFUSED[version] if not (model.is_node and each in EVENTS)]
        lines = [f"ANSWERS(fmi{version}{function}, FMI_ERROR)" for function in left]
        texts[f"refused_{version}"] = "\n".join(lines)
    names = ("fmu.h", "fmu.c", *(f"fmi{version}.c" for version in model.versions))
    wrapper = {name: support(name, model.parts, **texts) for name in names}
    return {**model.sources, **wrapper}, texts["token"]


def _description(version: str, model: Model, token: str, sources: Collection[str]) -> str:
    """``modelDescription.xml`` of one version of FMI."""
    is_2, tick = version == "2", repr(model.scenario.tick_s)
    root = Xml.Element(
        "fmiModelDescription", fmiVersion=f"{version}.0", modelName=model.name,
        description=model.words, generationTool="can-rig",
        attrib={"guid" if is_2 else "instantiationToken": token},
    )  # fmt: skip
    kind = Xml.SubElement(
        root, "CoSimulation", modelIdentifier=model.name,
        canHandleVariableCommunicationStepSize="true",
    )  # fmt: skip
    if is_2:
        _source_files(Xml.SubElement(kind, "SourceFiles"), "File", sources)
    else:
        has_events = {"hasEventMode": "true"}
        kind.attrib |= has_events if model.is_node else {"fixedInternalStepSize": tick}
    units = Xml.SubElement(root, "UnitDefinitions")
    for unit in sorted({"s", *(each.unit for each in model.variables)} - {""}):
        parent = Xml.SubElement(units, "Unit", name=unit)
        if unit in BASE_UNITS:
            Xml.SubElement(parent, "BaseUnit", BASE_UNITS[unit])
    stop = repr(model.scenario.duration_s)
    Xml.SubElement(root, "DefaultExperiment", startTime="0", stopTime=stop, stepSize=tick)
    variables, structure = (Xml.SubElement(root, f"Model{of}") for of in ("Variables", "Structure"))
    _add(variables, is_2, 0, Variable("time", "independent", unit="s"))
    outputs = []
    for reference, variable in enumerate(model.variables, 1):
        _add(variables, is_2, reference, variable)
        if variable.causality == "output":
            outputs.append((reference, variable))
    for of, left_out in (("Output", ""), ("InitialUnknown", "Binary")):
        if is_2:  # counts from 1, with the time
            parent = Xml.SubElement(structure, f"{of}s")
            for reference, _ in outputs:
                Xml.SubElement(parent, "Unknown", index=str(reference + 1))
            continue
        for reference, variable in outputs:
            if variable.kind != left_out:
                Xml.SubElement(structure, of, valueReference=str(reference))
    return as_text(root)


def _add(variables: Xml.Element, is_2: bool, reference: int, variable: Variable) -> None:
    name, causality, words, unit, start, kind, most, attributes = variable
    variability = {"independent": "continuous", "parameter": "fixed"}
    common = {
        "name": name, "valueReference": str(reference), "causality": causality,
        "variability": variability.get(causality, "discrete"),
    }  # fmt: skip
    bounds = {} if most is None else {"min": "0", "max": most}
    typed = {"unit": unit} if unit else {}
    typed |= bounds | ({} if start is None else {"start": start})
    common |= {"description": words} if words else {}
    if is_2:
        Xml.SubElement(Xml.SubElement(variables, "ScalarVariable", common), kind, typed)
        return
    found = Xml.SubElement(variables, KINDS_3.get(kind, kind), {**common, **typed, **attributes})
    if kind == "Binary" and causality == "input":
        Xml.SubElement(found, "Start", value="")


def _build_description(name: str, sources: Collection[str]) -> str:
    root = Xml.Element("fmiBuildDescription", fmiVersion="3.0")
    build = Xml.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    options = " ".join(each for each in FLAGS if each.startswith("-ff"))
    files = Xml.SubElement(
        build, "SourceFileSet", language="C99", compiler="gcc", compilerOptions=options
    )
    _source_files(files, "SourceFile", sources)
    Xml.SubElement(build, "Library", name="m")
    return as_text(root)


def _source_files(parent: Xml.Element, tag: str, sources: Collection[str]) -> None:
    for file in sorted(sources):
        if file.endswith(".c"):
            Xml.SubElement(parent, tag, name=file)


def as_text(root: Xml.Element) -> str:
    """The XML file of ``root``, indented."""
    Xml.indent(root)
    return Xml.tostring(root, "unicode", xml_declaration=True) + "\n"
