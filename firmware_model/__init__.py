"""The thesis's fault-tolerant controller: continuous designs, discretised into firmware.

No function opens a file, reads a clock or knows a bus: each function is arithmetic on its
arguments. So the tests run the same code as the target.

``discretise`` makes a ``Filter`` of any continuous filter; ``testing`` compares a filter with
theory.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from firmware_model.discretisation.filters import Filter, discretise

__all__ = ["Filter", "discretise"]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first asked for: importing the package alone costs nothing."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("firmware_model.discretisation.filters"), name)


def __dir__() -> list[str]:
    """The public names too, for completion in a notebook."""
    return sorted({*globals(), *__all__})
