"""Faults of frames: the right channel and ticks, no undetected damage, and the fate of a run."""

from typing import Any

import can
import numpy as np
import pytest

from can_rig.frames.codec import Receiver, Transmitter
from can_rig.plant.faults.frame_faults import Delivery, FrameFaults, delivery
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import CHANNELS, PLACES
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from tests.rig.plant.fault_settings import fault_list

SHORT = ["duration_s=1", "fault.at_s=0.005", "fault.for_s=0.003"]  # ticks 5, 6, 7
WINDOW = range(5, 8)
NETWORK = network_of(load("thesis-step"))
COMMANDS = (NETWORK.command_1, NETWORK.command_2)
CODECS = (*COMMANDS, NETWORK.feedback)


def faults(*settings):
    return FrameFaults(load("thesis-step", list(settings)), NETWORK)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", ["frames-missing", "frames-corrupted", "none", "sensor-biased"])
def test_frames_are_lost_in_their_place_and_in_their_window_alone(kind, place):
    wire = faults(*SHORT, f"fault.kind={kind}", f"fault.channel={place}")
    transmitters = [Transmitter(codec) for codec in CODECS]
    for tick in range(12):
        for index, name in enumerate(PLACES):
            frame = transmitters[index].frame(1.0, tick)
            before = bytes(frame.data)
            sent = wire.on_the_wire(frame, index, tick)
            concerned = kind.startswith("frames-") and name == place
            assert wire.concerns(index) == concerned
            hit = concerned and tick in WINDOW
            if hit and kind == "frames-missing":
                assert sent == []
            else:
                (one,) = sent
                changed = sum(a != b for a, b in zip(before, one.data, strict=True))
                assert changed == (1 if hit else 0)
                assert (one.arbitration_id, one.dlc) == (CODECS[index].frame_id, 8)


def corrupted(seed, *settings, count=400):
    """Frames of ``count`` ticks under the fault, and what they were."""
    wire = faults(
        "duration_s=1", "fault.kind=frames-corrupted", "fault.at_s=0", f"seed={seed}", *settings
    )
    transmitter, pairs = Transmitter(COMMANDS[0]), []
    for tick in range(count):
        frame = transmitter.frame(tick, tick)
        (sent,) = wire.on_the_wire(frame, 0, tick)
        pairs.append((bytes(frame.data), bytes(sent.data)))
    return pairs


def test_damage_comes_from_the_seed_reaches_every_byte_and_every_bit_and_none_is_accepted():
    pairs = corrupted(seed=3)
    assert pairs == corrupted(seed=3)
    assert pairs != corrupted(seed=4)
    reached = 0
    receiver = Receiver(COMMANDS[0])
    for tick, (before, after) in enumerate(pairs):
        reached |= int.from_bytes(before, "big") ^ int.from_bytes(after, "big")
        message = can.Message(arbitration_id=COMMANDS[0].frame_id, is_extended_id=False, data=after)
        assert receiver.accept(message, tick) is None
    assert reached == 2**64 - 1
    assert receiver.rejected == {"wrong_crc": len(pairs)}


def test_two_faults_that_corrupt_the_same_frame_change_one_byte():
    for before, after in corrupted(3, "fault.1.kind=frames-corrupted", "fault.1.at_s=0"):
        assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


def sent(*settings, place=0, count=14, changes=()):
    """By tick: for each frame on the wire the tick that it says, its value, and whether it counts.

    A receiver of all frames says whether a frame counts. ``changes``: settings from a tick on.
    """
    first, changed = ["duration_s=1", f"fault.channel={PLACES[place]}"], dict(changes)
    wire = faults(*first, *settings)
    transmitter, receiver = Transmitter(CODECS[place]), Receiver(CODECS[place])
    ticks = []
    for tick in range(count):
        if tick in changed:
            wire.change(load("thesis-step", [*first, *changed[tick]]))
        frames = wire.on_the_wire(transmitter.frame(tick / 10, tick), place, tick)
        judged = [(CODECS[place].decode(f.data), receiver.accept(f, tick)) for f in frames]
        ticks.append([(s.tick, round(s.value, 5), used is not None) for s, used in judged])
        receiver.end_tick()
    return ticks


def good(tick):
    return [(tick, tick / 10, True)]


def test_a_frame_that_is_repeated_is_the_last_one_before_and_is_not_used():
    ticks = sent(*SHORT, "fault.kind=frames-repeated")
    assert ticks[:5] == [good(tick) for tick in range(5)]
    assert ticks[5:8] == [[(4, 0.4, False)]] * 3
    assert ticks[8:] == [good(tick) for tick in range(8, 14)]
    assert sent("fault.at_s=0", "fault.kind=frames-repeated") == [[]] * 14  # nothing was before


def test_late_frames_come_late_before_those_of_the_tick_and_are_not_used():
    ticks = sent(*SHORT, "fault.kind=frames-late", "fault.late_ticks=2")
    assert ticks[5:7] == [[], []]
    assert ticks[7] == [(5, 0.5, False)]
    assert ticks[8] == [(6, 0.6, False), *good(8)]
    assert ticks[9] == [(7, 0.7, False), *good(9)]
    assert ticks[10:] == [good(tick) for tick in range(10, 14)]


@pytest.mark.parametrize("place", range(3))
def test_a_forged_frame_comes_first_and_is_used_in_place_of_the_real_one(place):
    ticks = sent(*SHORT, "fault.kind=frames-forged", "fault.value=-1.5", place=place)
    for tick, frames in enumerate(ticks):
        real = (tick, tick / 10, tick not in WINDOW)
        assert frames == ([(tick, -1.5, True), real] if tick in WINDOW else [real])


def test_an_intruder_beside_a_silent_sender_is_heard_too():
    both = ["fault.1.kind=frames-forged", "fault.1.value=2", "fault.1.at_s=0.005"]
    ticks = sent(*SHORT, "fault.kind=frames-missing", *both)
    assert ticks[5:8] == [[(tick, 2.0, True)] for tick in WINDOW]


def listed(*each):
    """Settings of faults of the torque: kind, first tick, how many ticks, keys of that kind."""
    return fault_list(
        *(
            {"kind": kind, "channel": "torque", "at_s": first / 1000, "for_s": count / 1000}
            | dict(others)
            for kind, first, count, *others in each
        )
    )


def test_of_two_frames_of_a_tick_the_last_is_repeated():
    forged = ("frames-forged", 5, 2, ("value", -1))
    ticks = sent(*listed(forged, ("frames-repeated", 7, 2)))
    assert ticks[6] == [(6, -1, True), (6, 0.6, False)]
    assert ticks[7:10] == [[(6, 0.6, False)], [(6, 0.6, False)], good(9)]
    # The same where that fault is not there from the beginning of the run.
    injected = [(7, listed(forged, ("frames-repeated", 7, 2)))]
    assert sent(*listed(forged), changes=injected) == ticks
    alone = sent("fault.kind=none", changes=[(7, listed(("frames-repeated", 7, 2)))])
    assert alone[6:9] == [good(6), [(6, 0.6, False)], [(6, 0.6, False)]]


def test_faults_that_are_no_faults_of_frames_leave_those_behind_them():
    dead = ("actuator-dead", 0, 9)
    assert sent(*listed(dead, ("frames-missing", 5, 2)))[4:8] == [good(4), [], [], good(7)]


def test_what_corrupts_twice_does_so_at_both_times_and_leaves_the_others():
    twice = [("frames-corrupted", 2, 1), ("frames-corrupted", 6, 1)]
    ticks = sent(*listed(*twice, ("frames-missing", 9, 1)))
    assert [at for at, frames in enumerate(ticks) if frames != good(at)] == [2, 6, 9]
    assert (len(ticks[2]), len(ticks[6]), ticks[9]) == (1, 1, [])


def test_it_is_known_from_when_to_when_frames_are_concerned():
    late = ("frames-late", 20, 5, ("late_ticks", 3))
    wire = faults("duration_s=1", *listed(("frames-missing", 5, 2, ("late_ticks", 3)), late))
    assert wire.ticks == ([range(5, 7), range(20, 28)], [], [])


@pytest.mark.parametrize("first", [3, 20])
def test_an_intruder_that_comes_during_a_run_knows_the_counter(first):
    forged = listed(("frames-forged", first, 2, ("value", -1)))
    ticks = sent("fault.kind=none", count=first + 4, changes=[(first, forged)])
    assert ticks[first - 1 : first + 1] == [
        good(first - 1),
        [(first, -1, True), (first, first / 10, False)],
    ]


def test_a_fault_that_goes_on_after_a_change_keeps_what_it_holds_back():
    """Of two that are the same each its own: a frame is late twice."""
    late, longer = (("frames-late", 3, count, ("late_ticks", 2)) for count in (4, 6))
    twice = sent(*listed(late, late))
    assert twice[3:7] == [[]] * 4
    assert [[tick for tick, *_ in frames] for frames in twice[7:9]] == [[3, 5, 7], [4, 6, 8]]
    changed = sent(*listed(late, late), changes=[(6, listed(longer, longer))])
    assert changed == sent(*listed(longer, longer)) != twice
    assert sent(*listed(late, late), changes=[(3, listed(late))]) == sent(*listed(late))


def test_frames_that_may_change_during_a_run_are_concerned():
    scenario = load("thesis-step", ["fault.kind=none"])
    for place in range(3):
        assert FrameFaults(scenario, NETWORK, changing=True).concerns(place)
        assert not FrameFaults(scenario, NETWORK).concerns(place)


def test_where_the_frame_itself_goes_on_nothing_comes_in_its_place():
    own, other = (Transmitter(NETWORK.feedback).frame(1.0, 0) for _ in range(2))
    assert faults("fault.kind=none").on_the_wire(own, 2, 0, otherwise=other) == [own]


@pytest.mark.parametrize("kind", ["missing", "corrupted", "repeated", "late", "forged"])
def test_a_tick_of_the_sensor_always_has_a_frame_that_counts(kind):
    """Lockstep goes on from tick to tick by it; what says nothing has the real one's counter."""
    wire = faults(*SHORT, f"fault.kind=frames-{kind}", "fault.channel=sensor", "fault.value=3")
    own, nothing, receiver = (cls(NETWORK.feedback) for cls in (Transmitter, Transmitter, Receiver))
    for tick in range(60):
        frames = wire.on_the_wire(
            own.frame(1.0, tick), 2, tick, otherwise=nothing.frame(float("nan"), tick)
        )
        records = [receiver.accept(frame, tick) for frame in frames]
        (used,) = [record for record in records if record is not None]
        value = {True: {"forged": 3.0}.get(kind, "nothing"), False: 1.0}[tick in WINDOW]
        assert (used.value if used.value == used.value else "nothing") == value
        receiver.end_tick()


# --- the fate of a run's frames ------------------------------------------------------------------

TICKS = 80
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


@pytest.mark.parametrize("first", [1, 7])
def test_after_a_gap_of_fourteen_the_counter_of_fifteen_stands_where_it_stood(first):
    """So the first frame that comes again looks like the last that came."""
    found = answered(scenario_of("frames-missing", first, 14))
    assert ticks_without(found.sent[:, 0]) == list(range(first, first + 14))
    assert ticks_without(found.used[:, 0]) == list(range(first, first + 15))
    assert found.rejected[NAMES[0]] == {"no_new_data": 14, "repeated": 1}


@pytest.mark.parametrize("ticks", [0, 5, 7, 20])
def test_the_first_ticks_alone(ticks):
    found = answered(scenario_of("frames-missing", 5, 3), ticks)
    lost = len(range(5, min(8, ticks)))
    assert ticks_without(found.sent[:, 0]) == list(range(5, 5 + lost))
    assert found.rejected[NAMES[0]] == ({"no_new_data": lost} if lost else {})
