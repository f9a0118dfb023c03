"""Mutation testing: whether a test fails for every small change of the code.

A mutant that no test notices is a gap in the tests, or changes nothing that a test can see.

The tests of a module are those of the folder that mirrors its room. One session of pytest imports
and collects them, measures which file of tests enters which function, and forks for each mutant:
the child gives the changed functions their new code and runs the files that enter them. A change of
code that runs at import needs a process with fresh imports.
"""

from __future__ import annotations

import argparse
import gc
import importlib.util
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from importlib.machinery import ModuleSpec, SourceFileLoader
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final

import coverage
import hypothesis
import pytest
from mutation_sites import Mutant, functions_of, mutants
from rich.console import Console
from rich.table import Table

CHECKOUT: Final = Path(__file__).parents[1]
TREE: Final = CHECKOUT / "build" / "mutation"  # a copy, so that work on the checkout can go on
OPTIONS: Final = (
    *("-q", "-s", "--tb=no", "-p", "no:cacheprovider"),
    *("-m", "not vcan and not compiled and not long"),
)
SLOWER: Final = 10  # times the usual CPU time of a test, and so many seconds more: the test hangs
HANGS_S: Final = 2.0
WAITS_S: Final = 120.0  # and 100 times the usual CPU time of all tests, by the clock on the wall
TIMEOUT: Final = "timeout"
NEEDS_IMPORT: Final = "needs import"
_CONSTANT: Final = int | float | tuple | dict


@dataclass(frozen=True)
class Site:
    """A mutant and where it is."""

    module: str
    mutant: Mutant

    def __str__(self) -> str:
        return f"{self.module}:{self.mutant.line}: {self.mutant.before}  →  {self.mutant.after}"


def modules(only: str = "*") -> list[str]:
    """Every module of the product, but for packages without code."""
    paths = [
        p for top in ("firmware_model", "can_rig") for p in sorted((CHECKOUT / top).rglob("*.py"))
    ]
    return [name for p in paths if fnmatch(name := str(p.relative_to(CHECKOUT)), only)]


def sites(names: Iterable[str]) -> list[Site]:
    """Every mutant of some modules."""
    texts = {name: (CHECKOUT / name).read_text("utf-8") for name in names}
    return [Site(name, mutant) for name, text in texts.items() for mutant in mutants(text)]


def tests_of(module: str) -> str:
    """The folder of tests that mirrors the room of a module, or the nearest one above."""
    top, *rooms = Path(module).parent.parts
    folder = CHECKOUT / "tests" / {"can_rig": "rig", "firmware_model": "firmware"}[top]
    for room in rooms:
        folder = folder / room if (folder / room).is_dir() else folder
    return str(folder.relative_to(CHECKOUT))


def is_compiled(module: str) -> bool:
    """Whether numba compiles functions of a module; each mutant would be compiled anew."""
    text = (CHECKOUT / module).read_text("utf-8")
    return module.startswith("firmware_model/") or "firmware_model.compiled" in text


def changed_lines(revision: str) -> dict[str, set[int]]:
    """The lines of each file that differ from a revision of git, in the working tree.

    Raises:
        SystemExit: git does not know the revision.
    """
    asked = ["git", "diff", "-U0", "--no-color", "--no-ext-diff", revision, "--", "*.py"]
    done = subprocess.run(asked, cwd=CHECKOUT, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"error: git diff {revision}: {done.stderr.strip().splitlines()[0]}")
    lines: dict[str, set[int]] = defaultdict(set)
    name = ""
    for line in done.stdout.splitlines():
        if line.startswith("+++ "):
            name = line.removeprefix("+++ ").removeprefix("b/")
        elif place := re.match(r"@@ -\S+ \+(\d+)(?:,(\d+))? @@", line):
            first, number = int(place[1]), int(place[2] or 1)
            lines[name] |= {*range(first, first + number)}
    return lines


def landed() -> str:
    """Where this branch left origin/main, or main; without either the last commit."""
    for upstream in ("origin/main", "main"):
        asked = ["git", "merge-base", "HEAD", upstream]
        done = subprocess.run(asked, cwd=CHECKOUT, capture_output=True, text=True, check=False)
        if not done.returncode:
            return done.stdout.strip()
    return "HEAD"


# In a session of pytest: a child for each mutant.

Functions = Mapping[tuple[str, str], list[FunctionType]]
"""By file and qualified name."""


def functions() -> Functions:
    """Every function that exists."""
    known = defaultdict(list)
    for each in gc.get_objects():
        if type(each) is FunctionType:  # the object behind a weak proxy may be gone
            known[each.__code__.co_filename, each.__code__.co_qualname].append(each)
    return known


def swap(known: Functions, path: str, before: str, after: str) -> bool:
    """Give a loaded module the functions and constants of its changed text, if they suffice."""
    old, new = (_codes(compile(text, path, "exec")) for text in (before, after))
    changed = {
        name.partition(".<locals>")[0]
        for name in old.keys() | new.keys()
        if [*map(_own, old.get(name, ()))] != [*map(_own, new.get(name, ()))]
    }
    if "<module>" in changed:
        return changed == {"<module>"} and _rebind(path, after)
    if not all(len(known.get((path, name), ())) == len(new.get(name, ())) == 1 for name in changed):
        return False
    for name in changed:
        (function,), (code,) = known[path, name], new[name]
        if function.__code__.co_freevars != code.co_freevars:
            return False
        function.__code__ = code
    return True


def _rebind(path: str, after: str) -> bool:
    """Give a constant its new value in every module that has the constant."""
    loaded = [module for module in sys.modules.values() if hasattr(module, "__dict__")]
    (own,) = (vars(m) for m in loaded if getattr(m, "__file__", None) == path)
    new = {name: own[name] for name in own if name.startswith("__")}
    exec(compile(after, path, "exec"), new)
    changed = [n for n in own if isinstance(own[n], _CONSTANT) and repr(own[n]) != repr(new.get(n))]
    for name in changed:
        before = own[name]
        for module in loaded:
            if vars(module).get(name) is before:
                setattr(module, name, new[name])
    return bool(changed)


def _codes(whole: CodeType) -> dict[str, list[CodeType]]:
    """The codes of a module, its classes and its functions, by qualified name."""
    codes, waiting = defaultdict(list), [whole]
    while waiting:
        code = waiting.pop()
        codes[code.co_qualname].append(code)
        waiting += [each for each in code.co_consts if isinstance(each, CodeType)]
    return codes


def _own(code: CodeType) -> tuple[object, ...]:
    """The effect of a code, without its line numbers and the codes within."""
    constants = [(type(c), c) for c in code.co_consts if not isinstance(c, CodeType)]
    return code.co_code, repr(constants), code.co_names, code.co_varnames


class Session:
    """A plugin of pytest that runs the tests for each mutant instead of running the tests."""

    def __init__(
        self, batch: Sequence[Site], workers: int, below_s: float, send: Callable[[object], None]
    ) -> None:
        self._batch, self._workers, self._below_s, self._send = batch, workers, below_s, send
        self._failed: str | None = None
        self._cpu_s: dict[str, float] = {}
        self._kills: Counter[str] = Counter()
        names = {str(TREE / site.module) for site in batch}
        self._coverage = coverage.Coverage(data_file=None, config_file=False, include=[*names])
        self._coverage.start()  # before any import of the product

    def pytest_sessionstart(self) -> None:
        """Let hypothesis report the first failing example: shrinking is slow."""
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        shortened = hypothesis.settings(hypothesis.settings.default, phases=phases)
        hypothesis.settings.register_profile("mutants", parent=shortened)
        hypothesis.settings.load_profile("mutants")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the first test that fails."""
        if report.failed:
            self._failed = self._failed or report.nodeid

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Measure the unchanged code, try every mutant, and look at the unchanged code again."""
        self._coverage.stop()
        at_import = self._entered()
        measured = _one(partial(self._measured, session.items))
        if measured is None or measured[0]:
            self._send(f"{measured[0] if measured else 'a test'} fails on the unchanged code")
            return True
        _, self._cpu_s, entered = measured
        items = [i for i in session.items if self._cpu_s[i.nodeid] < self._below_s]
        gc.unfreeze()  # frozen functions are not found
        known = functions()
        gc.collect()
        gc.freeze()
        work = partial(self._tried, items, known, entered, at_import)
        jobs = dict(enumerate(self._batch))
        usual_s = sum(self._cpu_s.values())
        for key, answer in in_children(work, jobs, self._workers, WAITS_S + 100 * usual_s):
            self._kills[answer or ""] += 1
            self._send((key, TIMEOUT if answer is None else answer))
        killers = [item for item in items if self._kills[item.nodeid]]
        again = _one(partial(self._run, killers))
        self._send(f"{again} fails on the unchanged code, after the mutants" if again else "")
        return True

    def _entered(self) -> dict[str, dict[str, set[int]]]:
        """By context and module the lines that ran."""
        data, lines = self._coverage.get_data(), defaultdict[str, dict[str, set[int]]](dict)
        for name in data.measured_files():
            module = str(Path(name).relative_to(TREE))
            for line, contexts in data.contexts_by_lineno(name).items():
                for context in contexts:
                    lines[context].setdefault(module, set()).add(line)
        return dict(lines)

    def _measured(self, items: list[pytest.Item]) -> Any:
        self._coverage.erase()
        self._coverage.start()
        failed = self._run(items, lambda i: self._coverage.switch_context(_file(i)))
        self._coverage.stop()
        return failed, self._cpu_s, self._entered()

    def _run(
        self, items: Sequence[pytest.Item], begin: Callable[[pytest.Item], object] = lambda _: None
    ) -> str:
        """Run tests until one fails; its name."""
        signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process
        for item, following in zip(items, [*items[1:], None], strict=True):
            begin(item)
            usual_s = self._cpu_s.get(item.nodeid, 60.0)
            signal.setitimer(signal.ITIMER_PROF, SLOWER * usual_s + HANGS_S)
            begun_s = time.process_time()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            self._cpu_s[item.nodeid] = time.process_time() - begun_s
            if self._failed:
                break
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        return self._failed or ""

    def _tried(
        self,
        items: Sequence[pytest.Item],
        known: Functions,
        entered: Any,
        at_import: Any,
        site: Site,
    ) -> str:
        """The test that notices a mutant, ``""`` or `NEEDS_IMPORT`."""
        path = TREE / site.module
        text = path.read_text("utf-8")
        lines = functions_of(text).get(site.mutant.line, set())
        if not swap(known, str(path), text, site.mutant.source):
            return NEEDS_IMPORT
        chosen = [
            i
            for i in items
            if not lines or entered.get(_file(i), {}).get(site.module, set()) & lines
        ]
        try:
            noticed = self._run(sorted(chosen, key=partial(self._place, Path(site.module).stem)))
        except BaseException as error:
            noticed = self._failed or f"pytest: {error!r}"
        ran_at_import = any(lines & there.get(site.module, set()) for there in at_import.values())
        return noticed or (NEEDS_IMPORT if ran_at_import else "")

    def _place(self, stem: str, item: pytest.Item) -> tuple[bool, float, str, float]:
        """Sort key: first the module's own tests, then tests with kills, quick tests first."""
        kills, file = self._kills[item.nodeid], _file(item)
        own = Path(file).stem == f"test_{stem}"
        return not (own or kills), -kills, file, self._cpu_s[item.nodeid]


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


# Processes.


def in_children(
    work: Callable[[Any], Any], jobs: Mapping[int, Any], workers: int, longest_s: float
) -> Iterator[tuple[int, Any]]:
    """Each key of ``jobs`` with the answer of ``work`` in a forked child; None: it gave none."""
    fork = get_context("fork")
    waiting = list(jobs)[::-1]
    running: dict[Any, tuple[int, Connection, float, str]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                key = waiting.pop()
                receiver, sender = fork.Pipe(duplex=False)
                folder = tempfile.mkdtemp(prefix="mutant-")
                child = fork.Process(target=_child, args=(work, jobs[key], sender, folder))
                child.start()
                sender.close()
                running[child] = key, receiver, time.monotonic() + longest_s, folder
            connection.wait([receiver for _, receiver, *_ in running.values()], timeout=1.0)
            for child, (key, receiver, deadline_s, folder) in list(running.items()):
                answer = None
                if receiver.poll():
                    with suppress(EOFError):
                        answer = receiver.recv()
                elif time.monotonic() < deadline_s:
                    continue
                del running[child]
                _end(child, folder)
                yield key, answer
    finally:
        for child, (*_, folder) in running.items():
            _end(child, folder)


def _one(work: Callable[[], Any]) -> Any:
    ((_, answer),) = in_children(lambda _: work(), {0: None}, 1, math.inf)
    return answer


def _child(work: Callable[[Any], Any], job: Any, to: Connection, folder: str) -> None:
    os.setpgrp()  # stays in the session of its parent, and so at the same priority
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ["TMPDIR"] = tempfile.tempdir = folder
    to.send(work(job))
    os._exit(0)  # threads that a mutant started do not count


def _end(child: Any, folder: str) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)  # and every process that the child started
    child.join()
    shutil.rmtree(folder, ignore_errors=True)


class _InMemory(SourceFileLoader):
    """Finds and loads one module from a changed text."""

    def __init__(self, module: str, source: str) -> None:
        name = ".".join(Path(module).with_suffix("").parts).removesuffix(".__init__")
        super().__init__(name, str(TREE / module))
        self._source = source

    def get_code(self, fullname: str) -> Any:
        return compile(self._source, self.path, "exec", dont_inherit=True)

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        return importlib.util.spec_from_loader(name, self) if name == self.name else None


def with_fresh_imports(tests: str, job: tuple[str, str]) -> str:
    """The folder of tests that notices a module's text, or "", in a child without the product."""
    sys.meta_path.insert(0, _InMemory(*job))
    return f"{tests}, imported anew, fails" if pytest.main([*OPTIONS, "-x", tests]) else ""


def copy_tree() -> None:
    """Bring `TREE` up to date and work there."""
    shutil.rmtree(TREE, ignore_errors=True)
    without = shutil.ignore_patterns("__pycache__")
    for name in ("can_rig", "firmware_model", "dbc", "tests", "tools", "docs"):
        if (CHECKOUT / name).is_dir():
            shutil.copytree(CHECKOUT / name, TREE / name, ignore=without)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy2(CHECKOUT / name, TREE / name)
    os.chdir(TREE)
    sys.path.insert(0, str(TREE))


def compile_the_law() -> None:
    """Before any test: a process that compiles the law says so, and tests count such lines."""
    short = ("run", "default", "--in-process", "--no-report", "--set", "duration_s=0.01")
    subprocess.run([sys.executable, "-m", "can_rig", *short], check=False, capture_output=True)


def run_room(tests: str, batch: Sequence[Site], asked: argparse.Namespace) -> Iterator[Any]:
    """By number of each mutant the test; last a text, empty unless the tests fail unchanged."""
    fork = get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)

    def session() -> None:
        signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends its children too
        plugin = Session(batch, asked.workers, asked.below, sender.send)
        status = pytest.main([*OPTIONS, tests], plugins=[plugin])
        if status not in (0, 5):
            sender.send(f"{tests} fails on the unchanged code: pytest ends with {status!r}")

    process = fork.Process(target=session)
    process.start()
    sender.close()
    try:
        while True:
            yield receiver.recv()
    except EOFError:
        pass
    finally:
        process.terminate()
        process.join()


def killers(tests: str, batch: Sequence[Site], asked: argparse.Namespace) -> dict[Site, str]:
    """The test that notices each mutant of the modules that share a folder of tests, or "".

    Raises:
        SystemExit: the tests fail on the unchanged code, before or after the mutants.
    """
    found: dict[Site, str] = {}
    anew: list[Site] = []
    begun_s = time.monotonic()
    print(f"{tests}: {len(batch)} mutants ...", file=sys.stderr, flush=True)

    def keep(site: Site, killer: str) -> None:
        found[site] = killer
        if not killer:
            print(f"survived: {site}", file=sys.stderr, flush=True)

    for answer in run_room(tests, batch, asked):
        if isinstance(answer, str):
            if answer:
                sys.exit(f"error: {answer}")
        elif answer[1] == NEEDS_IMPORT:
            anew.append(batch[answer[0]])
        else:
            keep(batch[answer[0]], answer[1])
    longest_s = WAITS_S + 10 * (time.monotonic() - begun_s)
    work = partial(with_fresh_imports, tests)
    jobs = {at: (site.module, site.mutant.source) for at, site in enumerate(anew)}
    for at, killer in in_children(work, jobs, asked.workers, longest_s):
        keep(anew[at], TIMEOUT if killer is None else killer)
    if anew:
        unchanged = anew[0].module, (TREE / anew[0].module).read_text("utf-8")
        failed = _one(partial(work, unchanged))
        if failed != "":
            sys.exit(f"error: {failed} on the unchanged code")
    return found


def report(found: Mapping[Site, str]) -> bool:
    """Print a row for each module, then the survivors; whether there are none."""
    table = Table(box=None, pad_edge=False)
    for heading in ("module", "mutants", "noticed", "survived"):
        table.add_column(heading, justify="left" if heading == "module" else "right")
    mutants_of = Counter(site.module for site in found)
    survivors = [site for site, killer in found.items() if not killer]
    survived_of = Counter(site.module for site in survivors)
    for module, count in [*mutants_of.items(), ("", len(found))]:
        survived = survived_of[module] if module else len(survivors)
        table.add_row(module, str(count), str(count - survived), str(survived))
    Console().print(table)
    for site in survivors:
        print(f"survived: {site}")
    return not survivors


def main() -> int:
    """Run the mutants; 1 if a mutant survived."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--changed", nargs="?", const="", metavar="REVISION",
        help="only lines that differ from a revision of git (default: where the branch left main)",
    )  # fmt: skip
    parser.add_argument("--only", default="*", metavar="GLOB", help="modules, such as '*/law/*'")
    parser.add_argument("--tests", metavar="PATH", help="instead of those of the module's room")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument(
        "--below", type=float, default=2.0, metavar="S", help="only tests quicker than this [2 s]"
    )
    asked = parser.parse_args()
    every = sites(modules(asked.only))
    if asked.changed is not None:
        lines = changed_lines(asked.changed or landed())
        every = [s for s in every if lines.get(s.module, set()) & {*s.mutant.lines}]
    batches: dict[tuple[bool, str], list[Site]] = defaultdict(list)
    for site in every:
        tests = asked.tests or tests_of(site.module)
        batches[is_compiled(site.module), tests].append(site)
    # The same examples for every mutant: tests/conftest.py.
    os.environ.update(CI="1", OPENBLAS_NUM_THREADS="1", PYTEST_TIMEOUT="3600")
    copy_tree()
    if not all(interpreted for interpreted, _ in batches):
        compile_the_law()
    found: dict[Site, str] = {}
    for (interpreted, tests), batch in batches.items():
        os.environ["NUMBA_DISABLE_JIT"] = str(int(interpreted))
        found |= killers(tests, batch, asked)
    return 0 if report(found) else 1


if __name__ == "__main__":
    sys.exit(main())
