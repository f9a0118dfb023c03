"""What a page may ask for, as JSON; whatever else it sends is refused."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING, Any, Final

from can_rig.errors import RigError
from can_rig.frames import control
from can_rig.panel.saving import save

if TYPE_CHECKING:
    from can_rig.panel.server import Panel

Order = dict[str, Any]


async def obey(panel: Panel, order: Order) -> None:
    """Do what ``order`` asks for.

    Raises:
        RigError: it cannot be done; the line says why.
        KeyError, TypeError, ValueError: it is no order.
    """
    await ORDERS[order["order"]](panel, order)


async def _start(panel: Panel, _order: Order) -> None:
    await panel.start()


async def _stop(panel: Panel, _order: Order) -> None:
    await panel.session.stop()


async def _choose(panel: Panel, order: Order) -> None:
    if panel.session.running:
        raise RigError("a run goes on; stop it before another scenario is chosen")
    name = order["scenario"]
    if name not in panel.scenarios:
        raise RigError(f"scenario {name!r}: must be one of the list")
    before = panel.session
    panel.show(panel.open_session(name))
    before.close()


async def _inject(panel: Panel, order: Order) -> None:
    kind, place = order["kind"], order["place"]
    if kind not in control.kinds() or place not in control.places():
        raise ValueError
    value, duration_s = _number(order.get("value")), _number(order.get("for_s"))
    panel.session.command(control.Command("INJECT", kind, place, value, duration_s))


async def _clear(panel: Panel, order: Order) -> None:
    panel.session.command(control.Command("CLEAR", place=str(order.get("place", control.ALL))))


async def _reference(panel: Panel, order: Order) -> None:
    panel.session.command(control.Command("MOVE_REFERENCE", value=_number(order["value"])))


async def _pace(panel: Panel, order: Order) -> None:
    panel.session.command(control.Command("PACE", value=_number(order["value"])))


async def _pause(panel: Panel, _order: Order) -> None:
    panel.session.command(control.Command("PAUSE"))


async def _step(panel: Panel, order: Order) -> None:
    panel.session.command(control.Command("STEP", value=_number(order.get("ticks", 1))))


async def _save(panel: Panel, order: Order) -> None:
    path = save(panel.session, str(order["name"]))
    panel.viewers.offer(f'{{"saved": "{path.name}"}}')


def _number(value: object) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


ORDERS: Final[dict[str, Callable[[Panel, Order], Awaitable[None]]]] = {
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
