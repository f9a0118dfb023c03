"""D* of the car, of a run whose sensor may be faulty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from can_rig.plant.faults import DISTORTING, PlantFaults
from can_rig.scenario.fault_settings import SENSOR
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import FloatArray


def car_output(
    scenario: Scenario, measured: FloatArray, true_output: FloatArray | None, first: int = 0
) -> FloatArray:
    """(ticks,), ``measured`` D* without what a faulty sensor makes of it, m/s².

    What is added to it is taken off. Where a fault does more, it is the car's own output, without
    noise and resolution; nan where that is not known.

    Args:
        scenario: the run.
        measured: (ticks,), D* as the controller got it.
        true_output: (ticks,), the car's own; None: not known.
        first: the first of these ticks.
    """
    ticks = range(first, first + len(measured))
    output = measured - PlantFaults(scenario).bias(ticks)
    hidden: NDArray[np.bool_] = np.zeros(len(measured), dtype=np.bool_)
    for fault in scenario.faults:
        if fault.place == SENSOR and (fault.acts_on_frames or fault.kind in DISTORTING):
            its = fault.ticks(scenario.tick_ns, ticks)
            hidden[np.array(its, dtype=np.int64) - first] = True
    return np.where(hidden, np.nan if true_output is None else true_output, output)
