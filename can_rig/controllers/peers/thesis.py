"""The thesis as printed: C, F1 with 1 + Q, F2 and F̂ as linear filters, and nothing else.

u1 = C (r - y), d̂ = F1 u + F2 y, u2 = F̂ d̂ (2.1), (2.37), (3.32), each filter by Tustin's rule. No
limits, no decision, no shaper, no substitution: ``[design]`` has the time constants.
"""

from can_rig.controllers.filters_law import FiltersLaw
from can_rig.controllers.setup import ControllerSetup
from can_rig.scenario.build import continuous_design
from firmware_model.discretisation.filters import discretise


class Thesis(FiltersLaw):
    """See ``Controller``."""

    def __init__(self, setup: ControllerSetup) -> None:
        design = continuous_design(setup.scenario)
        filters = {"f2": design.estimator.f2}
        filters["f1_u1"], filters["f1_u2"] = design.estimator.f1
        if design.tracking is not None:
            filters["c"] = design.tracking.controller
        if design.compensator is not None:
            filters["f_hat"] = design.compensator
        super().__init__({name: discretise(each, setup.tick_s) for name, each in filters.items()})
