"""Runs the tests on one mutant after another, each in a process forked from one that has imported.

The changed module exists in memory alone: no file is written, and the mutants do not meet.
"""

from __future__ import annotations

import gc
import importlib
import math
import os
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_loader
from multiprocessing import connection, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

import pytest

TREE: Final = Path(__file__).parents[1] / "build" / "mutation"
"""A copy of the checkout, so that work on that can go on meanwhile."""

OURS: Final = ("can_rig", "firmware_model", "tests")
TIMEOUT: Final = "timeout"
_SLOWER: Final = 10  # times the usual duration of a test, and then it hangs
_SLOWER_S: Final = 2.0
_WAITS_S: Final = 120  # of the clock on the wall, for a test that waits without computing
_LONGEST_S: Final = 7200.0  # for all of them


@dataclass
class Tests:
    """The tests of a room, and what is known of them."""

    paths: Sequence[str]
    cpu_s: dict[str, float] = field(default_factory=dict)
    """CPU time of each test on the unchanged code [s], as far as it is known."""
    below_s: float = math.inf
    """Tests that take longer are left out."""
    kills: Counter[str] = field(default_factory=Counter)
    """Number of mutants that each test has noticed first."""


class Plugin:
    """Within pytest: the module's own tests first, then those that noticed others.

    None may take much longer than usual.
    """

    def __init__(self, tests: Tests, module: str) -> None:
        self._tests = tests
        self._own = f"test_{module}.py"
        self.failed: str | None = None
        self.cpu_s: dict[str, float] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Choose and order them; files stay together, for the fixtures that their tests share."""
        cpu_s = self._tests.cpu_s
        items[:] = [i for i in items if cpu_s.get(i.nodeid, 0.0) < self._tests.below_s]
        file_s: dict[str, float] = defaultdict(float)
        for test, test_s in cpu_s.items():
            file_s[test.partition("::")[0]] += test_s
        kills = self._tests.kills

        def order(item: pytest.Item) -> tuple[bool, int, float]:
            file = item.nodeid.partition("::")[0]
            return not file.endswith(f"/{self._own}"), -kills[item.nodeid], file_s[file]

        items.sort(key=order)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Bound the CPU time of a test."""
        usual_s = self._tests.cpu_s.get(item.nodeid, 60.0)
        signal.setitimer(signal.ITIMER_PROF, _SLOWER * usual_s + _SLOWER_S)
        begun_s = time.process_time()
        result = yield
        self.cpu_s[item.nodeid] = time.process_time() - begun_s
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the first test that fails."""
        if report.failed:
            self.failed = self.failed or report.nodeid


class _InMemory(SourceFileLoader):
    """Finds and loads one module from a changed text."""

    def __init__(self, module: Path, source: str) -> None:
        name = ".".join(module.with_suffix("").parts).removesuffix(".__init__")
        super().__init__(name, str(TREE / module))
        self._source = source

    def get_code(self, fullname: str) -> Any:
        return compile(self._source, self.path, "exec", dont_inherit=True)

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        return spec_from_loader(name, self) if name == self.name else None


def _in_process(
    tests: Tests, mutant: tuple[Path, str] | None, folder: Path, to: Connection
) -> None:
    """Run the tests; answers with what failed, the times, and what had to be imported."""
    os.setsid()
    silence = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(silence, stream)
    signal.signal(signal.SIGPROF, signal.SIG_DFL)  # ends the process
    if mutant is not None:
        sys.meta_path.insert(0, _InMemory(*mutant))
    plugin = Plugin(tests, mutant[0].stem if mutant else "")
    options = ["-x", "-q", "-p", "no:cacheprovider", f"--timeout={_WAITS_S}"]
    options += [f"--basetemp={folder / 'tmp'}", "-m", "not vcan and not long"]
    status = pytest.main([*options, *tests.paths], plugins=[plugin])
    failed = plugin.failed or (f"pytest: {status!r}" if status else None)  # it cannot be imported
    theirs = [name for name in sys.modules if name.split(".")[0] not in OURS]
    to.send((failed, plugin.cpu_s, theirs))
    os._exit(0)  # whatever threads a mutant has left behind


def copy_tree() -> None:
    """Bring `TREE` up to date; what has not changed keeps its date, and so what is compiled."""
    checkout = TREE.parents[1]
    shutil.rmtree(TREE, ignore_errors=True)
    for name in ("can_rig", "firmware_model", "dbc", "tests", "tools"):
        without = shutil.ignore_patterns("__pycache__")
        shutil.copytree(checkout / name, TREE / name, ignore=without)
    for name in ("pyproject.toml", "README.md"):
        shutil.copy2(checkout / name, TREE / name)
    os.chdir(TREE)
    sys.path.insert(0, str(TREE))
    os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = str(TREE / ".hypothesis")  # what it reads of files


class BaselineError(Exception):
    """The tests fail on the unchanged code."""


def check_unchanged(tests: Tests) -> list[str]:
    """Run the tests on the unchanged code; the names of what had to be imported.

    Raises:
        BaselineError: one of them fails.
    """
    ((_, answer),) = _answers(tests, {"unchanged": None}, 1)
    if answer is None:
        raise BaselineError("a test takes too long on the unchanged code")
    failed, cpu_s, imported = answer
    if failed:
        raise BaselineError(f"{failed} fails on the unchanged code")
    tests.cpu_s.update(cpu_s)
    return imported


def measure(tests: Tests) -> None:
    """Run the tests on the unchanged code; imports here what they import of others.

    Raises:
        BaselineError: one of them fails.
    """
    for name in check_unchanged(tests):
        with suppress(Exception):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()  # pytest collects garbage at its end: of each process its own alone


def killers(
    tests: Tests, mutants: Mapping[str, tuple[Path, str]], workers: int
) -> Iterator[tuple[str, str | None]]:
    """For each key of ``mutants`` (module, source) the test that noticed; None: none did."""
    for key, answer in _answers(tests, mutants, workers):
        killer = answer[0] if answer else TIMEOUT
        if killer:
            tests.kills[killer] += 1
        yield key, killer


def _answers(tests: Tests, mutants: Mapping[str, Any], workers: int) -> Iterator[tuple[str, Any]]:
    """Each key with the answer of its process; None where there was no answer."""
    fork = get_context("fork")
    waiting = list(mutants)[::-1]
    running: dict[Any, tuple[str, Connection, float]] = {}
    with tempfile.TemporaryDirectory(prefix="mutants-", ignore_cleanup_errors=True) as root:
        try:
            while waiting or running:
                while waiting and len(running) < workers:
                    key = waiting.pop()
                    folder = Path(tempfile.mkdtemp(dir=root))
                    receiver, sender = fork.Pipe(duplex=False)
                    process = fork.Process(
                        target=_in_process, args=(tests, mutants[key], folder, sender)
                    )
                    process.start()
                    sender.close()
                    running[process] = key, receiver, time.monotonic() + _LONGEST_S
                connection.wait([receiver for _, receiver, _ in running.values()], timeout=1.0)
                for process, (key, receiver, deadline_s) in list(running.items()):
                    answer = None
                    if receiver.poll():
                        with suppress(EOFError):
                            answer = receiver.recv()
                    elif time.monotonic() < deadline_s:
                        continue
                    _end(process)
                    del running[process]
                    yield key, answer
        finally:
            for process in running:
                _end(process)


def _end(process: Any) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)  # with all that it started
    process.join()
