"""Mutants in one session of pytest: it imports and collects once, and forks for each of them.

There the functions that a mutant changes get its code, and constants of a module their new values.
That does not reach what is made of them as modules are imported, so what survives here has yet to
be tried by an import.
"""

from __future__ import annotations

import gc
import signal
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final

import pytest
from mutation_processes import TREE, answers
from mutation_tests import OPTIONS, Plugin, Tests

_CONSTANT: Final = int | float | tuple | dict

Functions = Mapping[tuple[str, str], list[FunctionType]]
"""By file and qualified name."""

UNCHANGED: Final = "unchanged"
"""The answer for a mutant that changes more than functions and constants."""


def functions() -> Functions:
    """Every function that there is."""
    found = defaultdict(list)
    for each in gc.get_objects():
        if type(each) is FunctionType:  # what a weak proxy stands for may be gone
            found[each.__code__.co_filename, each.__code__.co_qualname].append(each)
    return found


def swap(known: Functions, path: str, before: str, after: str) -> bool:
    """Give a module the functions and constants of its changed text; whether that is the change."""
    old, new = (dict(_codes(compile(text, path, "exec"))) for text in (before, after))
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
    """Give every module that has a constant of this one its new value; whether one has changed."""
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
    """Of a module, its classes and its functions, by qualified name."""
    found, waiting = defaultdict(list), [whole]
    while waiting:
        code = waiting.pop()
        found[code.co_qualname].append(code)
        waiting += [each for each in code.co_consts if isinstance(each, CodeType)]
    return found


def _own(code: CodeType) -> Any:
    """What a code does, apart from its lines and from codes within it."""
    constants = [(type(c), c) for c in code.co_consts if not isinstance(c, CodeType)]
    return code.co_code, repr(constants), code.co_names, code.co_varnames


class _Session(Plugin):
    """Within pytest: in place of the tests themselves, the tests for each mutant."""

    def __init__(
        self, tests: Tests, mutants: Mapping[str, tuple[Path, str]], workers: int, to: Connection
    ) -> None:
        super().__init__(tests)
        self._mutants, self._workers, self._to = mutants, workers, to
        self._functions: Functions = {}
        self._is_mutant = False

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Every mutant, each in a process where pytest's own loop follows."""
        if self._is_mutant:
            return None
        self._functions = functions()
        gc.collect()
        gc.freeze()
        work = lambda mutant: self._tried(session, *mutant)  # noqa: E731
        for key, answer in answers(work, self._mutants, self._workers):
            self.tests.count(answer)
            self._to.send((key, answer))
        return True

    def _tried(self, session: pytest.Session, module: Path, source: str) -> str:
        path = TREE / module
        if not swap(self._functions, str(path), path.read_text("utf-8"), source):
            return UNCHANGED
        self._is_mutant = True
        self.module = module.stem
        self.order(session.items)
        try:
            session.config.hook.pytest_runtestloop(session=session)
        except BaseException as error:
            self.failed = self.failed or f"pytest: {error!r}"
        return self.failed or ""


def _session(
    tests: Tests, mutants: Mapping[str, tuple[Path, str]], workers: int, to: Connection
) -> None:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # it ends its own processes
    plugin = _Session(tests, mutants, workers, to)
    pytest.main([*OPTIONS, "-s", *tests.paths], plugins=[plugin])


def in_one_session(
    tests: Tests, mutants: Mapping[str, tuple[Path, str]], workers: int
) -> Iterator[tuple[str, str | None]]:
    """For each key of ``mutants`` (module, source) what noticed; "" nothing, None: no answer."""
    fork = get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)
    process = fork.Process(target=_session, args=(tests, mutants, workers, sender))
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
