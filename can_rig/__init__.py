"""The rig: a simulated plant and the controller as two processes that exchange CAN frames.

``can_rig.api`` documents the names that the package offers to Python.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from can_rig.api import (
        Campaign,
        ReplayedDrive,
        campaign,
        check,
        compare,
        decode,
        diff,
        load,
        load_scenario,
        plot,
        replay,
        run,
        save_scenario,
        stats,
        tune,
        verify,
    )
    from can_rig.views.controllers_compared import Comparison
    from can_rig.views.recorded_run import RecordedRun

__all__ = [
    "Campaign",
    "Comparison",
    "RecordedRun",
    "ReplayedDrive",
    "campaign",
    "check",
    "compare",
    "decode",
    "diff",
    "load",
    "load_scenario",
    "plot",
    "replay",
    "run",
    "save_scenario",
    "stats",
    "tune",
    "verify",
]


def __getattr__(name: str) -> Any:
    """Load a public name on first use: importing the package alone costs nothing."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("can_rig.api"), name)


def __dir__() -> list[str]:
    """The public names too, for completion in a notebook."""
    return sorted({*globals(), *__all__})
