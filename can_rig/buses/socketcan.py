"""SocketCAN for a node of the rig: other traffic cannot displace the frames of the control loop.

A raw CAN socket has one receive queue, and the kernel silently drops overflowing frames: a flood of
other identifiers would drop the loop's frames. So a node has two sockets with filters in the
kernel. The loop's identifiers have a separate queue. The other socket receives everything else, for
the log, and also sends, so that the node never hears its own frames. While both queues hold frames,
the node reads the queues in turns, so a flood at most doubles the node's reading. Counts the frames
dropped by the kernel from either socket (``SO_MEMINFO``, sock_diag(7): ``SK_MEMINFO_DROPS``).
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
from collections.abc import Callable, Collection
from typing import Final

import can
from can.interfaces.socketcan import SocketcanBus

QUEUE_BYTES: Final = 8 << 20
"""Some 20 000 frames; without CAP_NET_ADMIN, net.core.rmem_max limits it."""

_SO_RCVBUFFORCE: Final = 33
_SO_MEMINFO: Final = 55
_MEMINFO: Final = struct.Struct("9I")
_DROPS: Final = 8
_SOL_CAN_RAW: Final = 101
_CAN_RAW_JOIN_FILTERS: Final = 6
_EXTENDED_FLAG: Final = 1 << 31
_ANY_ID: Final = (1 << 29) - 1
_CAN_INV_FILTER: Final = 0x20000000
_STALE_MAX: Final = 20_000


class NodeSocketcanBus(can.BusABC):
    """A node's end of a CAN interface.

    Args:
        opened: opens a python-can bus on the interface, given the arguments of its class.
        identifiers: identifiers for the separate queue; of 29 bits with bit 31 set.
        overhear: whether to receive all other frames too.

    Raises:
        BusError: from ``opened``.
    """

    def __init__(
        self, opened: Callable[..., can.BusABC], identifiers: Collection[int], overhear: bool
    ) -> None:
        own: list[can.typechecking.CanFilter] = [
            {
                "can_id": identifier & _ANY_ID,
                "can_mask": _ANY_ID if identifier & _EXTENDED_FLAG else 0x7FF,
                "extended": bool(identifier & _EXTENDED_FLAG),
            }
            for identifier in identifiers
        ]
        self._own = _socketcan(opened(can_filters=own))
        self._buses = [self._own]
        self._own_identifiers = frozenset(identifiers)
        self._last = self._own  # the one read last
        self.channel = self._own.channel
        self.channel_info = self._own.channel_info
        if overhear:
            others: list[can.typechecking.CanFilter] = [
                {**each, "can_id": each["can_id"] | _CAN_INV_FILTER} for each in own
            ]
            self._buses.append(_socketcan(opened(can_filters=others, ignore_rx_error_frames=True)))
            self._buses[1].socket.setsockopt(_SOL_CAN_RAW, _CAN_RAW_JOIN_FILTERS, 1)
        for bus in self._buses:
            _widen(bus.socket)
            for _ in range(_STALE_MAX):  # received before the filters were set
                if bus.recv(0) is None:
                    break
        self._dropped_before = self._dropped()
        super().__init__(channel=self.channel)

    @property
    def lost_frames(self) -> int:
        """Number of frames dropped by the kernel because this node read too late."""
        return self._dropped() - self._dropped_before

    def _dropped(self) -> int:
        return sum(
            _MEMINFO.unpack(bus.socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size))[
                _DROPS
            ]
            for bus in self._buses
        )

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As `can.BusABC.send`."""
        identifier = msg.arbitration_id | msg.is_extended_id * _EXTENDED_FLAG
        its = self._own if identifier in self._own_identifiers else self._buses[-1]
        its.send(msg, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if len(self._buses) == 1:
            return self._own.recv(timeout), True
        try:
            ready = select.select(self._buses, (), (), timeout)[0]
        except (OSError, ValueError) as error:  # ValueError: a closed socket
            raise can.CanOperationError(f"cannot receive: {error}") from error
        if not ready:
            return None, True
        self._last = ready[len(ready) > 1 and self._last is ready[0]]
        return self._last.recv(0), True

    def fileno(self) -> int:
        """The descriptor of the socket with the node's own identifiers."""
        return self._own.fileno()

    def shutdown(self) -> None:
        """Close both sockets."""
        super().shutdown()
        for bus in self._buses:
            bus.shutdown()


def _socketcan(bus: can.BusABC) -> SocketcanBus:
    assert isinstance(bus, SocketcanBus)
    return bus


def _widen(raw: socket.socket) -> None:
    with contextlib.suppress(OSError):
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)
    with contextlib.suppress(OSError):
        raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, QUEUE_BYTES)
