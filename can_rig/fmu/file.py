"""An FMU's file: its model description with the scenario's names resolved, and its unpacking.

A ZIP archive may claim and hold anything, so the bounds count the bytes that come out.
"""

import zipfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final, NamedTuple

import fmpy
from fmpy.model_description import ValidationError, read_model_description
from fmpy.simulation import settable_in_initialization_mode, settable_in_instantiated

from can_rig.errors import ScenarioError, did_you_mean, one_line
from can_rig.logs.columns import TAKEN
from can_rig.scenario.plant_settings import FMU, flat

CO_SIMULATION: Final = "co-simulation"
MODEL_EXCHANGE: Final = "model-exchange"
BINARIES: Final = {"2": fmpy.platform, "3": fmpy.platform_tuple}
"""The folder of ``binaries/`` for this machine, by FMI version."""

REAL: Final = ("Real", "Float64", "Float32")
WHOLE: Final = ("Integer", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")
NUMBERS: Final = (*REAL, *WHOLE, "Boolean", "Enumeration")
GIVEN: Final = ("input", "parameter", "structuralParameter")  # what an FMU does not compute
SHOWN: Final = 8  # names in a message

DESCRIPTION: Final = "modelDescription.xml"
MEBIBYTE: Final = 1 << 20
LARGEST: Final = 512 * MEBIBYTE
"""Of all files together."""
LARGEST_DESCRIPTION: Final = 64 * MEBIBYTE
LARGEST_RATIO: Final = 100
"""Of all files together to the archive, once they are larger than a description may be."""
MOST_FILES: Final = 10_000


class Variable(NamedTuple):
    """A number of the FMU."""

    reference: int
    access: str
    """The type in the names of FMPy's ``get…`` and ``set…``."""


@dataclass(frozen=True)
class Request:
    """What a scenario asks of an FMU.

    Attributes:
        table: of the scenario, ``plant`` or ``controller``.
        kind: ``fmu:`` and the file.
        variables: the FMU's names by key.
        parameters: the FMU's parameters, in tables.
        inputs: the keys of the inputs, in their order.
        outputs: the keys of the outputs.
        fmi_type: the type to run; None: co-simulation where the FMU offers it.
        codes: the keys of outputs that may be whole numbers.
        at_rest: values of inputs at rest, by key; 0 for every other input.
    """

    table: str
    kind: str
    variables: Mapping[str, str]
    parameters: Mapping[str, Any]
    inputs: Sequence[str]
    outputs: Sequence[str]
    fmi_type: str | None = None
    codes: Collection[str] = ()
    at_rest: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Description:
    """The facts about an FMU that a run needs.

    Attributes:
        path: the FMU file.
        model: FMPy's description of it.
        co_simulation: whether the FMU integrates by its own solver.
        inputs: in the order of the request.
        outputs: by key.
        signals: the other recorded variables, by column name.
        parameters: values set before the start, by the FMU's names.
        at_rest: the inputs' values at rest.
    """

    path: Path
    model: Any
    co_simulation: bool
    inputs: tuple[Variable, ...]
    outputs: dict[str, Variable]
    signals: dict[str, Variable]
    parameters: dict[str, bool | int | float | str]
    at_rest: tuple[float, ...]


def describe(request: Request) -> Description:
    """The FMU of ``request``, with its variables and parameters.

    Raises:
        ScenarioError: no FMU, an FMU without a binary for this machine, or an unknown name.
    """
    path = Path(request.kind.removeprefix(FMU))
    if not path.is_file():
        raise _refused(request, "there is no such file")
    try:
        files = _files(path)
        model = _read(path)
    except Exception as error:  # FMPy raises any exception while reading a wrong file
        raise _refused(request, f"must be an FMU: {_why_not(error)}") from None
    version = str(model.fmiVersion)[:1]
    if version not in BINARIES:
        raise _refused(request, f"is of FMI {model.fmiVersion}: must be of FMI 2 or 3")
    co_simulation = _is_co_simulation(request, model)
    kind = model.coSimulation if co_simulation else model.modelExchange
    _refuse_other_machines(request, files, BINARIES[version], kind.modelIdentifier)
    names = _Names(request, model)
    inputs = tuple(names.number(key) for key in request.inputs)
    outputs = {key: names.number(key) for key in request.outputs}
    names.refuse_one_for_both()
    columns = [key for key in request.variables if key not in (*request.inputs, *request.outputs)]
    return Description(
        path=path,
        model=model,
        co_simulation=co_simulation,
        inputs=inputs,
        outputs=outputs,
        signals={key: names.number(key) for key in columns},
        parameters=names.parameters(),
        at_rest=tuple(request.at_rest.get(key, 0.0) for key in request.inputs),
    )


def _files(path: Path) -> list[str]:
    """The names of the files, of which a parser can read the description."""
    with zipfile.ZipFile(path) as archive, archive.open(DESCRIPTION) as source:
        if len(source.read(LARGEST_DESCRIPTION + 1)) > LARGEST_DESCRIPTION:
            most = f"{LARGEST_DESCRIPTION // MEBIBYTE} MiB"
            raise UnpackingError(f"{DESCRIPTION} is larger than {most}")
        return archive.namelist()


def _read(path: Path) -> Any:
    """FMPy's model description; the schema serves only to explain a failure."""
    try:
        return read_model_description(str(path), validate=False)
    except (AttributeError, KeyError, TypeError, ValueError):
        return read_model_description(str(path), validate=True)


def _why_not(error: Exception) -> str:
    if isinstance(error, AttributeError):  # FMPy's first look-up
        return "modelDescription.xml does not say of which version of FMI it is"
    if isinstance(error, ValidationError):
        return f"modelDescription.xml: {one_line(Exception(error.problems[0]))}"
    if isinstance(error, KeyError):
        return "there is no modelDescription.xml in it"
    return one_line(error)


def _is_co_simulation(request: Request, model: Any) -> bool:
    """Whether the FMU runs as co-simulation: by ``fmi_type``, or by preference if offered."""
    has = {
        CO_SIMULATION: model.coSimulation is not None,
        MODEL_EXCHANGE: model.modelExchange is not None,
    }
    wanted = request.fmi_type
    types = " or ".join(name for name, there in has.items() if there)
    if not types:
        raise _refused(request, f"must be for {CO_SIMULATION} or {MODEL_EXCHANGE}")
    if wanted and not has[wanted]:
        raise ScenarioError(
            f"{request.table}.fmi_type = {wanted!r}: must be {types}, for {request.kind}"
        )
    return has[CO_SIMULATION] if wanted is None else wanted == CO_SIMULATION


def _refuse_other_machines(
    request: Request, files: Collection[str], folder: str, name: str
) -> None:
    library = f"binaries/{folder}/{name}{fmpy.sharedLibraryExtension}"
    if library in files:
        return
    parts = [file.split("/") for file in files]
    folders = sorted({part[1] for part in parts if part[0] == "binaries" and len(part) > 2})
    there = f"it has binaries for {', '.join(folders)}" if folders else "it has no binaries"
    raise _refused(
        request, f"must have {library}, and {there}; `fmpy compile` makes it of an FMU's sources"
    )


class _Names:
    """The variables of an FMU by name, with the refusals of wrong names."""

    def __init__(self, request: Request, model: Any) -> None:
        self._request = request
        self._old = model.fmiVersion.startswith("2")
        self._variables = {variable.name: variable for variable in model.modelVariables}

    def number(self, key: str) -> Variable:
        """The variable of the request by its key."""
        name = self._request.variables[key]
        here = f"{self._request.table}.variables.{key} = {name!r}"
        is_input, is_output = key in self._request.inputs, key in self._request.outputs
        if not (is_input or is_output) and (key in TAKEN or not key.isidentifier()):
            raise ScenarioError(
                f"{here}: {key!r} must be a name that no other column has, of letters, digits and "
                "_, and end in its unit"
            )
        variable = self._find(here, name, "input" if is_input else None)
        if is_input and variable.causality != "input":
            raise ScenarioError(
                f"{here}: must be an input of the FMU, not {_a(variable.causality)}; it has "
                f"{self._some('input')}"
            )
        if is_output and variable.causality in GIVEN:
            raise ScenarioError(
                f"{here}: must be an output of the FMU, not {_a(variable.causality)}"
            )
        if is_input and variable.name in dict(flat(self._request.parameters)):
            raise ScenarioError(f"{here}: must not stand in {self._request.table}.parameters too")
        is_real = (is_input or is_output) and key not in self._request.codes
        allowed = REAL if is_real else NUMBERS
        if variable.type not in allowed or variable.shape:
            shape = " array" if variable.shape else ""
            wanted = "a floating-point number" if allowed is REAL else "a number"
            raise ScenarioError(
                f"{here}: must be {wanted} of the FMU, not {_a(variable.type + shape)}"
            )
        access = variable.type
        if access == "Enumeration":
            access = "Integer" if self._old else "Int64"
        return Variable(variable.valueReference, access)

    def refuse_one_for_both(self) -> None:
        """Refuse one variable for two inputs: the second value would overwrite the first."""
        variables, taken = self._request.variables, dict[str, str]()
        for key in self._request.inputs:
            other = taken.setdefault(variables[key], key)
            if other != key:
                raise ScenarioError(
                    f"{self._request.table}.variables.{key} = {variables[key]!r}: must be another "
                    f"variable than {other}; it has {self._some('input')}"
                )

    def parameters(self) -> dict[str, bool | int | float | str]:
        """The parameters of the request, after checks of settability and type."""
        given = dict(flat(self._request.parameters))
        for name, value in given.items():
            here = f"{self._request.table}.parameters.{name} = {value!r}"
            variable = self._find(here, name, "parameter")
            if not (
                settable_in_instantiated(variable) or settable_in_initialization_mode(variable)
            ):
                raise ScenarioError(
                    f"{here}: must be a parameter that can be set, not {_a(variable.causality)} "
                    f"that the FMU computes; it has {self._some('parameter')}"
                )
            if variable.causality == "structuralParameter" or variable.shape:
                raise ScenarioError(f"{here}: must be a scalar parameter that shapes no array")
            wanted = _wanted(variable.type, value)
            if wanted:
                raise ScenarioError(f"{here}: must be {wanted}; it is of type {variable.type}")
        return given

    def _find(self, here: str, name: str, causality: str | None) -> Any:
        if name not in self._variables:
            hint = did_you_mean(name, self._variables, f"it has {self._some(causality)}")
            raise ScenarioError(f"{here}: the FMU has no such variable; {hint}")
        return self._variables[name]

    def _some(self, causality: str | None) -> str:
        """The available names, in a few words."""
        names = [
            name
            for name, variable in self._variables.items()
            if causality in (None, variable.causality)
        ]
        more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
        return ", ".join(names[:SHOWN]) + more if names else f"no {causality or 'variable'}"


def _wanted(kind: str, value: object) -> str:
    """The expected type of a parameter; "" for a ``value`` of the right type."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if kind in REAL:
        return "" if is_number else "a number"
    if kind in WHOLE or kind == "Enumeration":
        return "" if isinstance(value, int) and is_number else "a whole number"
    if kind == "Boolean":
        return "" if isinstance(value, bool) else "true or false"
    if kind == "String":
        return "" if isinstance(value, str) else "a text"
    return "of another variable"


def _a(word: str) -> str:
    return f"an {word}" if word[0] in "aeiouAEIO" else f"a {word}"


def _refused(request: Request, reason: str) -> ScenarioError:
    return ScenarioError(f"{request.table}.kind = {request.kind!r}: {reason}")


class UnpackingError(Exception):
    """An archive beyond the bounds, or with a path that leads out of its folder."""


def unpack(path: Path, folder: Path) -> None:
    """The files of the archive ``path`` below ``folder``, which exists.

    Raises:
        UnpackingError: see there; some files may have been written.
        OSError, zipfile.BadZipFile: as of ``zipfile``.
    """
    bound = min(LARGEST, max(LARGEST_DESCRIPTION, LARGEST_RATIO * path.stat().st_size))
    with zipfile.ZipFile(path) as archive:
        if len(archive.infolist()) > MOST_FILES:
            raise UnpackingError(f"it holds more than {MOST_FILES} files")
        left = bound
        for member in archive.infolist():
            target = folder / _inside(member.filename)
            if member.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as file:
                while chunk := source.read(MEBIBYTE):
                    left -= len(chunk)
                    if left < 0:
                        raise UnpackingError(
                            f"it unpacks to more than {bound // MEBIBYTE} MiB; at most "
                            f"{LARGEST_RATIO} times its own size and {LARGEST // MEBIBYTE} MiB "
                            "are unpacked"
                        )
                    file.write(chunk)


def _inside(name: str) -> PurePosixPath:
    """A path of the archive that stays in the folder it is unpacked to."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name:
        raise UnpackingError(f"it holds the path {name!r}, which must stay in the FMU's folder")
    return path
