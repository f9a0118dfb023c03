"""The rig: a simulated plant and the controller as two processes that exchange CAN frames.

From Python: ``can_rig.run``, ``load``, ``scenario``, ``check``, ``tune`` and ``decode``, which
``can_rig.api`` documents.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from can_rig.api import RecordedRun, check, decode, load, run, scenario, tune

__all__ = ["RecordedRun", "check", "decode", "load", "run", "scenario", "tune"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: importing the package alone costs nothing."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("can_rig.api"), name)


def __dir__() -> list[str]:
    """The public names too, for completion in a notebook."""
    return sorted({*globals(), *__all__})
