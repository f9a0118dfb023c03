"""Which commands are sent, and which of them their receivers use."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.frames.endpoints import Transmitter
from can_rig.plant.faults.delivery import Delivery, delivery
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import CHANNELS, PLACES
from can_rig.scenario.settings import Scenario
from tests.rig.plant.fault_settings import fault_list

TICKS = 80
NETWORK = network_of(load("thesis-step"))
COMMANDS = (NETWORK.command_1, NETWORK.command_2)
NAMES = [codec.name for codec in COMMANDS]


def scenario_of(kind: str, first: int, count: int, channel: int = 0) -> Scenario:
    """A loss of ``count`` ticks."""
    settings = [
        f"duration_s={TICKS / 1000}", f"fault.kind={kind}", f"fault.channel={CHANNELS[channel]}",
        f"fault.at_s={first / 1000}", f"fault.for_s={count / 1000}", "seed=4",
    ]  # fmt: skip
    return load("thesis-step", settings)


def ticks_without(marks: Any) -> list[int]:
    return np.flatnonzero(~marks).tolist()


def answered(scenario: Scenario, ticks: int | None = None) -> Delivery:
    found = delivery(scenario, NETWORK, ticks)
    assert found.sent.shape == found.used.shape == (TICKS if ticks is None else ticks, 2)
    assert found.damage.shape[1] == 4
    return found


@pytest.mark.parametrize("kind", ["none", "actuator-dead"])
def test_without_a_fault_of_frames_all_arrive(kind: str) -> None:
    found = answered(scenario_of(kind, 5, 3))
    assert found.sent.all()
    assert found.used.all()
    assert len(found.damage) == 0
    assert found.rejected == {name: {} for name in NAMES}


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("first", [0, 1, 5, TICKS - 3])
def test_missing_frames_are_missed_on_their_channel(first: int, channel: int) -> None:
    found = answered(scenario_of("frames-missing", first, 3, channel))
    lost = list(range(first, first + 3))
    assert ticks_without(found.sent[:, channel]) == ticks_without(found.used[:, channel]) == lost
    assert found.sent[:, 1 - channel].all()
    assert found.used[:, 1 - channel].all()
    assert len(found.damage) == 0
    # Before its first frame a receiver misses none.
    counts = {NAMES[channel]: {"no_new_data": 3}, NAMES[1 - channel]: {}}
    assert found.rejected == counts


@pytest.mark.parametrize("first", [1, 7])
def test_after_a_gap_of_fourteen_the_counter_of_fifteen_stands_where_it_stood(first: int) -> None:
    """So the first frame that comes again looks like the last that came."""
    found = answered(scenario_of("frames-missing", first, 14))
    assert ticks_without(found.sent[:, 0]) == list(range(first, first + 14))
    assert ticks_without(found.used[:, 0]) == list(range(first, first + 15))
    assert found.rejected[NAMES[0]] == {"no_new_data": 14, "repeated": 1}


@pytest.mark.parametrize("channel", [0, 1])
def test_damaged_frames_are_sent_and_say_what_was_damaged(channel: int) -> None:
    """As the node that sends them damages them, whatever their value is."""
    scenario = scenario_of("frames-corrupted", 6, 9, channel)
    found = answered(scenario)
    assert found.sent.all()
    assert ticks_without(found.used[:, channel]) == list(range(6, 15))
    assert found.used[:, 1 - channel].all()
    assert found.rejected[NAMES[channel]]["wrong_crc"] == 9
    faults, transmitter = FrameFaults(scenario, NETWORK), Transmitter(COMMANDS[channel])
    damage = []
    for tick in range(15):
        frame = transmitter.frame(123.0 * tick, tick)
        before = np.frombuffer(bytes(frame.data), np.uint8)
        (after,) = faults.on_the_wire(frame, channel, tick)
        change = before ^ np.frombuffer(bytes(after.data), np.uint8)
        damage += [[tick, channel, at, change[at]] for at in np.flatnonzero(change)]
    assert found.damage.tolist() == damage


@pytest.mark.parametrize("ticks", [0, 5, 7, 20])
def test_the_first_ticks_alone(ticks: int) -> None:
    found = answered(scenario_of("frames-missing", 5, 3), ticks)
    lost = len(range(5, min(8, ticks)))
    assert ticks_without(found.sent[:, 0]) == list(range(5, 5 + lost))
    assert found.rejected[NAMES[0]] == ({"no_new_data": lost} if lost else {})


def faults_of(*settings: str) -> Delivery:
    return answered(
        load("thesis-step", [f"duration_s={TICKS / 1000}", "fault.at_s=0.005", *settings])
    )


@pytest.mark.parametrize("place", range(3))
def test_what_is_forged_is_used_in_place_of_what_was_sent(place: int) -> None:
    found = faults_of(
        "fault.kind=frames-forged", f"fault.channel={PLACES[place]}", "fault.for_s=0.003",
        "fault.value=-1.5",
    )  # fmt: skip
    assert found.replaced == {(tick, place): pytest.approx(-1.5) for tick in range(5, 8)}
    assert found.used.all()


def test_where_the_measurement_is_missing_nothing_is_used_and_no_command_says_anything_else() -> (
    None
):
    found = faults_of("fault.kind=frames-missing", "fault.channel=sensor", "fault.for_s=0.003")
    assert sorted(found.replaced) == [(tick, 2) for tick in range(5, 8)]
    assert np.isnan(list(found.replaced.values())).all()
    assert faults_of("fault.kind=frames-missing", "fault.for_s=0.003").replaced == {}


@pytest.mark.parametrize("order", [(5, 50), (50, 5)])
def test_two_faults_far_from_each_other_both_count(order: tuple[int, int]) -> None:
    missing = {"kind": "frames-missing", "for_s": 0.003}
    settings = fault_list(*(missing | {"at_s": first / 1000} for first in order))
    assert ticks_without(faults_of(*settings).used[:, 0]) == [*range(5, 8), *range(50, 53)]
