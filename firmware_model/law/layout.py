"""The fixed memory of the controller: a constant table and a private state, a C struct each.

This module only nests the structs of the other modules. ``tables.build`` writes the table once; the
state holds all changing values.
"""

from __future__ import annotations

import numpy as np

from firmware_model.law import actuator, reference_shaper, status
from firmware_model.law.fault_decision import (
    bumpless_transfer,
    decision,
    likelihood_ratio,
    loss_model,
    mismatch,
    other_cars,
    probe,
    safe_stop,
)
from firmware_model.law.fault_decision.hypotheses import verdict
from firmware_model.law.filters import compensator, estimator, shortfall, tracking
from firmware_model.law.structs import Field, Precision, Record, record_type

TABLE = (
    Field("reference_shaper", "1", "limits r̈", reference_shaper.CONSTANTS),
    Field("tracking", "1", "C", tracking.CONSTANTS),
    Field("estimator", "1", "F1 and 1 + Q", estimator.CONSTANTS),
    Field("compensator", "1", "F̂", compensator.CONSTANTS),
    Field("actuator_1", "1", "what channel 1 can follow", actuator.CONSTANTS),
    Field("actuator_2", "1", "what channel 2 can follow", actuator.CONSTANTS),
    Field("shortfall_1", "1", "make-up of channel 1", shortfall.CONSTANTS),
    Field("shortfall_2", "1", "make-up of channel 2", shortfall.CONSTANTS),
    Field("other_cars", "1", "what they show", other_cars.CONSTANTS),
    Field("mismatch", "1", "how this car differs", mismatch.CONSTANTS),
    Field("sequential_test", "1", "for a loss or its end", likelihood_ratio.CONSTANTS),
    Field("loss_model", "1", "what is lost", loss_model.CONSTANTS),
    Field("decision", "1", "on the fault state", decision.CONSTANTS),
    Field("bumpless_transfer", "1", "of F̂ to s w", bumpless_transfer.CONSTANTS),
    Field("probe", "1", "of the torque", probe.CONSTANTS),
    Field("hypotheses", "1", "hypotheses of the fault's place", verdict.CONSTANTS),
    Field("safe_stop", "1", "where both actuators are lost", safe_stop.CONSTANTS),
)  # fmt: skip
STATE = (
    *status.STATE,
    Field("reference_shaper", "1", "reference of C", reference_shaper.STATE),
    Field("tracking", "1", "C", tracking.STATE),
    Field("estimator", "1", "F1 and 1 + Q", estimator.STATE),
    Field("compensator", "1", "F̂", compensator.STATE),
    Field("actuator_1", "1", "rounding of command 1", actuator.STATE),
    Field("actuator_2", "1", "rounding of command 2", actuator.STATE),
    Field("shortfall_1", "1", "what channel 1 could not do", shortfall.STATE),
    Field("shortfall_2", "1", "what channel 2 could not do", shortfall.STATE),
    Field("other_cars", "1", "what they show", other_cars.STATE),
    Field("mismatch", "1", "how this car differs", mismatch.STATE),
    Field("sequential_test", "1", "for a loss or its end", likelihood_ratio.STATE),
    Field("loss_model", "1", "what is lost", loss_model.STATE),
    Field("decision", "1", "on the fault state", decision.STATE),
    Field("bumpless_transfer", "1", "of F̂ to s w", bumpless_transfer.STATE),
    Field("probe", "1", "of the torque", probe.STATE),
    Field("hypotheses", "1", "hypotheses of the fault's place", verdict.STATE),
    Field("safe_stop", "1", "where both actuators are lost", safe_stop.STATE),
)


def table_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the constant table."""
    return record_type(TABLE, precision)


def state_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the state."""
    return record_type(STATE, precision)


def precision_of(table: Record) -> Precision:
    """The precision of every real number of ``table``."""
    return "float32" if table.dtype == table_type("float32") else "float64"
