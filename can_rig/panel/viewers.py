"""The connected browsers: each has a separate queue, so a slow browser delays no other."""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import Final

from aiohttp import WSCloseCode, web

MOST_WAITING: Final = 60
"""Messages that wait for one browser, two seconds of them; then the oldest goes."""

STUCK_S: Final = 10.0
"""After which a browser that takes nothing at all is given up."""

GOODBYE_S: Final = 1.0
"""For a browser to answer that the connection ends."""


class Viewer:
    """One browser.

    Args:
        socket: its connection.
        may_touch: whether its commands are obeyed.
    """

    def __init__(self, socket: web.WebSocketResponse, may_touch: bool) -> None:
        self.socket = socket
        self.may_touch = may_touch
        self._waiting: deque[bytes | str] = deque(maxlen=MOST_WAITING)
        self._some = asyncio.Event()

    def offer(self, message: bytes | str) -> None:
        """Queue ``message`` for this browser."""
        self._waiting.append(message)
        self._some.set()

    async def send_on(self) -> None:
        """Send queued messages until the connection ends or stalls for too long."""
        with suppress(ConnectionError, TimeoutError):
            while not self.socket.closed:
                await self._some.wait()
                self._some.clear()
                while self._waiting:
                    await asyncio.wait_for(self._send(self._waiting.popleft()), STUCK_S)
        await self.close()

    async def close(self) -> None:
        """End the connection, whether the browser answers or not."""
        with suppress(ConnectionError, TimeoutError):
            await asyncio.wait_for(self.socket.close(code=WSCloseCode.GOING_AWAY), GOODBYE_S)

    async def _send(self, message: bytes | str) -> None:
        if isinstance(message, bytes):
            await self.socket.send_bytes(message)
        else:
            await self.socket.send_str(message)


class Viewers:
    """All that look at the moment."""

    def __init__(self) -> None:
        self._all: set[Viewer] = set()

    def __len__(self) -> int:
        return len(self._all)

    def add(self, viewer: Viewer) -> None:
        """Add a browser, which from now on gets every offered message."""
        self._all.add(viewer)

    def remove(self, viewer: Viewer) -> None:
        """It has gone."""
        self._all.discard(viewer)

    def offer(self, message: bytes | str) -> None:
        """Let every one have ``message``."""
        for viewer in self._all:
            viewer.offer(message)

    async def close(self, _app: web.Application) -> None:
        """End all connections, for the server ends."""
        await asyncio.gather(*(viewer.close() for viewer in tuple(self._all)))
