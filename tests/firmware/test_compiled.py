"""Where compiled code is kept, and what happens where it cannot be."""

import os
import pickle
import resource
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import config, event
from numba.core.caching import FunctionCache
from numba.core.errors import NumbaError

from firmware_model import compiled
from firmware_model.law import controller


def test_another_state_of_what_a_file_imports_has_another_folder(tmp_path, monkeypatch):
    """Numba looks at the file of the cached function alone, not at what that calls.

    Modification times do not matter: hostfs of a user-mode kernel, for one, has no parts of a
    second. Nor do files that are not imported, such as a comment in the design for the law.
    """
    files = {
        "caller/__init__.py": "", "caller/room/__init__.py": "",
        "caller/room/a.py": "from caller.room import (\n    b,\n    c,\n)\n",
        "caller/room/b.py": "import firmware_model.law\nimport elsewhere\n",
        "caller/room/c.py": "def c():\n    from caller import late\n",
        "caller/late.py": "from caller.room.a import anything  # a circle", "caller/foreign.py": "",
        "firmware_model/__init__.py": "", "firmware_model/law.py": "", "elsewhere.py": "",
    }  # fmt: skip
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


def three() -> int:
    return 3


def test_refusal_to_cache_is_no_refusal_to_compile(monkeypatch):
    def refuse(*_: object) -> None:
        raise RuntimeError("no locator available")

    monkeypatch.setattr(config, "DISABLE_JIT", 0)
    monkeypatch.setattr(FunctionCache, "__init__", refuse)
    function = compiled.firmware(three)
    assert function() == 3
    assert len(numba.typeof(function).dispatcher.overloads) == 1


def test_a_function_of_no_file_is_compiled(monkeypatch):
    """As in a notebook, or from standard input."""
    monkeypatch.setattr(config, "DISABLE_JIT", 0)
    known: dict[str, Any] = {}
    exec(compile("def four(): return 4", "<stdin>", "exec"), known)
    assert compiled.firmware(known["four"])() == 4


def test_only_a_whole_run_lets_go_of_the_lock(monkeypatch):
    """A tick of a node keeps the lock: releasing costs a wait for the next owner."""
    monkeypatch.setattr(config, "DISABLE_JIT", 0)
    monkeypatch.setattr(compiled, "njit", lambda **options: lambda function: lambda: options)
    options: list[Any] = [
        mark(three)() for mark in (compiled.firmware, compiled.compiled, compiled.firmware_run)
    ]
    assert [each["nogil"] for each in options] == [False, False, True]
    assert [each["_nrt"] for each in options] == [False, True, False]
    assert options[0] == {
        "error_model": "numpy", "nogil": False, "_nrt": False, "no_cfunc_wrapper": True,
    }  # fmt: skip


def test_what_runs_on_the_target_cannot_allocate(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", 0)

    @compiled.firmware
    def reserve(n: int) -> float:
        return float(np.zeros(n)[0])

    @compiled.compiled
    def reserve_elsewhere(n: int) -> float:
        return float(np.zeros(n)[0])

    with pytest.raises(NumbaError, match="zeros"):
        reserve(3)
    assert reserve_elsewhere(3) == 0.0


def test_another_process_gets_a_compiled_function_by_its_name(monkeypatch):
    monkeypatch.setattr(config, "DISABLE_JIT", 0)
    made = compiled.firmware(three)
    monkeypatch.setattr(sys.modules[__name__], "three", made)
    assert pickle.loads(pickle.dumps(made)) is made


TWO_THREADS = """
import threading, time
import numba
from numba.core.compiler_lock import global_compiler_lock
from firmware_model import compiled

called, asked, locked = *(compiled.firmware(lambda: 3.0) for _ in range(2)), threading.Event()

def call():
    locked.wait()
    called()

other = threading.Thread(target=call)
other.start()
with global_compiler_lock:  # as while a caller of a function is compiled
    locked.set()
    time.sleep(0.2)  # the other thread waits for the lock now
    numba.typeof(asked)
other.join()
"""


@pytest.mark.compiled
def test_a_thread_that_compiles_does_not_wait_for_a_first_call_in_another(tmp_path):
    folders = {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    file = tmp_path / "two_threads.py"  # numba caches no function that has no file
    file.write_text(TWO_THREADS)
    subprocess.run([sys.executable, file], check=True, timeout=60, env=os.environ | folders)


def test_who_waits_for_the_law_to_be_compiled_is_told(monkeypatch):
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


def test_code_for_two_types_compiled_at_once_is_not_mixed_up(tmp_path, monkeypatch):
    """The order of two processes that lets numba put the code for one type in place of the other's.

    Both have read an index without entries; the first writes its code last.
    """
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    first, second = (compiled._Cache(three, allocates=False)._cache_file for _ in range(2))
    late: list[tuple[str, str]] = []
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(first, "_save_data", lambda name, code: late.append((name, code)))
        first.save("float64", "code for float64")
    (index,) = tmp_path.rglob("*.nbi")
    index.unlink()
    second.save("float32", "code for float32")
    first._save_data(*late[0])
    assert second.load("float32") == "code for float32"


MODULE = """
import sys
import numba
import numpy as np
from firmware_model.compiled import compiled, firmware

@firmware
def double(state):
    state.value += state.value

@compiled
def twice(values):
    return np.repeat(values, 2)

for real in sys.argv[1:]:
    states = np.full(1, 21, [("before", real), ("value", real), ("after", real)])
    double(states[0])
    assert states.item() == (21, 42, 21)
assert twice(np.ones(1)).sum() == 2
for code in numba.typeof(double).dispatcher.overloads.values():
    print(code.fndesc.mangled_name)
"""


def names(tmp_path: Path, *reals: str, **more: Any) -> list[str]:
    """What another process prints that runs ``MODULE`` for the types ``reals``."""
    (tmp_path / "two_types.py").write_text(MODULE)
    folders = {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, str(tmp_path / "two_types.py"), *reals]
    done = subprocess.run(
        command, env=os.environ | folders, capture_output=True, text=True, check=True, **more
    )
    return done.stdout.split()


@pytest.mark.compiled
def test_code_that_two_processes_have_cached_for_two_types_has_two_names(tmp_path):
    """A process that loads both would run the one for the other."""
    (double,), (single,) = names(tmp_path, "f8"), names(tmp_path, "f4")
    assert double != single
    assert names(tmp_path, "f4", "f8") == [single, double]


@pytest.mark.compiled
def test_a_full_disk_is_no_refusal_to_compile(tmp_path):
    def full() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))  # no file of a byte or more

    assert len(names(tmp_path, "f8", preexec_fn=full)) == 1
    assert not [path for path in tmp_path.rglob("*.nb?") if path.stat().st_size]
