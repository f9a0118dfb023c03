"""Where compiled code is kept, and what happens where it cannot be."""

from __future__ import annotations

import os
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numba.core import config, event
from numba.core.errors import NumbaError

from firmware_model import compiled
from firmware_model.law import controller


def test_another_state_of_what_a_file_imports_has_another_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba looks at the file of the cached function alone, not at what that calls.

    Modification times do not matter: hostfs of a user-mode kernel, for one, has no parts of a
    second. Nor do files that are not imported, such as a comment in the design for the law.
    """
    files = {
        "caller/__init__.py": "",
        "caller/room/__init__.py": "",
        "caller/room/a.py": "from caller.room import (\n    b,\n    c,\n)\n",
        "caller/room/b.py": "import firmware_model.law\nimport elsewhere\n",
        "caller/room/c.py": "def c():\n    from caller import late\n",
        "caller/late.py": "from caller.room.a import anything  # a circle",
        "caller/foreign.py": "",
        "firmware_model/__init__.py": "",
        "firmware_model/law.py": "",
        "elsewhere.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).write_text(text)
    compiler = tmp_path / "firmware_model" / "compiled.py"
    monkeypatch.setattr(compiled, "__file__", str(compiler))

    def folder_in_another_process() -> str:
        compiled._contents.cache_clear()
        compiled._imports.cache_clear()
        return compiled._cache_folder(tmp_path / "caller" / "room" / "a.py")

    first = folder_in_another_process()
    assert folder_in_another_process() == first
    imported = ["room/a.py", "room/b.py", "room/c.py", "late.py"]
    for name in [f"caller/{each}" for each in imported] + ["firmware_model/law.py"]:
        (tmp_path / name).write_text(files[name] + "# another state\n")
        assert folder_in_another_process() != first
        (tmp_path / name).write_text(files[name])
        os.utime(tmp_path / name, ns=(0, 0))
        assert folder_in_another_process() == first
    for name in ("caller/foreign.py", "elsewhere.py"):
        (tmp_path / name).write_text("# another state\n")
        assert folder_in_another_process() == first


def nothing() -> None:
    pass


def test_refusal_to_cache_is_no_refusal_to_compile(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def njit(cache, **options):  # type: ignore[no-untyped-def]
        calls.append((cache, options))
        if cache:
            raise RuntimeError("no locator available")
        return lambda function: function

    monkeypatch.setattr(compiled, "njit", njit)
    assert compiled.firmware(nothing) is nothing
    options = {"error_model": "numpy", "nogil": False, "_nrt": False}
    assert calls == [(True, options), (False, options)]


def test_only_a_whole_run_lets_go_of_the_lock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tick of a node keeps the lock: releasing costs a wait for the next owner."""
    monkeypatch.setattr(compiled, "njit", lambda cache, **options: lambda function: options)
    options: list[Any] = [
        mark(nothing) for mark in (compiled.firmware, compiled.compiled, compiled.firmware_run)
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
    law = getattr(controller.step, "py_func", controller.step)  # the interpreted function
    compile_one(law)
    assert told == [1]
    monkeypatch.setattr(os, "getpid", lambda: -1)  # a forked process
    compile_one(law)
    assert told == [1]
