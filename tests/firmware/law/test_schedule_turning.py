"""A jump of the speed turns every model of the car, and blends what acts within a tick."""

import math
from dataclasses import replace
from functools import reduce
from operator import getitem

import numpy as np
import pytest

from firmware_model.discretisation.targets import Reporting
from firmware_model.law.layout import Table
from firmware_model.law.schedule import MAX_SPEEDS, Constants, blend, place_of, turn_models
from firmware_model.law.structs import leaves, zeroed
from firmware_model.law.supervision.signatures import (
    FORCE_ECHO_ROW,
    FORCE_ROW,
    OFFSET_ROW,
    TORQUE_ECHO_ROW,
)
from tests.firmware.scheduled import LAGS, SPEEDS, TARGET, Blended, scheduled

OF = scheduled(target=replace(TARGET, echoes=tuple(map(Reporting, LAGS[:2]))), cars=1)
ONES = (  # whatever follows G1, and whatever follows G2
    (
        lambda s: s.estimator.channel_1,
        lambda s: s.shortfall_1,
        lambda s: s.supervision.sequential_test.channel_1,
        lambda s: s.supervision.sequential_test.earlier,
        lambda s: s.supervision.loss_model.channel_1,
        lambda s: s.supervision.loss_model.earlier,
        lambda s: s.supervision.hypotheses.signatures.rows[OFFSET_ROW].answer,
        lambda s: s.supervision.hypotheses.signatures.rows[TORQUE_ECHO_ROW].answer,
        lambda s: s.supervision.echoes.actuators[0].known,
        lambda s: s.supervision.other_cars.model.channel_1,
    ),
    (
        lambda s: s.estimator.channel_2,
        lambda s: s.shortfall_2,
        lambda s: s.supervision.hypotheses.signatures.rows[FORCE_ROW].answer,
        lambda s: s.supervision.hypotheses.signatures.rows[FORCE_ECHO_ROW].answer,
        lambda s: s.supervision.echoes.actuators[1].known,
        lambda s: s.supervision.other_cars.model.channel_2,
    ),
)


@pytest.mark.parametrize("channel", (1, 2))
@pytest.mark.parametrize("way", (SPEEDS, SPEEDS[::-1]))
def test_a_jump_turns_every_model_interval_by_interval(channel, way):
    at = Blended(OF)
    at.to(way[0])
    size = 2 * 4
    begin = np.random.default_rng(channel).standard_normal((4, 2))
    begin[3] = 0.0
    for get in ONES[channel - 1]:
        get(at.state).accumulators[:4] = begin
    expected = begin.ravel()
    turns = OF.schedule.model[f"turn_{channel}"].reshape(-1, size, size)
    intervals = range(len(SPEEDS) - 1)
    for i in intervals if way == SPEEDS else reversed(intervals):
        signed = turns[i] if way == SPEEDS else -turns[i]
        expected = expected + signed @ expected + 0.5 * signed @ signed @ expected
    at.to(way[-1])
    for get in ONES[channel - 1]:
        ours = get(at.state).accumulators
        np.testing.assert_allclose(ours[:4].ravel(), expected, rtol=1e-9, atol=1e-9)
        assert not ours[4:].any()


def test_gains_of_one_tick_are_blended_too():
    immediate = replace(TARGET, latency_ticks=0, estimator="tustin", on_confirmation=False)
    of = scheduled(SPEEDS[:2], immediate)
    at, alone = Blended(of), scheduled(SPEEDS[1:2], immediate).table
    before = [at.table.estimator.feedthrough_2, at.table.compensator.feedthrough]
    at.to(SPEEDS[1])
    for get in (
        lambda t: t.tracking.loop_inverse,
        lambda t: t.estimator.feedthrough_2,
        lambda t: t.compensator.feedthrough,
        lambda t: t.compensator.loop_inverse,
    ):
        assert math.isclose(get(at.table), get(alone), rel_tol=1e-12)
    assert before != [at.table.estimator.feedthrough_2, at.table.compensator.feedthrough]
    for name in ("shortfall_1", "shortfall_2"):
        z = at.table[name].gain
        assert z.any() and not np.array_equal(z, of.table[name].gain)


@pytest.mark.parametrize("n", range(5))
def test_as_many_other_cars_turn_as_the_table_knows_each_by_its_own_two_matrices(n):
    at, rng = Blended(OF), np.random.default_rng(n)
    at.table.other_cars.n = n
    places = [(car, channel) for car in range(4) for channel in (1, 2)]
    begin = {}
    for car, channel in places:
        turns = rng.standard_normal((len(SPEEDS) - 1, 8, 8))
        at.schedule.cars[car][f"turn_{channel}"][: len(turns)] = turns.reshape(-1, 64)
        accumulators = at.state.supervision.other_cars.cars[car][f"channel_{channel}"].accumulators
        accumulators[:4] = rng.standard_normal((4, 2))
        begin[car, channel] = accumulators[:4].ravel().copy(), turns[1]
    turn_models(at.schedule, at.own, at.table, at.state, at.state.supervision, 1, 0.25)
    for (car, channel), (s, turn) in begin.items():
        turned = s + 0.25 * turn @ s + 0.5 * 0.25**2 * turn @ turn @ s
        ours = (
            at.state.supervision.other_cars.cars[car][f"channel_{channel}"].accumulators[:4].ravel()
        )
        np.testing.assert_allclose(ours, turned if car < n else s, rtol=1e-12)


def test_everything_that_is_blended_lies_on_the_line_between_two_designs():
    """Every place has a number of its own, so that no other can stand for it.

    Behind the last design of a full schedule there is none, and none is read.
    """
    schedule = zeroed(Constants, "float64")[0]
    draw = np.random.default_rng(0)
    for path, _, numbers in leaves(Constants, schedule.dtype):
        if path != ("n",):
            reduce(getitem, path, schedule)[:] = draw.standard_normal(numbers.shape)
    table, sections = zeroed(Table, "float64")[0], 3
    cars = {("cars", i, f"channel_{j}"): ("other_cars", "cars", i, f"channel_{j}")
            for i in range(4) for j in (1, 2)}  # fmt: skip
    filters = {
        ("tracking",): ("tracking", "filter"),
        ("model", "channel_1"): ("estimator", "channel_1"),
        ("model", "channel_2"): ("estimator", "channel_2"),
        ("compensator",): ("compensator", "filter"),
        **cars,
    }
    ones = {
        ("tracking_inverse",): ("tracking", "loop_inverse"),
        ("feedthrough_2",): ("estimator", "feedthrough_2"),
        ("compensator_feedthrough",): ("compensator", "feedthrough"),
        ("compensator_inverse",): ("compensator", "loop_inverse"),
    }
    gains = {("make_up_1",): ("shortfall_1", "gain"), ("make_up_2",): ("shortfall_2", "gain")}

    def field(path):
        return reduce(getitem, path, table)

    for path in filters.values():
        field(path)["n"] = sections
    for at, share in ((4, 0.25), (4, 0.0), (MAX_SPEEDS - 1, 0.0)):
        blend(schedule, table, at, share)
        for name, path in (*filters.items(), *ones.items(), *gains.items()):
            low, high = reduce(getitem, name, schedule)[[at, (at + 1) % MAX_SPEEDS]]
            ours = field((*path, "coefficients") if name in filters else path)
            expected = np.reshape(low + share * (high - low), (-1, *np.shape(ours)[1:]))
            used = sections if np.ndim(ours) else 1
            np.testing.assert_allclose(np.reshape(ours, expected.shape)[:used], expected[:used])
            assert not np.any(np.reshape(ours, expected.shape)[used:])


def test_a_full_schedule_ends_with_its_last_design():
    schedule = zeroed(Constants, "float64")[0]
    schedule.n = MAX_SPEEDS
    schedule.speed[:] = 10.0 + np.arange(MAX_SPEEDS)
    assert place_of(schedule, 99.0) == MAX_SPEEDS - 1
    assert [place_of(schedule, speed) for speed in schedule.speed] == list(range(MAX_SPEEDS))
