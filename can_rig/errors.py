"""Errors that users can correct, with their exit statuses."""

import difflib
import re
import sys
from collections.abc import Callable, Iterable
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import Final, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

ARGUMENTS: Final = {
    "--allow-unstable": "allow_unstable=True",
    "--force": "force=True",
    "--box-set": "ranges",
    "--box": "box",
    "--spare-ticks": "spare_ticks",
    "--torque-noise-limit": "torque_noise_limit_nm",
    "--noise-limit": "noise_limit_n",
    "--out": "folder",
    "--scenario NAME": "name",
    "--set ": "",
    "--tolerance ": "tolerances: ",
    "--from": "from_s",
    "--to": "to_s",
}
"""Python's argument names for options of the command line."""

INTERRUPTED: Final = 130
"""Exit status after Ctrl-C, following shells."""

UNREAD: Final = 141
"""Exit status after the reader of the output has ended, such as head, following shells."""


def one_line(error: BaseException) -> str:
    """What ``error`` says, on one line; of the operating system the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split()) or type(error).__name__


def did_you_mean(name: str, known: Iterable[str], otherwise: str, cutoff: float = 0.6) -> str:
    """The hint of the ``known`` name nearest to an unknown one; ``otherwise`` if none is near."""
    near = difflib.get_close_matches(name, list(known), 1, cutoff)
    return f"did you mean {near[0]}?" if near else otherwise


class RigError(Exception):
    """A failure shown to the user as one line, with exit status 2."""

    exit_status = 2


def in_python(function: Callable[P, T]) -> Callable[P, T]:
    """``function`` with errors that name Python arguments in place of options."""
    option = re.compile("|".join(ARGUMENTS))

    @wraps(function)
    def called(*arguments: P.args, **keywords: P.kwargs) -> T:
        try:
            return function(*arguments, **keywords)
        except RigError as error:
            said = option.sub(lambda found: ARGUMENTS[found[0]], str(error))
            error.args = (said, *error.args[1:])
            raise

    return called


class BusError(RigError):
    """A failure to open the bus: an unknown name, or an absent interface."""


class ScenarioError(RigError):
    """A scenario that does not exist, an unknown key, a bad value."""


class RunFolderError(RigError):
    """An existing, unwritable or invalid run folder."""


class SilentNodeError(RigError):
    """The other node was silent for longer than the watchdog allows."""

    exit_status = 3


class BusLostError(RigError):
    """The bus stopped carrying frames during a run, for longer than the watchdog allows."""

    exit_status = 3


class WorkersLostError(RigError):
    """A campaign's workers died or left; finished runs are kept."""

    exit_status = 3


class DbcError(RigError):
    """A DBC without the rig's frames; names file, frame and requirement."""


class LogError(RigError):
    """An unreadable, unwritable or mismatched log; names file and place."""


class ExportError(RigError):
    """The control law cannot be exported, compiled or run as C; names the file and the line."""


class MissingExtraError(RigError):
    """A missing package that an extra installs; names package and extra."""


def require(package: str, extra: str) -> None:
    """Refuse a missing ``package`` before its import, naming the ``extra`` to install.

    Raises:
        MissingExtraError: it is not installed.
    """
    if find_spec(package) is not None:
        return
    from importlib.metadata import requires  # noqa: PLC0415 (hardly ever)

    setup = Path(__file__).parents[1] / "tools" / "setup"
    if setup.is_file() and Path(sys.prefix) == setup.parents[1] / ".venv":
        command = f"{setup} {extra}"
    else:  # this project stands in no index; the package does
        lines = (line.partition(";") for line in requires("fault-tolerant-steering") or [])
        (needed,) = (
            what for what, _, marker in lines if marker.strip("'\" ").endswith(f" '{extra}")
        )
        command = f"{sys.executable} -m pip install '{needed}'"
    raise MissingExtraError(f"{package} is not installed: {command}")
