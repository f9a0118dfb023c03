"""Mutation score of the law in C: whether trials and self-test notice a change of one token.

A mutant is an operator, a number, ``break``, ``continue`` or the name of an extreme that becomes
another; ``!`` and a sign are left out. A sample of all mutants is compiled. A mutant with the
object code of the original, or without any, does not count. The trials kill a mutant whose answers
differ from those of Python, that crashes, or that does not end.
"""

import hashlib
import os
import random
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from can_rig.errors import ExportError
from can_rig.export.compiler import placed, run
from can_rig.export.conditions import tokens
from can_rig.export.findings import MEMORIES, SEEDS, TICKS
from can_rig.export.law import law_files, support
from can_rig.export.trials import (
    HOST_FLAGS,
    comparable,
    encoded,
    in_python,
    on_host,
    random_trials,
    trial_files,
)
from can_rig.scenario.settings import Scenario

SAMPLE: Final = 300
SEED: Final = 0
MOST_S: Final = 300.0
"""Then no further mutant is begun."""
LONGEST_S: Final = 20.0
"""Of a program that takes a tenth of a second; a mutant that takes longer does not end."""
LATE: Final = "late"
FLAGS: Final = (
    *HOST_FLAGS, "-O1", "-w", "-fsanitize=bounds-strict", "-fsanitize-undefined-trap-on-error",
)  # fmt: skip
"""An index outside its array ends the program."""
SELF_TEST: Final = (
    "check.c", "constants.c", "crc.c", "firmware.c", "self_test.c", "self_test_data.c",
)  # fmt: skip
BINARY: Final = {
    "+": ["-"], "-": ["+"], "*": ["/"], "/": ["*"], "+=": ["-="], "-=": ["+="],
    "<": ["<=", ">="], "<=": ["<", ">"], ">": [">=", "<="], ">=": [">", "<"],
    "==": ["!="], "!=": ["=="], "&&": ["||"], "||": ["&&"],
}  # fmt: skip
WORDS: Final = {
    "true": "false", "break": "continue", "real_min": "real_max", "int_min": "int_max",
}  # fmt: skip
SWAPPED: Final = WORDS | {other: word for word, other in WORDS.items()}


@dataclass(frozen=True)
class Mutant:
    """A token that becomes another; ``at``: the place of its first character in the file."""

    file: str
    at: int
    before: str
    after: str


def mutants(file: str, text: str) -> Iterator[Mutant]:
    """Every mutant of a file of C; binary operators stand between blanks."""
    for token in tokens(text):
        word, end = token.text, token.at + len(token.text)
        is_binary = text[token.at - 1].isspace() and text[end].isspace()
        others = BINARY.get(word, []) if is_binary else [""] if word in {"!", "-"} else []
        if word in SWAPPED:
            others = [SWAPPED[word]]
        elif word[0].isdigit():
            is_zero = float(word.rstrip("f")) == 0.0
            others = ["1.0f" if is_zero else f"2.0f * {word}"]
            if word.isdigit():
                others = [str(int(word) + 1)]
        for other in others:
            yield Mutant(file, token.at, word, other)


class _Bench:
    """The programs of trials and self-test, of which each mutant replaces an object."""

    def __init__(self, folder: Path, scenario: Scenario, files: Mapping[str, str]) -> None:
        precision, blends = scenario.design.precision, "schedule.c" in files
        self._folder, self._precision = folder, precision
        self.law = {name: files[name] for name in law_files(precision, blends)}
        around = {**trial_files(self.law), "bench_main.c": support("bench_main.c")}
        placed(folder, {**files, **around})
        self._trial = {name for name in around if name.endswith(".c")}
        self._self_test = {name for name in self.law if name.endswith(".c")} | {*SELF_TEST}
        wanted = sorted(self._trial | self._self_test)
        run(["gcc", *FLAGS, "-c", *wanted], folder)
        self._trials: list[tuple[Path, str]] = []
        for seed in SEEDS:
            trials = random_trials(precision, seed, MEMORIES, TICKS, blends)
            orders = folder / f"orders{seed}"
            orders.write_bytes(encoded(trials))
            self._trials.append((orders, self._digest(in_python(trials))))
        if self.killers(folder / "none", None) != (False, False):
            raise ExportError("the law in C differs from Python: no mutant can be judged")

    def killers(self, folder: Path, mutant: Mutant | None) -> tuple[bool, bool] | None:
        """Whether trials and self-test notice ``mutant``; None: there is nothing to notice."""
        folder.mkdir()
        changed = {}
        if mutant is not None:
            text, end = self.law[mutant.file], mutant.at + len(mutant.before)
            placed(folder, {mutant.file: text[: mutant.at] + mutant.after + text[end:]})
            try:
                run(["gcc", *FLAGS, f"-I{self._folder}", "-c", mutant.file], folder)
            except ExportError:
                return None
            made = Path(mutant.file).with_suffix(".o")
            if (folder / made).read_bytes() == (self._folder / made).read_bytes():
                return None
            changed = {mutant.file: folder / made}
        noticed = False
        trial = self._linked(folder / "trial", self._trial, changed)
        check = self._linked(folder / "check", self._self_test, changed)
        try:
            on_host(check, b"", LONGEST_S)
        except ExportError:
            noticed = True
        return not all(self._right(trial, *each) for each in self._trials), noticed

    def _linked(self, program: Path, units: set[str], changed: Mapping[str, Path]) -> Path:
        objects = [str(changed.get(unit, Path(unit).with_suffix(".o"))) for unit in sorted(units)]
        run(["gcc", "-o", str(program), *objects, "-lm"], self._folder)
        return program

    def _right(self, program: Path, orders: Path, expected: str) -> bool:
        """Whether a program answers as Python."""
        try:
            answers = on_host(program, orders.read_bytes(), LONGEST_S)
        except ExportError:
            return False
        return self._digest(answers) == expected

    def _digest(self, answers: bytes) -> str:
        return hashlib.sha256(comparable(answers, self._precision).tobytes()).hexdigest()


def score(
    scenario: Scenario,
    files: Mapping[str, str],
    on_mutant: Callable[[int, int], object] = lambda done, of: None,
    sample: int = SAMPLE,
) -> dict[str, Any]:
    """How many mutants of a scenario's controller are noticed.

    A sample that takes longer than ``MOST_S`` ends early.

    Args:
        scenario: the scenario.
        files: the whole export without a prefix, text by file name.
        on_mutant: called with the number of mutants that are done, and of all.
        sample: how many mutants to draw.

    Raises:
        ExportError: gcc refuses, or the law in C differs from Python without any mutation.
    """
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        bench = _Bench(Path(place), scenario, files)
        units = sorted(name for name in bench.law if name.endswith(".c"))
        every = [each for name in units for each in mutants(name, files[name])]
        drawn = random.Random(SEED).sample(every, min(sample, len(every)))
        judged = []
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            end_s = time.monotonic() + MOST_S

            def judge(number: int) -> tuple[bool, bool] | str | None:
                if time.monotonic() > end_s:
                    return LATE
                return bench.killers(Path(place) / f"mutant{number}", drawn[number])

            for done, killers in enumerate(pool.map(judge, range(len(drawn)))):
                judged.append(killers)
                on_mutant(done + 1, len(drawn))
    tried = [each for each in zip(drawn, judged, strict=True) if each[1] != LATE]
    counted = [(mutant, killers) for mutant, killers in tried if isinstance(killers, tuple)]
    return {
        "possible": len(every),
        "seed": SEED,
        "sample": len(counted),
        "not_counted": len(tried) - len(counted),  # no object code, or that of the original
        "killed": sum(any(killers) for _, killers in counted),
        "killed_by_trials": sum(by for _, (by, _) in counted),
        "killed_by_self_test": sum(by for _, (_, by) in counted),
        "survivors": [
            _said(mutant, files[mutant.file]) for mutant, killers in counted if not any(killers)
        ],
    }


def _said(mutant: Mutant, text: str) -> tuple[str, str, str]:
    """``file:line``, the change, and the line as it was."""
    line = text.count("\n", 0, mutant.at)
    change = f"{mutant.before} becomes {mutant.after or 'nothing'}"
    return f"{mutant.file}:{line + 1}", change, text.splitlines()[line].strip()
