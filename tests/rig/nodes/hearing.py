"""A controller whose commands depend on all that it hears of the further sensors."""

import math

from can_rig.controllers.protocol import Inputs
from can_rig.controllers.setup import ControllerSetup


class Hearing:
    """See ``can_rig.controllers.protocol.Controller``."""

    def __init__(self, setup: ControllerSetup) -> None:
        self.reset(0.0)

    def reset(self, reference: float) -> None:
        self.kept: dict[str, float] = {}

    def step(self, inputs: Inputs) -> tuple[float, float]:
        self.kept |= {name: x for name, x in inputs.witnesses.items() if not math.isnan(x)}
        error = inputs.reference - inputs.measurement
        return 30.0 * error + 1e-3 * sum(self.kept.values()), 1.0 * len(self.kept)
