"""The compiled ticks of a loop with a car whose speed changes, or that the world pushes."""

from __future__ import annotations

from typing import Any

from firmware_model.analysis.changing_plant import follow_changing
from firmware_model.analysis.loop import tick
from firmware_model.compiled import firmware_run


@firmware_run
def run_changing(
    loop: Any, begin: int, end: int, y: float, read: float, plant: Any, memory: Any, ahead: int,
    world: Any, work: Any, speeds: Any,
) -> tuple[float, float]:  # fmt: skip
    """Ticks from ``begin`` to ``end`` of a loop with a ``ChangingPlant``.

    Args:
        loop: the first seven arguments of ``loop.tick``.
        begin: the first tick of the loop.
        end: the tick after the last tick.
        y: the output of the plant at ``begin``.
        read: the sensor's reading at ``begin``.
        plant: the constants of ``follow_changing``.
        memory: of the plant; changed in place.
        ahead: number of the plant's ticks before the first tick of the loop.
        world: (end - begin + 1, ``WORLD_ROW``), or ``NO_WORLD``.
        work: see ``follow_changing``.
        speeds: see ``follow_changing``, for every tick from ``begin`` to ``end``.
    """
    tables, controllers, inputs, grid, actuators, signals, states = loop
    left = inputs[3]
    for k in range(begin, end):
        u1, u2 = tick(tables, controllers, inputs, grid, actuators, signals, states, k, y, read)
        at = k - begin
        y, read = follow_changing(
            plant, memory, work, speeds[at], k + ahead, u1, u2, left[k, 0], left[k, 1],
            world[at : at + 2],
        )  # fmt: skip
    return y, read
