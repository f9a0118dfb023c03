"""Open loop: the logged reference and feedback drive today's controller node, frame by frame.

It is the node of a lockstep run, with its receive rules and its firmware, without a bus and without
a watchdog. What it answers is compared with what the log has.

The one thing that a log has and a lockstep bus has not is time that goes on without the feedback.
A frame of a later tick says so, if a second one agrees; then the node is told that the ticks in
between have passed, and the firmware holds. A frame that says so alone is handed to the node like
any other, which rejects it: that is what it would do with a frame that somebody made up.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from typing import Final

import can

from can_rig.errors import LogError
from can_rig.frames.codec import tick_at, ticks_ahead
from can_rig.frames.network import Network
from can_rig.logs.frames import NS_PER_S, Frames
from can_rig.nodes.lockstep import ControllerNode
from can_rig.replay.comparison import ANSWERS, Comparison
from can_rig.replay.gaps import NEAR, Account, Gap, Row
from can_rig.replay.in_real_time import Recorded
from can_rig.replay.rig_frames import INPUTS, RigFrame, is_input, rig_frames
from can_rig.scenario.fault_settings import RESTARTED
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Law

AHEAD: Final = 32
"""Frames that are looked at in advance for a second one that agrees."""


class OpenLoop:
    """One log through one controller.

    Args:
        scenario: the controller's. Faults of frames are not scheduled: the log has had its own.
        network: the frames.
        on_gap: gets what is wrong with the log; see `gaps`.
        recorded: what a run in real time left unanswered; None: a run in lockstep.
        law: what runs as the control law.

    Raises:
        ScenarioError: a design that cannot be made.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        on_gap: Callable[[Gap], None],
        recorded: Recorded | None = None,
        law: Law = PYTHON_LAW,
    ) -> None:
        self._tick_s = scenario.tick_s
        self._network = network
        self._codecs = network.by_role
        self._sent: list[bytes] = []
        self._node = ControllerNode(
            replace(scenario, fault=tuple(f for f in scenario.faults if f.kind == RESTARTED)),
            network,
            lambda message: self._sent.append(bytes(message.data)),
            recorded,
            law,
        )
        self._outages = scenario.outages
        self.account: Final = Account(network, scenario.tick_ns, on_gap, self._outages)
        self.comparison: Final = Comparison(network)
        self.compare_from_ns: int | None = None
        """Time stamp from which on ticks are compared; those before it are replayed alone. None:
        all are."""
        self.first_tick: int | None = None
        """The first that was answered."""
        self.before_start = 0
        """Frames before the first reference and feedback that belong together."""
        self.left_out = 0
        """Intact feedback of ticks far from the one that was due, as those of another run."""
        self._left_out_tick: int | None = None  # on the wire, of the last of these
        self._contact: list[RigFrame] = []  # what the node has got before it answers
        self._past = 0  # ticks that the 16 bits on the wire do not tell
        self._open = 0  # the first tick that is not compared yet
        self._rows: dict[int, Row] = {}
        self._answers: dict[int, tuple[bytes, ...]] = {}

    def run(self, chunks: Iterable[Frames]) -> None:
        """Replay the whole log.

        Raises:
            LogError: it has no reference and feedback of the rig that belong together.
        """
        time_ns = 0
        for frame, following in _with_following(rig_frames(chunks, self._network)):
            time_ns = frame.time_ns
            if self.first_tick is None:
                self._make_contact(frame)
                continue
            if is_input(frame.role):
                self._pass_over(frame, following)
            self._note(frame)
            if is_input(frame.role):
                self._serve(frame)
                self._close(self._due - NEAR, time_ns)
        if self.first_tick is None:
            names = f"{self._network.reference.name} and {self._network.feedback.name}"
            raise LogError(
                f"the log has no {names} of the same tick; it must be a log of the rig, and "
                "the scenario must be its own"
            )
        self._close(self._due, time_ns)
        for tick in sorted(self._rows):  # that the log ends with, or that no feedback came for
            self.account.close(tick, self._rows[tick])
        self.account.finish()

    def rejected(self) -> dict[str, dict[str, int]]:
        """What the node did not use, as `ControllerNode.rejected`."""
        return self._node.rejected()

    @property
    def _due(self) -> int:
        """The tick that the node expects next, as it is counted here."""
        return self._node.tick + self._past

    def _make_contact(self, frame: RigFrame) -> None:
        """Hand the node frames until it answers; those of that tick are the first of the account.

        A log that begins late begins at the tick that its time stamps say, if they are the rig's.
        """
        self._contact.append(frame)
        if is_input(frame.role):
            self._serve(frame)
        if self.first_tick is None:
            if len(self._contact) > NEAR:
                del self._contact[0]
                self.before_start += 1
            return
        for one in self._contact:
            if one.intact and one.tick == frame.tick:
                self._note(one)
            else:
                self.before_start += 1

    def _serve(self, frame: RigFrame) -> None:
        """Let the node have a frame, and take what it answers."""
        time_s = frame.time_ns / NS_PER_S
        codec = self._codecs[frame.role]
        message = can.Message(
            time_s, codec.frame_id, codec.extended, data=frame.data, is_fd=codec.fd
        )
        self._node.take(message)
        if self.first_tick is None and self._sent and self._node.expected is not None:
            tick = self._node.expected - 1
            self.first_tick = self._open = tick_at(tick, time_s, self._tick_s)
            self._past = self.first_tick - tick
        self._collect()

    def _collect(self) -> None:
        if self._sent:
            assert len(self._sent) == ANSWERS
            self._answers[self._due - 1] = tuple(self._sent)
            self._sent.clear()

    def _pass_over(self, frame: RigFrame, following: Iterable[RigFrame]) -> None:
        """Tell the node of ticks that went by without their feedback."""
        ahead = ticks_ahead(frame.tick, self._due)
        if frame.intact and ahead > 0 and _confirmed(frame, following):
            for _ in range(ahead):
                self._node.miss()
                self._collect()
                self._close(self._due - NEAR, frame.time_ns)

    def _note(self, frame: RigFrame) -> None:
        """Put a frame where it belongs, and have it judged."""
        due = self._due
        under_way = due if is_input(frame.role) else due - 1
        distance = ticks_ahead(frame.tick, due)
        if not frame.intact:
            self.account.take(frame, self._row(under_way, frame), under_way)
        elif self._goes_on_with_left_out(frame, distance):
            self._leave_out(frame, under_way)
        elif -NEAR <= distance <= (0 if is_input(frame.role) else NEAR):
            self.account.take(frame, self._row(due + distance, frame), due + distance)
        else:
            self._leave_out(frame, under_way)

    def _goes_on_with_left_out(self, frame: RigFrame, distance: int) -> bool:
        """Whether feedback is of another run, whose ticks have come near those of this one."""
        last = self._left_out_tick
        is_past = frame.role == INPUTS - 1 and distance < 0
        return is_past and last is not None and ticks_ahead(frame.tick, last) == 1

    def _leave_out(self, frame: RigFrame, under_way: int) -> None:
        self.account.take(frame, None, under_way)
        if frame.role == INPUTS - 1:
            self.left_out += 1
            self._left_out_tick = frame.tick

    def _row(self, tick: int, frame: RigFrame) -> Row | None:
        """The row of a tick that is still open."""
        return self._rows.setdefault(tick, Row(frame.time_ns)) if tick >= self._open else None

    def _close(self, end: int, time_ns: int) -> None:
        """Compare the ticks before ``end``; nothing more comes for them."""
        while self._open < end:
            tick = self._open
            row = self._rows.pop(tick, None) or Row(time_ns)
            answers = self._answers.pop(tick, None)
            self.account.close(tick, row)
            if answers is None:  # without power
                pass
            elif self.compare_from_ns is None or row.time_ns >= self.compare_from_ns:
                self.comparison.tick(tick, row, answers)
            self._open += 1


def _with_following(
    frames: Iterator[RigFrame],
) -> Iterator[tuple[RigFrame, Iterable[RigFrame]]]:
    """Every frame, and the ones that follow it."""
    window: deque[RigFrame] = deque(islice(frames, AHEAD))
    while window:
        frame = window.popleft()
        yield frame, window
        window.extend(islice(frames, 1))


def _confirmed(frame: RigFrame, following: Iterable[RigFrame]) -> bool:
    """Whether a second frame of the same sender says that its tick, or the next, has come."""
    return any(
        is_input(other.role)
        and other.intact
        and (other.role != frame.role or other.tick != frame.tick)
        and 0 <= ticks_ahead(other.tick, frame.tick) <= 1
        for other in following
    )
