"""The frames in C against the rig's own, which use autosar-e2e."""

import ctypes
import math
from functools import cache

import numpy as np
import pytest
from e2e.p01 import e2e_p01_check
from hypothesis import given, strategies as st

from can_rig.controllers.ecus import host_library
from can_rig.export.network_code import SENT
from can_rig.frames.codec import USABLE, Checker, CheckStatus, Protector
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from firmware_model.law.structs import Precision
from tests.rig.export.shared import PRECISIONS, frames_in_c

SCENARIO = load("default", [])
NETWORK = network_of(SCENARIO)


@cache
def c() -> ctypes.CDLL:
    """The node in C, for its functions."""
    found = ctypes.CDLL(str(host_library(SCENARIO)))
    found.e2e_check.restype = found.e2e_intact.restype = ctypes.c_bool
    return found


@cache
def frames(precision: Precision = "float64") -> ctypes.CDLL:
    """What packs and unpacks."""
    return frames_in_c(NETWORK, precision)


class CheckerInC(ctypes.Structure):
    _fields_ = (
        ("data_id", ctypes.c_uint16), ("begun", ctypes.c_uint8), ("bytes", ctypes.c_uint8),
        ("known", ctypes.c_bool), ("last", ctypes.c_uint8),
        ("window", ctypes.c_uint8), ("sync", ctypes.c_uint8),
        ("counts", ctypes.c_uint32 * len(CheckStatus)),
    )  # fmt: skip


class ProtectorInC(ctypes.Structure):
    _fields_ = (
        ("data_id", ctypes.c_uint16),
        ("begun", ctypes.c_uint8),
        ("counter", ctypes.c_uint8),
    )


@given(data_id=st.integers(1, 0xFFFF), payloads=st.lists(st.binary(min_size=8, max_size=8)))
def test_protected_frames_are_those_of_the_library(data_id, payloads):
    ours, protector = Protector(data_id), ProtectorInC()
    c().e2e_protector_init(ctypes.byref(protector), data_id)
    for payload in payloads:
        expected = bytearray(payload)
        ours.protect(expected)
        data = ctypes.create_string_buffer(payload, 8)
        c().e2e_protect(ctypes.byref(protector), data, 8)
        assert data.raw == bytes(expected)


EVENTS = st.one_of(
    st.tuples(st.just("frame"), st.integers(0, 15)),
    st.tuples(st.sampled_from(["damaged", "short", "none", "other tick", "other damaged"]),
              st.integers(0, 14)),
    st.tuples(st.just("next"), st.just(0)),
)  # fmt: skip


@given(st.lists(EVENTS, max_size=60))
def test_frames_are_judged_as_by_the_rig(events):
    ours, checker, counter = Checker(0x123), CheckerInC(), 0
    c().e2e_checker_init(ctypes.byref(checker), 0x123, 8)
    for what, number in events:
        counter = (counter + 1) % 15 if what == "next" else number
        protector = ProtectorInC()
        c().e2e_protector_init(ctypes.byref(protector), 0x123)
        protector.counter = counter
        buffer = ctypes.create_string_buffer(bytes(range(8)), 8)
        c().e2e_protect(ctypes.byref(protector), buffer, 8)
        frame = bytearray(buffer.raw)
        assert e2e_p01_check(frame, 0x123) == (counter < 15)
        if "damaged" in what:
            frame[3] ^= 1
        if what == "short":
            del frame[5:]
        if what == "none":
            ours.no_new_data()
            c().e2e_no_new_data(ctypes.byref(checker))
        elif what.startswith("other"):
            ours.reject(frame)
            c().e2e_reject(ctypes.byref(checker), bytes(frame), len(frame))
        else:
            usable = ours.check(frame) in USABLE
            assert c().e2e_check(ctypes.byref(checker), bytes(frame), len(frame)) == usable
        assert list(checker.counts) == list(ours.counts.values())


SENT_FRAMES = pytest.mark.parametrize("at", [2, 3, 4], ids=SENT)


def packed(
    value: float, tick: int, at: int, precision: Precision = "float64"
) -> tuple[bytes, bytes]:
    """By C and by the rig."""
    data, codec = ctypes.create_string_buffer(8), [*NETWORK][at]
    frames(precision).pack(at, value, tick, 0, data)
    return data.raw, bytes(codec.encode(value, tick))


HALF_STEPS = st.tuples(
    st.integers(-(2**32), 2**32), st.sampled_from([0.5e-3, 0.5e-8, 2.0**-4, 2.0**-7])
).map(math.prod)


@SENT_FRAMES
@pytest.mark.parametrize("precision", PRECISIONS)
@given(value=st.floats() | st.floats(width=32) | HALF_STEPS, tick=st.integers(0, 0xFFFF))
def test_values_are_packed_as_by_the_rig(at, precision, value, tick):
    """In single precision without double."""
    with np.errstate(over="ignore"):
        value = float(np.dtype(precision).type(value))
    found, expected = packed(value, tick, at, precision)
    assert found == expected


@SENT_FRAMES
def test_the_ends_of_a_range_are_packed_as_by_the_rig(at):
    codec = [*NETWORK][at]
    for end in (codec.minimum, codec.maximum, 0.0, math.nan):
        for value in (end, math.nextafter(end, math.inf), math.nextafter(end, -math.inf)):
            found, expected = packed(value, 0, at)
            assert found == expected


@pytest.mark.parametrize("at", [0, 1])
@given(data=st.binary(min_size=8, max_size=8))
def test_bytes_are_read_as_by_the_rig(at, data):
    expected, tick = [*NETWORK][at].decode(data), ctypes.c_uint32()
    found = frames().unpack(at, data, ctypes.byref(tick))
    assert tick.value == expected.tick
    assert found == expected.value or (math.isnan(found) and math.isnan(expected.value))
