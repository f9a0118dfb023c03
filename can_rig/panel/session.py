"""The displayed run: started by the panel, or already running on the named bus."""

import asyncio
import json
import os
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import can

from can_rig.buses.bus import open_bus
from can_rig.errors import INTERRUPTED, RigError
from can_rig.frames import operator_frames
from can_rig.panel.live import ENDS, Frames, LiveSignals
from can_rig.plant.faults.injection import require_possible
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

ENDED_WELL: Final = (0, INTERRUPTED, -signal.SIGTERM)
"""Exit statuses of a run that ended by itself or was stopped, perhaps while Python started."""

NEAR_S: Final = 1.0
"""Before the end of a run, the panel may lack ticks of nodes that have ended as planned."""

MOST_LINES: Final = 12
"""Of what a run has said that are kept."""


TOUCHING: Final = ("inject", "clear", "reference", "pace")
"""Orders to a plant node that obeys commands."""


class State(NamedTuple):
    """The state of the run, for a person."""

    name: str
    """``ready``, ``waiting``, ``starting``, ``running``, ``paused``, ``silent``, ``finishing``,
    ``ended``, ``failed`` or ``bus-down``."""
    says: str
    """A sentence: the state, its reason, the next step."""
    orders: tuple[str, ...] = ()
    """The orders that have an effect in this state."""


@dataclass
class Session:
    """A bus, its nodes, and this process's run on the bus.

    Args:
        bus: name of the bus.
        scenario: scenario of the nodes.
        settings: the ``KEY=VALUE`` changes after ``scenario``.
        name: name of the scenario for the user: a shipped scenario or a file.
        sends: whether the panel may send commands.
        starts: whether the panel starts the nodes; False: the bus belongs to running nodes.
    """

    bus: str
    scenario: Scenario
    name: str
    settings: tuple[str, ...] = ()
    sends: bool = True
    starts: bool = True
    said: list[str] = field(default_factory=list)
    """Last lines of the run that ended, or of why there is none."""
    folder: str | None = None
    """Of the run that ended last."""
    _noted: bool = False
    """Whether the end of the panel's own run is noted."""
    _stopped: bool = False
    """Whether the panel has told its run to end."""
    _process: asyncio.subprocess.Process | None = None

    def __post_init__(self) -> None:
        self._opened = open_bus(self.bus)
        self.live = self._new()
        self._notifier = can.Notifier(self._opened, [self.live.frames], timeout=0.2)

    def _new(self, frames: Frames | None = None) -> LiveSignals:
        """Signals of a run before its first tick."""
        return LiveSignals(self.scenario, network_of(self.scenario), frames)

    def close(self) -> None:
        """Leave the bus."""
        self._notifier.stop()
        self._opened.shutdown()

    @property
    def running(self) -> bool:
        """Whether a run that the panel started still runs."""
        return self._process is not None and self._process.returncode is None

    def state(self) -> State:
        """The state of the run now."""
        failed = self.live.frames.failed
        if failed is not None:
            return State("bus-down", f"The bus {self.bus} is down: {failed}.", self._stop)
        if self._noted:
            return self._state_after()
        if self.live.last_heard is None:
            return self._state_before()
        return self._state_silent() if self.live.lamps.silent else self._state_heard()

    @property
    def _stop(self) -> tuple[str, ...]:
        return ("stop",) if self.running else ()

    def _state_silent(self) -> State:
        """The state while a node is silent.

        In lockstep both are; the node with the last frame waits for the other.
        """
        silent, here = self.live.lamps.silent, f"{self.live.lamps.time_s:.2f} s"
        finishing = State("finishing", f"The run stands at {here}; its folder is being written.")
        if self.running and self._stopped:
            return finishing
        if len(silent) == 1 or self.live.last_heard == "plant":
            node = silent[0] if len(silent) == 1 else "controller"
            says = (
                f"The {node} node is silent since {here} of the run: "
                "the node was killed, hangs, or has left the bus."
            )
            return State("silent", says, self._stop)
        early = self.live.lamps.time_s < self.scenario.duration_s - NEAR_S
        if self.running and early:
            says = f"Both nodes are silent since {here}: a node was killed, or has ended."
            return State("silent", says, self._stop)
        if self.running:
            return finishing
        return State("ended", f"Both nodes are silent since {here}: the run has ended.")

    def _state_heard(self) -> State:
        """The state while all nodes are heard, or the plant node says that the run is paused."""
        lamps = self.live.lamps
        touching = TOUCHING if self.sends and lamps.injectable else ()
        orders = (*self._stop, *touching)
        if lamps.paused:
            says = f"Paused at {lamps.time_s:.2f} s: Go on continues the run, Step runs one tick."
            return State("paused", says, (*orders, "step") if touching else orders)
        if not self.sends:
            says = "The nodes run. This panel listens only; --allow-control lets the panel send."
        elif not touching:
            says = "The nodes run and obey no commands; --injectable at their start lets them obey."
        elif lamps.pace:
            says = f"Running, held to {lamps.pace:g} × real time."
        else:
            says = "Running as fast as the nodes can."
        return State("running", says, (*orders, "pause") if touching else orders)

    def _state_before(self) -> State:
        """The state before the first frame."""
        if self.running:
            return State("starting", "The nodes start, and compile the control law.", ("stop",))
        if self.starts:
            says = f"Press Start to run the scenario {self.name}."
            return State("ready", says, ("start", "choose"))
        return State("waiting", f"No node is heard on the bus {self.bus} yet.")

    def _state_after(self) -> State:
        """The state after the end of the panel's own run."""
        orders = ("start", "choose") if self.folder is None else ("start", "choose", "save")
        status = self._process.returncode if self._process is not None else None
        if status in ENDED_WELL:
            how = "was stopped" if status else "has ended"
            left = "no folder is left" if self.folder is None else f"run folder {self.folder}"
            at = f"{self.live.lamps.time_s:.2f} s"
            return State("ended", f"The run {how} at {at}; {left}.", orders)
        why = self.said[-1] if self.said else f"exit status {status}"
        return State("failed", f"The run has failed: {why}", orders)

    @property
    def begins_again(self) -> bool:
        """Whether nodes that the panel did not start send again after their end."""
        ended = len(self.live.lamps.silent) == len(ENDS)
        return not self.starts and ended and self.live.frames.has_some

    def renew(self) -> None:
        """Show another run from its first frames; the ticks of another run begin at 0 again."""
        frames = self.live.frames
        frames.begin_again(keep_waiting=not self.starts)
        self.live = self._new(frames)

    async def start(self) -> None:
        """Start a run of the scenario on this bus, paced at real time."""
        if self.running:
            return
        self.said, self.folder, self._noted, self._stopped = [], None, False, False
        self.renew()
        arguments = [argument for setting in self.settings for argument in ("--set", setting)]
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-m", "can_rig", "run", self.name, *arguments,
            "--bus", self.bus, "--pace", "1", "--injectable", "--json",
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
        )  # fmt: skip

    async def ended(self) -> None:
        """Wait for the end of the panel's run, and note folder and messages."""
        if self._process is None:
            return
        out, err = await self._process.communicate()
        with suppress(ValueError, IndexError):
            result: dict[str, Any] = json.loads(out.decode().splitlines()[-1])
            self.folder = result.get("folder")
        self.said = err.decode(errors="replace").splitlines()[-MOST_LINES:]
        self._noted = True

    async def stop(self) -> None:
        """End the run, and wait for the whole run folder: after an hour that takes minutes."""
        if not self.running or self._process is None:
            return
        self._stopped = True
        self._process.send_signal(signal.SIGTERM)  # SIGINT is ignored under a shell's &
        await self._process.wait()

    def command(self, command: operator_frames.Command) -> None:
        """Send ``command`` to the plant node.

        Raises:
            RigError: the panel may not send, or no plant node has announced that the node obeys
                commands.
        """
        state = self.live.state
        if not self.sends:
            raise RigError("this panel only listens; --allow-control lets it send")
        require_possible(command)
        if state is None or not state.injectable:
            raise RigError("the plant node obeys no commands: it must be started with --injectable")
        message = operator_frames.command_message(command, state.next_sequence)
        try:
            self._opened.send(message)
        except can.CanError as error:
            raise RigError(f"bus {self.bus}: {error}") from error
        self.live.state = state._replace(
            next_sequence=(state.next_sequence + 1) % operator_frames.SEQUENCES
        )


def new_bus() -> str:
    """A local bus of this start."""
    return f"local:panel-{os.getpid()}"
