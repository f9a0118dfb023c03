"""The contents of the screen for every browser, and the requests of the page."""

import asyncio
import json
import math
import os
import re
import struct
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import can
import numpy as np
import tomli_w
from aiohttp import WSCloseCode, web

from can_rig.decoding.trace import Kinds, of_messages
from can_rig.errors import RigError
from can_rig.frames import operator_frames
from can_rig.frames.databases import load_database, shipped_dbc
from can_rig.nodes.operating import done, touches
from can_rig.panel.live import COLUMNS
from can_rig.panel.session import Session
from can_rig.panel.setup import setup
from can_rig.results.run_folder import log_of
from can_rig.results.signals import read_signals
from can_rig.results.source import reference_csv, source_of
from can_rig.scenario.build import dbc_of, network_of
from can_rig.scenario.loading import keys_of, written
from can_rig.storage.files import atomic
from firmware_model.law.structs import FloatArray

LAMPS_EVERY: Final = 6
"""Updates."""

HISTORY: Final = 20_000
"""Rows that a browser gets which comes late: some three minutes."""


MOST_FRAMES: Final = 5_000
"""The last frames, for a browser that begins to show frames."""

MOST_CHANGES: Final = 200
"""The last changes of the state, for a browser that comes late; the page shows as many events."""

MOST_NEWS: Final = 60
"""Rows, frames and lamps that wait for one browser, a second of them; then the oldest go."""

MOST_KEPT: Final = 1000
"""Other messages that wait for one browser; with more, the connection ends."""

STUCK_S: Final = 10.0
"""After which a browser that takes nothing at all is given up."""

GOODBYE_S: Final = 1.0
"""How long a browser has to confirm the end of the connection."""


class Viewer:
    """One browser; with ``may_touch`` the panel obeys the browser's commands."""

    def __init__(self, socket: web.WebSocketResponse, may_touch: bool) -> None:
        self.socket = socket
        self.may_touch = may_touch
        self.kinds: int | None = None
        """Known kinds of frames; None: the browser shows no frames."""
        self._count = 0
        self._kept: deque[tuple[int, bytes | str]] = deque()
        self._news: deque[tuple[int, bytes | str]] = deque(maxlen=MOST_NEWS)
        self._some = asyncio.Event()
        self._given_up = False

    def offer(self, message: bytes | str, may_drop: bool = False) -> None:
        """Queue ``message`` for this browser.

        A browser that falls behind loses the oldest messages that ``may_drop``: rows, frames, lamps
        and refusals. Other messages arrive, unless too many wait: then the connection ends.
        """
        if self._given_up:
            return
        self._given_up = len(self._kept) >= MOST_KEPT
        self._count += 1
        (self._news if may_drop else self._kept).append((self._count, message))
        self._some.set()

    async def send_on(self) -> None:
        """Send queued messages until the connection ends or stalls for too long."""
        with suppress(ConnectionError, TimeoutError):
            while not (self.socket.closed or self._given_up):
                await self._some.wait()
                self._some.clear()
                while (message := self._next()) is not None:
                    await asyncio.wait_for(self._send(message), STUCK_S)
        await self.close()

    def _next(self) -> bytes | str | None:
        """Remove and return the oldest message; None: no message waits."""
        waiting = [queue for queue in (self._kept, self._news) if queue]
        if not waiting or self._given_up:
            return None
        return min(waiting, key=lambda queue: queue[0][0]).popleft()[1]

    async def close(self) -> None:
        """End the connection, whether the browser answers or not."""
        with suppress(ConnectionError, TimeoutError):
            await asyncio.wait_for(self.socket.close(code=WSCloseCode.GOING_AWAY), GOODBYE_S)

    async def _send(self, message: bytes | str) -> None:
        if isinstance(message, bytes):
            await self.socket.send_bytes(message)
        else:
            await self.socket.send_str(message)


def batch(rows: FloatArray) -> bytes:
    """Rows (n, columns) in the page's format: n, columns, then every column as float64."""
    return struct.pack("<II", *rows.shape) + rows.T.astype("<f8").tobytes()


def frames_batch(messages: Sequence[tuple[float, can.Message]], kinds: Kinds) -> bytes:
    """Frames in the page's format: their number, 0, then as ``trace.js`` reads them."""
    return struct.pack("<II", len(messages), 0) + of_messages(messages, kinds)


class Screen:
    """The displayed run and its viewers.

    The user can choose one of ``scenarios``, and ``open_session`` makes its session. There is no
    choice if the panel did not start the nodes.
    """

    def __init__(
        self, session: Session, scenarios: list[str], open_session: Callable[[str], Session]
    ) -> None:
        self.session = session
        self.scenarios = scenarios
        self.open_session = open_session
        self.viewers: set[Viewer] = set()
        self._history: deque[FloatArray] = deque()
        self._kept = 0
        self._updates = 0
        self._end: asyncio.Task[None] | None = None
        self._starting = asyncio.Lock()
        self._commands: list[dict[str, Any]] = []
        """Commands to the plant node, each with the time of the run from which the command acts."""
        self._changes: deque[dict[str, Any]] = deque(maxlen=MOST_CHANGES)
        """Changes of the state."""
        self._frames: deque[tuple[float, can.Message]] = deque(maxlen=MOST_FRAMES)
        self._kinds: Kinds | None = None

    def trace(self, viewer: Viewer, on: bool) -> None:
        """Send a browser the last frames, and from now on the new frames; or no further frames."""
        viewer.kinds = None
        if on:
            viewer.kinds = 0
            viewer.offer('{"frames": true}')
            self._offer_frames(viewer, list(self._frames))

    def _offer_frames(self, viewer: Viewer, frames: Sequence[tuple[float, can.Message]]) -> None:
        if self._kinds is None:
            dbcs = dbc_of(self.session.scenario), shipped_dbc(operator_frames.DBC)
            self._kinds = Kinds([(None, load_database(dbc, strict=False)) for dbc in dbcs])
        packed, described = frames_batch(frames, self._kinds), self._kinds.described
        if described[viewer.kinds :]:
            viewer.offer(json.dumps({"kinds": described[viewer.kinds :]}))
        viewer.kinds = len(described)
        viewer.offer(packed, may_drop=True)

    def welcome(self, viewer: Viewer) -> None:
        """Send a browser the history of the run."""
        viewer.offer(self._hello(viewer.may_touch))
        if self._history:
            viewer.offer(batch(np.concatenate(list(self._history))))
        self.viewers.add(viewer)

    def offer(self, message: bytes | str, may_drop: bool = False) -> None:
        """Queue ``message`` for every browser."""
        for viewer in self.viewers:
            viewer.offer(message, may_drop)

    async def say_goodbye(self, _app: web.Application) -> None:
        """End all connections at the end of the server."""
        await asyncio.gather(*(viewer.close() for viewer in tuple(self.viewers)))

    async def start(self) -> None:
        """Start the scenario's run, with an empty screen, after the whole end of another."""
        async with self._starting:
            if self.session.running:
                return
            if self._end is not None:
                await self._end
            self.show(self.session)
            await self.session.start()
            self._end = asyncio.create_task(self.session.ended())

    def show(self, session: Session) -> None:
        """Show ``session`` from its start."""
        self.session = session
        self._history.clear()
        self._kept = 0
        self._commands.clear()
        self._changes.clear()
        self._frames.clear()
        self._kinds = None
        for viewer in self.viewers:
            viewer.kinds = None if viewer.kinds is None else 0
        self.offer(self._hello(None))

    def _hello(self, may_touch: bool | None) -> str:
        """The page's setup before the first row; None for unchanged viewer permissions."""
        session = self.session
        hello = {
            "name": session.name,
            "scenarios": self.scenarios,
            "tick_s": session.scenario.tick_s,
            "duration_s": session.scenario.duration_s,
            "columns": COLUMNS,
            "events": sorted([*self._commands, *self._changes], key=itemgetter("time_s")),
            **setup(session.scenario, network_of(session.scenario), session.live.confirm),
        }
        permission = {} if may_touch is None else {"may_touch": may_touch}
        return json.dumps({"hello": hello, **permission})

    async def close(self) -> None:
        """End a run that the panel started, and leave the bus."""
        await self.session.stop()
        if self._end is not None:
            await self._end
        self.session.close()

    def update(self) -> None:
        """Offer every browser the new rows, and the lamps at a lower rate."""
        if self.session.begins_again:
            self.session.renew()
            self.show(self.session)
        live = self.session.live
        rows = live.update()
        commands = [{"time_s": time_s, **told._asdict()} for time_s, told in live.taken_commands()]
        changes = [{"action": "STATE", **each._asdict()} for each in live.state_changes()]
        if commands or changes:
            self._commands += commands
            self._changes.extend(changes)
            self.offer(json.dumps({"events": [*commands, *changes[-MOST_CHANGES:]]}))
        heard = live.heard_frames()
        self._frames.extend(heard)
        for viewer in self.viewers if heard else ():
            if viewer.kinds is not None:
                self._offer_frames(viewer, heard)
        if len(rows):
            self._history.append(rows)
            self._kept += len(rows)
            while self._kept > HISTORY:
                self._kept -= len(self._history.popleft())
            if self.viewers:
                self.offer(batch(rows), may_drop=True)
        self._updates += 1
        if self._updates % LAMPS_EVERY == 0 and self.viewers:
            state = self.session.state()._asdict()
            self.offer(json.dumps({"lamps": asdict(live.lamps), "state": state}), may_drop=True)

    async def obey(self, order: dict[str, Any]) -> None:
        """Execute a request of the page.

        Raises:
            RigError: the reason why the request is refused.
            KeyError, TypeError, ValueError: not a request.
        """
        what = order["order"]
        if what in _COMMANDS:
            self.session.command(_command(what, order))
        elif what == "start":
            if not self.scenarios:
                raise RigError(
                    "the nodes of this bus are not the panel's; it starts none beside them"
                )
            await self.start()
        elif what == "stop":
            await self.session.stop()
        elif what == "choose":
            self._choose(order["scenario"])
        elif what == "save":  # reads a log
            path = await asyncio.to_thread(save, self.session, str(order["name"]))
            self.offer(f'{{"saved": "{path.name}"}}')
        else:
            raise ValueError

    def _choose(self, name: str) -> None:
        if self.session.running:
            raise RigError("a run goes on; stop it before another scenario is chosen")
        if name not in self.scenarios:
            raise RigError(f"scenario {name!r}: must be one of the list")
        before = self.session
        self.show(self.open_session(name))
        before.close()


_COMMANDS: Final = ("inject", "clear", "reference", "pace", "pause", "step")
"""Requests that the plant node executes."""


def _command(what: str, order: dict[str, Any]) -> operator_frames.Command:
    if what == "inject":
        kind, place = order["kind"], order["place"]
        if kind not in operator_frames.kinds() or place not in operator_frames.places():
            raise ValueError
        value, duration_s = _number(order.get("value")), _number(order.get("for_s"))
        return operator_frames.Command("INJECT", kind, place, value, duration_s)
    if what == "clear":
        place = order.get("place", operator_frames.ALL)
        if place not in (operator_frames.ALL, *operator_frames.places()):
            raise ValueError
        return operator_frames.Command("CLEAR", place=place)
    if what == "pause":
        return operator_frames.Command("PAUSE")
    if what == "step":
        return operator_frames.Command("STEP", value=_number(order.get("ticks", 1)))
    value = _number(order["value"])
    return operator_frames.Command("MOVE_REFERENCE" if what == "reference" else "PACE", value=value)


def _number(value: object) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def save(session: Session, name: str) -> Path:
    """Write the scenario that repeats the last run, ``NAME.toml`` in the working directory.

    A changed reference goes into a file beside the scenario, tick by tick.

    Raises:
        RigError: no run has ended, the name is invalid, the file exists or cannot be written.
    """
    if session.running or session.folder is None:
        raise RigError("no run has ended yet; what was done is saved afterwards")
    if not NAME.fullmatch(name):
        raise RigError(
            f"{name!r}: must be letters, digits, - and _, and begin with one of the first"
        )
    path, folder = Path(f"{name}.toml"), Path(session.folder)
    for each in (path, path.with_suffix(".csv")):
        if os.path.lexists(each):
            raise RigError(f"{each}: exists already; choose another name")
    source = source_of(folder, None, ())
    network = network_of(source.scenario)
    what = done(source.scenario, touches(source.frames(), network))
    values = written(session.name).with_changes(session.settings).values
    values["fault"] = [keys_of("fault", asdict(fault)) for fault in what.scenario.faults]
    reference = path.with_suffix(".csv")
    if what.moved:
        values["reference"] = {"kind": "csv", "file": reference.name}
    with ExitStack() as both:  # both files or neither
        part = both.enter_context(atomic(path, force=False))
        part.write_text(f"# What was done in {folder}.\n\n{tomli_w.dumps(values)}", "utf-8")
        if what.moved:
            part = both.enter_context(atomic(reference, force=False))
            moved = read_signals(log_of(folder), network, session.scenario.tick_s)
            with part.open("w", encoding="utf-8", newline="\n") as file:
                file.writelines(reference_csv(moved))
    return path
