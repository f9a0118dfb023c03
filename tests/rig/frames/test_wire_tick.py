"""The 16 bits of the tick on the wire, read in both directions and over hours."""

import struct

from hypothesis import given, strategies as st

from can_rig.frames.codec import WIRE_TICKS, Transmitter, tick_at, tick_from, tick_on, ticks_ahead
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load

NETWORK = network_of(load("default"))
TICKS = st.integers(0, 10**7)


@given(TICKS)
def test_a_frame_carries_the_tick_modulo_65536(tick):
    frame = Transmitter(NETWORK.feedback).frame(1.0, tick)
    assert tick_on(frame.data) == tick % 65536 == NETWORK.feedback.decode(frame.data).tick


@given(TICKS, st.integers(-32768, 32767))
def test_half_of_the_bits_are_the_past(tick, step):
    assert ticks_ahead((tick + step) % WIRE_TICKS, tick) == step


@given(TICKS, st.integers(0, 65535))
def test_the_count_goes_on_from_where_it_stands(tick, step):
    assert tick_from((tick + step) % 65536, tick) == tick + step


@given(TICKS, st.sampled_from([0.0005, 0.001, 0.01]), st.floats(-0.9, 0.9))
def test_a_time_stamp_in_virtual_time_says_which_65536(tick, tick_s, jitter):
    assert tick_at(tick % 65536, (tick + jitter) * tick_s, tick_s) == tick


@given(
    st.integers(0, 65535),
    st.integers(0, 100),
    st.one_of(st.integers(1, 30_000), st.integers(-30_000, -1)),
)
def test_a_time_stamp_of_another_clock_says_nothing(wire, turns, off):
    """A clock that is exactly a tick off, without rounding because the tick is a power of two."""
    tick_s = 2.0**-10
    assert tick_at(wire, (turns * 65536 + wire + off) * tick_s, tick_s) == wire


@given(st.binary(min_size=8, max_size=8))
def test_the_tick_is_read_whatever_the_bytes_beside_are(payload):
    assert tick_on(payload) == struct.unpack("<HHi", payload)[1]


def test_a_short_frame_has_what_is_there():
    assert [tick_on(bytes([1, 2, 3, 4][:n])) for n in range(5)] == [0, 0, 0, 3, 0x0403]
