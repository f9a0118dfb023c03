"""The one place that compiles: ``@firmware`` marks what runs on the target, ``@compiled`` the rest.

The same lines run interpreted with ``NUMBA_DISABLE_JIT=1`` (for a debugger, for coverage) and
compiled without it, with bit-identical results: no fast-math, no reordering, no fused
multiply-add, and a division by zero that gives infinity or NaN, as in C and in NumPy.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import config, event

Function = TypeVar("Function", bound=Callable[..., object])


def _cache_folder(caller: str) -> str:
    """Where compiled code is kept: a folder of its own for each state of the files it is made of.

    Numba looks only at the file of the function that it has cached, and would go on with an old
    copy of what that function calls in another file: of this package, or of the room ``caller``.
    """
    here = Path(__file__).parent
    other = getattr(sys.modules.get(caller), "__file__", None)
    room = Path(other).parent if other else here
    digest = hashlib.sha256(_state(here) + (b"" if room.is_relative_to(here) else _state(room)))
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return str(Path(home) / "fault-tolerant-steering" / digest.hexdigest()[:16])


@cache  # every room asks for that of this package
def _state(folder: Path) -> bytes:
    """By what its files contain: another kernel, as in a virtual machine, rounds their times."""
    digest = hashlib.sha256(str(folder).encode())
    for file in sorted(folder.rglob("*.py")):
        digest.update(f"{file}\0".encode() + file.read_bytes() + b"\0")
    return digest.digest()


_folder = cache(_cache_folder)


def compiled(function: Function) -> Function:
    """Compile, cached on disk so that a second process starts at once."""
    return _compiled(function, allocates=True)


def firmware(function: Function) -> Function:
    """The same without memory of its own: nothing is counted as in use, what allocates fails."""
    return _compiled(function, allocates=False)


def firmware_run(function: Function) -> Function:
    """The same for a whole run: without the interpreter's lock, so that other threads go on.

    A tick keeps it: a node that let go of it there would wait for a thread that has taken it.
    """
    return _compiled(function, allocates=False, nogil=True)


@cache  # asked for twice, it is told once
def tell_when_compiling(tell: Callable[[], object]) -> None:
    """Call ``tell`` when this process compiles the control law, which takes most of a minute.

    It is kept, so this happens once for each version, precision and kind of processor.
    """
    event.register("numba:compile", _LawIsCompiled(tell))  # type: ignore[no-untyped-call]


class _LawIsCompiled(event.Listener):
    def __init__(self, tell: Callable[[], object]) -> None:
        self._tell = tell
        self._process = os.getpid()  # and not in those that it forks

    def on_start(self, event: event.Event) -> None:
        """Something is being compiled that is not kept yet."""
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__name__}"
        if name == "firmware_model.target.controller.step" and os.getpid() == self._process:
            self._tell()

    def on_end(self, event: event.Event) -> None:
        """It has been compiled."""


def _compiled(function: Function, *, allocates: bool, nogil: bool = False) -> Function:
    settings: Any = config
    package = ".".join(function.__module__.split(".")[:2])  # a room, or the package
    before, settings.CACHE_DIR = settings.CACHE_DIR, _folder(package)
    # _nrt: numba's own option, which its hints do not name
    options: dict[str, Any] = {"error_model": "numpy", "nogil": nogil, "_nrt": allocates}
    try:
        return cast(Function, njit(cache=True, **options)(function))
    except RuntimeError:  # there is no folder to keep it in
        return cast(Function, njit(cache=False, **options)(function))
    finally:
        settings.CACHE_DIR = before
