"""AUTOSAR end-to-end protection, profile 1 (variant 1A), of a frame of 8 bytes or any other length.

Byte 0 is a CRC-8 (SAE J1850, polynomial 0x1D) over the low byte and the high byte of the data
identifier and the bytes from 1 on; the low nibble of byte 1 is a counter 0..14. The CRC detects
damage and a frame of another sender, the counter detects repetition, loss and wrong order. The CRC
detects every burst of up to 8 bits, except for 5 of the 769 across bytes 0 and 1: the polynomial
needs the CRC after the data, and the profile sends the CRC first. CAN's CRC-15 detects these
bursts.

Source: AUTOSAR SWS E2E Library (Doc. 428), "Specification of E2E Profile 1": data identifier mode
E2E_P01_DATAID_BOTH, E2E_P01Protect and E2E_P01Check. Configuration: SyncCounterInit is 1;
MaxNoNewOrRepeatedData is 14, which disables its monitor.
"""

from enum import IntEnum
from typing import Final

from e2e.p01 import e2e_p01_check, e2e_p01_protect

FRAME_BYTES: Final = 8
"""Length of every frame of the rig's own [byte]."""

COUNTERS: Final = 15
"""Counters are 0..14; 15 is never sent."""

_LARGEST_DELTA: Final = COUNTERS - 1
_AFTER: Final = (*range(1, COUNTERS), 0)  # the successor of each counter
_SYNC_COUNTER_INIT: Final = 1


class CheckStatus(IntEnum):
    """Result of checking one frame: E2E_P01CheckStatusType, extended by the rig."""

    OK = 0
    """The next frame."""
    INITIAL = 1
    """The first intact frame of a run; no earlier counter exists."""
    OK_SOME_LOST = 2
    """An intact frame, newer than the last frame, after a tolerated number of losses."""
    REPEATED = 3
    """The last frame's counter again."""
    WRONG_SEQUENCE = 4
    """Too many frames lost, or an old frame."""
    SYNC = 5
    """In sequence again after WRONG_SEQUENCE, but not yet confirmed."""
    WRONG_CRC = 6
    """A damaged frame, another sender's frame, or the counter 15, which no sender uses."""
    WRONG_LENGTH = 7
    """Another length than the codec's."""
    NO_NEW_DATA = 8
    """A missing frame."""
    WRONG_TICK = 9
    """Intact, but from another tick; the counter is left unchecked."""


USABLE: Final = (CheckStatus.OK, CheckStatus.INITIAL, CheckStatus.OK_SOME_LOST)
"""The statuses of usable frames; frames of other statuses update nothing."""

# Module constants: a lookup in the enumeration costs as much as the rest of a check.
_OK, _INITIAL, _OK_SOME_LOST = USABLE
_REPEATED, _WRONG_SEQUENCE = CheckStatus.REPEATED, CheckStatus.WRONG_SEQUENCE
_SYNC, _WRONG_CRC, _WRONG_LENGTH = CheckStatus.SYNC, CheckStatus.WRONG_CRC, CheckStatus.WRONG_LENGTH
_WRONG_TICK = CheckStatus.WRONG_TICK


def _require_data_id(data_id: int) -> int:
    if not 0 <= data_id <= 0xFFFF:
        raise ValueError(f"data_id is {data_id}; it must be 0..65535")
    return data_id


class Protector:
    """The sending end of one protected frame (E2E_P01Protect).

    Args:
        data_id: 16-bit identifier of the frame, known to both ends and never sent itself.

    Raises:
        ValueError: `data_id` is not 16-bit unsigned.
    """

    __slots__ = ("_counter", "data_id")

    def __init__(self, data_id: int) -> None:
        self.data_id: Final = _require_data_id(data_id)
        self._counter = _LARGEST_DELTA  # sends 0 first, following SWS E2E

    def protect(self, data: bytearray) -> None:
        """Write the next counter and the CRC into `data`, in place."""
        # The library increments the counter in the frame; 0 follows 14.
        data[1] = (data[1] & 0xF0) | self._counter
        e2e_p01_protect(data, self.data_id)
        self._counter = data[1] & 0x0F


class Checker:
    """The receiving end of one protected frame (E2E_P01Check).

    Call `check` for every arrived frame, and `no_new_data` for every missing frame. Each call
    without a usable frame widens the tolerated counter step by one, because the sender continues
    counting; a usable frame resets the step to ``max_delta_counter``. After a larger step the
    received counter is adopted, and one more frame in sequence (SYNC) is needed before the content
    is used again.

    Args:
        data_id: identifier of the frame, as at the sender.
        max_delta_counter: tolerated number of frames lost between two that arrive in successive
            calls, 1..14 (MaxDeltaCounterInit).
        length: of its frames [byte].

    Raises:
        ValueError: an argument out of range.
    """

    __slots__ = (
        "_counts", "_last", "_length", "_next", "_sync", "_window", "data_id", "max_delta_counter",
    )  # fmt: skip

    def __init__(self, data_id: int, max_delta_counter: int = 1, length: int = FRAME_BYTES) -> None:
        if not 1 <= max_delta_counter <= _LARGEST_DELTA:
            raise ValueError(f"max_delta_counter is {max_delta_counter}; it must be 1..14")
        self.data_id: Final = _require_data_id(data_id)
        self.max_delta_counter: Final = max_delta_counter
        self._length = length
        self._last: int | None = None  # counter of the last accepted frame
        self._next: int | None = None  # the counter of an OK frame; None where that is not enough
        self._window = max_delta_counter  # largest tolerated step at the last call
        self._sync = 0  # frames in sequence still needed before use
        self._counts = [0] * len(CheckStatus)

    @property
    def expected(self) -> int | None:
        """The counter of a next frame that is OK; None where another status is next."""
        return self._next

    def go_on(self, frames: int) -> None:
        """Count frames that were found OK elsewhere, one in each of as many calls."""
        if frames and self._next is not None:
            self._last = (self._next + frames - 1) % COUNTERS
            self._next = _AFTER[self._last]
            self._window = self.max_delta_counter
            self._counts[_OK] += frames

    @property
    def counts(self) -> dict[CheckStatus, int]:
        """Number of frames with each status since the start."""
        return dict(zip(CheckStatus, self._counts, strict=True))

    def check(self, data: bytearray) -> CheckStatus:
        """Judge one received frame; never raises, whatever its content or length."""
        intact = len(data) == self._length and e2e_p01_check(data, self.data_id)
        if intact and data[1] & 0x0F == self._next:  # the usual case, made quick
            self._last, self._next = self._next, _AFTER[self._next]
            self._window = self.max_delta_counter
            self._counts[_OK] += 1
            return _OK
        self._window += 1  # SWS E2E limits the window to 14, which tolerates every step
        status = self._judge(data[1] & 0x0F) if intact else self._damage(data)
        self._counts[status] += 1
        return status

    def reject(self, data: bytearray) -> None:
        """Count a frame of another tick, without further effect.

        A forged frame therefore needs the current tick to disturb the counter.
        """
        intact = len(data) == self._length and e2e_p01_check(data, self.data_id)
        self._counts[_WRONG_TICK if intact else self._damage(data)] += 1

    def _damage(self, data: bytearray) -> CheckStatus:
        """The status of a damaged frame."""
        return _WRONG_LENGTH if len(data) != self._length else _WRONG_CRC

    def no_new_data(self) -> CheckStatus:
        """Record a missing frame."""
        self._window += 1
        self._counts[CheckStatus.NO_NEW_DATA] += 1
        return CheckStatus.NO_NEW_DATA

    def _judge(self, received: int) -> CheckStatus:
        """Compare the counter of an intact frame, not OK, with the last frame's counter."""
        if self._last is None:
            return self._accept(received, _INITIAL)
        delta = (received - self._last) % COUNTERS
        if delta == 0:
            return _REPEATED
        if delta > self._window:
            self._sync = _SYNC_COUNTER_INIT
            return self._accept(received, _WRONG_SEQUENCE)
        if self._sync:
            self._sync -= 1
            return self._accept(received, _SYNC)
        return self._accept(received, _OK_SOME_LOST)

    def _accept(self, received: int, status: CheckStatus) -> CheckStatus:
        """Adopt this counter, with the initial tolerance."""
        self._last = received
        self._next = None if self._sync else _AFTER[received]
        self._window = self.max_delta_counter
        return status


class Unprotected(Checker):
    """The receiving end of a frame without protection: only the length decides."""

    __slots__ = ()

    def __init__(self, length: int) -> None:
        super().__init__(0, length=length)

    def check(self, data: bytearray) -> CheckStatus:
        """As that of `Checker`."""
        status = _OK if len(data) == self._length else _WRONG_LENGTH
        self._counts[status] += 1
        return status

    def reject(self, data: bytearray) -> None:
        """As that of `Checker`."""
        self._counts[_WRONG_TICK if len(data) == self._length else _WRONG_LENGTH] += 1
