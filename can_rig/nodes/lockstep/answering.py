"""The common loop of controller nodes in lockstep: wait for a tick's feedback, and answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import can

from can_rig.nodes.watchdog import Interrupted, Watchdog


class AnsweringNode(ABC):
    """A node that answers each tick's frames.

    Attributes:
        ticks: the number of ticks of the whole run.
    """

    ticks: int

    @property
    @abstractmethod
    def tick(self) -> int:
        """The tick that is answered next."""

    @abstractmethod
    def take(self, message: can.Message) -> bool:
        """Receive a frame; returns True if the frame completed a tick, which is then answered."""

    def run(self, watchdog: Watchdog, on_tick: Callable[[int], None]) -> int:
        """Answer ticks to the end of the run or to a stop request; the number answered.

        Raises:
            SilentNodeError: the plant node is silent.
            BusLostError: the bus carries nothing any more.
        """
        while self.tick < self.ticks and not watchdog.stop.wanted:
            try:
                self.serve(watchdog)
            except Interrupted:
                break
            on_tick(self.tick)
        return self.tick

    def serve(self, watchdog: Watchdog) -> None:
        """Wait for one tick's feedback and answer the tick.

        Raises:
            SilentNodeError, BusLostError, Interrupted: see ``Watchdog.receive``.
        """
        while not self.take(watchdog.receive(self.tick)):
            watchdog.go_on_waiting(self.tick)
        watchdog.hear()
