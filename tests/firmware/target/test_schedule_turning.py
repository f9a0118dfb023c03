"""A jump of the speed turns every model of the car, and blends what acts within a tick."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.firmware.scheduled import SPEEDS, TARGET, Blended, scheduled

OF = scheduled(cars=1)
ONES = (  # whatever follows G1, and whatever follows G2
    (
        lambda s: s.estimator.channel_1,
        lambda s: s.shortfall_1,
        lambda s: s.sequential_test.channel_1,
        lambda s: s.sequential_test.earlier,
        lambda s: s.loss_model.channel_1,
        lambda s: s.loss_model.earlier,
        lambda s: s.hypotheses.signatures.torque_offset.answer,
        lambda s: s.other_cars.model.channel_1,
    ),
    (
        lambda s: s.estimator.channel_2,
        lambda s: s.shortfall_2,
        lambda s: s.hypotheses.signatures.force_lost.answer,
        lambda s: s.other_cars.model.channel_2,
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
    turns = OF.schedule[f"turn_{channel}"].reshape(-1, size, size)
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
