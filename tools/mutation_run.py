"""Runs the tests of a room on one mutant after another, each in a process of its own.

The changed module exists in memory alone: no file is written, and the mutants do not meet. First
all of them are tried in one session of pytest (``mutation_session``), which is quick; what survives
that is tried in processes forked from one that has imported other libraries, but nothing of ours.
"""

from __future__ import annotations

import gc
import importlib
import math
import os
import shutil
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import partial
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_loader
from pathlib import Path
from typing import Any, Final

import pytest
from mutation_processes import TREE, answers
from mutation_session import UNCHANGED, in_one_session
from mutation_tests import OPTIONS, Plugin, Tests

OURS: Final = ("can_rig", "firmware_model", "tests")
TIMEOUT: Final = "timeout"


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


def _imported(tests: Tests, mutant: tuple[Path, str] | None) -> Any:
    """Run the tests on what is imported anew; what failed, the times, and what was imported."""
    if mutant is not None:
        sys.meta_path.insert(0, _InMemory(*mutant))
    plugin = Plugin(tests, mutant[0].stem if mutant else "")
    status = pytest.main([*OPTIONS, *tests.paths], plugins=[plugin])
    failed = plugin.failed or (f"pytest: {status!r}" if status else None)  # it cannot be imported
    theirs = [name for name in sys.modules if name.split(".")[0] not in OURS]
    return failed, plugin.cpu_s, theirs


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
    ((_, answer),) = answers(partial(_imported, tests), {"unchanged": None}, 1)
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
    """For each key of ``mutants`` (module, source) the test that noticed; None: none did.

    In a first pass what survives the session is left at that.
    """
    left = dict(mutants)
    for key, killer in in_one_session(tests, mutants, workers):
        if killer == UNCHANGED or (killer == "" and tests.below_s == math.inf):
            continue
        del left[key]
        yield key, TIMEOUT if killer is None else killer or None
    for key, answer in answers(partial(_imported, tests), left, workers):
        yield key, answer[0] if answer else TIMEOUT
