"""The one place that compiles: ``@firmware`` marks what runs on the target.

The same lines run interpreted with ``NUMBA_DISABLE_JIT=1`` (for a debugger, for coverage) and
compiled without it, with bit-identical float64 results: no fast-math, no reordering, no fused
multiply-add.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from numba import njit

Function = TypeVar("Function", bound=Callable[..., object])


def firmware(function: Function) -> Function:
    """Compile for the target, cached on disk so that a second process starts at once."""
    return cast(Function, njit(cache=True, fastmath=False)(function))
