"""Coverage of the C code by the back-to-back trials: gcov's lines and branches, and differences."""

from __future__ import annotations

import json
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from can_rig.export.application import application
from can_rig.export.back_to_back.frames import as_orders
from can_rig.export.back_to_back.programs import HOST_FLAGS, on_host, trial_files
from can_rig.export.back_to_back.trials import different, encoded, in_python, random_trials
from can_rig.export.law import law_files, support
from can_rig.export.running.compiler import run
from can_rig.export.running.ecu import bench
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

TOOLS: Final = ("gcc", "gcov")
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
        for name, text in {**files, "bench_main.c": support("bench_main.c")}.items():
            (folder / name).write_text(text, encoding="utf-8")
        units = sorted(path.name for path in folder.glob("*.c"))
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
