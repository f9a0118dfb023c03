"""Bus timing of the rig's own frames and of any DBC, and a scenario's latency that follows."""

from dataclasses import replace
from fractions import Fraction
from itertools import groupby
from math import ceil

import can
import pytest
from can import Message
from hypothesis import example, given, strategies as st

from can_rig.frames.bus_timing import TimingError, latency_ticks, network_timing
from can_rig.frames.foreign_frames import FD_LENGTHS
from can_rig.frames.frame_length import INTERMISSION_BITS, FrameBits, FrameError, worst_case_bits
from can_rig.frames.network import load_network
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.drawn_frames import frames
from tests.helpers import DBC, refuses
from tests.rig.frames.simulated_bus import simulate
from tests.rig.frames.wire import bits_of, classic, flexible

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
        with refuses("or the tick longer", TimingError):
            latency_ticks(STEER_BY_WIRE, bitrate, tick_s, compute_s)
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


@pytest.mark.parametrize("compute", [0, 50, 100, 400, 2000])
def test_further_sensors_that_the_answers_overtake_arrive_as_late_as_said(compute):
    """Five sensors behind the inputs: the answer to the inputs comes before them."""
    network = network_of(load("cluster"))
    behind = [replace(each, frame_id=0x300 + at) for at, each in enumerate(network.witnesses)]
    network = replace(network, witnesses=tuple(behind))
    timing = network_timing(network, 1_000_000, 0.004, compute * US)
    said = {frame.name: frame.arrival_s / US for frame in timing.frames}
    plant = [(0, frame, 0) for frame in (0, 1, *range(5, 10))]
    answers = [(270 + compute, frame, 0) for frame in (2, 3, 4)]
    ends = simulate([*plant, *answers], [135] * 10)
    for frame, codec in enumerate((*network, *network.witnesses)):
        assert ends[frame, 0] <= said[codec.name]
    assert said[behind[-1].name] == 1350
    assert timing.latency_ticks == 1


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


RUNS = st.sampled_from([0x00, 0xFF, 0xF8, 0x07, 0xE0, 0x1F, 0x3C, 0xC3, 0x78, 0x87, 0x55])


def stuffed(size):
    """Data with runs of equal bits, which need stuff bits."""
    of = st.one_of(RUNS, st.integers(0, 255))
    return st.lists(of, min_size=size, max_size=size).map(bytes)


def worst_case_of(message):
    return worst_case_bits(
        message.dlc,
        extended=message.is_extended_id,
        remote=message.is_remote_frame,
        fd=message.is_fd,
        brs=message.bitrate_switch,
    )


@given(frames(["data", "remote"], stuffed))
def test_no_classic_frame_is_longer_than_the_worst_case(message):
    assert classic(message).total <= worst_case_of(message).total


@given(frames(["fd"], stuffed))
@example(Message(is_fd=True, is_extended_id=False, arbitration_id=1, data=b"\x1f"))  # ends in 5
@example(Message(is_fd=True, is_extended_id=False, arbitration_id=1, data=b"\xff" * 64))
@example(Message(is_fd=True, bitrate_switch=True, arbitration_id=0x1FFFFC00, data=b""))
def test_no_fd_frame_is_longer_than_the_worst_case(message):
    exact, worst = flexible(message), worst_case_of(message)
    assert exact.total <= worst.total
    for data_bitrate in (500_000, 5_000_000) if message.bitrate_switch else (None,):
        assert exact.duration_s(500_000, data_bitrate) <= worst.duration_s(500_000, data_bitrate)


# Bits with the intermission, printed by can_frame_length(..., CFL_EXACT, CAN_MTU) of can-utils
# 2023.03 (canframelen.c, compiled by itself); 2020.11.0 prints the same.
CAN_UTILS = [
    (0x000, False, False, "", 53), (0x000, False, True, "", 50), (0x123, True, True, "", 71),
    (0x000, False, False, "0000000000000000", 127), (0x7FF, False, False, "ffffffffffffffff", 126),
    (0x0000000, True, False, "0000000000000000", 150),
    (0x1FFFFFFF, True, False, "ffffffffffffffff", 149),
    (0x100, False, False, "c1000500eb32a400", 120), (0x78, False, False, "3c" * 8, 131),
    (0x123, False, False, "11223344", 80), (0x1ABCDEF5, True, False, "deadbeef", 102),
]  # fmt: skip


@pytest.mark.parametrize(("number", "extended", "remote", "data", "bits"), CAN_UTILS)
def test_the_frames_built_here_have_the_lengths_of_can_utils(number, extended, remote, data, bits):
    message = Message(
        arbitration_id=number, is_extended_id=extended, is_remote_frame=remote,
        data=None if remote else bytes.fromhex(data), dlc=len(data) // 2,
    )  # fmt: skip
    assert classic(message).on_the_bus == bits


def test_a_remote_frame_has_the_dlc_of_the_data_that_it_asks_for_and_none_of_them():
    lengths = {
        classic(Message(arbitration_id=0x555, is_extended_id=False, is_remote_frame=True, dlc=n))
        for n in range(9)
    }
    assert max(lengths).total <= worst_case_bits(8, remote=True).total == 52  # 55 in the paper
    assert worst_case_bits(0) == worst_case_bits(8, remote=True) == worst_case_bits(5, remote=True)


def test_worst_cases_are_those_of_the_paper():
    """Davis et al. 2007: (55 + 10 s) and (80 + 10 s) bits, the intermission among them."""
    for length in range(9):
        assert worst_case_bits(length).on_the_bus == 55 + 10 * length
        assert worst_case_bits(length, extended=True).on_the_bus == 80 + 10 * length


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("length", FD_LENGTHS)
def test_the_worst_fd_frame_is_the_sum_of_its_fields(length, extended):
    """Counted from the standard's fields, with no formula of the code's."""
    stuffable = 1 + (32 if extended else 12) + (3 if extended else 4) + 1 + 4 + 8 * length
    check = (4 + 17) + 6 if length <= 16 else (4 + 21) + 7  # and 6 or 7 fixed stuff bits
    total = stuffable + (stuffable - 2) // 4 + check + 1 + 2 + 7
    steady, switched = (
        worst_case_bits(length, extended=extended, fd=True, brs=brs) for brs in (False, True)
    )
    assert steady == (total, 0)
    assert switched.total == total
    arbitration = 1 + (32 if extended else 12) + (3 if extended else 4)
    assert switched.nominal == arbitration + (arbitration - 2) // 4 + 2 + 7


def test_the_header_alone_reaches_its_bound_of_stuff_bits_in_the_arbitration_phase():
    """An identifier that stuffs as early and as often as any can."""
    message = Message(arbitration_id=0b00001111000, is_extended_id=False, is_fd=True, data=b"")
    runs = [len(list(run)) for _, run in groupby([0, *bits_of(message.arbitration_id, 11), 0, 0])]
    assert runs == [5, 4, 5]  # a stuff bit opens each later run, so four are enough
    switched = Message(
        arbitration_id=message.arbitration_id, is_extended_id=False, is_fd=True,
        bitrate_switch=True, data=b"",
    )  # fmt: skip
    assert flexible(switched).nominal == worst_case_bits(0, fd=True, brs=True).nominal


def test_durations_count_each_bit_at_its_rate_and_the_intermission():
    bits = FrameBits(nominal=30, data=680)
    assert INTERMISSION_BITS == 3
    assert bits.duration_s(500_000, 2_000_000) == Fraction(33, 500_000) + Fraction(340, 1_000_000)
    assert FrameBits(132).duration_s(1_000_000) == Fraction(135, 1_000_000)
    assert (bits.total, bits.on_the_bus) == (710, 713)


@pytest.mark.parametrize(("bitrate", "data_bitrate"), [(0, 1), (-5, 1), (500_000, None), (10, 9)])
def test_a_bit_rate_that_is_none_is_refused(bitrate, data_bitrate):
    with pytest.raises(FrameError, match="bit rate"):
        FrameBits(30, 100).duration_s(bitrate, data_bitrate)


@pytest.mark.parametrize(("length", "fd"), [(9, False), (-1, False), (9, True), (65, True)])
def test_a_length_that_no_frame_has_is_refused(length, fd):
    with pytest.raises(FrameError, match=f"{length} bytes"):
        worst_case_bits(length, fd=fd)
