"""The rig's own frames in a log, one by one, with what their bytes say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from can_rig.decoding import e2e_columns
from can_rig.frames.network import Network
from can_rig.frames.protection import FRAME_BYTES
from can_rig.frames.wire_tick import ticks_on
from can_rig.logs.frames import ERROR, EXTENDED, REMOTE, Frames

INPUTS: Final = 2
"""The first roles, reference and feedback, are what the controller gets; the others its answer."""


class RigFrame(NamedTuple):
    """One frame of the network, as a log has it."""

    role: int
    """Which one, an index of `frames.layout.ROLES`."""
    time_ns: int
    """Time stamp, as `Frames.time_ns`."""
    data: bytes
    tick: int
    """What it says, modulo 65536; 0 if it is too short to say anything."""
    counter: int
    intact: bool
    """Whether length, CRC and data identifier are those of the frame."""


def rig_frames(chunks: Iterable[Frames], network: Network) -> Iterator[RigFrame]:
    """The frames of ``network`` among others, in their order."""
    roles = {codec.frame_id: role for role, codec in enumerate(network)}
    identifiers = np.array(sorted(roles), dtype=np.uint32)
    data_ids = [codec.data_id for codec in network]
    for chunk in chunks:
        ours = np.isin(chunk.arbitration_id, identifiers) & ~chunk.has(EXTENDED | REMOTE | ERROR)
        frames = chunk if ours.all() else chunk[ours]
        role = np.array([roles[i] for i in frames.arbitration_id.tolist()], dtype=np.int64)
        intact = np.zeros(len(frames), dtype=np.bool_)
        for at, data_id in enumerate(data_ids):
            rows = role == at
            intact[rows] = e2e_columns.intact(frames.data[rows], frames.length[rows], data_id)
        data = frames.data
        tick = ticks_on(data)
        whole = data[:, :FRAME_BYTES].tobytes()
        columns = (
            role.tolist(),
            frames.time_ns.tolist(),
            frames.length.tolist(),
            tick.tolist(),
            e2e_columns.counters(data).tolist(),
            intact.tolist(),
        )
        for at, (which, time_ns, length, says, counter, good) in enumerate(
            zip(*columns, strict=True)
        ):
            payload = whole[at * FRAME_BYTES : at * FRAME_BYTES + FRAME_BYTES]
            if length != FRAME_BYTES:
                payload = data[at, :length].tobytes()
            yield RigFrame(which, time_ns, payload, says, counter, good)
