"""Whether two nodes that were started by hand run the same scenario.

Each node announces a digest of its scenario: the plant with its first offer and as often as it
repeats that, the controller when it begins to listen. Whoever hears another digest than its own
sends the digests of all its keys, one by one. Whoever hears another digest of a key sends its own
of that key and ends, with a line that names it; so both end. A plant node that has completed a tick
goes on: a controller that joins late and has another scenario is told, and ends by itself.

A partner that announces nothing, such as a log that is played, is taken as it is. None of these
frames is recorded, as repeated offers are not; nodes that one process has started have one scenario
and send none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

import can

from can_rig.errors import ScenarioError
from can_rig.frames.beside.agreement import SENDERS, Comparison, ComparisonFrame, digest
from can_rig.nodes.bus_access import NodeBus, PersistentSender
from can_rig.nodes.clock import NS_PER_S, Clock
from can_rig.scenario.plant_settings import FMU
from can_rig.scenario.settings import Scenario
from can_rig.scenario.tables.changes import FAULT
from can_rig.scenario.tables.fault import FaultSettings

WHOLE: Final = 0
UNSETTLED_S: Final = 5.0
"""How long a node waits for the key when it knows that the scenarios are not the same."""

OWN: Final = ("name", "description", "reference.file", "drive.file", "network.dbc")
"""Keys that say nothing about the run: what it is called, and where one node finds a file."""


def keys_of(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Keys and values of a scenario in their order, with a dot between table and key.

    They are the same keys in every scenario: a plant's own parameters count as one, and so do the
    variables of an FMU; a key of the faults has the values of all of them. Where a node finds the
    FMU says nothing about the run.
    """
    for key, value in values.items():
        path = f"{prefix}{key}"
        if key in {"parameters", "variables"}:
            yield path, str(dict(sorted(value.items())))
        elif path == FAULT:
            faults = value if isinstance(value, list) else [value]
            for name in FaultSettings.__dataclass_fields__:
                yield f"{path}.{name}", str([fault[name] for fault in faults])
        elif key == "kind" and str(value).startswith(FMU):
            yield path, f"{FMU}{Path(str(value).removeprefix(FMU)).name}"
        elif isinstance(value, Mapping):
            yield from keys_of(value, f"{path}.")
        elif path not in OWN:
            yield path, value


class Agreement:
    """A bus behind which the scenarios are compared: to a node it is a bus without those frames.

    Args:
        scenario: this node's.
        name: this node, ``plant`` or ``controller``.
        bus: what lies behind.
        clock: the time.
    """

    def __init__(self, scenario: Scenario, name: str, bus: NodeBus, clock: Clock) -> None:
        (self._other,) = set(SENDERS) - {name}
        self._keys = list(keys_of(scenario.as_dict()))
        digests = [digest(key, value) for key, value in self._keys]
        self._digests = [digest("", digests), *digests]
        self._bus = bus
        self._send = PersistentSender(bus, UNSETTLED_S, clock)
        self._clock = clock
        self._own_frame, self._other_frame = ComparisonFrame(name), ComparisonFrame(self._other)
        self._differs_ns: int | None = None  # since when the scenarios are known to differ
        self._told = False  # a late controller, by a plant node that goes on
        self.settled = False
        """Whether the other node's scenario ends this one no more."""
        self.channel = getattr(bus, "channel", "")
        self.channel_info = getattr(bus, "channel_info", "")

    @property
    def lost_frames(self) -> int:
        """Frames that the bus dropped unread."""
        return int(getattr(self._bus, "lost_frames", 0))

    def announce(self) -> None:
        """Say which scenario this node has."""
        self._say(WHOLE)

    def send(self, msg: can.Message) -> None:
        """As the bus."""
        self._bus.send(msg)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        """As the bus, without the frames of the comparison; nothing once the scenarios differ.

        Raises:
            ScenarioError: the other node has another scenario.
        """
        end_ns = self._clock.now_ns() + round((timeout or 0.0) * NS_PER_S)
        while True:
            left_s = max(0.0, (end_ns - self._clock.now_ns()) / NS_PER_S)
            message = self._bus.recv(left_s)
            if message is not None and message.arbitration_id == self._other_frame.frame_id:
                self._hear(self._other_frame.read(message))
            elif self._differs_ns is None:
                return message
            elif self._clock.now_ns() - self._differs_ns > UNSETTLED_S * NS_PER_S:
                raise self._refusal("the scenario")
            elif message is None:
                return None

    def _say(self, key: int) -> None:
        message = self._own_frame.message(Comparison(key, self._digests[key]))
        if self.settled:
            with suppress(can.CanError):  # the run comes first
                self._bus.send(message)
        else:
            self._send(message)

    def _hear(self, said: Comparison | None) -> None:
        if said is None or said.key >= len(self._digests):
            return
        if said.digest == self._digests[said.key]:
            # From now on this controller has its plant; a plant first wants its tick answered.
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
        """Let a controller that joins late know what differs; a settled controller tells nobody."""
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
