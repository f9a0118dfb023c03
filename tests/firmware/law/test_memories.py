"""Every memory of a state, one by one, after a reset and after an overflow."""

import math
from functools import reduce
from operator import getitem
from typing import Any

import numpy as np
import pytest

from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.law import controller
from firmware_model.law.layout import State
from firmware_model.law.status import FaultState, Mode
from firmware_model.law.structs import Struct, fields_of
from firmware_model.law.supervision import further_sensors
from firmware_model.law.supervision.decision import restart_test
from firmware_model.law.supervision.overflow import clear_memories
from firmware_model.law.supervision.takeover import end_takeover
from firmware_model.law.supervision.verdict import clear_hypotheses
from firmware_model.law.supervision.witness import settle_witness
from tests.firmware.law.cases import CAR, DESIGN, TICK_S, other_cars

LATENCY = 3


def table_of(**changes: Any) -> Any:
    chosen = {"mismatch": other_cars(4), "on_confirmation": True, "lsb_1": 0.01, **changes}
    return build(DESIGN, Target(TICK_S, LATENCY, "tustin-held", **chosen))


def leaves(struct: type[Struct], record: Any, path: str = "") -> dict[str, Any]:
    """Every number of a state, by the path that leads to it."""
    found: dict[str, Any] = {}
    for field in fields_of(struct):
        if isinstance(field.kind, type):
            for way in field.paths:
                part = reduce(getitem, way, record)
                found |= leaves(field.kind, part, f"{path}{'.'.join(map(str, way))}.")
        else:
            found[f"{path}{field.name}"] = np.array(record[field.name])
    return found


def used(table: Any, seed: int = 1) -> Any:
    """A state in which every number is another than at rest."""
    state = controller.init(table)[0]
    own = state.supervision
    draw = np.random.default_rng(seed)

    def fill(struct: type[Struct], record: Any) -> None:
        for field in fields_of(struct):
            if isinstance(field.kind, type):
                for way in field.paths:
                    fill(field.kind, reduce(getitem, way, record))
            elif field.kind == "real":
                record[field.name] = draw.uniform(0.1, 0.2, field.shape)
            else:
                record[field.name] = 2

    fill(State, state)
    state.fault_state, state.mode = FaultState.CONFIRMED, Mode.RUN
    (own.standby.slow, own.standby.elapsed, own.saved.fingerprint) = 0, 0.0, 0
    return state


def changes(before: Any, after: Any) -> set[str]:
    """The paths of what differs."""
    old, new = leaves(State, before), leaves(State, after)
    return {path for path in old if old[path].tobytes() != new[path].tobytes()}


def answers(table: Any, state: Any, ticks: int = 25) -> list[list[float]]:
    """Answers and findings of the law in the following ticks."""
    draw, rows = np.random.default_rng(8), []
    for k in range(ticks):
        measurement = math.nan if k in (4, 5) else 0.4 + 0.01 * draw.standard_normal()
        controller.step(table, state, 0.4 + 0.01 * k, measurement)
        torque, known = state.supervision.sequential_test.candidate, state.supervision.mismatch
        said = (state.command_1, state.command_2, state.fault_estimate, state.mode)
        rows.append(
            [*said, state.fault_state, torque.predicted, *known.theta, *known.x, known.change]
        )
    return [[float(number) for number in row] for row in rows]


@pytest.mark.compiled
@pytest.mark.parametrize("reference", [0.4, 0.0])
@pytest.mark.parametrize("on_confirmation", [True, False])
def test_after_a_reset_nothing_is_left_of_what_was_before(reference, on_confirmation):
    """The same bits from then on as of a new controller, whatever the memories held."""
    table = table_of(reference_acceleration=40.0, on_confirmation=on_confirmation)
    found = []
    for state in (controller.init(table)[0], used(table), used(table, seed=2)):
        controller.reset(table, state, reference)
        assert (state.mode, state.fault_state) == (Mode.STANDBY, FaultState.CLEAR)
        assert state.reference == reference
        assert state.command_1 == pytest.approx(reference / CAR.g1.dc_gain, abs=0.01)
        assert state.fault_estimate == 0.0
        found.append(answers(table, state))
    assert found[1] == found[2] == found[0]


@pytest.mark.parametrize("on_confirmation", [True, False])
def test_an_overflow_forgets_what_the_measurement_feeds_alone(on_confirmation):
    """All else follows the commands, which are finite, and goes on; so a loss stays known."""
    table = table_of(on_confirmation=on_confirmation)
    state = used(table)
    expected = state.copy()
    clear_memories(table, state, state.supervision)
    expected.tracking.filter.accumulators[:] = 0.0
    expected.tracking.error = 0.0
    expected.tracking.stabiliser.accumulators[:] = 0.0
    expected.estimator.measurement.accumulators[:] = 0.0
    expected.estimator.one_plus_q.accumulators[:] = 0.0
    if not on_confirmation:
        expected.compensator.filter.accumulators[:] = 0.0
    known = expected.supervision.mismatch
    for name in ("x", "theta", "extent", "change", "remainder", "previous_model_output",
                 "previous_residual", "rule"):  # fmt: skip
        known[name] = 0.0
    for name in known.white.dtype.names:
        known.white[name]["memory"][:] = 0.0
    known.covariance.lower[:] = 0.0
    known.covariance.variances[:] = [0.0, 0.0, 0.36, 0.36, 0.36, 0.36, 0.0]
    for name in ("difference", "fading", "elapsed"):
        expected.supervision.prediction[name] = 0.0
    settle_witness(expected.supervision.witness, 0.0)
    expected.supervision.corroboration.slow = expected.supervision.corroboration.sudden = 0.0
    restart_test(table, expected, expected.supervision)
    clear_hypotheses(expected.supervision.hypotheses)
    end_takeover(expected.supervision.takeover)
    asked = {"estimator.showing_1", "estimator.showing_2", "supervision.other_cars.command_1",
             "supervision.other_cars.command_2", "supervision.other_cars.shown"}  # fmt: skip
    assert changes(state, expected) <= asked  # what each model shows of no command
    assert state.fault_state == FaultState.CONFIRMED


LOST = [
    "estimator.channel_1.accumulators", "estimator.channel_2.accumulators",
    "shortfall_1.accumulators", "shortfall_2.accumulators", "compensator.filter.accumulators",
    "supervision.loss_model.channel_1.accumulators",
    "supervision.other_cars.model.channel_1.accumulators", "reference_shaper.shaped",
    *(f"supervision.other_cars.cars.{i}.channel_2.accumulators" for i in range(4)),
]  # fmt: skip


@pytest.mark.parametrize("path", LOST)
def test_where_one_of_the_models_is_lost_nothing_is_known_any_more(path):
    """From then on the same bits as of a new controller that has sent the same commands."""
    table = table_of(reference_acceleration=40.0)
    state, fresh = used(table), controller.init(table)[0]
    *parts, name = path.split(".")
    part: Any = state
    for each in parts:
        part = part[int(each) if each.isdigit() else each]
    if name == "accumulators":
        part[name][0, 0] = math.inf
    else:
        part[name] = math.inf
    state.supervision.loss_model.followed = 1.0
    clear_memories(table, state, state.supervision)
    assert state.fault_state == FaultState.CLEAR
    fresh.command_1, fresh.command_2 = state.command_1, state.command_2
    for name in ("queue_1", "queue_2"):
        fresh.estimator[name] = state.estimator[name]  # what is on its way still comes
    fresh.reference_shaper.previous_reference = state.reference_shaper.previous_reference
    fresh.supervision.takeover.pending = 1
    restart_test(table, fresh, fresh.supervision)
    assert answers(table, state) == answers(table, fresh)


INDICES = ["estimator.queue_1.index", "estimator.queue_2.index", "supervision.echoes.index",
           "supervision.witness.index", "supervision.mismatch.covariance.first"]  # fmt: skip


@pytest.mark.parametrize("path", INDICES)
@pytest.mark.parametrize("index", [-1, 128, 2**30, -(2**31)])
def test_a_damaged_index_reaches_nothing_and_is_whole_after_a_tick(path, index):
    """Whatever is damaged, the next tick forgets the same, and a reset leaves the same."""
    *way, last = path.split(".")

    def damaged(record: str, field: str) -> Any:
        table, state = table_of(), used(table_of())
        of: Any = state
        for name in record.split("."):
            of = of[name]
        of[field] = index
        further_sensors.hear(table, state, 1.0, 5.0, 0.0)
        return table, state

    rows = []
    for record, field in ((".".join(way), last), ("supervision.witness", "index")):
        table, state = damaged(record, field)
        rows.append(answers(table, state))
        assert 0 <= leaves(State, state)[path] <= 2
        table, state = damaged(record, field)
        controller.reset(table, state, 0.4)
        rows.append(answers(table, state))
    assert rows[:2] == rows[2:]
    assert np.isfinite(rows).all()
