"""Open loop: the logged reference and feedback drive today's controller node, frame by frame.

The node is the node of a lockstep run, with its receive rules and its firmware, without a bus and
without a watchdog. The answers are compared with the log, signal by signal, as on the wire.

A log can contain ticks without feedback; a lockstep bus cannot. A frame of a later tick shows such
ticks, if a second frame agrees; then the node is told to skip the ticks, and the firmware holds.
Without a second frame the node receives the frame as usual and rejects the frame as forged.
"""

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import islice
from typing import Any, Final

import can

from can_rig.controllers.making import PEER
from can_rig.controllers.our_law import PYTHON
from can_rig.controllers.protocol import InNode
from can_rig.errors import LogError
from can_rig.frames.codec import MessageCodec, Unpacked, tick_at, ticks_ahead
from can_rig.frames.network import Network
from can_rig.logs.frames import NS_PER_S, Frames
from can_rig.nodes.lockstep import ControllerNode
from can_rig.replaying.gaps import NEAR, Account, Row
from can_rig.replaying.rig_frames import (
    INPUTS,
    SPEED_ROLE,
    Recorded,
    RigFrame,
    codecs_of,
    is_input,
    rig_frames,
)
from can_rig.scenario.fault_settings import RESTARTED
from can_rig.scenario.settings import Scenario

ANSWERS: Final = 3
"""Frames of an answer: both commands and the status."""


@dataclass
class Place:
    """A tick with a difference."""

    tick: int
    time_s: float
    """Time stamp in the log."""
    logged: float | str
    """Value in the log in the signal's unit, a word of the value table, or "not available"."""
    replayed: float | str
    """Value of the replay."""


@dataclass
class SignalComparison:
    """One signal over all ticks with a usable frame in the log."""

    message: str
    signal: str
    unit: str
    compared: int = 0
    """Ticks."""
    different: int = 0
    first: Place | None = None
    largest: float = 0.0
    """Largest difference [unit]; nan for words of a value table, and where one side is not
    available."""
    largest_at: Place | None = None

    def as_dict(self) -> dict[str, Any]:
        """Every figure by its name; nan as None."""
        values = asdict(self)
        values["largest"] = None if math.isnan(self.largest) else self.largest
        return values


VALUE, MODE, FAULT_STATE, VERDICT = 0, 2, 3, 4
"""Places in an unpacked frame."""


@dataclass
class _Signal:
    """A signal's place in the frame, and its comparison."""

    result: SignalComparison
    codec: MessageCodec
    at: int = VALUE
    words: Mapping[int, str] = field(default_factory=dict)

    def raw(self, said: Unpacked) -> float:
        return said[self.at]

    def shown(self, raw: float) -> float | str:
        if self.at != VALUE:
            return self.words.get(int(raw), str(raw))
        value = self.codec.from_raw(raw)
        return "not available" if math.isnan(value) else value

    def compare(self, tick: int, time_ns: int, logged: float, replayed: float) -> None:
        result = self.result
        result.compared += 1
        if logged == replayed:
            return
        result.different += 1
        place = Place(tick, time_ns / NS_PER_S, self.shown(logged), self.shown(replayed))
        if result.first is None:
            result.first = place
        size = math.nan
        if self.at == VALUE:  # nan if not available
            steps = abs(logged - replayed) * (self.codec.lsb or 1.0)
            size = steps + 0.0 * (self.codec.from_raw(logged) + self.codec.from_raw(replayed))
        # A difference with a known size takes precedence.
        if result.largest_at is None or size > result.largest or math.isnan(result.largest):
            result.largest, result.largest_at = size, place


class Comparison:
    """Compares tick by tick."""

    def __init__(self, network: Network) -> None:
        codecs = tuple(network)[INPUTS:]
        self._says_speed = network.speed is not None
        self._signals = [_signals(codec) for codec in codecs]
        self.ticks = 0
        """All answered ticks."""
        self.compared = 0
        """Ticks with every frame compared."""
        self.without_input = 0
        """Ticks not compared: the log lacks the reference, the feedback or the speed."""
        self.without_answer = dict.fromkeys((codec.name for codec in codecs), 0)
        """By message, ticks not compared: the log lacks a usable frame of the message."""
        self.same_bytes = 0
        """Frames equal in every byte, with counter and CRC."""
        self.other_counter = 0
        """Frames with equal signals and a different counter."""
        self._names = [codec.name for codec in codecs]
        self._layouts = [codec.layout for codec in codecs]

    @property
    def signals(self) -> list[SignalComparison]:
        """The results of all signals."""
        return [signal.result for signals in self._signals for signal in signals]

    @property
    def identical(self) -> bool:
        """Whether no compared signal differs."""
        return not any(signal.different for signal in self.signals)

    @property
    def first_different_tick(self) -> int | None:
        """The first tick with a difference in any signal."""
        return min((s.first.tick for s in self.signals if s.first is not None), default=None)

    def tick(self, tick: int, row: Row, answer: Sequence[bytes]) -> None:
        """Compare one tick of the log with the frames of the replay."""
        self.ticks += 1
        if None in row.seen[:INPUTS] or (self._says_speed and row.seen[SPEED_ROLE] is None):
            self.without_input += 1
            return
        whole = True
        for at, replayed in enumerate(answer):
            logged = row.seen[INPUTS + at]
            if logged is None:
                self.without_answer[self._names[at]] += 1
                whole = False
                continue
            if logged == replayed:
                self.same_bytes += 1
                for signal in self._signals[at]:
                    signal.result.compared += 1
                continue
            layout = self._layouts[at]
            one, other = layout.unpack(logged), layout.unpack(replayed)
            pairs = [(signal.raw(one), signal.raw(other)) for signal in self._signals[at]]
            self.other_counter += all(a == b for a, b in pairs)
            for signal, (a, b) in zip(self._signals[at], pairs, strict=True):
                signal.compare(tick, row.time_ns, a, b)
        self.compared += whole


def _signals(codec: MessageCodec) -> list[_Signal]:
    def signal(name: str, unit: str, **where: Any) -> _Signal:
        return _Signal(SignalComparison(codec.name, name, unit), codec, **where)

    found = [signal(codec.signal_name, codec.unit)]
    if codec.modes:
        found.append(signal("Mode", "", at=MODE, words=codec.modes))
        found.append(signal("FaultState", "", at=FAULT_STATE, words=codec.fault_states))
    if codec.verdicts:
        found.append(signal("Verdict", "", at=VERDICT, words=codec.verdicts))
    return found


AHEAD: Final = 32
"""Frames searched in advance for a second frame that agrees."""


class OpenLoop:
    """One log through one controller.

    Args:
        scenario: the controller's scenario; its frame faults are ignored, the log contains its own.
        network: the frames.
        controller: starts the controller; None: that of the scenario.
        recorded: the answers of a run in real time; None: a run in lockstep.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(
        self,
        scenario: Scenario,
        network: Network,
        controller: InNode | None = None,
        recorded: Recorded | None = None,
    ) -> None:
        self._tick_s = scenario.tick_s
        self._network = network
        self._codecs = codecs_of(network)
        self._sent: list[bytes] = []
        self._node = ControllerNode(
            replace(scenario, fault=tuple(f for f in scenario.faults if f.kind == RESTARTED)),
            network,
            lambda message: self._sent.append(bytes(message.data)),
            controller or (PYTHON if scenario.controller.is_ours else PEER),
            recorded,
        )
        self.account: Final = Account(network, scenario.tick_ns, scenario.outages)
        self.comparison: Final = Comparison(network)
        self.compare_from_ns: int | None = None
        """First compared time stamp; earlier ticks are replayed only. None: compare all ticks."""
        self.first_tick: int | None = None
        """The first answered tick."""
        self.before_start = 0
        """Frames before the first reference and feedback of one tick."""
        self.left_out = 0
        """Intact feedback frames of ticks far from the expected tick, as of a second run."""
        self._left_out_tick: int | None = None  # on the wire, of the last left-out feedback
        self._contact: list[RigFrame] = []  # received frames before the first answer
        self._past = 0  # ticks beyond the 16 bits on the wire
        self._open = 0  # the first uncompared tick
        self._rows: dict[int, Row] = {}
        self._answers: dict[int, tuple[bytes, ...]] = {}

    def run(self, chunks: Iterable[Frames]) -> None:
        """Replay the whole log.

        Raises:
            LogError: no tick of the log has both reference and feedback.
        """
        time_ns = 0
        for frame, following in _with_following(rig_frames(chunks, self._network)):
            time_ns = frame.time_ns
            if frame.role > SPEED_ROLE:  # of a further sensor: heard, and not accounted for
                self._serve(frame)
                continue
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
        for tick in sorted(self._rows):  # at the end of the log, or without feedback
            self.account.close(tick, self._rows[tick])
        self.account.finish()

    def rejected(self) -> dict[str, dict[str, int]]:
        """See `ControllerNode.rejected`."""
        return self._node.rejected()

    @property
    def _due(self) -> int:
        """The next expected tick, counted beyond the 16 bits of the wire."""
        return self._node.tick + self._past

    def _make_contact(self, frame: RigFrame) -> None:
        """Hand the node frames up to its first answer; the account starts with that tick.

        The time stamps determine the first tick of a log with a late begin, if the rig set them.
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
        """Hand the node a frame, and collect the answer."""
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
        """Tell the node to skip ticks without feedback."""
        ahead = ticks_ahead(frame.tick, self._due)
        if frame.intact and ahead > 0 and _confirmed(frame, following):
            for _ in range(ahead):
                self._node.miss()
                self._collect()
                self._close(self._due - NEAR, frame.time_ns)

    def _note(self, frame: RigFrame) -> None:
        """Put a frame into its row, and judge the frame."""
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
        """Whether feedback continues a second run with ticks close to the ticks of this run."""
        last = self._left_out_tick
        is_past = frame.role == INPUTS - 1 and distance < 0
        return is_past and last is not None and ticks_ahead(frame.tick, last) == 1

    def _leave_out(self, frame: RigFrame, under_way: int) -> None:
        self.account.take(frame, None, under_way)
        if frame.role == INPUTS - 1:
            self.left_out += 1
            self._left_out_tick = frame.tick

    def _row(self, tick: int, frame: RigFrame) -> Row | None:
        """The row of a tick; None after its comparison."""
        return self._rows.setdefault(tick, Row(frame.time_ns)) if tick >= self._open else None

    def _close(self, end: int, time_ns: int) -> None:
        """Compare the ticks before ``end``."""
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


def _with_following(frames: Iterator[RigFrame]) -> Iterator[tuple[RigFrame, Iterable[RigFrame]]]:
    """Every frame with the frames that follow."""
    window: deque[RigFrame] = deque(islice(frames, AHEAD))
    while window:
        frame = window.popleft()
        yield frame, window
        window.extend(islice(frames, 1))


def _confirmed(frame: RigFrame, following: Iterable[RigFrame]) -> bool:
    """Whether a second frame of the same sender is of the same tick or the next."""
    return any(
        is_input(other.role)
        and other.intact
        and (other.role != frame.role or other.tick != frame.tick)
        and 0 <= ticks_ahead(other.tick, frame.tick) <= 1
        for other in following
    )
