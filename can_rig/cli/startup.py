"""The process around a command, before anything heavy is imported.

Ctrl-C ends an import without a traceback; garbage collection is off during imports; libraries lose
unused optional dependencies and keep silent; errors of the operating system become one line; and a
note comes before the control law compiles.
"""

import atexit
import errno
import gc
import logging
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import LazyLoader
from types import ModuleType
from typing import Final

from can_rig.errors import INTERRUPTED, UNREAD, RigError, one_line


def end_at_once() -> None:
    """From here on Ctrl-C and SIGTERM end the process silently: no file needs cleaning up."""
    for number, handler in ((signal.SIGINT, _end), (signal.SIGTERM, signal.SIG_DFL)):
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup
            signal.signal(number, handler)


def raise_again() -> None:
    """From here on Ctrl-C raises ``KeyboardInterrupt``, so half-written files are removed."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = _interrupt_later


LOST_INTERRUPT: Final = threading.Event()
"""Set where Python has dropped a Ctrl-C: what fails next may fail by the Ctrl-C."""


def _interrupt_later(lost: "sys.UnraisableHookArgs") -> None:
    """Python drops what a destructor or a callback of C raises, a Ctrl-C too: raise it once more.

    The thread gives the main thread time to leave the destructor.
    """
    if isinstance(lost.exc_value, KeyboardInterrupt):
        LOST_INTERRUPT.set()
        threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(lost)


def _end(_number: int, _frame: object) -> None:
    os._exit(INTERRUPTED)


def collect_nothing() -> None:
    """Switch garbage collection off from here on, at process exit too.

    Hundreds of thousands of imported objects stay alive; Python would search the growing heap again
    and again, a third of the time of a short command.
    """
    gc.disable()
    atexit.register(gc.freeze)


def collect_again() -> None:
    """Switch garbage collection on again, except for imported objects."""
    if not gc.isenabled():
        gc.freeze()
        gc.enable()


_NOT_WANTED = {
    "asammdf": ("can.io.mf4", "MF4Writer"),
    "coverage": ("numba.misc.coverage_support", "coverage_available"),
    "yaml": ("numba.core.config", "_HAVE_YAML"),
}
"""By name: which module imports it if it can, and what that module has once it is imported.

Asammdf brings pandas with it, most of a second that only .mf4 logs need, and ``can_rig.logs`` calls
it itself. Coverage would be told which lines numba compiles. Yaml would read a file of settings.
"""
_LATER = {
    "cantools.logreader", "cantools.tester", "numpy.f2py", "numpy.ma", "numpy.testing",
}  # fmt: skip
"""Parts of libraries that their packages import unused; loaded where an attribute is asked for.

The first two bring parts of python-can, those of NumPy come with scipy's ``from numpy import *``.
"""


class _WithoutSignatures(SourceFileLoader):
    """Loads ``matplotlib.artist``, whose signatures for ``help()`` take 0.2 s to write."""

    def exec_module(self, module: ModuleType) -> None:
        """Execute the module; its later classes inherit a plain method ``set``."""
        super().exec_module(module)
        artist = vars(module)["Artist"]
        artist._update_set_signature_and_docstring = classmethod(lambda _: None)


class _WithoutThem:
    """Hides optional dependencies from a single importing module, and puts parts off."""

    @classmethod
    def find_spec(
        cls, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Refuse a hidden dependency to its importer alone; let a part of `_LATER` wait."""
        if name in _NOT_WANTED:
            asking, has = _NOT_WANTED[name]
            importer = sys.modules.get(asking)
            if importer is not None and not hasattr(importer, has):
                raise ModuleNotFoundError(f"{name} is left out of {asking}", name=name)
        if name not in _LATER and name != "matplotlib.artist":
            return None
        spec = PathFinder.find_spec(name, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            later, file = name in _LATER, spec.loader
            spec.loader = LazyLoader(file) if later else _WithoutSignatures(name, file.path)
        return spec


def silence() -> None:
    """Silence a library's remarks on bad input; the command's own error line names the fault."""
    logging.getLogger().addHandler(logging.NullHandler())
    if not sys.warnoptions:
        warnings.simplefilter("ignore")


def leave_out() -> None:
    """Hide dependencies in this process; a program that imports ``can_rig`` sees them all."""
    sys.meta_path.insert(0, _WithoutThem)


_OF_A_STREAM = {errno.ENOSPC, errno.EIO, errno.EBADF}
"""Errors that name no file when they concern standard output."""


def write_what_can_be_written() -> None:
    """A terminal that has no ² shows a question mark; what can be shown is shown."""
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:  # closed by the shell
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]


@contextmanager
def refusals_in_one_line() -> Iterator[None]:
    """A full disk, too many open files and the like end the command with one line.

    Output that still waits is written before the context is left, because afterwards Python would
    print a traceback for it.
    """
    try:
        try:
            yield
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:  # whoever read it, such as head, has seen enough
        sys.stdout = None
        sys.exit(UNREAD)
    except OSError as error:
        with suppress(OSError):  # standard error may be full too
            print(f"error: {_reason(error)}", file=sys.stderr)
        sys.stdout = None  # Python flushes it once more
        sys.unraisablehook = lambda _: None  # of what was half made, such as an event loop
        sys.exit(RigError.exit_status)


def _reason(error: OSError) -> str:
    if error.filename is None and error.errno in _OF_A_STREAM:
        return f"standard output cannot be written: {one_line(error)}"
    return one_line(error)


def announce_compilation() -> None:
    """From here on print a note before the control law compiles."""
    if "firmware_model.compiled" in sys.modules:
        from firmware_model.compiled import tell_when_compiling  # noqa: PLC0415 (is there already)

        tell_when_compiling(_tell)


def _tell() -> None:
    from can_rig.cli.output import note  # noqa: PLC0415 (hardly ever)

    note("compiling the control law, once for this version and precision: most of a minute")
