"""A bus that refuses to send and to receive."""

import errno

import can

from tests.clock import TurnedClock

FRAME = can.Message(arbitration_id=0x300, is_extended_id=False)


def refusal(code: int | None) -> can.CanOperationError:
    return can.CanOperationError("Failed to transmit: no", code)


class Refusing(can.BusABC):
    """Refuses a number of times; what it has sent comes back."""

    channel_info = "socketcan channel 'can9'"
    channel = "can9"

    def __init__(self, clock: TurnedClock, times: int, code: int | None = errno.ENOBUFS) -> None:
        super().__init__(channel=self.channel)
        self.clock = clock
        self.times, self.code, self.asked = times, code, 0
        self.sent: list[can.Message] = []

    def _refuse(self) -> None:
        self.asked += 1
        if self.asked <= self.times:
            raise refusal(self.code)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._refuse()
        self.sent.append(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self._refuse()
        self.clock.pass_s(0.001 if self.sent else timeout or 0.0)
        return self.sent[0] if self.sent else None
