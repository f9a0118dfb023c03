"""The response-time analysis, against the paper's example and a bus simulated bit by bit."""

from dataclasses import replace
from fractions import Fraction
from math import inf, nan

import pytest
from hypothesis import example, given, strategies as st

from can_rig.frames.bus_timing import (
    AnalysisError,
    PeriodicFrame,
    exact,
    response_times,
    utilisation,
)
from can_rig.frames.frame_length import FrameBits, FrameError, worst_case_bits
from tests.helpers import refuses
from tests.rig.frames.simulated_bus import simulate

BITS = worst_case_bits(7)  # 125 with the intermission: 1 ms at 125 kbit/s
PAPER = [
    PeriodicFrame("A", 1, BITS, period_s=0.0025),
    PeriodicFrame("B", 2, BITS, period_s=0.0035),
    PeriodicFrame("C", 3, BITS, period_s=0.0035),
]


def small(name, length, period, jitter=0):
    """A frame on a bus of 1 bit/s, so that seconds are bits; `length` has the intermission."""
    return PeriodicFrame(str(name), name, FrameBits(length - 3), Fraction(period), Fraction(jitter))


def bounds(frames):
    return [found.arrival_s for found in response_times(frames, 1)]


@st.composite
def frame_sets(draw):
    return [
        small(
            name,
            draw(st.integers(4, 12)),
            draw(st.integers(10, 70)),
            draw(st.sampled_from([0, 0, 0, 1, 5, 13, 40])),
        )
        for name in range(draw(st.integers(1, 4)))
    ]


def observed(frames, offsets, chance, count):
    """Longest response of each frame in one simulation; instances are queued late by chance."""
    dues, queued = {}, []
    for m, (frame, offset) in enumerate(zip(frames, offsets, strict=True)):
        queued_at = 0
        for k in range(count):
            dues[m, k] = offset + k * int(frame.period_s)
            # a node queues one after the other, also where the jitter is longer than the period
            queued_at = max(queued_at, dues[m, k] + chance.randint(0, int(frame.jitter_s)))
            queued.append((queued_at, m, k))
    ends = simulate(queued, [frame.bits.on_the_bus for frame in frames])
    last = min(dues[m, count - 1] for m in range(len(frames)))  # from there some are missing
    return [
        max((ends[key] - due for key, due in dues.items() if key[0] == m and due < last), default=0)
        for m in range(len(frames))
    ]


def test_the_example_that_refutes_the_original_analysis():
    """Davis et al. 2007: the second instance of C misses its deadline, the first does not."""
    found = response_times(PAPER, 125_000)
    ms = Fraction(1, 1000)
    assert [each.transmission_s for each in found] == [ms] * 3
    assert [each.response_s for each in found] == [2 * ms, 3 * ms, Fraction(7, 2) * ms]
    assert utilisation(PAPER, 125_000) == Fraction(4, 10) + Fraction(4, 7)


@given(frame_sets(), st.randoms(use_true_random=False))
def test_no_simulated_response_exceeds_its_bound(frames, chance):
    found = bounds(frames)
    for _ in range(5):
        offsets = [chance.randint(0, int(frame.period_s)) for frame in frames]
        seen = observed(frames, offsets, chance, 20)
        assert all(bound is None or s <= bound for s, bound in zip(seen, found, strict=True))


def critical_instant(frames, start=0):
    """All queued at once as late as they may be, and from then on without delay."""
    queued, dues = [], {}
    for m, frame in enumerate(frames):
        for k in range(60):
            dues[m, k] = start + k * int(frame.period_s) - int(frame.jitter_s)
            queued.append((max(dues[m, k], start), m, k))
    return queued, dues


def lasts_too_long(frames, blocking=0):
    """Whether the busy period after the critical instant may have more than 60 of a frame."""
    length, shortest = 0, min(frame.period_s for frame in frames)
    while length <= 60 * shortest:
        queued = (-(-(length + f.jitter_s) // f.period_s) * f.bits.on_the_bus for f in frames)
        before, length = length, blocking + max(sum(queued), 1)
        if length == before:
            return False
    return True


@given(frame_sets())
@example([small(0, 4, 10), small(1, 4, 14), small(2, 4, 14)])  # the paper's, in quarter ms
def test_the_least_important_frame_reaches_its_bound_at_the_critical_instant(frames):
    last, bound = len(frames) - 1, bounds(frames)[-1]
    if bound is None or lasts_too_long(frames):
        return
    queued, dues = critical_instant(frames)
    ends = simulate(queued, [frame.bits.on_the_bus for frame in frames])
    assert max(ends[last, k] - dues[last, k] for k in range(60)) == bound


@given(frame_sets(), st.integers(4, 30))
def test_a_frame_just_begun_blocks_and_all_but_the_last_bit_of_it_counts(frames, length):
    """The bound with it is met up to the arrivals in one bit, which the analysis lets all win."""
    blocker = small(99, length, 10**6)
    m = len(frames) - 1
    blocked = bounds([*frames, blocker])[m]
    shorter = bounds([*frames, small(99, max(length - 1, 4), 10**6)])[m]
    if blocked is None or lasts_too_long(frames, length):
        return
    queued, dues = critical_instant(frames, start=1)
    lengths = [*(frame.bits.on_the_bus for frame in frames), length]
    ends = simulate([*queued, (0, len(frames), 0)], lengths)
    seen = max(ends[m, k] - dues[m, k] for k in range(60))
    assert seen <= blocked
    if length > 4:
        assert seen >= shorter - 1


def test_a_bus_that_is_just_full_has_a_bound_as_long_as_nothing_comes_on_top():
    full = [small(0, 4, 8), small(1, 4, 8)]
    assert utilisation(full, 1) == 1
    assert bounds(full) == [8, 8]
    assert bounds([*full, small(2, 4, 10**6)])[1:] == [None, None]  # the second is blocked once
    assert bounds([replace(full[0], jitter_s=Fraction(1)), full[1]])[1] is None


def test_priority_is_what_arbitration_sees():
    frames = [
        PeriodicFrame("long 0", 0x0, BITS, 1.0, extended=True),
        PeriodicFrame("short 0", 0x0, BITS, 1.0),
        PeriodicFrame("long after 0x123", 0x123 << 18, BITS, 1.0, extended=True),
        PeriodicFrame("short 0x123", 0x123, BITS, 1.0),
        PeriodicFrame("long before 0x123", (0x122 << 18) + 0x3FFFF, BITS, 1.0, extended=True),
    ]
    order = [timing.name for timing in response_times(frames, 500_000)]
    assert order == [
        "short 0", "long 0", "long before 0x123", "short 0x123", "long after 0x123"
    ]  # fmt: skip


@given(frame_sets(), st.randoms(use_true_random=False))
def test_the_order_of_the_frames_and_the_unit_of_time_change_nothing(frames, chance):
    mixed = list(frames)
    chance.shuffle(mixed)
    assert response_times(mixed, 1) == response_times(frames, 1)
    factor = 500_000
    fast = [replace(f, period_s=f.period_s / factor, jitter_s=f.jitter_s / factor) for f in frames]
    slow = bounds(frames)
    found = [timing.arrival_s for timing in response_times(fast, factor)]
    assert found == [None if bound is None else bound / factor for bound in slow]


def test_a_switched_frame_counts_at_both_rates():
    frame = PeriodicFrame("FD", 1, worst_case_bits(64, fd=True, brs=True), 0.01)
    (found,) = response_times([frame], 500_000, 2_000_000)
    assert found.response_s == frame.bits.duration_s(500_000, 2_000_000)
    with pytest.raises(FrameError):
        response_times([frame], 500_000)


def test_floats_are_the_decimals_that_they_print_as():
    assert exact(0.1) == Fraction(1, 10)
    assert exact(1e-9) == Fraction(1, 10**9)
    assert exact(Fraction(1, 3)) == Fraction(1, 3)
    assert exact(2) == 2


@pytest.mark.parametrize(
    "frames",
    [
        [replace(PAPER[0], period_s=0.0)], [replace(PAPER[0], period_s=nan)],
        [replace(PAPER[0], period_s=inf)], [replace(PAPER[0], jitter_s=-1e-6)],
        [PAPER[0], replace(PAPER[1], frame_id=1)],
    ],
)  # fmt: skip
def test_what_cannot_be_analysed_is_refused_in_one_line(frames):
    with refuses("must", AnalysisError):
        response_times(frames, 125_000)


def test_no_frames_need_no_time():
    assert response_times([], 500_000) == []
    assert utilisation([], 500_000) == 0
