"""End-to-end protection against an independent CRC and an independent reading of the SWS."""

import itertools

import pytest
from hypothesis import given, settings, strategies as st

from can_rig.frames.codec import Checker, CheckStatus, Protector

DATA_ID = 0x5B11

payloads = st.binary(min_size=8, max_size=8)
data_ids = st.integers(0, 0xFFFF)


def crc8_j1850(data, crc=0xFF, final=0xFF):
    """CRC-8 SAE J1850 bit by bit: polynomial 0x1D, start and final XOR 0xFF."""
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x11D if crc & 0x80 else 0)
    return crc ^ final


def profile_1_crc(data, data_id):
    """SWS E2E profile 1: its start value and final XOR compensate those of the CRC library to 0."""
    return crc8_j1850([data_id & 0xFF, data_id >> 8, *data[1:]], crc=0, final=0)


def frame(counter, data_id=DATA_ID, payload=b"\x12\x34\x56\x78\x9a\xbc"):
    data = bytearray([0, 0xA0 | counter, *payload])
    data[0] = profile_1_crc(data, data_id)
    return data


def test_the_reference_crc_gives_the_catalogue_check_value():
    assert crc8_j1850(b"123456789") == 0x4B


@given(payloads, data_ids)
def test_crc_is_that_of_profile_1(payload, data_id):
    data = bytearray(payload)
    Protector(data_id).protect(data)
    assert data[0] == profile_1_crc(data, data_id)
    assert data[1] >> 4 == payload[1] >> 4  # status bits stay
    assert data[2:] == payload[2:]
    assert Checker(data_id).check(data) is CheckStatus.INITIAL


def test_counter_starts_at_0_and_skips_15():
    protector, sent = Protector(DATA_ID), []
    for _ in range(32):
        data = bytearray(b"\xff" * 8)
        protector.protect(data)
        sent.append(data[1] & 0x0F)
    assert sent == [n % 15 for n in range(32)]


def bursts():
    """Every damage of 1 to 8 neighbouring bits of 8 bytes, in the order of the wire, once."""
    for shift in range(64):
        for pattern in range(1, 256, 2):  # the last bit is damaged: no burst twice
            if (pattern << shift).bit_length() <= 64:
                yield (pattern << shift).to_bytes(8, "big")


@settings(max_examples=10)
@given(payloads, data_ids)
def test_every_burst_of_up_to_8_bits_is_detected(payload, data_id):
    data = bytearray(payload)
    Protector(data_id).protect(data)
    checker, missed = Checker(data_id), set()
    for damage in bursts():
        status = checker.check(bytearray(a ^ b for a, b in zip(data, damage, strict=True)))
        if status is not CheckStatus.WRONG_CRC:
            missed.add(damage[:2].hex())
            assert damage[0]
            assert damage[1]  # it straddles the CRC and the data
    assert missed <= {"010e", "021c", "0438", "0870", "10e0"}


def test_a_frame_of_another_sender_is_refused():
    assert Checker(DATA_ID).check(frame(0, data_id=DATA_ID + 1)) is CheckStatus.WRONG_CRC


@pytest.mark.parametrize("length", [0, 1, 7, 9, 64])
def test_wrong_length_is_refused(length):
    checker = Checker(DATA_ID)
    assert checker.check(bytearray(length)) is CheckStatus.WRONG_LENGTH
    assert checker.counts[CheckStatus.WRONG_LENGTH] == 1


# 15 is never sent; the library refuses it together with a wrong CRC.
NOT_COMPARED = {None: "NO_NEW_DATA", "bad": "WRONG_CRC", 15: "WRONG_CRC", "short": "WRONG_LENGTH"}


class ReferenceChecker:
    """E2E_P01Check transcribed from the SWS, SyncCounterInit 1, with its own names."""

    def __init__(self):
        self.max_delta_counter = 1
        self.wait_for_first_data, self.last_valid_counter, self.sync_counter = True, 0, 0

    def check(self, event):
        """`event`: the counter of an intact frame, or "bad", "short", or None for no frame."""
        self.max_delta_counter = min(14, self.max_delta_counter + 1)
        if event in NOT_COMPARED:
            return NOT_COMPARED[event]
        if self.wait_for_first_data:
            self.wait_for_first_data = False
            return self.take(event, "INITIAL")
        if event >= self.last_valid_counter:
            delta = event - self.last_valid_counter
        else:
            delta = 15 + event - self.last_valid_counter
        if delta == 0:
            return "REPEATED"
        if delta > self.max_delta_counter:
            self.sync_counter = 1
            return self.take(event, "WRONG_SEQUENCE")
        status = "OK" if delta == 1 else "OK_SOME_LOST"
        if self.sync_counter > 0:
            self.sync_counter -= 1
            status = "SYNC"
        return self.take(event, status)

    def take(self, counter, status):
        self.last_valid_counter = counter
        self.max_delta_counter = 1
        return status


events = st.one_of(st.integers(0, 15), st.sampled_from([None, "bad", "short"]))


@given(st.lists(events, max_size=60))
def test_counter_sequences_against_the_reference_model(sequence):
    checker, reference = Checker(DATA_ID), ReferenceChecker()
    seen = dict.fromkeys(CheckStatus, 0)
    for event in sequence:
        if event is None:
            status = checker.no_new_data()
        elif event == "bad":
            status = checker.check(frame(3, data_id=DATA_ID ^ 0x0100))
        elif event == "short":
            status = checker.check(frame(3)[:7])
        else:
            status = checker.check(frame(event))
        assert status.name == reference.check(event)
        seen[status] += 1
    assert checker.counts == seen


STEPS = (1, 2, 3, 4, 0, None, "bad")
"""Counter steps, no frame, a damaged one: what tells the statuses apart at the narrowest limit."""


def test_every_short_sequence_against_the_reference_model():
    """What chance finds late: where the tolerance is narrowed again, and by how much it widens."""
    frames = [frame(counter) for counter in range(15)]
    damaged = frame(3, data_id=DATA_ID ^ 0x0100)
    for sequence in itertools.product(STEPS, repeat=5):
        checker, reference, counter = Checker(DATA_ID), ReferenceChecker(), 7
        assert checker.check(frames[counter]).name == reference.check(counter)
        for step in sequence:
            if step is None:
                status, expected = checker.no_new_data(), reference.check(None)
            elif step == "bad":
                status, expected = checker.check(damaged), reference.check("bad")
            else:
                counter = (counter + step) % 15
                status, expected = checker.check(frames[counter]), reference.check(counter)
            assert status.name == expected, sequence


@pytest.mark.parametrize("data_id", [-1, 0x10000])
def test_data_id_out_of_range_is_refused(data_id):
    with pytest.raises(ValueError, match=r"must be 0\.\.65535"):
        Protector(data_id)
    with pytest.raises(ValueError, match=r"must be 0\.\.65535"):
        Checker(data_id)


def test_reject_counts_what_is_wrong_with_a_frame_and_leaves_the_sequence_alone():
    checker = Checker(DATA_ID)
    assert checker.check(frame(3)) is CheckStatus.INITIAL
    damaged = frame(4)
    damaged[5] ^= 0x10
    for data in (frame(4), frame(9), damaged, frame(4, data_id=1), bytearray(3), bytearray()):
        checker.reject(data)
    counts = {status.name: n for status, n in checker.counts.items() if n}
    assert counts == {"INITIAL": 1, "WRONG_TICK": 2, "WRONG_CRC": 2, "WRONG_LENGTH": 2}
    assert checker.check(frame(5)) is CheckStatus.OK_SOME_LOST  # the window of one call, not seven
    assert checker.check(frame(8)) is CheckStatus.WRONG_SEQUENCE
