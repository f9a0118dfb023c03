"""A clock that tests turn."""


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
