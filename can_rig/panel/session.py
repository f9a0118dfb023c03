"""The displayed run: started by the panel, or already running on the named bus."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import can

from can_rig.buses.bus import open_bus
from can_rig.errors import RigError
from can_rig.frames import operator_frames
from can_rig.panel.live import LiveSignals
from can_rig.plant.faults.injection import require_possible
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

ENDS_WITHIN_S: Final = 60.0
"""A run that is stopped completes its folder."""

MOST_LINES: Final = 12
"""Of what a run has said that are kept."""


@dataclass
class Session:
    """A bus, its nodes, and this process's run on the bus.

    Args:
        bus: name of the bus.
        scenario: scenario of the nodes.
        settings: the ``KEY=VALUE`` changes behind ``scenario``.
        name: name of the scenario for the user: a shipped scenario or a file.
        sends: whether the panel may send commands.
    """

    bus: str
    scenario: Scenario
    name: str
    settings: tuple[str, ...] = ()
    sends: bool = True
    said: list[str] = field(default_factory=list)
    """Last lines of the run that ended, or of why there is none."""
    folder: str | None = None
    """Of the run that ended last."""
    _process: asyncio.subprocess.Process | None = None

    def __post_init__(self) -> None:
        self._opened = open_bus(self.bus)
        self.live = self._new()
        self._notifier = can.Notifier(self._opened, [self.live.frames], timeout=0.2)

    def _new(self) -> LiveSignals:
        """Signals of a run before its first tick."""
        return LiveSignals(self.scenario, network_of(self.scenario))

    def close(self) -> None:
        """Leave the bus."""
        self._notifier.stop()
        self._opened.shutdown()

    @property
    def running(self) -> bool:
        """Whether a run that the panel started still runs."""
        return self._process is not None and self._process.returncode is None

    async def start(self) -> None:
        """Start a run of the scenario on this bus, paced at real time."""
        if self.running:
            return
        self.said, self.folder = [], None
        self._notifier.remove_listener(self.live.frames)
        self.live = self._new()  # the ticks of another run begin at 0 again
        self._notifier.add_listener(self.live.frames)
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

    async def stop(self) -> None:
        """End the run and complete the run folder."""
        if not self.running or self._process is None:
            return
        self._process.send_signal(signal.SIGTERM)  # SIGINT is ignored under a shell's &
        try:
            await asyncio.wait_for(self._process.wait(), ENDS_WITHIN_S)
        except TimeoutError:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

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
