"""What a controller of one's own is constructed with."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_plant, target
from can_rig.scenario.settings import Scenario
from firmware_model.design.plants import Plant


@dataclass(frozen=True)
class ControllerSetup:
    """The facts that a controller may use; the scenario has all of them."""

    scenario: Scenario
    _asked: set[str] = field(default_factory=set, init=False, compare=False)

    @property
    def unread(self) -> str:
        """One line on a parameter that the controller never asked for; "" without any."""
        for name in self.scenario.controller.parameters:
            if name not in self._asked:
                known = ", ".join(sorted(self._asked)) or "none"
                return f"controller.parameters.{name}: unknown; known: {known}"
        return ""

    @property
    def parameters(self) -> Mapping[str, Any]:
        """The table ``[controller.parameters]``; whoever reads the table knows all names."""
        self._asked.update(self.scenario.controller.parameters)
        return self.scenario.controller.parameters

    def number(self, name: str, default: float) -> float:
        """A number of ``parameters``; ``default`` where the table has no such number.

        Raises:
            ScenarioError: the parameter is no number.
        """
        self._asked.add(name)
        value = self.scenario.controller.parameters.get(name, default)
        if not isinstance(value, Real) or isinstance(value, bool):
            raise ScenarioError(f"controller.parameters.{name} = {value!r}: must be a number")
        return float(value)

    @property
    def tick_s(self) -> float:
        """Seconds from step to step."""
        return self.scenario.tick_s

    @property
    def latency_ticks(self) -> int:
        """Whole ticks from a sample until its commands act."""
        return self.scenario.latency_ticks

    @property
    def plant(self) -> Plant:
        """The modelled plant with actuators and sensor: ``g1``, ``g2``, ``a``, ``b``, ``c``.

        Raises:
            ScenarioError: an unstable car.
        """
        return continuous_plant(self.scenario.model)

    @property
    def limits(self) -> tuple[float, float]:
        """The largest magnitude of each command; infinite without a limit."""
        of = target(self.scenario, None)
        return of.limit_1, of.limit_2

    @property
    def slews(self) -> tuple[float, float]:
        """The largest change of each command in a tick; infinite without a limit."""
        of = target(self.scenario, None)
        rates = of.rate_1, of.rate_2
        one, two = (rate * self.tick_s if math.isfinite(rate) else math.inf for rate in rates)
        return one, two
