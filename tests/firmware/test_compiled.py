"""Where compiled code is kept, and what happens where it cannot be."""

from __future__ import annotations

import os
import sys
from collections import defaultdict
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numba.core import config, event
from numba.core.errors import NumbaError

from firmware_model import compiled
from firmware_model.target import controller


def test_another_state_of_the_package_has_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba looks at the file of the cached function alone, not at what that calls.

    Times do not matter: hostfs of a user-mode kernel, for one, has no parts of a second.
    """
    for package in ("here", "caller"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "a.py").write_text("1")
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "here" / "compiled.py"))
    caller = ModuleType("caller")
    caller.__file__ = str(tmp_path / "caller" / "__init__.py")
    monkeypatch.setitem(sys.modules, "caller", caller)

    def folder_in_another_process() -> str:
        compiled._state.cache_clear()
        return compiled._cache_folder("caller")

    found = [folder_in_another_process()]
    assert folder_in_another_process() == found[0]
    for package in ("here", "caller"):
        (tmp_path / package / "a.py").write_text("2")
        found.append(folder_in_another_process())
        os.utime(tmp_path / package / "a.py", ns=(0, 0))
        assert folder_in_another_process() == found[-1]
    assert len(set(found)) == 3


def test_refusal_to_cache_is_no_refusal_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def njit(cache, **options):  # type: ignore[no-untyped-def]
        calls.append((cache, options))
        if cache:
            raise RuntimeError("no locator available")
        return lambda function: function

    monkeypatch.setattr(compiled, "njit", njit)
    assert compiled.firmware(abs) is abs
    options = {"error_model": "numpy", "nogil": False, "_nrt": False}
    assert calls == [(True, options), (False, options)]


def test_only_a_whole_run_lets_go_of_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tick of a node keeps it: to have it back it would wait for whoever took it."""
    monkeypatch.setattr(compiled, "njit", lambda cache, **options: lambda function: options)
    options: list[Any] = [
        mark(abs) for mark in (compiled.firmware, compiled.compiled, compiled.firmware_run)
    ]
    assert [each["nogil"] for each in options] == [False, False, True]
    assert not options[2]["_nrt"]


def test_what_runs_on_the_target_cannot_allocate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "DISABLE_JIT", 0)

    @compiled.firmware
    def reserve(n: int) -> float:
        return float(np.zeros(n)[0])

    with pytest.raises(NumbaError, match="zeros"):
        reserve(3)


def test_who_waits_for_the_law_to_be_compiled_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_one(function: Any) -> None:
        dispatcher = SimpleNamespace(py_func=function)
        with event.trigger_event("numba:compile", data={"dispatcher": dispatcher}):
            pass

    told: list[int] = []
    monkeypatch.setattr(event, "_registered", defaultdict(list))
    compiled.tell_when_compiling(lambda: told.append(1))
    compile_one(compiled.firmware)
    assert told == []
    law = getattr(controller.step, "py_func", controller.step)  # as it is where it is interpreted
    compile_one(law)
    assert told == [1]
    monkeypatch.setattr(os, "getpid", lambda: -1)  # a process that this one has forked
    compile_one(law)
    assert told == [1]
