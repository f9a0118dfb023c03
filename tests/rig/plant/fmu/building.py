"""FMUs of a linear plant: ``linear.c`` compiled by this machine's compiler, and its description."""

import inspect
import shutil
import subprocess
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import fmpy
from fmpy import fmi2, fmi3

SOURCE = Path(__file__).with_name("linear.c")
COMPILER = shutil.which("cc")
TOKEN = "{c0ffee}"
REALS = {  # name: value reference, causality, start
    "u1": (0, "input", "0"),
    "u2": (1, "input", "0"),
    "y": (2, "output", None),
    "gain": (3, "parameter", "1"),
    "wall.at": (4, "parameter", "1e9"),
    "switch_s": (5, "parameter", "1e9"),
    "fail_s": (6, "parameter", "1e9"),
    "w": (7, "input", "0"),
}
OTHERS = {  # name: value reference, type of FMI 2, type of FMI 3, causality, start
    "bounces": (8, "Integer", "Int32", "output", None),
    "on": (9, "Boolean", "Boolean", "parameter", "true"),
    "name": (10, "String", "String", "parameter", "plain"),
}
FIRST_STATE = 11
PLACES = {2: fmpy.platform, 3: fmpy.platform_tuple}
CLASSES = {2: (fmi2.FMU2Model, fmi2.FMU2Slave), 3: (fmi3.FMU3Model, fmi3.FMU3Slave)}


def build(
    path: Path, version: int, a, b, c, changes: Mapping[str, str] | None = None, e=None
) -> Path:
    """An FMU of x' = Ax + Bu + Ew, y = Cx; ``changes`` replace text of its description."""
    folder = path.parent / f"{path.stem}-{version}"
    folder.mkdir()
    library = folder / "linear.so"
    (folder / "numbers.h").write_text(
        f'#define FMI {version}\n#define N {len(a)}\n#define TOKEN "{TOKEN}"\n'
        f"static const double A[N][N] = {_braces(a)}, B[N][2] = {_braces(b)}, "
        f"C[N] = {_braces(c)}, E[N] = {_braces([0.0] * len(a) if e is None else e)};\n"
    )
    (folder / "rest.c").write_text(_rest(version))
    flags = ["-shared", "-fPIC", "-O2", "-w", f"-I{folder}", "-o", library]
    subprocess.run([COMPILER, *flags, SOURCE, folder / "rest.c", "-lm"], check=True, timeout=60)
    return pack(path, version, library, description(version, len(a)), changes or {})


def pack(path: Path, version: int, library: Path, text: str, changes: Mapping[str, str]) -> Path:
    """A library and its description as an FMU."""
    for old, new in changes.items():
        assert old in text, old
        text = text.replace(old, new)
    with zipfile.ZipFile(path, "w") as fmu:
        fmu.writestr("modelDescription.xml", text)
        fmu.write(library, f"binaries/{PLACES[version]}/linear.so")
        fmu.writestr("resources/none.txt", "")
    return path


def description(version: int, n: int) -> str:
    """``modelDescription.xml`` of a plant with ``n`` states."""
    states = range(FIRST_STATE, FIRST_STATE + n)
    reals = REALS | {f"x[{i}]": (vr, "local", None) for i, vr in enumerate(states)}
    rates = {f"der(x[{i}])": (vr + n, "local", None) for i, vr in enumerate(states)}
    variables = [_real(version, name, *rest) for name, rest in (reals | rates).items()]
    variables += [_other(version, name, *rest) for name, rest in OTHERS.items()]
    at = list(reals | rates)
    derivatives = [at.index(name) + 1 for name in rates]  # FMI 2 counts from 1
    if version == 2:
        derived = zip(derivatives, states, strict=True)
        for index, vr in derived:
            old = "<Real/>"
            new = f'<Real derivative="{vr - FIRST_STATE + len(REALS) + 1}"/>'
            variables[index - 1] = variables[index - 1].replace(old, new)
        unknowns = "".join(f'<Unknown index="{index}"/>' for index in derivatives)
        structure = f'<Outputs><Unknown index="3"/></Outputs><Derivatives>{unknowns}</Derivatives>'
        head = 'fmiVersion="2.0" numberOfEventIndicators="1" guid='
    else:
        for index, vr in zip(derivatives, states, strict=True):
            variables[index - 1] = variables[index - 1].replace("/>", f' derivative="{vr}"/>')
        structure = (
            '<Output valueReference="2"/>'
            + "".join(f'<ContinuousStateDerivative valueReference="{vr + n}"/>' for vr in states)
            + '<EventIndicator valueReference="2"/>'
        )
        head = 'fmiVersion="3.0" instantiationToken='
    return (
        f'<?xml version="1.0"?>\n<fmiModelDescription {head}"{TOKEN}" modelName="linear">'
        '<ModelExchange modelIdentifier="linear"/><CoSimulation modelIdentifier="linear"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables>"
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def _real(version: int, name: str, vr: int, causality: str, start: str | None) -> str:
    value = "" if start is None else f' start="{start}"'
    kind = ' variability="fixed"' if causality == "parameter" else ""
    common = f'name="{name}" valueReference="{vr}" causality="{causality}"{kind}'
    if version == 2:
        return f"<ScalarVariable {common}><Real{value}/></ScalarVariable>"
    return f"<Float64 {common}{value}/>"


def _other(version: int, name: str, vr: int, old: str, new: str, causality: str, start) -> str:
    value = "" if start is None else f' start="{start}"'
    kind = "fixed" if causality == "parameter" else "discrete"
    common = f'name="{name}" valueReference="{vr}" causality="{causality}" variability="{kind}"'
    if version == 2:
        return f"<ScalarVariable {common}><{old}{value}/></ScalarVariable>"
    if new == "String":
        return f'<String {common}><Start value="{start}"/></String>'
    return f"<{new} {common}{value}/>"


def _rest(version: int) -> str:
    """Stubs of the FMI functions that ``linear.c`` lacks."""
    names = {name for each in CLASSES[version] for name, _ in inspect.getmembers(each)}
    wanted = sorted(name for name in names if name.startswith(f"fmi{version}"))
    return "".join(f"__attribute__((weak)) int {name}(void) {{ return 3; }}\n" for name in wanted)


def _braces(values: Any) -> str:
    if isinstance(values, float | int):
        return repr(float(values))
    return "{" + ", ".join(_braces(each) for each in values) + "}"
