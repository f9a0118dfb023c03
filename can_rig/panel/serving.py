"""The panel from start to end: its socket on 127.0.0.1, its bus, its run."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import web

from can_rig.assessment.resolve import load
from can_rig.errors import BusError, one_line
from can_rig.panel.access import NAMES, Access
from can_rig.panel.screen import Screen
from can_rig.panel.server import Server
from can_rig.panel.session import Session, new_bus
from can_rig.scenario.settings import Scenario


@dataclass(frozen=True)
class Shown:
    """What is asked for.

    Attributes:
        scenario: what runs, or runs already.
        name: what it is called: a shipped one or a file.
        settings: the ``KEY=VALUE`` changes that made it.
        scenarios: names to choose from.
        bus: of nodes that run already; None: the panel starts them.
        sends: whether commands may be sent.
        port: of 127.0.0.1; 0: a free one.
    """

    scenario: Scenario
    name: str
    settings: tuple[str, ...]
    scenarios: list[str]
    bus: str | None
    sends: bool
    port: int = 0


def serve(shown: Shown, say: Callable[..., None]) -> None:
    """Serve until Ctrl-C or SIGTERM; either signal also ends a run that the panel started.

    Args:
        shown: scenario and bus of the command line.
        say: gets the addresses.

    Raises:
        BusError: the port or the bus cannot be opened.
    """
    listening = _listening(shown.port)
    access = Access(listening.getsockname()[1])
    bus = shown.bus or new_bus()

    def opened(name: str) -> Session:
        return Session(bus, load(name, shown.settings), name, shown.settings)

    session = Session(bus, shown.scenario, shown.name, shown.settings, shown.sends)
    names = shown.scenarios
    if names and shown.name not in names:
        names = [shown.name, *names]
    server = Server(Screen(session, names, opened), access)
    if shown.sends:
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
        raise BusError(f"port {port}: cannot be opened: {one_line(error)}") from None
    listening.listen()
    return listening
