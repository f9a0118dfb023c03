"""The longest frames, against frames built bit by bit."""

from fractions import Fraction
from itertools import groupby

import pytest
from can import Message
from hypothesis import example, given
from hypothesis import strategies as st

from can_rig.assessment.frame_length import (
    INTERMISSION_BITS,
    FrameBits,
    FrameError,
    worst_case_bits,
)
from can_rig.frames.foreign_frames import FD_LENGTHS
from tests.rig.assessment.wire import bits_of, classic, flexible


def payload(lengths):
    """Data with runs of equal bits, which need stuff bits."""
    common = st.sampled_from([0x00, 0xFF, 0xF8, 0x07, 0xE0, 0x1F, 0x3C, 0xC3, 0x78, 0x87, 0x55])
    of = st.one_of(common, st.integers(0, 255))
    return lengths.flatmap(lambda n: st.lists(of, min_size=n, max_size=n)).map(bytes)


@st.composite
def messages(draw, fd=False):
    extended = draw(st.booleans())
    lengths = st.sampled_from(FD_LENGTHS) if fd else st.integers(0, 8)
    data = draw(payload(lengths))
    remote = not fd and draw(st.booleans())
    switches = fd and draw(st.booleans())
    return Message(
        arbitration_id=draw(st.integers(0, (1 << (29 if extended else 11)) - 1)),
        is_extended_id=extended,
        is_remote_frame=remote,
        is_fd=fd,
        bitrate_switch=switches,
        error_state_indicator=fd and draw(st.booleans()),
        dlc=len(data),
        data=None if remote else data,
        check=True,
    )


def worst_case_of(message):
    return worst_case_bits(
        message.dlc,
        extended=message.is_extended_id,
        remote=message.is_remote_frame,
        fd=message.is_fd,
        brs=message.bitrate_switch,
    )


@given(messages())
def test_no_classic_frame_is_longer_than_the_worst_case(message):
    assert classic(message).total <= worst_case_of(message).total


@given(messages(fd=True))
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
