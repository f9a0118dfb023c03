"""The other end of ``RIG_CONTROL``: who touches a run."""

from __future__ import annotations

import time
from typing import Final

import can

from can_rig.errors import BusError, RigError, one_line
from can_rig.frames import operator_frames
from can_rig.plant.faults.injection import require_possible

WITHIN_S: Final = 1.0
"""A plant node says 20 times a second how it stands to commands."""


def operate(bus: can.BusABC, name: str, command: operator_frames.Command) -> None:
    """Send ``command`` on the bus called ``name``, and wait until the plant node obeys.

    Raises:
        RigError: no plant node there obeys commands, or the plant node refuses ``command``.
    """
    require_possible(command)
    state, is_silent = _state(bus)
    if state is None:
        raise RigError(
            f"bus {name}: silent; no nodes run there, or they have another bus (--bus)"
            if is_silent
            else f"bus {name}: no plant node says that it obeys commands; "
            "it must be started with --injectable"
        )
    if command.action == "STEP" and not state.paused:
        raise RigError(f"bus {name}: nothing is paused; inject pause comes before step")
    message = operator_frames.command_message(command, state.next_sequence)
    try:
        bus.send(message)
    except can.CanError as error:
        raise BusError(f"bus {name}: {one_line(error)}") from error
    end_s = time.monotonic() + WITHIN_S
    while time.monotonic() < end_s:
        after, _ = _state(bus)
        if after is None:
            break
        if after.next_sequence != state.next_sequence:
            if after.last_checksum != message.data[0]:
                raise RigError(f"bus {name}: somebody else was quicker; try again")
            if after.refused != state.refused:
                raise RigError(f"bus {name}: refused, as no such thing can be done")
            return
    raise RigError(f"bus {name}: the plant node did not answer within {WITHIN_S:g} s")


def _state(bus: can.BusABC) -> tuple[operator_frames.State | None, bool]:
    """The next state of a plant node (None after a timeout), and whether the bus is silent."""
    frame_id, is_silent = operator_frames.identifiers().state, True
    end_s = time.monotonic() + WITHIN_S
    while (left_s := end_s - time.monotonic()) > 0.0:
        message = bus.recv(left_s)
        is_silent = is_silent and message is None
        if message is not None and message.arbitration_id == frame_id:
            said = operator_frames.read_state(message)
            if said is not None:
                return said, False
    return None, is_silent
