"""Mutation testing: whether a test fails for every small change of the code.

A mutant that no test notices is a gap in the tests, or stands in `tools/mutation.toml` with the
reason why nothing can notice it. Results are kept in `build/mutation.jsonl`, so that a run that was
interrupted goes on where it stopped; a mutant is run again when its module has changed, or when it
survived. The tests must pass on the unchanged code before and after the mutants of a room:
otherwise they fail for another reason, and the results of that room are taken back.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import json
import math
import os
import random
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from mutation_sites import Mutant, mutants
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

CHECKOUT: Final = Path(__file__).parents[1]
SETTINGS: Final = Path(__file__).with_suffix(".toml")
FOUND: Final = CHECKOUT / "build" / "mutation.jsonl"
LOCK: Final = CHECKOUT / "build" / "mutation.lock"
TIMES: Final = CHECKOUT / "build" / "mutation-times.json"


@dataclass(frozen=True)
class Site:
    """A mutant and where it is."""

    module: str
    mutant: Mutant
    room: int

    @property
    def key(self) -> str:
        """What it is known by in `FOUND`."""
        return f"{self.module} {hashlib.sha1(self.mutant.source.encode()).hexdigest()}"

    @property
    def change(self) -> tuple[str, str, str]:
        """What it is known by in `SETTINGS`."""
        return self.module, self.mutant.before, self.mutant.after

    def __str__(self) -> str:
        return f"{self.module}:{self.mutant.line}: {self.mutant.before}  →  {self.mutant.after}"


def sites(settings: dict[str, Any]) -> Iterator[Site]:
    """Every mutant of every room."""
    for room, entry in enumerate(settings["room"]):
        paths = [path for glob in entry["modules"] for path in sorted(CHECKOUT.glob(glob))]
        for path in paths:
            for mutant in mutants(path.read_text("utf-8")):
                yield Site(str(path.relative_to(CHECKOUT)), mutant, room)


def accepted(settings: dict[str, Any], every: list[Site]) -> set[tuple[str, str, str]]:
    """The changes that nothing can notice.

    Raises:
        SystemExit: one of them is not a mutant (any longer), or has no reason.
    """
    listed = {}
    for entry in settings.get("accepted", []):
        for after in entry["after"] if isinstance(entry["after"], list) else [entry["after"]]:
            listed[entry["module"], entry["before"], after] = entry.get("reason", "")
    known = {site.change for site in every}
    for change, reason in listed.items():
        if change not in known:
            sys.exit(f"error: {SETTINGS.name}: no such mutant: {'  →  '.join(change)}")
        if not reason:
            sys.exit(f"error: {SETTINGS.name}: a reason must be given for {'  →  '.join(change)}")
    return set(listed)


def found() -> dict[str, str | None]:
    """What noticed each mutant in earlier runs, by its key."""
    if not FOUND.exists():
        return {}
    lines = map(json.loads, FOUND.read_text("utf-8").splitlines())
    return {line["key"]: line["killer"] for line in lines}


def run_room(
    entry: dict[str, Any], chosen: list[Site], asked: argparse.Namespace, known: list[str]
) -> None:
    """Run the mutants of one room, in a process of its own."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    os.environ["CI"] = "1"  # tests/conftest.py: the same examples for every mutant
    if entry.get("interpreted"):
        os.environ["NUMBA_DISABLE_JIT"] = "1"
    sys.dont_write_bytecode = False  # in the copy: compiling the tests takes longer than most
    from mutation_run import (  # noqa: PLC0415 (here)
        BaselineError,
        check_unchanged,
        copy_tree,
        killers,
        measure,
    )
    from mutation_tests import Tests  # noqa: PLC0415

    copy_tree()

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[survived]} survived"),
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    console = Console(stderr=True)
    console.print(f"{', '.join(entry['modules'])}: the tests on the unchanged code ...")
    times = json.loads(TIMES.read_text("utf-8")) if TIMES.exists() else {}
    tests = Tests(entry["tests"], times, asked.tests_below)
    for killer in known:
        tests.count(killer)
    try:
        measure(tests)
    except BaselineError as error:
        sys.exit(f"error: {error}")
    TIMES.write_text(json.dumps(tests.cpu_s), "utf-8")
    jobs = {site.key: (Path(site.module), site.mutant.source) for site in chosen}
    # Without a thread of its own: this process forks.
    with FOUND.open("a") as log:
        before = log.tell()
        try:
            with Progress(*columns, console=console, auto_refresh=False) as bar:
                task = bar.add_task("mutants", total=len(jobs), survived=0)
                survived = 0
                for key, killer in killers(tests, jobs, asked.workers):
                    survived += killer is None
                    print(json.dumps({"key": key, "killer": killer}), file=log, flush=True)
                    bar.update(task, advance=1, survived=survived, refresh=True)
        except KeyboardInterrupt:
            sys.exit("interrupted: the next run goes on here")
        finally:
            try:
                check_unchanged(tests)
            except BaselineError as error:
                log.truncate(before)
                sys.exit(f"error: {error}, after the mutants: their results are taken back")


def report(every: list[Site], listed: set[tuple[str, str, str]]) -> bool:
    """Print a row for each module, then the mutants that survived; whether there are none."""
    known = found()
    table = Table(box=None, pad_edge=False)
    for heading in ("module", "mutants", "killed", "survived", "accepted", "not run"):
        table.add_column(heading, justify="left" if heading == "module" else "right")
    survivors = []
    total = [0] * 5
    for module in dict.fromkeys(site.module for site in every):
        here = [site for site in every if site.module == module]
        killed = [site for site in here if known.get(site.key)]
        excused = [site for site in here if site.change in listed and not known.get(site.key)]
        rest = [site for site in here if site not in killed and site not in excused]
        alive = [site for site in rest if site.key in known]
        survivors += alive
        row = [len(here), len(killed), len(alive), len(excused), len(rest) - len(alive)]
        total = [a + b for a, b in zip(total, row, strict=True)]
        table.add_row(module, *map(str, row))
        lines = Counter(site.change for site in here if site.change in listed)
        noticed = Counter(site.change for site in killed)
        for change in lines:
            if noticed[change] == lines[change]:
                note = f"note: in {SETTINGS.name}, but killed: {'  →  '.join(change)}"
                print(note, file=sys.stderr)
    table.add_row("", *map(str, total))
    Console().print(table)
    for site in survivors:
        print(f"survived: {site}")
    return not survivors


def main() -> int:
    """Run what is asked for; 1 if a mutant survived that is not on the list."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="*", metavar="GLOB", help="modules, such as '*/target/*'")
    parser.add_argument("--sample", type=int, metavar="N", help="so many mutants, by chance")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (default: 0)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument(
        "--tests-below", type=float, default=math.inf, metavar="S",
        help="leave out tests that take longer [s of CPU]: a first pass over many mutants",
    )  # fmt: skip
    parser.add_argument("--fresh", action="store_true", help="forget what was found before")
    parser.add_argument("--list", action="store_true", help="run nothing, report what was found")
    asked = parser.parse_args()
    settings = tomllib.loads(SETTINGS.read_text("utf-8"))
    every = list(sites(settings))
    listed = accepted(settings, every)
    FOUND.parent.mkdir(exist_ok=True)
    lock = LOCK.open("w")  # held until this process ends
    try:
        if not asked.list:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        sys.exit("error: another run of tools/mutation is under way; it must end first")
    if asked.fresh:
        FOUND.unlink(missing_ok=True)
    every = [site for site in every if fnmatch(site.module, asked.only)]
    if asked.sample is not None:
        every = random.Random(asked.seed).sample(every, min(asked.sample, len(every)))
    known = found()
    for room, entry in enumerate(settings["room"]):
        here = [site for site in every if site.room == room]
        chosen = [s for s in here if s.change not in listed and not known.get(s.key)]
        if chosen and not asked.list:
            tests = [killer for site in here if (killer := known.get(site.key))]
            process = get_context("fork").Process(
                target=run_room, args=(entry, chosen, asked, tests)
            )
            process.start()
            with suppress(KeyboardInterrupt):  # that process ends by it, in its own time
                process.join()
            process.join()
            if process.exitcode:
                return 2
    return 0 if report(every, listed) else 1


if __name__ == "__main__":
    sys.exit(main())
