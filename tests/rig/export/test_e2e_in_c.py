"""The frames in C against the rig's own, which use autosar-e2e."""

from __future__ import annotations

import ctypes
import math
from functools import cache

import numpy as np
import pytest
from e2e.p01 import e2e_p01_check
from hypothesis import given
from hypothesis import strategies as st

from can_rig.assessment.resolve import load
from can_rig.controllers.ecus import host_library
from can_rig.export.application import in_precision
from can_rig.frames.codec import USABLE, Checker, CheckStatus, MessageCodec, Protector
from can_rig.scenario.build import network_of
from firmware_model.law.structs import Precision

SCENARIO = load("default", [])
NETWORK = network_of(SCENARIO)


@cache
def c(precision: Precision = "float64") -> ctypes.CDLL:
    """The node in C, for its functions."""
    real = ctypes.c_float if precision == "float32" else ctypes.c_double
    found = ctypes.CDLL(str(host_library(in_precision(SCENARIO, precision))))
    found.e2e_check.restype = found.e2e_intact.restype = ctypes.c_bool
    found.frame_value.restype = real
    found.frame_tick.restype = ctypes.c_uint16
    argtypes = [ctypes.c_void_p, real, ctypes.c_uint16, ctypes.c_void_p]
    found.frame_pack.argtypes = argtypes
    return found


class CheckerInC(ctypes.Structure):
    _fields_ = (
        ("data_id", ctypes.c_uint16), ("known", ctypes.c_bool), ("last", ctypes.c_uint8),
        ("window", ctypes.c_uint8), ("sync", ctypes.c_uint8),
        ("counts", ctypes.c_uint32 * len(CheckStatus)),
    )  # fmt: skip


class ProtectorInC(ctypes.Structure):
    _fields_ = (("data_id", ctypes.c_uint16), ("counter", ctypes.c_uint8))


def definition(codec: MessageCodec, precision: Precision = "float64") -> int:
    return ctypes.addressof(ctypes.c_char.in_dll(c(precision), f"frame_{codec.role}"))


@given(data_id=st.integers(0, 0xFFFF), payloads=st.lists(st.binary(min_size=8, max_size=8)))
def test_protected_frames_are_those_of_the_library(data_id: int, payloads: list[bytes]) -> None:
    ours, protector = Protector(data_id), ProtectorInC()
    c().e2e_protector_init(ctypes.byref(protector), data_id)
    for payload in payloads:
        expected = bytearray(payload)
        ours.protect(expected)
        data = ctypes.create_string_buffer(payload, 8)
        c().e2e_protect(ctypes.byref(protector), data)
        assert data.raw == bytes(expected)


EVENTS = st.one_of(
    st.tuples(st.just("frame"), st.integers(0, 15)),
    st.tuples(st.sampled_from(["damaged", "short", "none", "other tick", "other damaged"]),
              st.integers(0, 14)),
    st.tuples(st.just("next"), st.just(0)),
)  # fmt: skip


@given(st.lists(EVENTS, max_size=60))
def test_frames_are_judged_as_by_the_rig(events: list[tuple[str, int]]) -> None:
    ours, checker, counter = Checker(0x123), CheckerInC(), 0
    c().e2e_checker_init(ctypes.byref(checker), 0x123)
    for what, number in events:
        counter = (counter + 1) % 15 if what == "next" else number
        protector = ProtectorInC(0x123, counter)
        buffer = ctypes.create_string_buffer(bytes(range(8)), 8)
        c().e2e_protect(ctypes.byref(protector), buffer)
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


@pytest.mark.parametrize("codec", list(NETWORK), ids=lambda codec: codec.role)
@given(
    value=st.one_of(st.floats(), st.integers(-(2**32), 2**32).map(lambda n: n * 0.5e-3),
                    st.integers(-(2**32), 2**32).map(lambda n: n * 0.5e-8)),
    tick=st.integers(0, 0xFFFF),
)  # fmt: skip
def test_values_are_packed_as_by_the_rig(codec: MessageCodec, value: float, tick: int) -> None:
    data = ctypes.create_string_buffer(8)
    c().frame_pack(definition(codec), value, tick, data)
    assert data.raw == bytes(codec.encode(value, tick))
    assert c().frame_tick(data) == tick


@pytest.mark.parametrize("codec", list(NETWORK), ids=lambda codec: codec.role)
def test_the_ends_of_a_range_are_packed_as_by_the_rig(codec: MessageCodec) -> None:
    for end in (codec.minimum, codec.maximum, 0.0, math.nan):
        for value in (end, math.nextafter(end, math.inf), math.nextafter(end, -math.inf)):
            data = ctypes.create_string_buffer(8)
            c().frame_pack(definition(codec), value, 0, data)
            assert data.raw == bytes(codec.encode(value, 0))


@pytest.mark.parametrize("codec", list(NETWORK), ids=lambda codec: codec.role)
@given(
    value=st.one_of(
        st.floats(width=32),
        st.integers(-(2**24), 2**24).map(lambda n: n * 2.0**-16),  # halves of a step
        st.integers(-(2**31), 2**31).map(lambda n: float(np.float32(n * 1e-3))),
        st.integers(-(2**31), 2**31).map(lambda n: float(np.float32(n * 1e-8))),
    )
)
def test_single_precision_is_packed_without_double_as_by_the_rig(
    codec: MessageCodec, value: float
) -> None:
    data = ctypes.create_string_buffer(8)
    c("float32").frame_pack(definition(codec, "float32"), value, 7, data)
    assert data.raw == bytes(codec.encode(value, 7))


@pytest.mark.parametrize("codec", list(NETWORK), ids=lambda codec: codec.role)
@given(data=st.binary(min_size=8, max_size=8))
def test_bytes_are_read_as_by_the_rig(codec: MessageCodec, data: bytes) -> None:
    expected = codec.decode(data).value
    found = c().frame_value(ctypes.c_void_p(definition(codec)), data)
    assert found == expected or (math.isnan(found) and math.isnan(expected))
