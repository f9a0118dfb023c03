"""Mutation of the exported C: whether back-to-back tests notice every small change of it.

The law runs on random memory and must have every bit of the law in Python; the node runs on random
frames and must send and count what it does unchanged, which tests compare with the node in Python.
A mutant that nothing notices is a gap, or stands in `tools/mutation_c.toml` with the reason why
nothing can notice it.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from mutation_c_sites import mutants
from mutation_sites import Mutant

from can_rig.assessment.resolve import load
from can_rig.export.application import application, bench
from can_rig.export.compiler import run
from can_rig.export.law import law_files, support
from can_rig.export.trials import (
    HOST_FLAGS,
    Trial,
    as_orders,
    different,
    encoded,
    in_python,
    random_trials,
    trial_files,
)
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

SETTINGS: Final = Path(__file__).with_suffix(".toml")
GCC: Final = ("gcc", *HOST_FLAGS, "-O0")
TCC: Final = ("tcc", "-std=c99")  # ten times as fast, and as exact
FAST: Final = TCC if shutil.which("tcc") else GCC
SCENARIOS: Final = {"default": (20, 200, 2000), "drive-cycle": (20, 200)}
"""And how many memories: most mutants are noticed by the few. A drive blends tables by speed."""

TICKS: Final = 16
SEEDS: Final = range(60)
SLOW: Final = (
    "gcc", *HOST_FLAGS, "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all",
)  # fmt: skip
CPU_S: Final = 10
LONGEST_S: Final = 300


@dataclass(frozen=True)
class Bench:
    """A program, what it is told, and how its answers are judged.

    Attributes:
        folder: its sources and objects.
        sanitized: the same, with gcc's sanitizers.
        orders: each a file, the quick one first, which the sanitized one gets last.
        noticed: whether the answers to the orders of that number are wrong.
    """

    folder: Path
    sanitized: Path
    orders: list[Path]
    noticed: Callable[[int, bytes], bool]


def built(folder: Path, files: dict[str, str], compile_: Sequence[str]) -> None:
    """Sources and objects in a folder of their own."""
    folder.mkdir()
    for name, text in {**files, "bench_main.c": support("bench_main.c")}.items():
        (folder / name).write_text(text, encoding="utf-8")
    for path in folder.glob("*.c"):
        run([*able(path, compile_), "-c", path.name], folder)


def able(source: Path, compile_: Sequence[str]) -> Sequence[str]:
    """``compile_``, or gcc for a source that tcc refuses: to it -INFINITY is no constant."""
    if compile_ != TCC:
        return compile_
    with tempfile.TemporaryDirectory() as place:  # not /dev/null: tcc puts a file in its place
        tried = [*TCC, "-c", source.name, "-o", f"{place}/tried.o"]
        done = subprocess.run(tried, cwd=source.parent, capture_output=True, check=False)
    return GCC if done.returncode else TCC


def answers(
    folder: Path, objects: list[str], orders: Path, program: str, compile_: Sequence[str]
) -> bytes | None:
    """Return the output of a program linked from ``objects``; None if the program fails."""
    run([*compile_, "-o", program, *objects, "-lm"], folder)
    limited = ["prlimit", f"--cpu={CPU_S}", f"./{program}"]
    with orders.open("rb") as source:
        try:
            done = subprocess.run(
                limited, cwd=folder, stdin=source, capture_output=True, check=False,
                timeout=LONGEST_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return None
        finally:
            (folder / program).unlink()
    return None if done.returncode else done.stdout


def objects_of(folder: Path) -> list[str]:
    """The unchanged objects."""
    return sorted(
        path.with_suffix(".o").name for path in folder.glob("*.c") if "-" not in path.stem
    )


def said_by(
    mutant: Mutant, name: str, number: int, folder: Path, orders: list[Path], by: Sequence[str]
) -> Iterator[bytes | None]:
    """What a mutant of ``name`` answers to each of the orders; None where it fails."""
    stem = f"{Path(name).stem}-{number}"
    (folder / f"{stem}.c").write_text(mutant.source, encoding="utf-8")
    compiled = subprocess.run(
        [*able(folder / name, by), "-c", f"{stem}.c"], cwd=folder, capture_output=True, check=False
    )
    (folder / f"{stem}.c").unlink()
    if compiled.returncode:
        yield None
        return
    own = Path(name).with_suffix(".o").name
    objects = [f"{stem}.o" if each == own else each for each in objects_of(folder)]
    try:
        for each in orders:
            yield answers(folder, objects, each, stem, by)
    finally:
        (folder / f"{stem}.o").unlink()


def is_noticed(bench: Bench, name: str, number: int, mutant: Mutant) -> bool:
    """Whether a mutant of ``name`` fails to compile, fails, or answers otherwise."""
    for at, said in enumerate(said_by(mutant, name, number, bench.folder, bench.orders, FAST)):
        if said is None or bench.noticed(at, said):
            return True
    checked = said_by(mutant, name, number, bench.sanitized, bench.orders[:1], SLOW)
    return any(said is None for said in checked)


def law_bench(place: Path, law: dict[str, str], memories: Sequence[int]) -> Bench:
    """Random memory for the law in double precision, and random speeds where there are some.

    Raises:
        SystemExit: the C differs unchanged.
    """
    folder, sanitized, blends = place / "law", place / "law-sanitized", "schedule.c" in law
    for each, by in ((folder, FAST), (sanitized, SLOW)):
        built(each, trial_files(law), by)
    trials: list[list[Trial]] = [
        random_trials("float64", seed, some, TICKS, blends) for seed, some in enumerate(memories, 1)
    ]
    expected = [in_python(each) for each in trials]
    orders = [place / f"law-{at}" for at in range(len(trials))]
    for path, some_trials in zip(orders, trials, strict=True):
        path.write_bytes(encoded(some_trials))

    def noticed(at: int, said: bytes) -> bool:
        return said != expected[at] and different(expected[at], said, trials[at]) > 0

    found = Bench(folder, sanitized, orders, noticed)
    for at, path in enumerate(orders):
        said = answers(folder, objects_of(folder), path, "unchanged", FAST)
        if said is None or noticed(at, said):
            sys.exit("error: the C differs from Python before anything is changed")
    return found


def node_bench(place: Path, scenario: Scenario, whole: dict[str, str]) -> Bench:
    """Random frames for the node."""
    folder, sanitized = place / "node", place / "node-sanitized"
    for each, by in ((folder, FAST), (sanitized, SLOW)):
        built(each, whole | bench(whole), by)
    orders = place / "frames"
    orders.write_bytes(as_orders(network_of(scenario), SEEDS, round(scenario.tick_s * 1e6)))
    expected = answers(folder, objects_of(folder), orders, "unchanged", FAST)
    return Bench(folder, sanitized, [orders], lambda _, said: said != expected)


def judged(
    name: str, chosen: Sequence[str], memories: Sequence[int], processes: int
) -> Iterator[tuple[str, Mutant, bool]]:
    """The mutants of some files of a scenario's controller, and whether each is noticed."""
    if not chosen:
        return
    scenario = load(name, [])
    whole = application(scenario)
    law = law_files("float64", "schedule.c" in whole)
    with tempfile.TemporaryDirectory(prefix="mutation-c-") as where:
        benches = law_bench(Path(where), law, memories), node_bench(Path(where), scenario, whole)
        for file in chosen:
            each = list(mutants(whole[file]))
            judge = partial(is_noticed, benches[file not in law], file)
            with ThreadPoolExecutor(processes) as pool:
                for mutant, known in zip(
                    each, pool.map(judge, range(len(each)), each), strict=True
                ):
                    yield file, mutant, known
            print(f"{name}, {file}: {len(each)} mutants", file=sys.stderr, flush=True)


def main() -> None:
    """Run the mutants; exit status 1 where one survives that has no reason to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("files", nargs="*", help="only mutants of these, as in biquad.c")
    parser.add_argument("--processes", type=int, default=2)
    asked = parser.parse_args()
    entries = tomllib.loads(SETTINGS.read_text("utf-8")).get("accepted", [])
    accepted = {change for each in entries for change in each["changes"]}
    noticed = survived = excused = 0
    seen: set[str] = set()
    for scenario, memories in SCENARIOS.items():
        whole = application(load(scenario, []))
        names = sorted(name for name in asked.files or whole if name.endswith(".c"))
        chosen = [name for name in names if whole.get(name, "") not in seen | {""}]
        seen |= {*whole.values()}
        for name, mutant, known in judged(scenario, chosen, memories, asked.processes):
            noticed += known
            if known:
                continue
            if f"{name}: {mutant.before}  →  {mutant.after}" in accepted:
                excused += 1
                continue
            survived += 1
            print(f"{name}:{mutant.line}: {mutant.before}  →  {mutant.after}", flush=True)
    print(f"{noticed} noticed, {excused} with a reason, {survived} not noticed")
    sys.exit(1 if survived else 0)


if __name__ == "__main__":
    main()
