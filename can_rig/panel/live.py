"""The live state of a bus: frames in, rows and lamps for the screen out."""

import math
import time
from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import can
import numpy as np
from numpy.typing import NDArray

from can_rig.controllers.protocol import Inputs
from can_rig.drawing.names import names_of, printed, with_unit
from can_rig.drawing.thinning import BUCKET_S, Decimator
from can_rig.errors import one_line
from can_rig.frames import operator_frames
from can_rig.frames.codec import Receiver, ticks_ahead
from can_rig.frames.frame_length import FrameError, worst_case_bits
from can_rig.frames.network import Network
from can_rig.logs.columns import EVIDENCE
from can_rig.plant.faults.injection import injected
from can_rig.results.isolation import Reasoning, in_words
from can_rig.results.signals import CODES, ROLE_COLUMNS, SignalRows
from can_rig.results.state_changes import Event, StateChanges
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.sampled_plant import held_input
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

COLUMNS: Final = (
    "time", "reference", "output", "command_1", "command_2", "estimate", "mode", "fault_state",
    "verdict", "applied_1", "applied_2", *EVIDENCE, "x", "y", "heading", "steering",
)  # fmt: skip
"""Of a row, in the order in which the page gets them."""

FLOAT_FRAME: Final = 1e-3
"""What a frame with a float of 16 bits may round off, of the value."""

UNKNOWN: Final = (math.nan,) * len(EVIDENCE)

MOST_EARLY: Final = 1000
"""Commands before the feedback of their tick that are remembered."""

NO_MOTION: Final = (math.nan,) * 4

HOLD: Final = 6
"""Updates, some 0.2 s, that a frame waits for earlier ones of the other node."""

ERROR_PAUSE_S: Final = 0.05
"""Between two attempts to receive from a bus that fails."""

SILENT_S: Final = 0.5
SILENT_TICKS: Final = 5
"""After both of these times, a node that has spoken is called silent."""

ENDS: Final = {
    "plant": ("reference", "feedback"),
    "controller": ("command_1", "command_2", "status"),
}
"""By which frames a node is heard."""

OUTPUT, COMMAND_1, COMMAND_2, ESTIMATE, MODE, FAULT_STATE, VERDICT = (
    COLUMNS.index(name)
    for name in (
        "output", "command_1", "command_2", "estimate", "mode", "fault_state", "verdict",
    )
)  # fmt: skip


@dataclass
class Lamps:
    """The states that the page shows at a glance."""

    time_s: float = 0.0
    mode: str = ""
    fault_state: str = ""
    verdict: str = ""
    """Whose fault it is, in words."""
    silent: list[str] = field(default_factory=list)
    """Nodes that have spoken, and do no more."""
    unanswered_ticks: int = 0
    """Ticks with an answer of the controller that lacks a command."""
    unheard_ticks: int = 0
    """Ticks without a feedback, or without any frame of the controller: lost or not sent."""
    bus_load: float | None = None
    """Frames of the scenario at their longest, at its bit rate and tick; 1 is full."""
    ticks_per_s: float = 0.0
    speed_mps: float | None = None
    """Of the car, where a frame says it."""
    sensors: dict[str, float | None] = field(default_factory=dict)
    """The last value of each further sensor by its name and unit; None: not valid."""
    injectable: bool = False
    paused: bool = False
    pace: float = 0.0
    """Times real time that lockstep is held to; 0: as fast as it can."""
    refused: int = 0
    """Commands that the plant node has not obeyed."""
    bus_errors: dict[str, int] = field(default_factory=dict)


class Frames(can.Listener):
    """Frames from python-can's thread, and the bus's own error messages.

    Args:
        at_once: identifier of frames that are delivered without sorting.
    """

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self.news: deque[can.Message] = deque()
        """These frames, the newest last."""
        self._waiting: deque[can.Message] = deque()
        self._held: list[can.Message] = []
        self._newest_s: deque[float] = deque([-math.inf] * HOLD, HOLD)
        self.errors: Counter[str] = Counter()
        self.failed: str | None = None
        """The bus's error, until the next frame."""

    def on_message_received(self, msg: can.Message) -> None:
        """Keep a frame until the next update."""
        self.failed = None
        (self.news if msg.arbitration_id == self._at_once else self._waiting).append(msg)

    def in_order(self) -> list[can.Message]:
        """The frames until the newest of ``HOLD`` calls ago, in the order of their time stamps.

        A lagging listener receives the frames of one node late, after newer frames of the other
        node.
        """
        until_s = self._newest_s[0]
        for _ in range(len(self._waiting)):
            self._held.append(self._waiting.popleft())
        self._held.sort(key=lambda message: message.timestamp)
        self._newest_s.append(self._held[-1].timestamp if self._held else self._newest_s[-1])
        split = bisect_right(self._held, until_s, key=lambda message: message.timestamp)
        ready, self._held = self._held[:split], self._held[split:]
        return ready

    @property
    def has_some(self) -> bool:
        """Whether frames of nodes wait."""
        return bool(self._waiting)

    def begin_again(self, keep_waiting: bool) -> None:
        """Forget the frames of a run that ended; waiting frames may belong to the next run."""
        self._held.clear()
        self._newest_s = deque([-math.inf] * HOLD, HOLD)
        if not keep_waiting:
            self._waiting.clear()
            self.news.clear()

    def on_error(self, exc: Exception) -> None:
        """Count a bus error; without this method python-can ends its thread with a traceback."""
        self.failed = one_line(exc)
        self.errors[self.failed] += 1
        time.sleep(ERROR_PAUSE_S)  # a bus that is down fails again at once


class SecondMass:
    """The position of a plant's second mass, from the inputs as applied since the first tick."""

    def __init__(self, scenario: Scenario) -> None:
        self._at = scenario.plant.second_mass
        if self._at is not None:
            plant = continuous_plant(scenario.plant)
            stable = np.linalg.eigvals(plant.a).real.max() < 0.0  # else an error would grow
            self._at = self._at if stable else None
            self._phi, self._gamma, _ = held_input(plant.a, plant.b, scenario.tick_s, (0.0, 0.0))
            self._state, self._inputs = np.zeros(len(plant.a)), np.zeros(2)

    def next(self, applied: tuple[float, float]) -> float:
        """The position at the next tick, from which the inputs ``applied`` act; nan: none."""
        if self._at is None:
            return math.nan
        self._inputs = np.where(np.isfinite(applied), applied, self._inputs)
        position = float(self._state[self._at])
        self._state = self._phi @ self._state + self._gamma @ self._inputs
        return position


class LiveSignals:
    """A bus under observation, and the rows that the screen has not received yet.

    Args:
        scenario: the scenario of the nodes on the bus.
        network: the frames of the bus.
        frames: gets the frames; None: a new listener.

    Raises:
        ScenarioError: the design fails.
    """

    def __init__(self, scenario: Scenario, network: Network, frames: Frames | None = None) -> None:
        self._scenario = scenario
        self._reasoning = Reasoning(scenario, network) if scenario.controller.is_ours else None
        self.confirm: Final = None if self._reasoning is None else self._reasoning.confirm
        """The evidence that confirms a loss; None: a controller of one's own, which says none."""
        self._lsbs = network.command_1.lsb, network.command_2.lsb
        self._next_tick = 0
        self._status = network.status
        names, says = names_of(scenario.plant), bool(network.status.verdicts)
        self._verdicts = {int(v): in_words(v, names) for v in Verdict if says}
        self._changes = StateChanges(names, network, first=False)
        self._changed: list[Event] = []
        self._rows = SignalRows(network, scenario.tick_s, max(1, scenario.latency_ticks))
        bucket = max(1, round(BUCKET_S / scenario.tick_s))
        self._decimator = Decimator(bucket, len(COLUMNS))
        self._nodes = {
            getattr(network, role).frame_id: node for node, roles in ENDS.items() for role in roles
        }
        self._speed = None if network.speed is None else Receiver(network.speed)
        self._witnesses = [Receiver(codec) for codec in network.witnesses]
        self._of_sensors = {codec.frame_id for codec in network.witnesses}
        identifiers = operator_frames.identifiers()
        self._applied_id, self._taken_id = identifiers.applied, identifiers.taken
        self._motion_id = identifiers.motion
        self._moved_tick: int | None = None
        self._motion: dict[int, tuple[float, ...]] = {}
        self._pose = (0.0, 0.0, 0.0)
        self._second_mass = SecondMass(scenario)
        self._commands = {each.frame_id: each for each in (network.command_1, network.command_2)}
        self._early: deque[int] = deque(maxlen=MOST_EARLY)
        self._operator_ids = frozenset(identifiers)
        self._applied: dict[int, tuple[float, float]] = {}
        self._heard_s: dict[str, float] = {}
        self.last_heard: str | None = None
        """The node with the newest frame; None before the first frame."""
        self._looked_s = time.monotonic()
        self.frames = frames or Frames(identifiers.state)
        self.lamps = Lamps()
        self.state: operator_frames.State | None = None
        """Of the plant node, where it says one."""
        self._taken: list[tuple[float, operator_frames.Command]] = []
        self._heard: list[tuple[float, can.Message]] = []
        self._told_s = 0.0  # the time of the last state
        self._counted = np.ones((1, 2), dtype=np.bool_)  # the last ticks: heard, answered

    def update(self) -> FloatArray:
        """The rows (n, columns) for the screen that are complete since the last call."""
        now_s = time.monotonic()
        bits = 0
        while self.frames.news:
            self._hear_state(self.frames.news.popleft())
        for message in self.frames.in_order():
            if message.arbitration_id not in self._operator_ids:
                bits += _length(message)
            self._take(message, now_s)
            self._heard.append((max(self._rows.tick, 0) * self._scenario.tick_s, message))
        first = self._rows.first_tick
        rows = np.array(
            [self._row(tick, *row) for tick, row in enumerate(self._rows.take_complete(), first)]
        ).reshape(-1, len(COLUMNS))
        self._note(rows, bits, now_s)
        for state, column in (("fault state", FAULT_STATE), ("whose fault", VERDICT)):
            self._changed += self._changes.of(state, rows[:, 0], rows[:, column])
        return self._decimator.take(rows)

    def taken_commands(self) -> list[tuple[float, operator_frames.Command]]:
        """Commands to the plant node since the last call, each with its first time of effect."""
        taken, self._taken = self._taken, []
        return taken

    def state_changes(self) -> list[Event]:
        """Changes of the fault state and the verdict since the last call, each at its tick."""
        changed, self._changed = self._changed, []
        return sorted(changed, key=lambda event: event.time_s)

    def heard_frames(self) -> list[tuple[float, can.Message]]:
        """The frames since the last call, each with the time of its tick in s."""
        heard, self._heard = self._heard, []
        return heard

    def _take(self, message: can.Message, now_s: float) -> None:
        node = self._nodes.get(message.arbitration_id)
        if node is not None:
            self._hear_early(message)
            self._heard_s[node], self.last_heard = now_s, node
            self._rows.take(message)
        elif self._speed is not None and message.arbitration_id == self._speed.codec.frame_id:
            said = self._speed.accept(message)
            if said is not None and math.isfinite(said.value):
                self.lamps.speed_mps = said.value
        elif message.arbitration_id in self._of_sensors:
            self._rows.take(message)
            for receiver in self._witnesses:
                if receiver.codec.frame_id == message.arbitration_id:
                    self._hear_sensor(receiver, message)
        elif message.arbitration_id == self._applied_id:
            applied = operator_frames.read_applied(message)
            if applied is not None:
                self._applied[self._rows.tick] = applied
        elif message.arbitration_id == self._motion_id:
            motion = operator_frames.read_motion(message)
            if motion is not None:
                self._move(motion)
        elif message.arbitration_id == self._taken_id:
            numbered = operator_frames.read_taken(message)
            if numbered is None or (numbered[1].kind and injected(numbered[1], 0, 1) is None):
                return  # a damaged frame or an unknown fault
            # the command's frame precedes the frames of the tick in which the command takes effect
            self._taken.append(((self._rows.tick + 1) * self._scenario.tick_s, numbered[1]))

    def _hear_early(self, message: can.Message) -> None:
        """Note a command that comes before the feedback of its tick, because the panel lags."""
        codec = self._commands.get(message.arbitration_id)
        says = None if codec is None else codec.layout.tick(message.data)
        ahead = 0 if says is None else ticks_ahead(says, self._rows.tick)
        if ahead > 0:
            self._early.append(self._rows.tick + ahead)

    def _move(self, motion: operator_frames.Motion) -> None:
        """Integrate a car's position and heading since its last motion."""
        tick, (x_m, y_m, heading) = self._rows.tick, self._pose
        ticks = 0 if self._moved_tick is None else tick - self._moved_tick
        passed_s, self._moved_tick = ticks * self._scenario.tick_s, tick
        course = heading + 0.5 * passed_s * motion.yaw_rate_rad_per_s + motion.side_slip_rad
        along_m = passed_s * motion.speed_mps
        self._pose = (
            x_m + along_m * math.cos(course),
            y_m + along_m * math.sin(course),
            heading + passed_s * motion.yaw_rate_rad_per_s,
        )
        self._motion[tick] = (*self._pose, motion.steering_angle_rad)

    def _hear_sensor(self, receiver: Receiver, message: can.Message) -> None:
        codec, said = receiver.codec, receiver.accept(message)
        if said is not None:
            valid = math.isfinite(said.value) and (said.mode or not codec.modes)
            name = with_unit(codec.role.replace("_", " "), printed(codec.unit))
            self.lamps.sensors[name] = said.value if valid else None

    def _hear_state(self, message: can.Message) -> None:
        self.state = operator_frames.read_state(message) or self.state
        if self.state is not None:
            self._told_s = time.monotonic()
            self.lamps.injectable, self.lamps.pace = self.state.injectable, self.state.pace
            self.lamps.refused = self.state.refused

    def _row(self, tick: int, *heard: float) -> tuple[float, ...]:
        said, further = heard[: ROLE_COLUMNS + CODES], heard[ROLE_COLUMNS + CODES :]
        names = (*self._rows.sensors, *self._rows.sample_ages)
        witnesses = dict(zip(names, further, strict=True))
        reference, measured, *sent = heard[:4]
        evidence = self._evidence(tick, Inputs(reference, measured, witnesses=witnesses), sent)
        applied = self._applied.pop(tick, (np.nan, np.nan))
        still = (self._second_mass.next(applied), *NO_MOTION[1:])
        return (
            tick * self._scenario.tick_s,
            *said,
            *applied,
            *evidence,
            *self._motion.pop(tick, still),
        )

    def _evidence(self, tick: int, inputs: Inputs, sent: Sequence[float]) -> Sequence[float]:
        """The evidence for each hypothesis, from a second control law fed with the received frames.

        The copy equals the controller's law only from the first tick of a run on, with the same
        commands.
        """
        if self._reasoning is None or tick != self._next_tick:
            self._reasoning = None
            return UNKNOWN
        self._next_tick += 1
        _, evidence = self._reasoning.take(tick, inputs)
        for own, its, lsb in zip(self._reasoning.commands, sent, self._lsbs, strict=True):
            if abs(own - its) > max(0.5 * lsb, FLOAT_FRAME * abs(own)):
                self._reasoning = None
                break
        said: list[float] = evidence.tolist()
        return said

    def _note(self, rows: FloatArray, bits: int, now_s: float) -> None:
        """Update the lamps from these rows."""
        lamps, state, tick_s = self.lamps, self.state, self._scenario.tick_s
        elapsed_s = max(now_s - self._looked_s, 1e-3)
        self._looked_s = now_s
        self._smooth("ticks_per_s", len(rows) / elapsed_s)
        lamps.bus_errors = dict(self.frames.errors)
        silent_s = max(SILENT_S, SILENT_TICKS * tick_s / (lamps.pace or 1.0))
        lamps.paused = state is not None and state.paused and now_s - self._told_s < silent_s
        lamps.silent = [
            node
            for node, heard_s in self._heard_s.items()
            if now_s - heard_s > silent_s and not lamps.paused
        ]
        if not len(rows):
            return
        lamps.time_s = float(rows[-1, 0])
        virtual_s = len(rows) * tick_s
        self._smooth("bus_load", bits / (self._scenario.bus.bitrate * virtual_s))
        ticks = np.round(rows[:, 0] / tick_s)
        self._count(np.isfinite(rows), np.isin(ticks, list(self._early)))
        for name, column, words in (
            ("mode", MODE, self._status.modes),
            ("fault_state", FAULT_STATE, self._status.fault_states),
            ("verdict", VERDICT, self._verdicts),
        ):
            said = rows[np.isfinite(rows[:, column]), column]
            if len(said):
                setattr(lamps, name, words.get(int(said[-1]), ""))

    def _count(self, known: NDArray[np.bool_], early: NDArray[np.bool_]) -> None:
        """Count the ticks without commands and the ticks that the panel has not heard.

        A listener that lags loses whole ticks, and parts of the ticks beside. A tick that lacks a
        command therefore counts only between ticks that were heard.
        """
        heard = known[:, OUTPUT] & known[:, [COMMAND_1, COMMAND_2, ESTIMATE, MODE]].any(axis=1)
        answered = known[:, [COMMAND_1, COMMAND_2]].all(axis=1) | early
        self.lamps.unheard_ticks += int((~heard).sum())
        before = self._counted
        both = np.concatenate([before, np.stack([heard, answered], axis=1)])
        heard, answered = both.T
        lacking = heard[:-2] & heard[1:-1] & heard[2:] & ~answered[1:-1]
        self.lamps.unanswered_ticks += int(lacking.sum())
        self._counted = both[-2:]

    def _smooth(self, name: str, value: float) -> None:
        """Over about ten updates."""
        before = getattr(self.lamps, name)
        setattr(self.lamps, name, value if not before else before + 0.1 * (value - before))


def _length(message: can.Message) -> int:
    """Bits of a frame at worst, until the next can start."""
    try:
        bits = worst_case_bits(message.dlc, extended=message.is_extended_id, fd=message.is_fd)
    except FrameError:
        return 0
    return bits.on_the_bus
