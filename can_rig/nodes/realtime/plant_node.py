"""The plant node in real time: owns the wall clock, and treats late frames as lost.

At deadline k the node latches the received commands, sends the reference and D* of tick k, and
then, in the slack, computes D* of tick k + 1 and packs its frames, receives, and records.

**Latency.** The latency is the transit time over the real bus plus the controller's computing time:
a command computed from the sample of tick k acts from deadline k + ``latency_ticks`` on, even after
an early arrival, and counts as lost if absent at this deadline (logical execution time: Henzinger,
Horowitz, Kirsch, "Giotto", Proc. IEEE 91 (2003) 84). The actuator then reacts as to a missing
command. A run without late frames therefore equals the lockstep run, command for command, and a
late frame has the effect of a lost frame in lockstep. A latency of zero is refused: commands would
act before their computation.

**Missed deadlines.** A node that wakes up to ``CATCH_UP_TICKS`` late runs the missed ticks at once,
in sequence; deadlines stay unchanged. After a longer sleep (SIGSTOP, a debugger) the node skips and
counts the missed ticks: the car drives without commands, and no frames are sent. Time on the bus is
always wall-clock time.
"""

import math
from dataclasses import replace
from typing import Any, Final

import can

from can_rig.errors import SilentNodeError
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import NS_PER_S, Clock, Interrupted, NodeBus, Watchdog
from can_rig.nodes.ends import COMMANDS, PlantEnd
from can_rig.nodes.realtime.timing import CATCH_UP_TICKS, Schedule, Timing, require_causal
from can_rig.nodes.recording import PlantRecorder, Recorder
from can_rig.scenario.settings import Scenario

GUARD_NS: Final = 100_000
"""Before a deadline the node sleeps: waking from a bus is less exact."""

MOST_AT_ONCE: Final = 100
"""Frames taken in at a deadline, however many a third node floods the bus with."""


class RealTimePlantNode:
    """Sends reference and feedback at each deadline, applies timely commands.

    Args:
        scenario: the run.
        network: the frames of the run.
        bus: for sending and receiving; never raises ``can.CanError``.
        recorder: gets every frame sent or received; None records nothing.
        reports: gets the plant's report of every tick; None records nothing.
        clock: the time.

    Raises:
        ScenarioError: a latency of zero, a reference beyond the range of its frame.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        bus: NodeBus,
        recorder: Recorder | None,
        clock: Clock,
        reports: PlantRecorder | None = None,
    ) -> None:
        require_causal(scenario)
        self.ticks: Final = scenario.ticks
        self.timing = Timing(scenario.tick_ns)
        # Commands wait in _inbox until their tick, so the simulated bus adds no delay.
        undelayed = replace(scenario, latency_ticks=0)
        self._end = PlantEnd(undelayed, network, bus.send, recorder, reports)
        self._commands = (network.command_1.name, network.command_2.name)
        self._bus = bus
        self._recorder = recorder
        self._clock = clock
        self._latency_ticks = scenario.latency_ticks
        self._inbox: list[list[float | None]] = [[None, None] for _ in range(self._latency_ticks)]
        self._acting: list[float | None] = [None, None]
        self._sent_ns = [0] * self._latency_ticks
        self._schedule = Schedule(clock.now_ns(), scenario.tick_ns)
        self._guard_ns = min(GUARD_NS, scenario.tick_ns // 4)
        self._ended = False
        self._answered = False  # the status of tick 0 has come
        self._heard_ns = 0

    def carry(self, watchdog: Watchdog, tick: int) -> int:
        """Carry the tick under way to the next deadline, and begin the next tick; see ``drive``.

        The clock starts with the controller node's answer to tick 0; until then the node repeats
        the offer of tick 0.

        Raises:
            SilentNodeError: no controller node came, or the controller is silent for too long.
            Interrupted: a stop was requested.
        """
        if self._ended:
            raise Interrupted
        if not self._answered:
            self._meet(watchdog)
            self._schedule = Schedule(self._clock.now_ns(), self._schedule.tick_ns)
            self._heard_ns = self._schedule.start_ns
            self._follow(tick)
        deadline_ns = self._schedule.deadline_ns(tick + 1)
        self._receive_until(deadline_ns - self._guard_ns, tick)
        self._clock.sleep_until(deadline_ns)
        now_ns = self._clock.now_ns()
        self._take_in(tick)
        self._ended = watchdog.stop.wanted
        if self._ended or tick + 1 == self.ticks:
            return tick + 1
        due, tick = tick + 1, self._skip(tick + 1, now_ns)
        if self._recorder is not None:
            self._recorder.at(now_ns - self._schedule.start_ns)
        # Right after the last look at the bus: the time stamp shows late commands.
        self._end.send_sample()
        self.timing.woke(due, now_ns - deadline_ns)
        self.timing.skipped(tick - due)
        self._latch(tick)
        self._sent_ns[tick % self._latency_ticks] = now_ns
        self._follow(tick)
        self._watch(tick, now_ns, watchdog)
        return tick

    def repeat(self) -> None:
        """Send the offer of tick 0 again, for a controller that starts late."""
        self._end.repeat()

    def rejected(self) -> dict[str, dict[str, int]]:
        """Per message, how many frames were not used and why."""
        return self._end.rejected()

    def realtime(self) -> dict[str, Any]:
        """How the deadlines were met, and how many commands came too late."""
        rejected = self.rejected()
        late = sum(rejected[name].get("wrong_tick", 0) for name in self._commands)
        return {**self.timing.as_dict(), "late_frames": late}

    def _meet(self, watchdog: Watchdog) -> None:
        self._end.sample(0)
        self._end.send_sample()
        while not self._answered:
            self._hear(watchdog.receive(0), 0)
            watchdog.go_on_waiting(0)
        watchdog.hear()

    def _receive_until(self, end_ns: int, tick: int) -> None:
        while (left_ns := end_ns - self._clock.now_ns()) > 0:
            message = self._bus.recv(left_ns / NS_PER_S)
            if message is not None:
                self._hear(message, tick)

    def _take_in(self, tick: int) -> None:
        """What came while the node slept."""
        for _ in range(MOST_AT_ONCE):
            message = self._bus.recv(0)
            if message is None:
                return
            self._hear(message, tick)

    def _hear(self, message: can.Message, tick: int) -> None:
        """Take in a frame while ``tick`` is under way."""
        now_ns = self._clock.now_ns()
        if self._recorder is not None:
            if self._answered:
                self._recorder.at(now_ns - self._schedule.start_ns)
            self._recorder.record(message, sent=False)
        age = self._end.age(message, tick)
        in_time = 0 <= age < self._latency_ticks
        judged = self._end.judge(message, tick - age if in_time else tick)
        if judged is None:
            return
        at, record = judged
        slot = (tick - age) % self._latency_ticks
        if at < COMMANDS:
            if math.isfinite(record.value):
                self._inbox[slot][at] = record.value
            return
        self._heard_ns = now_ns
        if self._answered and self._sent_ns[slot]:  # tick 0 has no time
            self.timing.answer.add(now_ns - self._sent_ns[slot])
        self._answered = True

    def _skip(self, tick: int, now_ns: int) -> int:
        """The next tick: ``tick``, or after a long sleep the newest due tick."""
        newest = min(self._schedule.newest(now_ns), self.ticks - 1)  # the last one ends the run
        if newest - tick <= CATCH_UP_TICKS:
            return tick
        for skipped in range(tick, newest):
            if skipped > tick:
                self._end.plant.measure()  # noise belongs to its tick
            self._latch(skipped)
            self._end.advance(skipped, *self._acting)
        self._end.sample(newest)
        return newest

    def _latch(self, tick: int) -> None:
        """Close the inbox: commands of ``latency_ticks`` ago act from here on."""
        slot = tick % self._latency_ticks
        self._acting = self._inbox[slot]
        self._inbox[slot] = [None, None]
        if None in self._acting and tick >= self._latency_ticks:
            self.timing.unanswered_ticks += 1
        self._end.end_tick()

    def _follow(self, tick: int) -> None:
        """In the slack: D* of the next tick, its frames, and the log."""
        self._end.advance(tick, *self._acting)
        if tick + 1 < self.ticks:
            self._end.sample(tick + 1)
        if self._recorder is not None:
            self._recorder.flush()

    def _watch(self, tick: int, now_ns: int, watchdog: Watchdog) -> None:
        if now_ns - self._heard_ns > watchdog.silence_s * NS_PER_S:
            raise SilentNodeError(
                f"no frame from the controller node for {watchdog.silence_s:g} s at tick {tick}"
            )
