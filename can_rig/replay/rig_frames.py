"""The rig's own frames in a log, one by one, with what their bytes say."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np

from can_rig.decoding.message_decoder import counters, intact_rows
from can_rig.frames.codec import ROLES, WIRE_TICKS, MessageCodec, ticks_on
from can_rig.frames.network import Network
from can_rig.frames.protection import COUNTERS, FRAME_BYTES, Checker, CheckStatus, Unprotected
from can_rig.logs.frames import ERROR, EXTENDED, FD, REMOTE, Frames

INPUTS: Final = 2
"""The first roles, reference and feedback, are what the controller gets; then comes its answer."""

SPEED_ROLE: Final = len(ROLES)
"""Of the speed, which the controller gets before them, where the network has it."""


def is_input(role: int) -> bool:
    """Whether the controller gets the frame; otherwise it is one of its answer."""
    return role < INPUTS or role == SPEED_ROLE


class RigFrame(NamedTuple):
    """One frame of the network, as a log has it."""

    role: int
    """Which one, an index of `frames.layout.ROLES`, or ``SPEED_ROLE``."""
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
    roles = {codec.frame_id: role for role, codec in enumerate(network.by_role)}
    identifiers = np.array(sorted(roles), dtype=np.uint32)
    data_ids = [codec.data_id for codec in network.by_role]
    if not network.is_the_rigs:
        yield from _of_any_layout(chunks, network, roles)
        return
    for chunk in chunks:
        ours = np.isin(chunk.arbitration_id, identifiers) & ~chunk.has(EXTENDED | REMOTE | ERROR)
        frames = chunk if ours.all() else chunk[ours]
        role = np.array([roles[i] for i in frames.arbitration_id.tolist()], dtype=np.int64)
        intact = np.zeros(len(frames), dtype=np.bool_)
        for at, data_id in enumerate(data_ids):
            rows = role == at
            assert data_id is not None
            intact[rows] = intact_rows(frames.data[rows], frames.length[rows], data_id)
        data = frames.data
        tick = ticks_on(data)
        whole = data[:, :FRAME_BYTES].tobytes()
        columns = (
            role.tolist(),
            frames.time_ns.tolist(),
            frames.length.tolist(),
            tick.tolist(),
            counters(data).tolist(),
            intact.tolist(),
        )
        for at, (which, time_ns, length, says, counter, good) in enumerate(
            zip(*columns, strict=True)
        ):
            payload = whole[at * FRAME_BYTES : at * FRAME_BYTES + FRAME_BYTES]
            if length != FRAME_BYTES:
                payload = data[at, :length].tobytes()
            yield RigFrame(which, time_ns, payload, says, counter, good)


def _of_any_layout(
    chunks: Iterable[Frames], network: Network, roles: dict[int, int]
) -> Iterator[RigFrame]:
    """The same of frames that are not the rig's own, one by one.

    One that says no tick is counted: a reference or a feedback is of the tick after the last of
    its kind, an answer of the last feedback's.
    """
    codecs = tuple(network)
    counted = [-1] * INPUTS
    identifiers = np.array(sorted(roles), dtype=np.uint32)
    for chunk in chunks:
        ours = np.isin(chunk.arbitration_id, identifiers) & ~chunk.has(REMOTE | ERROR)
        frames = chunk[ours]
        for at, identifier in enumerate(frames.arbitration_id.tolist()):
            role, flags = roles[identifier], int(frames.flags[at])
            codec = codecs[role]
            if (bool(flags & EXTENDED), bool(flags & FD)) != (codec.extended, codec.fd):
                continue
            data = frames.data[at, : int(frames.length[at])].tobytes()
            tick = codec.layout.tick(data)
            if tick is None:
                if role < INPUTS:
                    counted[role] += 1
                tick = counted[role if role < INPUTS else INPUTS - 1] % WIRE_TICKS
            counter = tick % COUNTERS  # of a frame without one, as if none were lost or repeated
            if codec.protected and len(data) > 1:
                counter = data[1] & 0x0F
            yield RigFrame(role, int(frames.time_ns[at]), data, tick, counter, _intact(codec, data))


def _intact(codec: MessageCodec, data: bytes) -> bool:
    length = codec.layout.length
    checker = (
        Unprotected(length) if codec.data_id is None else Checker(codec.data_id, length=length)
    )
    return checker.check(bytearray(data)) in {CheckStatus.OK, CheckStatus.INITIAL}
