"""Record ↔ 8 bytes: bit-exact with cantools, saturating, and never raising in the loop."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from can_rig.frames.codec import Record
from firmware_model.law.status import Verdict
from tests.rig.frames.codecs import PAIRS, codec_pairs, codecs, floats, ticks

raws = st.one_of(st.integers(-(2**31) + 1, 2**31 - 1), st.sampled_from([1 - 2**31, 0, 2**31 - 1]))
two_bits = st.integers(0, 3)
verdicts = st.sampled_from(Verdict)


@given(codec_pairs, floats, ticks, two_bits, two_bits, verdicts)
def test_bytes_are_those_of_cantools(pair, value, tick, mode, fault_state, verdict):
    codec, message = pair
    sent = codec.quantise(value)
    signals = {
        "Checksum": 0,
        "AliveCounter": 0,
        "Tick": tick % 65536,
        codec.signal_name: "NOT_AVAILABLE" if math.isnan(sent) else sent,
    }
    if codec.modes:
        signals |= {"Mode": mode, "FaultState": fault_state, "Verdict": verdict}
    strict = not math.isnan(sent)  # NOT_AVAILABLE lies outside the range, by intention
    expected = message.encode(signals, strict=strict)
    assert codec.encode(value, tick, mode, fault_state, verdict) == expected


@given(codec_pairs, raws, st.binary(min_size=4, max_size=4))
def test_decoding_is_that_of_cantools_bit_for_bit(pair, raw, header):
    codec, message = pair
    assume(codec.to_raw(math.nan) != raw >> codec.layout.verdict_bits)
    data = header + raw.to_bytes(4, "little", signed=True)
    record, expected = codec.decode(data), message.decode(data, decode_choices=False)
    assert record.value == expected[codec.signal_name]
    assert record.tick == expected["Tick"]
    said = tuple(expected.get(name, 0) for name in ("Mode", "FaultState", "Verdict"))
    assert (record.mode, record.fault_state, record.verdict) == said


@given(codecs, floats, ticks)
def test_what_arrives_is_the_quantised_value(codec, value, tick):
    sent = codec.quantise(value)
    for given_value in (value, sent):
        record = codec.decode(codec.encode(given_value, tick))
        assert record.tick == tick % 65536
        assert record.value == sent or (math.isnan(record.value) and math.isnan(value))


@given(codecs, st.floats(allow_nan=False))
def test_quantise_saturates_and_rounds_to_the_nearest_step(codec, value):
    sent = codec.quantise(value)
    assert codec.minimum <= sent <= codec.maximum
    if value >= codec.maximum:
        assert sent == codec.maximum
    elif value <= codec.minimum:
        assert sent == codec.minimum
    else:
        assert abs(sent - value) <= codec.lsb / 2 * (1 + 1e-6)
        assert sent == np.rint(value / codec.lsb) * codec.lsb  # as the firmware rounds


@pytest.mark.parametrize("codec", [codec for codec, _ in PAIRS], ids=lambda codec: codec.name)
def test_ends_and_infinities(codec):
    beyond = np.nextafter(codec.maximum, np.inf)
    for value in (codec.maximum, beyond, 1e300, math.inf):
        assert codec.decode(codec.encode(value, 0)).value == codec.maximum
        assert codec.decode(codec.encode(-value, 0)).value == codec.minimum == -codec.maximum
    assert codec.encode(math.nan, 0)[4:] == b"\x00\x00\x00\x80"
    assert math.isnan(codec.quantise(math.nan))
    assert math.isnan(codec.decode(codec.encode(math.nan, 0)).value)


@given(st.integers(), st.integers(), st.integers(), st.tuples(two_bits, two_bits, verdicts))
def test_status_words_saturate_and_touch_nothing_else(mode, fault_state, verdict, good):
    status = load_once()
    data = status.encode(-1.5, 7, mode, fault_state, verdict)
    ends = (min(max(word, 0), end) for word, end in ((mode, 3), (fault_state, 3), (verdict, 15)))
    assert status.decode(data) == Record(-1.5, 7, *ends)
    assert data[1] & 0x0F == 0
    assert status.decode(status.encode(0.0, 0, *good))[2:] == good
    assert status.decode(status.encode(0.0, 0))[2:] == (0, 0, 0)


def load_once():
    return next(codec for codec, _ in PAIRS if codec.role == "status")
