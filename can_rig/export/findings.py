"""Findings in the exported files, and coverage of the C code by the back-to-back trials.

Compilers and analysers give the findings; gcov gives lines, ``conditions`` MC/DC. Missing tools are
skipped.
"""

import json
import re
import shutil
import tempfile
from collections import Counter, defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from can_rig.export.application import BENCH, exported
from can_rig.export.compiler import WARNINGS, placed, run
from can_rig.export.conditions import RECORDER, Recording
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

SEEDS: Final = range(8)
MEMORIES: Final = 500
TICKS: Final = 4
NODES: Final = range(100)


def coverage(scenario: Scenario) -> dict[str, Any]:
    """Coverage of lines and conditions: of the law by random memory, of the node by random frames.

    Where designs are blended by the speed, both have random speeds too. A condition is proven that
    has decided the outcome of its decision both ways.

    Raises:
        ExportError: gcc refuses, or a program ends early.
    """
    precision, files = scenario.design.precision, exported(scenario)
    node = _application(files)
    blends, recording = "schedule.c" in node, Recording(node)
    law = law_files(precision, blends)
    of_law = trial_files({name: recording.files[name] for name in (*law, *RECORDER)})
    of_node = recording.files | {name: files[name] for name in BENCH}
    frames = as_orders(network_of(scenario), NODES, round(scenario.tick_s * 1e6))
    compared = differing = 0
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        law_program, node_program = (
            _program(Path(place) / name, texts)
            for name, texts in (("law", of_law), ("node", of_node))
        )
        for seed in SEEDS:
            trials = random_trials(precision, seed, MEMORIES, TICKS, blends)
            compared += sum(trial.answers for trial in trials)
            answers = on_host(law_program, encoded(trials))
            differing += different(in_python(trials), answers, trials)
        on_host(node_program, frames)
        counts = {
            f"{name}:{line}": n
            for program, is_law in ((law_program, True), (node_program, False))
            for (name, line), n in _lines(program).items()
            if name in node and name.endswith(".c") and (name in law) is is_law
        }
        seen = [
            recording.seen((program.parent / "seen").read_bytes())
            for program in (law_program, node_program)
        ]
    missed = [place for place, n in counts.items() if not n]
    unproven = [
        each
        for decision, of_trials, of_frames in zip(recording.decisions, *seen, strict=True)
        for each in decision.unproven(of_trials if decision.file in law else of_frames)
    ]
    conditions = sum(len(decision.texts) for decision in recording.decisions)
    return {
        "compared": compared,  # states of the law
        "different": differing,
        "lines": len(counts),
        "lines_run": len(counts) - len(missed),
        "decisions": len(recording.decisions),
        "conditions": conditions,
        "conditions_proven": conditions - len(unproven),
        "missed": missed,  # as ``file:line``
        "unproven": unproven,  # ``file:line``, condition, and what the trials had of it
    }


def _program(folder: Path, files: Mapping[str, str]) -> Path:
    """Built in its own folder, where each run adds to the counts."""
    folder.mkdir()
    units = placed(folder, {**files, "bench_main.c": support("bench_main.c")})
    run(["gcc", *HOST_FLAGS, "-O0", "--coverage", "-o", "program", *units, "-lm"], folder)
    return folder / "program"


def _lines(program: Path) -> dict[tuple[str, int], int]:
    """How often each line ran, by file and number."""
    found = {}
    for data in sorted(program.parent.glob("*.gcda")):
        said = run(["gcov", "--json-format", "--stdout", data.name], program.parent)
        for file in json.loads(said)["files"]:
            for line in file["lines"]:
                found[Path(file["file"]).name, line["line_number"]] = line["count"]
    return found


STRICT: Final = ("-std=c99", *WARNINGS, "-O2", "-c")
COMPILERS: Final = {
    "gcc": "gcc", "gcc -fanalyzer": "gcc", "clang": "clang", "cppcheck": "cppcheck",
}  # fmt: skip
"""The program of each tool that ``findings`` asks."""

OUTSIDE: Final = (*BENCH, "check.c", "main.c", "bench_main.c")
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
    """Each rule of MISRA C:2012 that is broken: the count, the files and the reason.

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
        if name not in OUTSIDE and name.endswith((".c", ".h"))
    }
