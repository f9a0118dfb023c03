"""Random tables and states with valid indices."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_model.target.layout import state_type, table_type
from firmware_model.target.status import Verdict
from firmware_model.target.structs import (
    MAX_LATENCY_TICKS,
    MAX_SECTIONS,
    Precision,
    Record,
    RecordArray,
)

TICKS = (0, 0, 1, 2, 7, MAX_LATENCY_TICKS)


def reals(
    random: np.random.Generator, shape: tuple[int, ...], precision: Precision, even: bool = False
) -> Any:
    """Mostly ordinary magnitudes, mixed with all special values; ``even``: values repeat."""
    if even:
        return random.choice([-1.0, -0.0, 0.0, 0.5, 1.0, 2.0], shape).astype(precision)
    limits = np.finfo(precision)
    ordinary = random.standard_normal(shape) * 10.0 ** random.uniform(-3, 3, shape)
    kinds: list[float] = [0.0, -0.0, np.inf, -np.inf, np.nan, 1.0, -1.0]
    for each in (limits.max, -limits.max, limits.tiny, limits.smallest_subnormal):
        kinds.append(float(each))
    odd = random.choice(kinds, shape)
    share = random.choice([0.0, 0.0, 0.02, 0.3])
    with np.errstate(over="ignore"):
        return np.where(random.random(shape) < share, odd, ordinary).astype(precision)


def fill(random: np.random.Generator, record: Any, precision: Precision, even: bool) -> None:
    """Randomise every real number of ``record``, nested records included."""
    for name in record.dtype.names:
        kind = record.dtype[name]
        if kind.names:
            fill(random, record[name], precision, even)
        elif kind.base.kind == "f":
            record[name] = reals(random, kind.shape, precision, even)


def random_table(
    random: np.random.Generator, precision: Precision, even: bool = False
) -> RecordArray:
    """A table, shape (1,), with valid counts and indices, and some plausible numbers."""
    tables = np.zeros(1, table_type(precision))
    table: Record = tables[0]
    fill(random, tables[0], precision, even)
    if random.random() < 0.8:  # plausible limits
        for actuator in (table.actuator_1, table.actuator_2):
            actuator.limit, actuator.slew = abs(actuator.limit), abs(actuator.slew)
            actuator.lsb = random.choice([0.0, 1e-3])
    if random.random() < 0.8 and not even:  # thresholds within reach
        table.decision.suspect, table.decision.confirm = np.sort(random.exponential(2.0, 2))
        table.decision.recover = random.exponential(3.0)
        table.mismatch.noise = random.exponential(1.0)
        table.mismatch.white = random.exponential(1.0)
        test = table.sequential_test
        test.restart, test.promising, test.freshness = -1.0, random.exponential(), random.random()
        test.needed = random.exponential()
        test.share = random.choice([0.0, random.random(), test.share])
    cars = table.other_cars
    for filter in (
        table.tracking.filter, table.estimator.channel_1, table.estimator.channel_2,
        table.estimator.one_plus_q, table.compensator.filter, *(
            channel for car in (cars.car_1, cars.car_2, cars.car_3, cars.car_4)
            for channel in (car.channel_1, car.channel_2)
        ),
    ):  # fmt: skip
        filter.n = random.integers(0, MAX_SECTIONS + 1) if random.random() < 0.3 else 2
        filter.coefficients[:, 3:] *= random.choice([1.0, 0.01])
    for filter in (  # filters of an unstable plant
        table.estimator.measurement, table.tracking.stabiliser, *(
            car.measurement for car in (cars.car_1, cars.car_2, cars.car_3, cars.car_4)
        ),
    ):  # fmt: skip
        filter.n = random.choice([0, 0, 1, 2])
    estimator = table.estimator
    estimator.latency_ticks, estimator.dead_ticks_1, estimator.dead_ticks_2 = random.choice(
        TICKS, 3
    )
    estimator.shown_ticks_1 = estimator.latency_ticks + estimator.dead_ticks_1
    estimator.shown_ticks_2 = estimator.latency_ticks + estimator.dead_ticks_2
    cars.n = random.integers(0, 5)
    table.mismatch.n = 0 if random.random() < 0.1 else cars.n + 3
    table.reference_shaper.enabled = random.integers(0, 2)
    table.compensator.on_confirmation = random.integers(0, 2)
    table.decision.tracks_share = int(random.random() < 0.2)
    table.decision.pause_ticks = random.integers(0, 5)
    table.probe.ticks = random.choice([0, 0, 3])
    return tables


def random_state(
    random: np.random.Generator, table: Record, precision: Precision, even: bool = False
) -> RecordArray:
    """A state for ``table``, shape (1,), with indices that exist."""
    states = np.zeros(1, state_type(precision))
    state: Record = states[0]
    fill(random, states[0], precision, even)
    constants, estimator = table.estimator, state.estimator
    for index, size in (
        ("delay_index", constants.latency_ticks), ("dead_index_1", constants.dead_ticks_1),
        ("dead_index_2", constants.dead_ticks_2), ("shown_index_1", constants.shown_ticks_1),
        ("shown_index_2", constants.shown_ticks_2),
    ):  # fmt: skip
        setattr(estimator, index, random.integers(0, max(size, 1)))
    if random.random() < 0.5:  # a candidate near its age limit
        test = state.sequential_test
        test.half_age, test.evidence = random.integers(2, 9), random.exponential()
        test.age = 2.0 * test.half_age + random.integers(-2, 3)
        test.half_information, test.information = np.sort(random.exponential(1.0, 2))
        if random.random() < 0.4:  # without evidence
            test.delay[:], test.explained[:], test.previous_shown = 0.0, 0.0, 0.0
    if random.random() < 0.3:
        state.bumpless_transfer.carried_speed = random.choice([np.inf, np.nan])
    state.mode, state.fault_state = random.integers(0, 4, 2)
    state.hypotheses.verdict = random.integers(0, len(Verdict))
    state.probe.tick = random.integers(0, table.probe.ticks + 1)
    state.decision.pause = random.integers(0, 4)
    state.mismatch.covariance.variances[:] = abs(state.mismatch.covariance.variances)
    return states
