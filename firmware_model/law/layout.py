"""The fixed memory of the controller: a constant table and a private state, a C struct each.

This module only nests the structs of the other modules. ``tables.build`` writes the table once; the
state holds all changing values.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from firmware_model.law import monitor
from firmware_model.law.core import thesis
from firmware_model.law.structs import Precision, Struct, record_type
from firmware_model.law.supervision import (
    bumpless_transfer,
    corroboration,
    decision,
    echoes,
    knowledge,
    likelihood_ratio,
    loss_model,
    mismatch,
    other_cars,
    prediction,
    safe_stop,
    standby,
    takeover,
    verdict,
    witness,
)


class Table(thesis.Table):
    """The constant table."""

    other_cars: Annotated[other_cars.Constants, "1", "what they show"]
    mismatch: Annotated[mismatch.Constants, "1", "how this car differs"]
    sequential_test: Annotated[likelihood_ratio.Constants, "1", "for a loss or its end"]
    loss_model: Annotated[loss_model.Constants, "1", "what is lost"]
    decision: Annotated[decision.Constants, "1", "on the fault state"]
    bumpless_transfer: Annotated[bumpless_transfer.Constants, "1", "of F̂ to s w"]
    echoes: Annotated[echoes.Constants, "1", "of what the actuators report"]
    witness: Annotated[witness.Constants, "1", "of yaw rate and lateral acceleration"]
    corroboration: Annotated[corroboration.Constants, "1", "of findings from d̂ alone"]
    hypotheses: Annotated[verdict.Constants, "1", "hypotheses of the fault's place"]
    safe_stop: Annotated[safe_stop.Constants, "1", "where both actuators are lost"]
    prediction: Annotated[prediction.Constants, "1", "in place of a missing measurement"]
    takeover: Annotated[takeover.Constants, "1", "of a moving plant"]
    monitor: Annotated[monitor.Constants, "1", "independent bounds on commands and motion"]


class Supervision(Struct):
    """The memory of the supervision."""

    other_cars: Annotated[other_cars.State, "1", "what they show"]
    mismatch: Annotated[mismatch.State, "1", "how this car differs"]
    sequential_test: Annotated[likelihood_ratio.State, "1", "for a loss or its end"]
    loss_model: Annotated[loss_model.State, "1", "what is lost"]
    bumpless_transfer: Annotated[bumpless_transfer.State, "1", "of F̂ to s w"]
    echoes: Annotated[echoes.State, "1", "what the actuators report"]
    witness: Annotated[witness.State, "1", "what yaw rate and lateral acceleration say"]
    corroboration: Annotated[corroboration.State, "1", "how fast d̂ changes"]
    hypotheses: Annotated[verdict.State, "1", "hypotheses of the fault's place"]
    safe_stop: Annotated[safe_stop.State, "1", "where the commands have to go"]
    prediction: Annotated[prediction.State, "1", "in place of a missing measurement"]
    standby: Annotated[standby.State, "1", "of a car slower than the lowest design"]
    takeover: Annotated[takeover.State, "1", "of a moving plant"]
    saved: Annotated[knowledge.Saved, "1", "what outlives a restart, until the begin"]


class State(thesis.State):
    """The memory of the law: of the thesis, of the supervision, of the monitor."""

    supervision: Annotated[Supervision, "1", "what decides whose fault d̂ is"]
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
