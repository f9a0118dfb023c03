"""The page and its web socket, on 127.0.0.1 only."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Final

from aiohttp import WSMsgType, web

from can_rig.errors import RigError
from can_rig.panel.access import Access
from can_rig.panel.orders import obey
from can_rig.panel.screen import Screen
from can_rig.panel.viewers import Viewer

UPDATES_PER_S: Final = 30
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


class Server:
    """The server of one start.

    Args:
        screen: what is shown.
        access: who may look and touch.
    """

    def __init__(self, screen: Screen, access: Access) -> None:
        self._screen = screen
        self._access = access

    def application(self) -> web.Application:
        """For aiohttp."""
        app = web.Application(middlewares=[self._guard], client_max_size=MOST_BYTES)
        for name, file in PAGE.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.panel", f"page/{file}"))
        for name, file in UPLOT.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.drawing", f"uplot/{file}"))
        app.router.add_get("/{token}/socket", self._socket)
        app.cleanup_ctx.append(self._updating)
        app.on_shutdown.append(self._screen.viewers.close)
        return app

    @web.middleware
    async def _guard(
        self,
        request: web.Request,
        handler: Callable[[web.Request], Awaitable[web.StreamResponse]],
    ) -> web.StreamResponse:
        """Refuse a request without a token or with a foreign Host or Origin."""
        origin = request.headers.get("Origin")
        if not self._access.is_own_host(request.headers.get("Host")):
            raise web.HTTPForbidden(text="another Host than this panel's")
        if origin is not None and not self._access.is_own_origin(origin):
            raise web.HTTPForbidden(text="another Origin than this panel's")
        if self._access.may_touch(request.match_info.get("token", "")) is None:
            raise web.HTTPForbidden(text="no such panel; the address that can-rig panel says is")
        response = await handler(request)
        if not response.prepared:
            response.headers.update(HEADERS)
        return response

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        if not self._access.is_own_origin(request.headers.get("Origin")):
            raise web.HTTPForbidden(text="another Origin than this panel's")
        socket = web.WebSocketResponse(heartbeat=10.0, max_msg_size=MOST_BYTES, compress=False)
        await socket.prepare(request)
        may_touch = bool(self._access.may_touch(request.match_info["token"]))
        viewer = Viewer(socket, may_touch and self._screen.session.sends)
        self._screen.welcome(viewer)
        sending = asyncio.create_task(viewer.send_on())
        try:
            async for message in socket:
                if message.type is WSMsgType.TEXT:
                    await self._order(viewer, message.data)
        finally:
            self._screen.viewers.remove(viewer)
            sending.cancel()
        return socket

    async def _order(self, viewer: Viewer, text: str) -> None:
        """Execute a page's request, or answer with the reason for refusal."""
        try:
            if not viewer.may_touch:
                raise RigError("this address may look only")
            await obey(self._screen, json.loads(text))
        except RigError as error:
            viewer.offer(json.dumps({"refused": str(error)}))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            viewer.offer(json.dumps({"refused": "not an order of this panel"}))

    async def _updating(self, _app: web.Application) -> AsyncIterator[None]:
        """While the server runs, tell the browsers what is new, 30 times a second at most."""
        task = asyncio.create_task(self._update_for_ever())
        yield
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
        await self._screen.close()

    async def _update_for_ever(self) -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            due_s = max(due_s + 1.0 / UPDATES_PER_S, loop.time())
            await asyncio.sleep(due_s - loop.time())
            self._screen.update()


def _static(package: str, name: str) -> Callable[[web.Request], Awaitable[web.StreamResponse]]:
    """A handler that answers with a file of a package."""
    path = Path(str(files(package))) / name

    async def answer(_request: web.Request) -> web.StreamResponse:
        return web.FileResponse(path)

    return answer
