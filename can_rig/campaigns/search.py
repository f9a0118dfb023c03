"""The search for the worst run: CMA-ES over the unit cube of the axes, generation by generation.

Asked for points and told their margins in the order of their runs, so that it goes the same way on
any number of workers, and again after an interruption (Hansen, The CMA Evolution Strategy: A
Tutorial, 2016). Where it has settled it begins anew, somewhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from can_rig.errors import require

GENERATION: Final = 16
"""Points that are asked for at once, whoever computes them."""
SPREAD: Final = 0.3
"""Standard deviation of the first generation, in parts of each axis."""
LEAST_DIMENSIONS: Final = 2
"""Of cma; an axis that is alone gets one beside it that does nothing."""

Point = tuple[float, ...]
"""A place in [0, 1] on each axis."""


class Search:
    """Points whose margins ``tell`` has heard of make those that ``ask`` names.

    Args:
        axes: how many there are.
        seed: decides what is drawn.

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
        """The margins of that generation; a run that has none is no worse than any other."""
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
