"""The page and its socket, on 127.0.0.1 only."""

from __future__ import annotations

import asyncio
import json
import struct
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
from aiohttp import WSMsgType, web

from can_rig.drawing.names import names_of
from can_rig.errors import RigError
from can_rig.frames import control
from can_rig.panel.access import Access
from can_rig.panel.live import COLUMNS
from can_rig.panel.orders import obey
from can_rig.panel.session import Session
from can_rig.panel.viewers import Viewer, Viewers
from firmware_model.target.structs import FloatArray

UPDATES_PER_S: Final = 30
LAMPS_EVERY: Final = 6
"""Updates."""
HISTORY: Final = 20_000
"""Rows that a browser gets which comes late: some three minutes."""

MOST_BYTES: Final = 4096
"""Of an order."""

PAGE: Final = {"": "index.html", "panel.js": "panel.js", "panel.css": "panel.css"}
UPLOT: Final = {"uplot.js": "uPlot.iife.min.js", "uplot.css": "uPlot.min.css"}

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


def batch(rows: FloatArray) -> bytes:
    """Rows (n, columns) as the page gets them: n, columns, then every column as float64."""
    return struct.pack("<II", *rows.shape) + rows.T.astype("<f8").tobytes()


class Panel:
    """The server of one start.

    Args:
        session: the run that is shown; replaced when another scenario is chosen.
        access: who may look and touch.
        scenarios: names to choose from; none where the nodes are not the panel's.
        open_session: makes the session of another scenario.
    """

    def __init__(
        self,
        session: Session,
        access: Access,
        scenarios: list[str],
        open_session: Callable[[str], Session],
    ) -> None:
        self.session = session
        self.access = access
        self.scenarios = scenarios
        self.open_session = open_session
        self.viewers = Viewers()
        self._history: deque[FloatArray] = deque()
        self._kept = 0
        self._updates = 0
        self._end: asyncio.Task[None] | None = None
        self.events: list[dict[str, Any]] = []
        """What was sent to the plant node, with the time of the run."""

    def application(self) -> web.Application:
        """For aiohttp."""
        app = web.Application(middlewares=[self._guard], client_max_size=MOST_BYTES)
        for name, file in PAGE.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.panel", f"page/{file}"))
        for name, file in UPLOT.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.drawing", f"uplot/{file}"))
        app.router.add_get("/{token}/socket", self._socket)
        app.cleanup_ctx.append(self._updating)
        return app

    @web.middleware
    async def _guard(
        self,
        request: web.Request,
        handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    ) -> web.StreamResponse:
        """Refuse whoever has no token, another Host, or another Origin."""
        origin = request.headers.get("Origin")
        if not self.access.is_own_host(request.headers.get("Host")):
            raise web.HTTPForbidden(text="another Host than this panel's")
        if origin is not None and not self.access.is_own_origin(origin):
            raise web.HTTPForbidden(text="another Origin than this panel's")
        if self.access.may_touch(request.match_info.get("token", "")) is None:
            raise web.HTTPForbidden(text="no such panel; the address that can-rig panel says is")
        response = await handler(request)
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if not self.access.is_own_origin(request.headers.get("Origin")):
            raise web.HTTPForbidden(text="another Origin than this panel's")
        socket = web.WebSocketResponse(heartbeat=10.0, max_msg_size=MOST_BYTES, compress=False)
        await socket.prepare(request)
        may_touch = bool(self.access.may_touch(request.match_info["token"]))
        viewer = Viewer(socket, may_touch and self.session.sends)
        viewer.offer(self._hello(viewer.may_touch))
        if self._history:
            viewer.offer(batch(_joined(self._history)))
        self.viewers.add(viewer)
        sending = asyncio.create_task(viewer.send_on())
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._order(viewer, message.data)
        finally:
            self.viewers.remove(viewer)
            sending.cancel()
        return socket

    async def _order(self, viewer: Viewer, text: str) -> None:
        """Do what a page asks for, or tell it why not."""
        try:
            if not viewer.may_touch:
                raise RigError("this address may look only")
            await obey(self, json.loads(text))
        except RigError as error:
            viewer.offer(json.dumps({"refused": str(error)}))
        except (ValueError, KeyError, TypeError, AttributeError):
            viewer.offer(json.dumps({"refused": "not an order of this panel"}))

    async def start(self) -> None:
        """Start the scenario's run, with an empty screen."""
        if self.session.running:
            return
        self.show(self.session)
        await self.session.start()
        self._end = asyncio.create_task(self.session.ended())

    def show(self, session: Session) -> None:
        """Show ``session`` from its start."""
        self.session = session
        self._history.clear()
        self._kept = 0
        self.events = []
        self.viewers.offer(self._hello(None))

    def _hello(self, may_touch: bool | None) -> str:
        """What a page must know before the first row; None: what it may has not changed."""
        session = self.session
        names = names_of(session.scenario.plant)
        return json.dumps(
            {
                "hello": {
                    "name": session.name,
                    "scenarios": self.scenarios,
                    "tick_s": session.scenario.tick_s,
                    "duration_s": session.scenario.duration_s,
                    "columns": COLUMNS,
                    "kinds": control.kinds(),
                    "places": control.places(),
                    "signals": [{"name": each.name, "unit": each.unit} for each in names],
                    "events": self.events,
                },
                **({} if may_touch is None else {"may_touch": may_touch}),
            }
        )

    async def _updating(self, _app: web.Application) -> AsyncIterator[None]:
        """While the server runs, tell the browsers what is new, 30 times a second at most."""
        task = asyncio.create_task(self._update_for_ever())
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await self.session.stop()
        if self._end is not None:
            await self._end
        self.session.close()

    async def _update_for_ever(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            due_s = max(due_s + 1.0 / UPDATES_PER_S, loop.time())
            await asyncio.sleep(due_s - loop.time())
            self.update()

    def update(self) -> None:
        """Offer every browser the rows that are new, and now and then the lamps."""
        live = self.session.live
        rows = live.update()
        for command in live.taken_commands():
            event = {"time_s": live.lamps.time_s, **command._asdict()}
            self.events.append(event)
            self.viewers.offer(json.dumps({"event": event}))
        if len(rows):
            self._history.append(rows)
            self._kept += len(rows)
            while self._kept > HISTORY:
                self._kept -= len(self._history.popleft())
            if len(self.viewers):
                self.viewers.offer(batch(rows))
        self._updates += 1
        if self._updates % LAMPS_EVERY == 0 and len(self.viewers):
            run = {
                "running": self.session.running,
                "folder": self.session.folder,
                "said": self.session.said,
            }
            self.viewers.offer(json.dumps({"lamps": live.lamps.as_dict(), "run": run}))


def _joined(batches: deque[FloatArray]) -> FloatArray:
    return np.concatenate(list(batches))


def _static(package: str, name: str) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
    """A handler that answers with a file of a package."""
    path = Path(str(files(package))) / name

    async def answer(_request: web.Request) -> web.StreamResponse:
        return web.FileResponse(path)

    return answer
