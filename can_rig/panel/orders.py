"""The JSON requests that a page may send; every other message is refused."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any, Final

from can_rig.errors import RigError
from can_rig.frames import operator_frames
from can_rig.panel.saving import save
from can_rig.panel.screen import Screen

Order = dict[str, Any]


async def obey(screen: Screen, order: Order) -> None:
    """Do what ``order`` asks for.

    Raises:
        RigError: it cannot be done; the line says why.
        KeyError, TypeError, ValueError: it is no order.
    """
    await ORDERS[order["order"]](screen, order)


async def _start(screen: Screen, _order: Order) -> None:
    if not screen.scenarios:
        raise RigError("the nodes of this bus are not the panel's; it starts none beside them")
    await screen.start()


async def _stop(screen: Screen, _order: Order) -> None:
    await screen.session.stop()


async def _choose(screen: Screen, order: Order) -> None:
    if screen.session.running:
        raise RigError("a run goes on; stop it before another scenario is chosen")
    name = order["scenario"]
    if name not in screen.scenarios:
        raise RigError(f"scenario {name!r}: must be one of the list")
    before = screen.session
    screen.show(screen.open_session(name))
    before.close()


async def _inject(screen: Screen, order: Order) -> None:
    kind, place = order["kind"], order["place"]
    if kind not in operator_frames.kinds() or place not in operator_frames.places():
        raise ValueError
    value, duration_s = _number(order.get("value")), _number(order.get("for_s"))
    screen.session.command(operator_frames.Command("INJECT", kind, place, value, duration_s))


async def _clear(screen: Screen, order: Order) -> None:
    place = order.get("place", operator_frames.ALL)
    if place not in (operator_frames.ALL, *operator_frames.places()):
        raise ValueError
    screen.session.command(operator_frames.Command("CLEAR", place=place))


async def _reference(screen: Screen, order: Order) -> None:
    screen.session.command(operator_frames.Command("MOVE_REFERENCE", value=_number(order["value"])))


async def _pace(screen: Screen, order: Order) -> None:
    screen.session.command(operator_frames.Command("PACE", value=_number(order["value"])))


async def _pause(screen: Screen, _order: Order) -> None:
    screen.session.command(operator_frames.Command("PAUSE"))


async def _step(screen: Screen, order: Order) -> None:
    screen.session.command(operator_frames.Command("STEP", value=_number(order.get("ticks", 1))))


async def _save(screen: Screen, order: Order) -> None:
    path = await asyncio.to_thread(save, screen.session, str(order["name"]))  # it reads a log
    screen.viewers.offer(f'{{"saved": "{path.name}"}}')


def _number(value: object) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


ORDERS: Final[dict[str, Callable[[Screen, Order], Awaitable[None]]]] = {
    "start": _start,
    "stop": _stop,
    "choose": _choose,
    "inject": _inject,
    "clear": _clear,
    "reference": _reference,
    "pace": _pace,
    "pause": _pause,
    "step": _step,
    "save": _save,
}
