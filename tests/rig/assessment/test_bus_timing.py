"""Bus timing of the rig's own frames and of any DBC, and a scenario's latency that follows."""

from dataclasses import replace
from fractions import Fraction
from math import ceil

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_rig.assessment.bus_timing import (
    TimingError,
    latency_ticks,
    network_timing,
)
from can_rig.frames.network import load_network
from tests.helpers import DBC
from tests.rig.assessment.simulated_bus import simulate
from tests.rig.assessment.wire import classic

STEER_BY_WIRE = load_network(DBC / "steer_by_wire.dbc")
US = Fraction(1, 10**6)


def in_us(timing, what):
    return [getattr(frame, what) / US for frame in timing.frames]


def test_the_five_frames_at_one_megabit_and_one_kilohertz():
    """135 bits each: two, the answer, and the one that may have begun in each group of its own."""
    timing = network_timing(STEER_BY_WIRE, 1_000_000, 0.001, 0.0002)
    assert [frame.name for frame in timing.frames] == [codec.name for codec in STEER_BY_WIRE]
    assert {frame.bits for frame in timing.frames} == {34 + 64 + 13 + 97 // 4} == {135}
    assert in_us(timing, "transmission_s") == [135] * 5
    assert in_us(timing, "release_s") == [0, 0, 470, 470, 470]
    assert in_us(timing, "response_s") == [270, 270, 270, 405, 405]
    assert in_us(timing, "arrival_s") == [270, 270, 740, 875, 875]
    assert in_us(timing, "slack_s") == [730, 730, 730, 595, 595]
    assert (timing.utilisation, timing.schedulable) == (Fraction(675, 1000), True)
    assert timing.latency_ticks == 1


CASES = [
    (1_000_000, 0.001, 0.0002, 1), (1_000_000, 0.002, 0.0002, 1), (500_000, 0.002, 0.0002, 1),
    (1_000_000, 0.001, 0.0, 1),
    (1_000_000, 0.001, 0.000325, 1),  # the last arrives as the tick ends, in time
    (1_000_000, 0.001, 0.000326, 2), (1_000_000, 0.001, 0.0004, 2), (1_000_000, 1.0, 5.0, 6),
    (1_000_000, 0.000875, 0.0002, 1),
    (500_000, 0.001, 0.0002, None),  # 1.35 of the bus
    (1_000_000, 0.000674, 0.0, None), (125_000, 0.005, 0.0, None), (125_000, 0.0055, 0.0, 1),
    (1_000_000, 0.001, 0.003, None),  # up to four answers of each kind may come at once
    (1_000_000, 1.0, 70.0, None),  # nothing here waits 70 ticks
]  # fmt: skip


@pytest.mark.parametrize(("bitrate", "tick_s", "compute_s", "expected"), CASES)
def test_latency_is_whole_ticks_to_the_arrival_of_the_later_command(
    bitrate, tick_s, compute_s, expected
):
    timing = network_timing(STEER_BY_WIRE, bitrate, tick_s, compute_s)
    assert timing.latency_ticks == expected
    assert timing.schedulable == (expected is not None)
    if expected is None:
        with pytest.raises(TimingError, match="or the tick longer") as caught:
            latency_ticks(STEER_BY_WIRE, bitrate, tick_s, compute_s)
        assert "\n" not in str(caught.value)
        return
    assert latency_ticks(STEER_BY_WIRE, bitrate, tick_s, compute_s) == expected
    arrival = max(timing.frames[2].arrival_s, timing.frames[3].arrival_s)
    assert expected == ceil(arrival / Fraction(repr(tick_s)))


def real_lengths(chance):
    """Exact bits of the five frames, with something in them."""
    for codec in STEER_BY_WIRE:
        data = codec.encode(chance.uniform(codec.minimum, codec.maximum), chance.randrange(65536))
        data[0], data[1] = chance.randrange(256), data[1] | chance.randrange(15)
        frame = can.Message(arbitration_id=codec.frame_id, is_extended_id=False, data=data)
        yield classic(frame).on_the_bus


def exchange(tick, compute, lengths, ticks):
    """Every tick on one simulated bus, in bits: when each frame arrives after its tick began.

    The answers follow the plant's two frames, whenever those are through, so the bus is simulated
    again until no answer moves.
    """
    plant = [(k * tick, frame, k) for k in range(ticks) for frame in (0, 1)]
    released = [k * tick for k in range(ticks)]
    while True:
        answers = [(released[k], frame, k) for k in range(ticks) for frame in (2, 3, 4)]
        ends = simulate([*plant, *answers], lengths)
        moved = [max(ends[0, k], ends[1, k]) + compute[k] for k in range(ticks)]
        if moved == released:
            return {key: end - key[1] * tick for key, end in ends.items()}
        released = moved


@given(
    st.integers(700, 1500), st.sampled_from([0, 50, 200, 400, 900]),
    st.randoms(use_true_random=False), st.booleans(),
)  # fmt: skip
def test_no_frame_of_a_simulated_exchange_arrives_later_than_said(tick, compute, chance, longest):
    timing = network_timing(STEER_BY_WIRE, 1_000_000, tick * US, compute * US)
    if not timing.schedulable:
        return
    lengths = [135] * 5 if longest else list(real_lengths(chance))
    took = [chance.choice([compute, chance.randint(0, compute)]) for _ in range(12)]
    for (frame, _), arrival in exchange(tick, took, lengths, 12).items():
        assert arrival * US <= timing.frames[frame].arrival_s


def test_an_exchange_of_longest_frames_arrives_as_late_as_said():
    timing = network_timing(STEER_BY_WIRE, 1_000_000, 0.001, 0.0002)
    ends = exchange(1000, [200] * 5, [135] * 5, 5)
    assert [max(ends[frame, k] for k in range(5)) for frame in (1, 3 + 1)] == [270, 875]
    assert timing.frames[4].arrival_s == 875 * US


@given(st.sampled_from([125_000, 500_000, 1_000_000]), st.integers(1, 400))
def test_a_slower_controller_never_makes_the_latency_less(bitrate, compute_us):
    ticks = [
        network_timing(STEER_BY_WIRE, bitrate, 0.006, us * US).latency_ticks
        for us in (compute_us, 10 * compute_us, 40 * compute_us)
    ]
    known = [99 if latency is None else latency for latency in ticks]
    assert known == sorted(known)
    assert known[0] >= 1


def test_commands_more_important_than_measurements_are_settled_too():
    """The answers' jitter then delays the measurements that it follows from."""
    swapped = replace(
        STEER_BY_WIRE,
        reference=replace(STEER_BY_WIRE.reference, frame_id=0x400),
        feedback=replace(STEER_BY_WIRE.feedback, frame_id=0x401),
    )
    fits = network_timing(swapped, 1_000_000, 0.001, 0.0002)
    assert fits.latency_ticks == 1
    assert [frame.frame_id for frame in fits.frames] == [0x400, 0x401, 0x110, 0x111, 0x120]
    late = network_timing(swapped, 1_000_000, 0.002, 0.0015)
    arrivals = {frame.frame_id: frame.arrival_s for frame in late.frames}
    assert late.frames[0].release_s == max(arrivals[0x400], arrivals[0x401]) + 1500 * US
    assert late.latency_ticks == ceil(max(arrivals[0x110], arrivals[0x111]) / (2000 * US))


def test_both_networks_take_the_same_time():
    other = load_network(DBC / "plant_by_numbers.dbc")
    times = [
        in_us(network_timing(network, 1_000_000, 0.001, 0.0002), "arrival_s")
        for network in (STEER_BY_WIRE, other)
    ]
    assert times[0] == times[1]
