"""The search for the worst run: CMA-ES over the unit cube of the axes, generation by generation.

The search proposes points and receives margins in the order of the runs; so the path is the same
for any number of workers, and after an interruption (Hansen, The CMA Evolution Strategy: A
Tutorial, 2016). After convergence the search restarts from another point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from can_rig.errors import require

GENERATION: Final = 16
"""Points requested at once, independent of the workers."""
SPREAD: Final = 0.3
"""Standard deviation of the first generation, in parts of each axis."""
LEAST_DIMENSIONS: Final = 2
"""Least dimension for cma; a single axis gets a second axis without effect."""

Point = tuple[float, ...]
"""A place in [0, 1] on each axis."""


class Search:
    """Ask-and-tell search: ``tell`` takes the margins of the points from ``ask``.

    Args:
        axes: number of axes.
        seed: of the random numbers.

    Raises:
        MissingExtraError: cma is not installed.
    """

    def __init__(self, axes: int, seed: int) -> None:
        require("cma", extra="search")
        self._axes = axes
        self._random = np.random.default_rng(seed)
        self._strategy: Any = None
        self._asked: list[Any] = []

    def ask(self) -> list[Point]:
        """The next generation."""
        if self._strategy is None or self._strategy.stop():
            self._strategy = self._begun()
        self._asked = self._strategy.ask()
        return [tuple(point[: self._axes].tolist()) for point in self._asked]

    def tell(self, margins: Sequence[float | None]) -> None:
        """Take the margins of the last generation.

        A run without a margin gets the largest margin of the generation.
        """
        known = [margin for margin in margins if margin is not None]
        none = max(known, default=0.0)
        self._strategy.tell(self._asked, [none if each is None else each for each in margins])

    def _begun(self) -> Any:
        import cma  # noqa: PLC0415 (an extra)

        dimensions = max(self._axes, LEAST_DIMENSIONS)
        return cma.CMAEvolutionStrategy(
            self._random.random(dimensions),
            SPREAD,
            {
                "popsize": GENERATION,
                "bounds": [0.0, 1.0],
                "randn": lambda *shape: self._random.standard_normal(shape),
                "seed": np.nan,  # the generator of all of NumPy is left alone
                "verbose": -9,
                "verb_log": 0,
            },
        )
