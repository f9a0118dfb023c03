"""The panel's server on 127.0.0.1: tokens for access, the page, the socket of a browser.

The browser of a viewer lets pages of foreign sites reach the loopback interface too. A foreign page
does not know the token and cannot forge the Origin header. If a foreign site points a domain name
of its own to 127.0.0.1 (DNS rebinding), the Host header carries the foreign name.
"""

import asyncio
import hmac
import json
import secrets
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Final

from aiohttp import WSMsgType, web

from can_rig.errors import BusError, RigError, one_line
from can_rig.panel.screen import Screen, Viewer
from can_rig.panel.session import Session, new_bus
from can_rig.scenario.loading import load

TOKEN_BYTES: Final = 24
NAMES: Final = ("127.0.0.1", "localhost")
HTTP_PORT: Final = 80
USUAL_PORT: Final = 8035
"""A browser keeps layouts for each port."""


def _token() -> str:
    return secrets.token_urlsafe(TOKEN_BYTES)


@dataclass(frozen=True)
class Access:
    """The tokens of one start of the panel.

    ``control`` permits viewing and commands, ``view`` permits viewing only.
    """

    port: int
    control: str = field(default_factory=_token)
    view: str = field(default_factory=_token)

    def url(self, token: str) -> str:
        """The address of the page with ``token``."""
        return f"http://{NAMES[0]}:{self.port}/{token}/"

    def may_touch(self, token: str) -> bool | None:
        """Whether who has ``token`` may touch; None: may not even look."""
        if hmac.compare_digest(token.encode(), self.control.encode()):
            return True
        if hmac.compare_digest(token.encode(), self.view.encode()):
            return False
        return None

    def is_own_host(self, host: str | None) -> bool:
        """Whether a request's Host header names this server."""
        return host in self._names()

    def is_own_origin(self, origin: str | None) -> bool:
        """Whether a request's Origin is a page of this server; web sockets always send Origin."""
        return origin in {f"http://{name}" for name in self._names()}

    def _names(self) -> set[str]:
        """The server's names in a browser's spelling: without port 80, the default of http."""
        port = "" if self.port == HTTP_PORT else f":{self.port}"
        return {f"{name}{port}" for name in NAMES}


UPDATES_PER_S: Final = 60
MOST_BYTES: Final = 4096
"""Of an order."""

HEARTBEAT_S: Final = 60.0
"""Between two questions whether a browser is there; a busy one has half of the time to answer."""

PAGE: Final = {"": "index.html", "panel.js": "panel.js"}
BENCH: Final = {
    "uplot.js": "uPlot.iife.min.js", "uplot.css": "uPlot.min.css",
    **{name: name for name in ("charts.js", "trace.js", "scene.js", "bench.css")},
}  # fmt: skip

HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; connect-src 'self'; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


class Server:
    """The server of one start."""

    def __init__(self, screen: Screen, access: Access) -> None:
        self._screen = screen
        self._access = access

    def application(self) -> web.Application:
        """For aiohttp."""
        app = web.Application(middlewares=[self._guard], client_max_size=MOST_BYTES)
        for name, file in PAGE.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.panel", f"page/{file}"))
        for name, file in BENCH.items():
            app.router.add_get(f"/{{token}}/{name}", _static("can_rig.drawing", f"bench/{file}"))
        app.router.add_get("/{token}/socket", self._socket)
        app.cleanup_ctx.append(self._updating)
        app.on_shutdown.append(self._screen.say_goodbye)
        return app

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
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
        socket = web.WebSocketResponse(
            heartbeat=HEARTBEAT_S, max_msg_size=MOST_BYTES, compress=False
        )
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
            self._screen.viewers.discard(viewer)
            sending.cancel()
        return socket

    async def _order(self, viewer: Viewer, text: str) -> None:
        """Execute a page's request, or answer with the reason for refusal."""
        try:
            order = json.loads(text)
            if order["order"] == "trace":
                self._screen.trace(viewer, bool(order["on"]))
                return
            if not viewer.may_touch:
                raise RigError("this address may look only")
            await self._screen.obey(order)
        except RigError as error:
            viewer.offer(json.dumps({"refused": str(error)}), may_drop=True)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError):
            viewer.offer(json.dumps({"refused": "not an order of this panel"}), may_drop=True)

    async def _updating(self, _app: web.Application) -> AsyncIterator[None]:
        """While the server runs, tell the browsers what is new, 60 times a second at most."""
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


def serve(
    name: str,
    settings: tuple[str, ...],
    scenarios: list[str],
    bus: str | None,
    sends: bool,
    port: int | None,
    say: Callable[..., None],
) -> None:
    """Serve until Ctrl-C or SIGTERM; either signal also ends a run that the panel started.

    Args:
        name: the scenario that runs, or runs already: a shipped one or a file.
        settings: its ``KEY=VALUE`` changes.
        scenarios: names to choose from.
        bus: of nodes that run already; None: the panel starts them.
        sends: whether commands may be sent.
        port: of 127.0.0.1; 0: a free port; None: ``USUAL_PORT`` or else a free port.
        say: prints the addresses.

    Raises:
        RigError: the scenario cannot be loaded.
        BusError: the port or the bus cannot be opened.
    """
    scenario = load(name, settings)
    try:
        listening = _listening(USUAL_PORT if port is None else port)
    except BusError:
        if port is not None:
            raise
        listening = _listening(0)
    access = Access(listening.getsockname()[1])
    shown = bus or new_bus()

    def opened(name: str) -> Session:
        return Session(shown, load(name, settings), name, settings)

    session = Session(shown, scenario, name, settings, sends, starts=bus is None)
    if scenarios and name not in scenarios:
        scenarios = [name, *scenarios]
    server = Server(Screen(session, scenarios, opened), access)
    if sends:
        say(f"to watch and touch  {access.url(access.control)}")
    say(f"to watch only       {access.url(access.view)}")

    async def application() -> web.Application:
        return server.application()

    web.run_app(application(), sock=listening, print=None, access_log=None, handle_signals=True)


def _listening(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind((NAMES[0], port))
    except OSError as error:
        listening.close()
        raise BusError(
            f"port {port}: cannot be opened: {one_line(error)}; choose another --port, or 0"
        ) from None
    listening.listen()
    return listening
