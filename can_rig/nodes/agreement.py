"""Comparison of the scenarios of two nodes started by hand, and a search for a third node.

Each node announces a digest of its scenario: the plant node with the first offer and every repeated
offer, the controller node when listening begins. A node that hears a foreign digest sends the
digests of all scenario keys, one by one. A node that hears a foreign digest of a key answers with
its own digest of the key and ends, with an error line that names the key; so both nodes end. A
plant node that has completed a tick goes on: a late controller with another scenario receives the
digests and ends alone.

Each announcement also asks for nodes of the same kind: one plant and one controller share a bus. A
node that hears such a question answers; before its first tick the node then ends, as does the node
that asked. A controller node by hand in lockstep listens first, and sends no frame beside another
controller. A rig on a bus that others can join asks before the rig starts, and answers while it
runs. A random number tells a question of another node from the own one that the bus brings back.

A partner that announces no digest, such as a replayed log, is accepted. Neither these
frames nor repeated offers are recorded; nodes started by one process share a scenario and send no
digests.
"""

import os
import secrets
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import can

from can_rig.buses.bus import in_one_process, open_for_node
from can_rig.errors import BusError, ScenarioError
from can_rig.frames.codec import MessageCodec, is_frame_of
from can_rig.frames.comparison_frames import (
    ASKED,
    PRESENT,
    SENDERS,
    Comparison,
    ComparisonFrame,
    digest,
)
from can_rig.frames.network import EXTENDED_FLAG
from can_rig.nodes.bus_access import (
    NS_PER_S,
    SYSTEM_CLOCK,
    Clock,
    NodeBus,
    PersistentSender,
    TolerantBus,
)
from can_rig.scenario.build import network_of
from can_rig.scenario.plant_settings import FMU
from can_rig.scenario.settings import LISTS, Scenario

WHOLE: Final = 0
UNSETTLED_S: Final = 5.0
"""How long a node waits for the key when it knows that the scenarios are not the same."""

ANSWERED_S: Final = 0.5
"""How long a rig waits, before its start, for an answer of another rig on a quiet bus."""

ASK_AGAIN_S: Final = 0.05
"""How soon the rig asks again: the nodes of another rig that is starting hear no question yet."""

QUIET_S: Final = 0.05
"""A run at work is never silent for so long, unless paused."""

BUSY_S: Final = 2.0
"""How long the rig waits where frames of a rig are on the bus: a busy machine answers late."""

OWN: Final = ("name", "description", "reference.file", "drive.file", "network.dbc")
"""Keys that say nothing about the run: what it is called, and where one node finds a file."""


def keys_of(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Keys and values of a scenario in order, with a dot between table and key.

    Every scenario yields the same keys: the parameters of a user's plant count as one key, likewise
    the variables of an FMU; a key of a list, such as the faults, has the values of all its tables.
    The path of the FMU is excluded, because the path does not change the run.
    """
    for key, value in values.items():
        path = f"{prefix}{key}"
        if key in {"parameters", "variables"}:
            yield path, str(dict(sorted(value.items())))
        elif path in LISTS:
            tables = value if isinstance(value, list) else [value]
            for name in LISTS[path].__dataclass_fields__:
                yield f"{path}.{name}", str([table[name] for table in tables])
        elif key == "kind" and str(value).startswith(FMU):
            yield path, f"{FMU}{Path(str(value).removeprefix(FMU)).name}"
        elif isinstance(value, Mapping):
            yield from keys_of(value, f"{path}.")
        elif path not in OWN:
            yield path, value


class Agreement:
    """A bus that compares scenarios: the wrapped bus without the digest frames.

    Args:
        scenario: the scenario of this node.
        name: the name of this node, ``plant`` or ``controller``.
        bus: the wrapped bus.
        clock: the time.
    """

    def __init__(self, scenario: Scenario, name: str, bus: NodeBus, clock: Clock) -> None:
        self._name = name
        (self._other,) = set(SENDERS) - {name}
        self._keys = list(keys_of(scenario.as_dict()))
        digests = [digest(key, value) for key, value in self._keys]
        self._digests = [digest("", digests), *digests]
        self.bus: Final = bus
        """The wrapped bus."""
        self._number = secrets.randbits(32)
        self._send = PersistentSender(bus, UNSETTLED_S, clock)
        self._clock = clock
        self._own_frame, self._other_frame = ComparisonFrame(name), ComparisonFrame(self._other)
        self._differs_ns: int | None = None  # since when the scenarios are known to differ
        self._told = False  # a continuing plant node has informed a late controller
        self.settled = False
        """Whether the other node's scenario ends this one no more."""
        self.channel = getattr(bus, "channel", "")
        self.channel_info = getattr(bus, "channel_info", "")

    @property
    def lost_frames(self) -> int:
        """Frames that the bus dropped unread."""
        return int(getattr(self.bus, "lost_frames", 0))

    def announce(self) -> None:
        """Send the digest of this node's scenario, and ask for another node of the same kind."""
        self._say(WHOLE)
        self.ask()

    def ask(self) -> None:
        """Ask for another node of the same kind."""
        self._put(Comparison(ASKED, self._number))

    def send(self, msg: can.Message) -> None:
        """As the bus."""
        self.bus.send(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As the bus, without the frames of the comparison; nothing once the scenarios differ.

        Raises:
            ScenarioError: the other node has another scenario.
            BusError: another node of the same kind is on the bus.
        """
        end_ns = self._clock.now_ns() + round((timeout or 0.0) * NS_PER_S)
        while True:
            left_s = max(0.0, (end_ns - self._clock.now_ns()) / NS_PER_S)
            message = self.bus.recv(left_s)
            # a foreign frame with the same identifier fails the check, and belongs into the log
            if message is not None and (said := self._other_frame.read(message)) is not None:
                self._hear(said)
            elif message is not None and self.hears_its_kind(message):
                continue
            elif self._differs_ns is None:
                return message
            elif self._clock.now_ns() - self._differs_ns > UNSETTLED_S * NS_PER_S:
                raise self._refusal("the scenario")
            elif message is None:
                return None

    def hears_its_kind(self, message: can.Message) -> bool:
        """Whether the frame is of a node of the same kind, or of this node.

        Raises:
            BusError: another node of the same kind is on the bus.
        """
        said = self._own_frame.read(message)
        if said is not None:
            self._hear_own_kind(said)
        return said is not None

    def _say(self, key: int) -> None:
        self._put(Comparison(key, self._digests[key]))

    def _put(self, said: Comparison) -> None:
        message = self._own_frame.message(said)
        if self.settled:
            with suppress(can.CanError):  # the run comes first
                self.bus.send(message)
        else:
            self._send(message)

    def _hear_own_kind(self, said: Comparison) -> None:
        if said.key not in {ASKED, PRESENT} or said.digest == self._number:
            return
        if said.key == ASKED:  # an answer to an answer would never end
            self._put(Comparison(PRESENT, self._number))
        if not self.settled:
            raise self._another()

    def _another(self) -> BusError:
        return BusError(
            f"another {self._name} node is on {self.channel_info or 'this bus'}; "
            f"a bus has one, so end the other or name another bus with --bus"
        )

    def listen(self, own: Collection[MessageCodec]) -> None:
        """Listen before the first frame, until the bus is quiet.

        Args:
            own: the frames that this node alone may send.

        Raises:
            BusError: another node of the same kind is at work.
        """
        end_ns = self._clock.now_ns() + round(ANSWERED_S * NS_PER_S)
        while self._clock.now_ns() < end_ns and (message := self.recv(QUIET_S)) is not None:
            if is_frame_of(own, message):
                raise self._another()

    def _hear(self, said: Comparison) -> None:
        if said.key >= len(self._digests):
            return
        if said.digest == self._digests[said.key]:
            # From now on this controller has its plant; a plant first needs an answered tick.
            self.settled |= said.key == WHOLE and self._other == "plant"
        elif self.settled:
            self._tell(said.key)
        elif said.key != WHOLE:
            self._say(said.key)
            name, value = self._keys[said.key - 1]
            raise self._refusal(f"{name} = {value!r}")
        elif self._differs_ns is None:
            self._differs_ns = self._clock.now_ns()
            for key in range(1, len(self._digests)):
                self._say(key)

    def _tell(self, key: int) -> None:
        """Send a late controller the differing keys; a settled controller sends no digests."""
        if self._other == "plant":
            return
        if key == WHOLE:
            self._told = False
        elif self._told:
            return
        else:
            self._told = True
        self._say(key)

    def _refusal(self, what: str) -> ScenarioError:
        return ScenarioError(
            f"{what} is not what the {self._other} node on this bus has; "
            "both nodes must be given the same scenario"
        )


def is_shared(bus_name: str) -> bool:
    """Whether nodes of other processes can join the bus of a run.

    Raises:
        BusError: the name is malformed.
    """
    return not in_one_process(bus_name) and bus_name != own_bus()


def own_bus() -> str:
    """The private bus of a run of this process, without ``--bus``."""
    return f"local:run-{os.getpid()}"


def require_alone(scenario: Scenario, bus_name: str) -> None:
    """Refuse to start a rig where another rig or node is.

    Raises:
        BusError: an answer from another plant or controller node, or a missing bus.
    """
    network = network_of(scenario)
    comparison = [ComparisonFrame(each).frame_id for each in SENDERS]
    with open_for_node(bus_name, (*network.identifiers, *comparison), False, network.fd) as bus:
        kinds = [Agreement(scenario, name, bus, SYSTEM_CLOCK) for name in SENDERS]
        hearing = TolerantBus(bus, SYSTEM_CLOCK)
        begin_ns, wait_s = SYSTEM_CLOCK.now_ns(), ANSWERED_S
        while (left_s := wait_s - (SYSTEM_CLOCK.now_ns() - begin_ns) / NS_PER_S) > 0:
            for kind in kinds:
                kind.ask()
            pause_ns = SYSTEM_CLOCK.now_ns() + round(min(left_s, ASK_AGAIN_S) * NS_PER_S)
            while (pause_s := (pause_ns - SYSTEM_CLOCK.now_ns()) / NS_PER_S) > 0:
                frame = hearing.recv(pause_s)
                if frame is None or any(kind.hears_its_kind(frame) for kind in kinds):
                    continue
                if (
                    frame.arbitration_id | frame.is_extended_id * EXTENDED_FLAG
                    in network.identifiers
                ):
                    wait_s = BUSY_S
