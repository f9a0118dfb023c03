"""Findings in the exported files, and coverage of the C code by the back-to-back trials.

Compilers and analysers give the findings; gcov gives lines and branches. Missing tools are skipped.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from can_rig.export.application import application, bench
from can_rig.export.compiler import WARNINGS, placed, run
from can_rig.export.law import law_files, parts_of, support
from can_rig.export.trials import (
    HOST_FLAGS,
    as_orders,
    different,
    encoded,
    in_python,
    on_host,
    random_trials,
    trial_files,
)
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

MEMORIES: Final = 100
TICKS: Final = 12
NODES: Final = range(20)


@dataclass(frozen=True)
class Coverage:
    """Coverage of lines and branches."""

    compared: int
    """Compared states of the law; ``different`` counts differences from Python."""
    different: int
    lines: int
    lines_run: int
    branches: int
    branches_taken: int
    missed: tuple[str, ...]
    """Lines without coverage, as ``file:line``."""


def coverage(scenario: Scenario) -> Coverage:
    """Of a scenario's controller: of the law by random memory, of the node by random frames.

    Where designs are blended by the speed, both have random speeds too.

    Raises:
        ExportError: gcc refuses, or a program ends early.
    """
    precision, whole = scenario.design.precision, application(scenario)
    blends = "schedule.c" in whole
    law = law_files(precision, blends)
    trials = random_trials(precision, 0, MEMORIES, TICKS, blends)
    answers, parts = _measured(trial_files(law), encoded(trials), {*law})
    _, others = _measured(
        whole | bench(whole),
        as_orders(network_of(scenario), NODES, round(scenario.tick_s * 1e6)),
        {*whole} - {*law},
    )
    lines, branches = {}, []
    for name, each in (*parts, *others):
        lines[f"{name}:{each['line_number']}"] = each["count"]
        branches += [branch["count"] for branch in each["branches"]]
    missed = tuple(place for place, count in lines.items() if not count)
    return Coverage(
        sum(trial.answers for trial in trials),
        different(in_python(trials), answers, trials),
        len(lines),
        len(lines) - len(missed),
        len(branches),
        sum(count > 0 for count in branches),
        missed,
    )


def _measured(
    files: Mapping[str, str], orders: bytes, wanted: set[str]
) -> tuple[bytes, list[tuple[str, dict[str, Any]]]]:
    """A program's answers, and gcov's record of every line of the ``wanted`` files."""
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        folder = Path(place)
        units = placed(folder, {**files, "bench_main.c": support("bench_main.c")})
        run(["gcc", *HOST_FLAGS, "-O0", "--coverage", "-o", "program", *units, "-lm"], folder)
        answers = on_host(folder / "program", orders)
        found = []
        for data in sorted(folder.glob("*.gcda")):
            said = subprocess.run(
                ["gcov", "--json-format", "--stdout", "--branch-probabilities", data.name],
                cwd=folder, capture_output=True, check=True, text=True,
            ).stdout  # fmt: skip
            for file in json.loads(said)["files"]:
                name = Path(file["file"]).name
                if name in wanted and name.endswith(".c"):
                    found += [(name, line) for line in file["lines"]]
    return answers, found


STRICT: Final = ("-std=c99", *WARNINGS, "-O2", "-c")
COMPILERS: Final = {
    "gcc": "gcc", "gcc -fanalyzer": "gcc", "clang": "clang", "cppcheck": "cppcheck",
}  # fmt: skip
"""The program of each tool that ``findings`` asks."""

BENCH: Final = ("check.c", "main.c", "bench_main.c", "bench.c", "bench.h", "harness.c", "harness.h")
"""Files outside the application: examples and the bench."""

EVA: Final = (
    "-eva", "-eva-precision", "1", "-eva-no-print", "-warn-special-float", "none", "-machdep",
    "gcc_x86_64",
)  # fmt: skip
DEVIATIONS: Final = {
    "2.4": "an enumeration has no tag, for the state has an int32_t: its enumerators are used",
    "9.3": "what the table does not name is zero, as C says",
    "12.1": "* before +, + before <, < before ?: as in the Python lines; gcc and clang warn of the "
    "precedences that mislead",
    "15.5": "a function returns where its answer is known, as in the Python lines",
    "17.8": "a parameter goes on as the value that it becomes, as in the Python lines",
}
"""MISRA C:2012 rules from which the export deviates, and why. Except 9.3 and 10.4, the rules are
advisory or concern readability; no rule is mandatory."""


def findings(files: Mapping[str, str]) -> dict[str, int | None]:
    """By key of ``COMPILERS``, the number of warnings on exported files; None: not installed.

    Args:
        files: text by file name.

    Raises:
        ExportError: a compiler refuses.
    """
    found: dict[str, int | None] = {}
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        units = placed(place, files)
        check = ("--quiet", "--std=c99", "--enable=warning,performance,portability", ".")
        for tool, program in COMPILERS.items():
            found[tool] = None
            if shutil.which(program) is not None:
                options = check if tool == "cppcheck" else (*STRICT, *units)
                said = run([*tool.split(), *options], Path(place))
                found[tool] = len(re.findall(r"\b(?:warning|error|performance|portability):", said))
    return found


def misra(files: Mapping[str, str]) -> list[dict[str, Any]]:
    """Each rule of MISRA C:2012 that is broken: how often, in which files, and for which reason.

    Args:
        files: text by file name; bench files are left out.

    Raises:
        ExportError: cppcheck refuses.
    """
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        placed(place, _application(files))
        said = run(["cppcheck", "--quiet", "--std=c99", "--addon=misra", "."], Path(place))
    places: dict[str, Counter[str]] = defaultdict(Counter)
    for file, rule in re.findall(r"^(\S+?):\d+:.*\[misra-c2012-([\d.]+)\]", said, flags=re.M):
        places[rule][file] += 1
    return [
        {
            "rule": rule,
            "times": sum(of.values()),
            "reason": DEVIATIONS.get(rule),
            "files": dict(of.most_common()),
        }
        for rule, of in sorted(places.items(), key=lambda each: [*map(int, each[0].split("."))])
    ]


def eva(files: Mapping[str, str]) -> list[str]:
    """Alarms of Frama-C's Eva for a node that receives arbitrary frames for ever.

    The self-test, which has only its own data, is left out.

    Args:
        files: a whole export, text by file name.

    Raises:
        ExportError: Frama-C refuses.
    """
    whole = {name: text for name, text in _application(files).items() if name != "self_test.c"}
    return alarms(whole | {"eva.c": support("eva.c", parts_of(files))})


def alarms(files: Mapping[str, str]) -> list[str]:
    """Where Eva cannot exclude an error, and which, from ``main`` on.

    Raises:
        ExportError: Frama-C refuses.
    """
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        units = [f"{place}/{unit}" for unit in placed(place, files)]  # it looks at PWD, not at cwd
        command = ["frama-c", *EVA, f"-cpp-extra-args=-I{place}", *units]
        said = run(command, Path(place))
    found = re.findall(r"\[eva:alarm\] (\S+): Warning: ?\n? *([^.\n]+)", said)
    return [f"{Path(where).name}: {what}" for where, what in found]


def _application(files: Mapping[str, str]) -> dict[str, str]:
    """The files that run on a target."""
    return {
        name: text
        for name, text in files.items()
        if name not in BENCH and name.endswith((".c", ".h"))
    }
