"""The screen of every browser: one run, its rows, its lamps and its list of commands."""

from __future__ import annotations

import asyncio
import json
import struct
from collections import deque
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from can_rig.drawing.names import names_of
from can_rig.frames import operator_frames
from can_rig.logs.columns import EVIDENCE
from can_rig.panel.live import COLUMNS
from can_rig.panel.session import Session
from can_rig.panel.viewers import Viewer, Viewers
from can_rig.results.isolation.words import in_words
from firmware_model.target.structs import FloatArray

LAMPS_EVERY: Final = 6
"""Updates."""

HISTORY: Final = 20_000
"""Rows that a browser gets which comes late: some three minutes."""


def batch(rows: FloatArray) -> bytes:
    """Rows (n, columns) in the page's format: n, columns, then every column as float64."""
    return struct.pack("<II", *rows.shape) + rows.T.astype("<f8").tobytes()


class Screen:
    """The displayed run and its viewers.

    Args:
        session: the run; replaced when the user chooses another scenario.
        scenarios: names of the offered scenarios; empty if the panel did not start the nodes.
        open_session: makes the session of another scenario.
    """

    def __init__(
        self,
        session: Session,
        scenarios: list[str],
        open_session: Callable[[str], Session],
    ) -> None:
        self.session = session
        self.scenarios = scenarios
        self.open_session = open_session
        self.viewers = Viewers()
        self._history: deque[FloatArray] = deque()
        self._kept = 0
        self._updates = 0
        self._end: asyncio.Task[None] | None = None
        self.events: list[dict[str, Any]] = []
        """What the plant node was told, with the time of the run from which it acts."""

    def welcome(self, viewer: Viewer) -> None:
        """Send a browser the history of the run."""
        viewer.offer(self._hello(viewer.may_touch))
        if self._history:
            viewer.offer(batch(np.concatenate(list(self._history))))
        self.viewers.add(viewer)

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
        """The page's setup before the first row; None for unchanged viewer permissions."""
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
                    "kinds": operator_frames.kinds(),
                    "places": operator_frames.places(),
                    "signals": [{"name": each.name, "unit": each.unit} for each in names],
                    "hypotheses": [
                        [column, in_words(verdict, names)]
                        for verdict, column in enumerate(EVIDENCE, 1)
                    ],
                    "confirm": session.live.confirm,
                    "events": self.events,
                },
                **({} if may_touch is None else {"may_touch": may_touch}),
            }
        )

    async def close(self) -> None:
        """End a run that the panel started, and leave the bus."""
        await self.session.stop()
        if self._end is not None:
            await self._end
        self.session.close()

    def update(self) -> None:
        """Offer every browser the new rows, and the lamps at a lower rate."""
        live = self.session.live
        rows = live.update()
        for time_s, command in live.taken_commands():
            event = {"time_s": time_s, **command._asdict()}
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
