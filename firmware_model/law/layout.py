"""The fixed memory of the controller: a constant table and a private state, a C struct each.

This module only nests the structs of the other modules. ``tables.build`` writes the table once; the
state holds all changing values.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from firmware_model.law import monitor, status
from firmware_model.law.core import actuator, shortfall, thesis
from firmware_model.law.core.compensator import (
    Constants as CompensatorConstants,
)
from firmware_model.law.core.compensator import (
    State as CompensatorState,
)
from firmware_model.law.core.estimator import (
    Constants as EstimatorConstants,
)
from firmware_model.law.core.estimator import (
    State as EstimatorState,
)
from firmware_model.law.core.reference_shaper import (
    Constants as ReferenceShaperConstants,
)
from firmware_model.law.core.reference_shaper import (
    State as ReferenceShaperState,
)
from firmware_model.law.core.tracking import (
    Constants as TrackingConstants,
)
from firmware_model.law.core.tracking import (
    State as TrackingState,
)
from firmware_model.law.structs import Precision, Struct, record_type
from firmware_model.law.supervision import knowledge, likelihood_ratio, standby, takeover, verdict
from firmware_model.law.supervision.bumpless_transfer import (
    Constants as BumplessTransferConstants,
)
from firmware_model.law.supervision.bumpless_transfer import (
    State as BumplessTransferState,
)
from firmware_model.law.supervision.corroboration import Constants as CorroborationConstants
from firmware_model.law.supervision.corroboration import State as CorroborationState
from firmware_model.law.supervision.decision import (
    Constants as DecisionConstants,
)
from firmware_model.law.supervision.echoes import Constants as EchoesConstants
from firmware_model.law.supervision.echoes import State as EchoesState
from firmware_model.law.supervision.loss_model import (
    Constants as LossModelConstants,
)
from firmware_model.law.supervision.loss_model import (
    State as LossModelState,
)
from firmware_model.law.supervision.mismatch import (
    Constants as MismatchConstants,
)
from firmware_model.law.supervision.mismatch import (
    State as MismatchState,
)
from firmware_model.law.supervision.other_cars import (
    Constants as OtherCarsConstants,
)
from firmware_model.law.supervision.other_cars import (
    State as OtherCarsState,
)
from firmware_model.law.supervision.prediction import (
    Constants as PredictionConstants,
)
from firmware_model.law.supervision.prediction import (
    State as PredictionState,
)
from firmware_model.law.supervision.safe_stop import (
    Constants as SafeStopConstants,
)
from firmware_model.law.supervision.safe_stop import (
    State as SafeStopState,
)
from firmware_model.law.supervision.witness import Constants as WitnessConstants
from firmware_model.law.supervision.witness import State as WitnessState


class Table(Struct):
    """The constant table."""

    supervised: Annotated[int, "1", "0: the thesis's law alone", (0, 1)]
    reference_shaper: Annotated[ReferenceShaperConstants, "1", "limits r̈"]
    tracking: Annotated[TrackingConstants, "1", "C"]
    estimator: Annotated[EstimatorConstants, "1", "F1 and 1 + Q"]
    compensator: Annotated[CompensatorConstants, "1", "F̂"]
    actuator_1: Annotated[actuator.Constants, "1", "what channel 1 can follow"]
    actuator_2: Annotated[actuator.Constants, "1", "what channel 2 can follow"]
    shortfall_1: Annotated[shortfall.Constants, "1", "make-up of channel 1"]
    shortfall_2: Annotated[shortfall.Constants, "1", "make-up of channel 2"]
    other_cars: Annotated[OtherCarsConstants, "1", "what they show"]
    mismatch: Annotated[MismatchConstants, "1", "how this car differs"]
    sequential_test: Annotated[likelihood_ratio.Constants, "1", "for a loss or its end"]
    loss_model: Annotated[LossModelConstants, "1", "what is lost"]
    decision: Annotated[DecisionConstants, "1", "on the fault state"]
    bumpless_transfer: Annotated[BumplessTransferConstants, "1", "of F̂ to s w"]
    echoes: Annotated[EchoesConstants, "1", "of what the actuators report"]
    witness: Annotated[WitnessConstants, "1", "of yaw rate and lateral acceleration"]
    corroboration: Annotated[CorroborationConstants, "1", "of findings from d̂ alone"]
    hypotheses: Annotated[verdict.Constants, "1", "hypotheses of the fault's place"]
    safe_stop: Annotated[SafeStopConstants, "1", "where both actuators are lost"]
    prediction: Annotated[PredictionConstants, "1", "in place of a missing measurement"]
    takeover: Annotated[takeover.Constants, "1", "of a moving plant"]
    monitor: Annotated[monitor.Constants, "1", "independent bounds on commands and motion"]


class State(status.State):
    """State."""

    tick: Annotated[thesis.State, "1", "what the stages of a tick hand on"]
    reference_shaper: Annotated[ReferenceShaperState, "1", "reference of C"]
    tracking: Annotated[TrackingState, "1", "C"]
    estimator: Annotated[EstimatorState, "1", "F1 and 1 + Q"]
    compensator: Annotated[CompensatorState, "1", "F̂"]
    actuator_1: Annotated[actuator.State, "1", "rounding of command 1"]
    actuator_2: Annotated[actuator.State, "1", "rounding of command 2"]
    shortfall_1: Annotated[shortfall.State, "1", "what channel 1 could not do"]
    shortfall_2: Annotated[shortfall.State, "1", "what channel 2 could not do"]
    other_cars: Annotated[OtherCarsState, "1", "what they show"]
    mismatch: Annotated[MismatchState, "1", "how this car differs"]
    sequential_test: Annotated[likelihood_ratio.State, "1", "for a loss or its end"]
    loss_model: Annotated[LossModelState, "1", "what is lost"]
    bumpless_transfer: Annotated[BumplessTransferState, "1", "of F̂ to s w"]
    echoes: Annotated[EchoesState, "1", "what the actuators report"]
    witness: Annotated[WitnessState, "1", "what yaw rate and lateral acceleration say"]
    corroboration: Annotated[CorroborationState, "1", "how fast d̂ changes"]
    hypotheses: Annotated[verdict.State, "1", "hypotheses of the fault's place"]
    safe_stop: Annotated[SafeStopState, "1", "where the commands have to go"]
    prediction: Annotated[PredictionState, "1", "in place of a missing measurement"]
    standby: Annotated[standby.State, "1", "of a car slower than the lowest design"]
    takeover: Annotated[takeover.State, "1", "of a moving plant"]
    saved: Annotated[knowledge.Saved, "1", "what outlives a restart, until the begin"]
    monitor: Annotated[monitor.State, "1", "what has been taken away"]


def table_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the constant table."""
    return record_type(Table, precision)


def state_type(precision: Precision = "float64") -> np.dtype[np.void]:
    """Layout of the state."""
    return record_type(State, precision)


def precision_of(table: Table) -> Precision:
    """The precision of every real number of ``table``."""
    return "float32" if table.dtype == table_type("float32") else "float64"
