"""The one place that compiles: ``@firmware`` marks what runs on the target, ``@compiled`` the rest.

The same lines run interpreted with ``NUMBA_DISABLE_JIT=1`` (for a debugger, for coverage) and
compiled without it, with bit-identical results: no fast-math, no reordering, no fused
multiply-add, and a division by zero that gives infinity or NaN, as in C and in NumPy.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import re
import uuid
from collections.abc import Callable
from contextlib import suppress
from functools import cache, update_wrapper
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit
from numba.core import config, event
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock
from numba.core.runtime.nrt import rtsys
from numba.np import numpy_support

Function = TypeVar("Function", bound=Callable[..., object])

# Numba numbers functions and record types from 1 on in each process, and names code by the numbers.
# Then code that two processes cache for two types has one name, and a third process that loads both
# runs the one for the other (numba's issue 10486).
_identity: Any = FunctionIdentity
_identity._unique_ids = iter(lambda: uuid.uuid4().int >> 64, None)

# Numba takes a record's layout apart anew for each of its nested records.
_records: Any = numpy_support
_records.from_struct_dtype = cache(_records.from_struct_dtype)


_IMPORT = re.compile(
    rb"^ *(?:from +([\w.]+) +import +(\([^)]*\)|[^\n]*)|import +([\w.]+))", re.MULTILINE
)


def _cache_folder(file: Path) -> str:
    """The folder for the compiled code of ``file``: each state of the source has a folder.

    Numba compares only the file of a cached function and ignores the files of called functions.
    Here the folder follows from the contents of ``file`` and of all project files that ``file``
    imports, directly or not. Modification times do not count: the kernel of a virtual machine
    rounds them.
    """
    digest = hashlib.sha256()
    for each in sorted(_closure(file)):
        digest.update(f"{each}\0".encode() + _contents(each))
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return str(Path(home) / "fault-tolerant-steering" / digest.hexdigest()[:16])


def _closure(file: Path) -> set[str]:
    """``file`` and all project files imported by ``file``, directly or indirectly."""
    root = file.parent
    while (root / "__init__.py").exists():
        root = root.parent
    roots = {"firmware_model": str(Path(__file__).parents[1])}
    roots |= {file.relative_to(root).parts[0]: str(root)}
    found: set[str] = set()
    to_read = {str(file)}
    while to_read:
        each = to_read.pop()
        found.add(each)
        to_read |= _imports(each, tuple(roots.items())) - found
    return found


@cache
def _contents(file: str) -> bytes:
    return hashlib.sha256(Path(file).read_bytes()).digest()


@cache  # many files import the same ones
def _imports(file: str, roots: tuple[tuple[str, str], ...]) -> frozenset[str]:
    """The project files that ``file`` imports itself; ``roots`` has the folder of each package."""
    folders = dict(roots)
    names = set()
    for module, imported, plain in _IMPORT.findall(Path(file).read_bytes()):
        name = (module or plain).decode()
        if name.partition(".")[0] in folders:
            names |= {name, *(f"{name}.{each}" for each in re.findall(r"\w+", imported.decode()))}
    return frozenset(
        path for name in names for path in _files(folders[name.partition(".")[0]], name)
    )


@cache
def _files(folder: str, name: str) -> tuple[str, ...]:
    """The files of the module ``name``, a package in ``folder`` or below; none for a function."""
    path = os.path.join(folder, *name.split("."))  # noqa: PTH118 (thousands: pathlib takes longer)
    both = f"{path}.py", os.path.join(path, "__init__.py")  # noqa: PTH118
    return tuple(file for file in both if os.path.isfile(file))  # noqa: PTH113


_folder = cache(_cache_folder)


def compiled(function: Function) -> Function:
    """Compile, cached on disk so that a second process starts at once."""
    return _compiled(function, allocates=True)


def firmware(function: Function) -> Function:
    """Compile without a memory counter: a function that allocates memory fails."""
    return _compiled(function, allocates=False)


def firmware_run(function: Function) -> Function:
    """Compile a whole run that releases the interpreter's lock, so that other threads go on.

    A single tick keeps the lock: a node that released the lock would wait for another thread.
    """
    return _compiled(function, allocates=False, nogil=True)


@cache  # each caller is registered once
def tell_when_compiling(tell: Callable[[], object]) -> None:
    """Call ``tell`` when this process compiles the control law (most of a minute).

    The cache keeps the code, so each version, precision and kind of processor compiles once.
    """
    event.register("numba:compile", _LawIsCompiled(tell))  # type: ignore[no-untyped-call]


class _LawIsCompiled(event.Listener):
    def __init__(self, tell: Callable[[], object]) -> None:
        self._tell = tell
        self._process = os.getpid()  # forked processes stay silent

    def on_start(self, event: event.Event) -> None:
        """Numba compiles a function that the cache lacks."""
        function = event.data["dispatcher"].py_func
        name = f"{function.__module__}.{function.__name__}"
        if name == "firmware_model.law.controller.step" and os.getpid() == self._process:
            self._tell()

    def on_end(self, event: event.Event) -> None:
        """It has been compiled."""


def _compiled(function: Function, *, allocates: bool, nogil: bool = False) -> Function:
    settings: Any = config
    if settings.DISABLE_JIT:
        return function
    # No function is passed as an argument, so none needs a wrapper for C: 7 % of the time that
    # compiling takes.
    return cast(Function, _OnFirstCall(
        function, error_model="numpy", nogil=nogil, _nrt=allocates, no_cfunc_wrapper=True,
    ))  # fmt: skip


class _OnFirstCall:
    """A function that numba sees on its first call, or where numba compiles a caller.

    A command needs code for a few of the hundreds of functions: a run from the cache starts sooner.
    """

    def __init__(self, function: Callable[..., object], **options: Any) -> None:
        update_wrapper(self, function)
        self.py_func = function
        self._options = options
        self._dispatcher: Any = None

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return (self._dispatcher or self._made())(*arguments, **named)

    def __reduce__(self) -> str:
        """Pickled by name, as a function."""
        return str(vars(self)["__qualname__"])

    @property
    def _numba_type_(self) -> Any:
        """The type that numba asks for where compiled code calls the function."""
        return (self._dispatcher or self._made())._numba_type_

    def _made(self) -> Any:
        # No second lock: a thread that compiles holds this one, and asks for further functions.
        with global_compiler_lock:
            self._dispatcher = self._dispatcher or self._new()
        return self._dispatcher

    def _new(self) -> Any:
        settings: Any = config
        made: Any = njit(**self._options)(self.py_func)
        before = settings.CACHE_DIR  # the process's
        try:
            with suppress(OSError, RuntimeError):  # no file of the source, or none for the cache
                settings.CACHE_DIR = _folder(Path(inspect.getfile(self.py_func)))
                made._cache = _Cache(self.py_func, allocates=self._options["_nrt"])
        finally:
            settings.CACHE_DIR = before
        return made


class _Cache(FunctionCache):
    """Numba's cache on the disk, for many processes and disks that fill up."""

    def __init__(self, function: Callable[..., object], *, allocates: bool) -> None:
        super().__init__(function)  # type: ignore[no-untyped-call]
        self._allocates = allocates
        # Numba counts the files of a function: two processes that compile the function at the same
        # time for different types write the same file, and the code for one type runs on the other.
        files: Any = self._cache_file
        files._data_name = lambda _number: f"{uuid.uuid4().hex}.nbc"

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The code for ``signature``; without 0.2 s for numba's library, which compiling needs."""
        if self._allocates:
            rtsys.initialize(context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(signature, context)  # type: ignore[no-untyped-call]

    def _guard_against_spurious_io_errors(self) -> Any:
        return suppress(OSError)  # then compile, as numba does where there is no folder
