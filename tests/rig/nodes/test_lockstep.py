"""The loop of each node in lockstep: to the end, or to a stop request, and no frame further."""

from __future__ import annotations

import can
import pytest

from can_rig.errors import SilentNodeError
from can_rig.frames.codec import tick_on
from tests.rig.nodes.ends import ANSWER, OFFER, TICKS, Ends, order


def test_the_controller_answers_every_tick_and_ends() -> None:
    ends = Ends()
    assert ends.run_controller() == TICKS
    assert ends.ticks == list(range(1, TICKS + 1))
    assert order(ends.sent_by_controller) == [(i, tick) for tick in range(TICKS) for i in ANSWER]
    assert not ends.offers
    assert not ends.stop.wanted  # it did not wait for more


def test_the_plant_offers_every_tick_and_ends() -> None:
    ends = Ends()
    assert ends.run_plant() == TICKS
    assert ends.ticks == list(range(1, TICKS + 1))
    assert order(ends.sent_by_plant) == [(i, tick) for tick in range(TICKS) for i in OFFER]
    assert not ends.answers
    assert not ends.stop.wanted


@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_stop_request_ends_a_node_after_the_tick(node: str) -> None:
    ends = Ends()
    ends.stop_after = 7
    assert getattr(ends, f"run_{node}")() == 7
    assert ends.ticks == list(range(1, 8))
    assert tick_on(getattr(ends, f"sent_by_{node}")[-1].data) == 6


def test_a_stop_request_ends_a_controller_that_never_waits() -> None:
    """Each feedback comes at once and no reference before it, so nothing but the tick is new."""
    ends = Ends()
    ends.stop_after = 7
    plant_s = ends.plant.offer

    def feedback_alone(tick: int) -> None:
        plant_s(tick)
        if tick > 0:  # the first contact needs both
            del ends.offers[-2]

    ends.plant.offer = feedback_alone
    assert ends.run_controller() == 7


@pytest.mark.parametrize("node", ["plant", "controller"])
def test_a_stop_request_ends_a_node_that_waits(node: str) -> None:
    ends = Ends()
    ends.silent_from = 5
    assert getattr(ends, f"run_{node}")() == 5
    assert ends.ticks == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("others", [None, can.Message(arbitration_id=0x700, is_extended_id=False)])
@pytest.mark.parametrize(("node", "other"), [("plant", "controller"), ("controller", "plant")])
@pytest.mark.parametrize(("silent_from", "allowed_s"), [(0, 60.0), (3, 1.0)])
def test_a_silent_partner_is_named_whatever_others_send(
    node: str, other: str, silent_from: int, allowed_s: float, others: can.Message | None
) -> None:
    """Before it was heard first it is waited for, afterwards not."""
    ends = Ends()
    ends.silent_from, ends.stop_when_silent, ends.others = silent_from, False, others
    with pytest.raises(SilentNodeError, match=rf"the {other} node .* at tick {silent_from}$"):
        getattr(ends, f"run_{node}")()
    assert len(ends.ticks) == silent_from
    assert ends.clock.now_s == pytest.approx(allowed_s, abs=0.1)


def test_an_offer_is_repeated_as_it_was() -> None:
    """To a controller that was not there yet: the same counters, so that either copy will do."""
    ends = Ends()
    ends.plant.offer(0)
    ends.plant.repeat()
    first, again = ends.sent_by_plant[:2], ends.sent_by_plant[2:]
    assert [bytes(m.data) for m in again] == [bytes(m.data) for m in first]
    assert order(again) == order(first) == [(i, 0) for i in OFFER]
