"""Findings of compilers and analysers in exported files; missing tools are skipped."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from can_rig.export.law import support
from can_rig.export.running.compiler import WARNINGS, run

STRICT: Final = ("-std=c99", *WARNINGS, "-O2", "-c")
BENCH: Final = ("main.c", "bench_main.c", "bench.c", "bench.h", "harness.c", "harness.h")
"""Files outside the application: examples and the bench."""

EVA: Final = (
    "-eva", "-eva-precision", "1", "-eva-no-print", "-warn-special-float", "none", "-machdep",
    "gcc_x86_64",
)  # fmt: skip
NOT_INSTALLED: Final = "not installed"

DEVIATIONS: Final = {
    "2.4": "tags of enumerations are not used, because the state has an int32_t for each: the "
    "enumerators are",
    "9.3": "what the table does not name is zero, as C says",
    "10.4": "a constant of another essential type stands beside int32_t or uint8_t: enumerators, "
    "bits, counters; -Wconversion finds nothing",
    "12.1": "* before +, + before <, < before ?: as in the Python lines; gcc and clang warn of the "
    "precedences that mislead",
    "15.5": "a function returns where its answer is known, as in the Python lines",
    "15.7": "the last else if of the Python lines has no else",
    "17.8": "a parameter goes on as the value that it becomes, as in the Python lines",
}
"""MISRA C:2012 rules from which the export deviates, and why. Except 9.3 and 10.4, the rules are
advisory or concern readability; no rule is mandatory."""


def findings(files: Mapping[str, str]) -> dict[str, int | str]:
    """By tool, the number of warnings on exported files, or a note on a missing tool.

    Args:
        files: text by file name.

    Raises:
        ExportError: a compiler refuses.
    """
    found: dict[str, int | str] = {}
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = _written(files, Path(place))
        units = sorted(name for name in files if name.endswith(".c"))
        check = ["--quiet", "--std=c99", "--enable=warning,performance,portability", "."]
        for tool, command in {
            "gcc": ["gcc", *STRICT, *units],
            "gcc -fanalyzer": ["gcc", *STRICT, "-fanalyzer", *units],
            "clang": ["clang", *STRICT, *units],
            "cppcheck": ["cppcheck", *check],
        }.items():
            if shutil.which(command[0]) is None:
                found[tool] = NOT_INSTALLED
            else:
                said = run(command, folder)
                found[tool] = len(re.findall(r"\b(?:warning|error|performance|portability):", said))
    return found


def misra(files: Mapping[str, str]) -> Counter[str] | None:
    """How often each rule of MISRA C:2012 is broken; None without cppcheck.

    Args:
        files: text by file name; bench files are left out.

    Raises:
        ExportError: cppcheck refuses.
    """
    if shutil.which("cppcheck") is None:
        return None
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = _written(_application(files), Path(place))
        said = run(["cppcheck", "--quiet", "--std=c99", "--addon=misra", "."], folder)
    return Counter(re.findall(r"\[misra-c2012-([\d.]+)\]", said))


def eva(files: Mapping[str, str]) -> list[str] | None:
    """Alarms of Frama-C's Eva for a node that receives arbitrary frames for ever.

    None without Frama-C.

    Args:
        files: a whole export, text by file name.

    Raises:
        ExportError: Frama-C refuses.
    """
    if shutil.which("frama-c") is None:
        return None
    whole = _application(files) | {"eva.c": support("eva.c")}
    return alarms(whole)


def alarms(files: Mapping[str, str]) -> list[str]:
    """Where Eva cannot exclude an error, and which, from ``main`` on.

    Raises:
        ExportError: Frama-C refuses.
    """
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = _written(files, Path(place))
        units = sorted(str(folder / name) for name in files if name.endswith(".c"))
        said = run(["frama-c", *EVA, f"-cpp-extra-args=-I{folder}", *units], folder)
    found = re.findall(r"\[eva:alarm\] (\S+): Warning: ?\n? *([^.\n]+)", said)
    return [f"{Path(where).name}: {what}" for where, what in found]


def _application(files: Mapping[str, str]) -> dict[str, str]:
    """The files that run on a target."""
    return {
        name: text
        for name, text in files.items()
        if name not in BENCH and name.endswith((".c", ".h"))
    }


def _written(files: Mapping[str, str], folder: Path) -> Path:
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder
