"""The packages whose versions decide the bits of a run."""

from __future__ import annotations

from functools import cache
from importlib.metadata import version


@cache
def versions() -> dict[str, str]:
    """Versions of this process, by package."""
    packages = ("fault-tolerant-steering", "numpy", "scipy", "numba")
    return {package: version(package) for package in packages}
