"""A clock that tests turn, and a bus on which it goes on."""

import can


class TurnedClock:
    """Only sleeping moves it; the clock of the bus's time stamps is the same."""

    def __init__(self, now_ns: int = 0) -> None:
        self.ns = now_ns

    def now_ns(self) -> int:
        return self.ns

    def sleep_until(self, at_ns: int) -> None:
        self.ns = max(self.ns, at_ns)

    def stamp_s(self) -> float:
        return self.ns * 1e-9

    @property
    def now_s(self) -> float:
        return self.ns * 1e-9

    def pass_s(self, seconds: float) -> None:
        """Let time go by."""
        self.ns += round(seconds * 1e9)


class Wire:
    """A bus with scripted messages that keeps sent messages; time passes during waits."""

    def __init__(self, clock: TurnedClock, *waiting: can.Message) -> None:
        self.clock, self.waiting = clock, list(waiting)
        self.sent: list[can.Message] = []

    def send(self, msg: can.Message) -> None:
        self.sent.append(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self.waiting:
            return self.waiting.pop(0)
        self.clock.pass_s(timeout or 0.0)
        return None
