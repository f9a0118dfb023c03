"""A scenario: TOML to settings, settings to design, target, table and reference.

`shipped/` holds the scenarios of the package. It imports `frames` and `firmware_model`.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """A room that also acts as a function: ``can_rig.scenario(…)`` calls ``can_rig.api``."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return import_module("can_rig.api").scenario(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
