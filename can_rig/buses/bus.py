"""Opening a CAN bus by name: ``local``, ``socketcan:vcan0``, ``kvaser:0?bitrate=500000``.

A name is ``interface[:channel][?key=value[&key=value ...]]``: any interface of python-can, and any
arguments of its bus class; values are converted like those of python-can's configuration files.

A node opens SocketCAN by `NodeSocketcanBus`, so that other traffic cannot displace the frames of
the control loop. A raw CAN socket has one receive queue, and the kernel silently drops overflowing
frames: a flood of other identifiers would drop the loop's frames. So a node has two sockets with
filters in the kernel. The loop's identifiers have a separate queue. The other socket receives
everything else, for the log, and also sends, so that the node never hears its own frames. While
both queues hold frames, the node reads the queues in turns, so a flood at most doubles the node's
reading. Counts the frames dropped by the kernel from either socket (``SO_MEMINFO``, sock_diag(7):
``SK_MEMINFO_DROPS``).
"""

import contextlib
import difflib
import errno
import logging
import re
import select
import socket
import struct
from collections import deque
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import can
from can.interfaces import VALID_INTERFACES
from can.interfaces.socketcan import SocketcanBus
from can.util import cast_from_string

from can_rig.errors import BusError, BusLostError, one_line

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
_ECHOES: Final = 1000
"""Own frames that are still awaited from a multicast group, which may lose some."""


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
            with contextlib.suppress(can.CanError):  # down again: whoever sends or waits says so
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


class NodeMulticastBus(can.BusABC):
    """A node's end of a multicast group, without its own frames, which the group brings back.

    Args:
        bus: python-can's bus.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._sent: deque[tuple[object, ...]] = deque(maxlen=_ECHOES)
        self.channel, self.channel_info = getattr(bus, "channel", ""), bus.channel_info
        super().__init__(channel=self.channel)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """As `can.BusABC.send`."""
        self._bus.send(msg, timeout)
        self._sent.append(_content(msg))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        message = self._bus.recv(timeout)
        while message is not None and _content(message) in self._sent:
            self._sent.remove(_content(message))
            message = self._bus.recv(0)
        return message, True

    def fileno(self) -> int:
        """The descriptor of the group's socket."""
        return self._bus.fileno()

    def shutdown(self) -> None:
        """Close the socket."""
        super().shutdown()
        self._bus.shutdown()


def _content(message: can.Message) -> tuple[object, ...]:
    kind = message.is_extended_id, message.is_remote_frame, message.is_error_frame, message.is_fd
    return message.arbitration_id, *kind, bytes(message.data)


def _socketcan(bus: can.BusABC) -> SocketcanBus:
    assert isinstance(bus, SocketcanBus)
    return bus


def _widen(raw: socket.socket) -> None:
    with contextlib.suppress(OSError):
        raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, QUEUE_BYTES)
    with contextlib.suppress(OSError):
        raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, QUEUE_BYTES)


_NETWORK: Final = Path("/sys/class/net")
_LOCAL_OPTIONS: Final = {"fd", "preserve_timestamps", "receive_own_messages", "tx_backlog"}
_IFF_UP: Final = 1
_FD_MTU: Final = 72  # bytes of the kernel's frame of CAN FD
_ALWAYS_FD = ("virtual", "udp_multicast")  # or without an argument for it
_NO_CAN: Final = {errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT}

_LINUX_NAME: Final = re.compile(r"v?x?can\d+")  # what Linux calls CAN interfaces
_MISSING: Final = re.compile(r"missing \d+ required positional arguments?: (.*)")

# Interfaces with an additional package, and python-can's extra for installing that package.
_EXTRAS: Final = {
    "canalystii": "canalystii",
    "cantact": "cantact",
    "gs_usb": "gs-usb",
    "nixnet": "nixnet",
    "robotell": "serial",
    "seeedstudio": "seeedstudio",
    "serial": "serial",
    "slcan": "serial",
    "udp_multicast": "multicast",
}


def open_bus(name: str, **kwargs: Any) -> can.BusABC:
    """Open the bus called ``name``; python-can's configuration files are ignored.

    Args:
        name: ``local``, ``local:NAME``, ``local:/path``, ``socketcan:vcan0``, ``virtual:x``,
            ``udp_multicast:239.74.163.2``, ``interface:channel?key=value&key=value``.
        **kwargs: arguments of the bus class; they override those in the name.

    Raises:
        BusError: the name is malformed, or the interface, the channel or a package is missing.
    """
    interface, channel, arguments = _parse(name)
    if interface not in VALID_INTERFACES:
        raise BusError(f"unknown bus interface {interface!r}; {_suggestion(interface)}")
    if interface == "local" and (unknown := sorted(set(arguments) - _LOCAL_OPTIONS)):
        known = ", ".join(sorted(_LOCAL_OPTIONS))
        raise BusError(f"bus {name!r}: unknown option {', '.join(unknown)}; must be of {known}")
    if interface == "socketcan":
        if channel is None:
            raise BusError(f"bus {name!r}: must name a channel, as in socketcan:vcan0")
        _check_is_up(str(channel))
        if {**arguments, **kwargs}.get("fd"):
            _check_carries_fd(str(channel))
    with _quiet():  # also while Python discards a half-opened bus together with the error
        try:
            bus = can.Bus(
                channel=channel, interface=interface, ignore_config=True, **{**arguments, **kwargs}
            )
            if bus.channel_info == can.BusABC.channel_info:  # "unknown"
                bus.channel_info = name
            return bus
        except Exception as error:  # backends raise their driver library's exceptions
            reason = _explain(name, interface, channel, error)
    raise BusError(reason)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence python-can's log records; the error carries their content."""
    logger = logging.getLogger("can")  # the parent of the loggers of its buses
    propagate, logger.propagate = logger.propagate, False
    nowhere = logging.NullHandler()
    # without a handler, logging prints to standard error as a last resort
    logger.addHandler(nowhere)
    try:
        yield
    finally:
        logger.removeHandler(nowhere)
        logger.propagate = propagate


def open_for_node(
    name: str, identifiers: Collection[int], overhear: bool, fd: bool = False
) -> can.BusABC:
    """Open the bus called ``name`` for a node of the rig.

    On SocketCAN the bus is a `NodeSocketcanBus`: other traffic cannot displace frames with the
    ``identifiers`` (of 29 bits with bit 31 set), and only ``overhear`` lets other traffic through.
    A multicast group is a `NodeMulticastBus`. Other interfaces open like `open_bus`. With ``fd``
    the bus carries CAN FD frames.

    Raises:
        BusError: as `open_bus`.
    """
    interface = _parse(name)[0]
    flexible = {"fd": True} if fd and interface not in _ALWAYS_FD else {}
    if interface == "local":
        flexible["bursts"] = True
    if interface == "udp_multicast":
        return NodeMulticastBus(open_bus(name, **flexible))
    if interface != "socketcan":
        return open_bus(name, **flexible)

    def opened(**kwargs: Any) -> can.BusABC:
        return open_bus(name, **flexible, **kwargs)

    return NodeSocketcanBus(opened, identifiers, overhear)


def in_one_process(name: str) -> bool:
    """Whether the bus ``name`` connects only nodes of a single process.

    Raises:
        BusError: the name is malformed.
    """
    return _parse(name)[0] == "virtual"


def _parse(name: str) -> tuple[str, str | int | None, dict[str, Any]]:
    address, _, query = name.partition("?")
    interface, _, channel = address.partition(":")
    arguments = {}
    for item in filter(None, query.split("&")):
        key, equals, value = item.partition("=")
        if not (key.isidentifier() and equals):
            raise BusError(f"bus {name!r}: {item!r} must be of the form key=value")
        arguments[key] = cast_from_string(value)
    return interface, int(channel) if channel.isdecimal() else channel or None, arguments


def _suggestion(interface: str) -> str:
    if _LINUX_NAME.fullmatch(interface):
        return f"did you mean socketcan:{interface}?"
    near = difflib.get_close_matches(interface, VALID_INTERFACES, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"it must be one of {', '.join(sorted(VALID_INTERFACES))}"


def _check_is_up(channel: str) -> None:
    # The kernel binds to an interface that is down; only the first recv() would fail.
    flags = _NETWORK / channel / "flags"
    if flags.exists() and not int(flags.read_text(), 16) & _IFF_UP:
        raise BusError(f"CAN interface {channel} is down: sudo ip link set up {channel}")


def _check_carries_fd(channel: str) -> None:
    # Only the first send() would fail, and with "Invalid argument".
    mtu = _NETWORK / channel / "mtu"
    if mtu.exists() and int(mtu.read_text()) < _FD_MTU:
        raise BusError(
            f"CAN interface {channel} carries no CAN FD frames: sudo ip link set {channel} down; "
            f"sudo ip link set {channel} mtu {_FD_MTU} up (of hardware: ip link ... type can fd on)"
        )


def lost(bus: object, error: can.CanError, for_s: float) -> BusLostError:
    """The error for a bus failing with ``error`` for ``for_s``, with a remedy."""
    code = error.error_code or 0
    channel = getattr(bus, "channel", "")
    reasons = {
        errno.ENETDOWN: f"the interface has been down for {for_s:g} s: "
        f"sudo ip link set up {channel}",
        errno.ENODEV: f"the interface is gone: {_recipe(channel)}",
        errno.ENXIO: f"the interface is gone: {_recipe(channel)}",
        errno.ENOBUFS: f"the transmit queue has been full for {for_s:g} s; is there a node that "
        f"acknowledges? for a longer queue: sudo ip link set {channel} txqueuelen 1000",
    }
    name = getattr(bus, "channel_info", "the bus")
    return BusLostError(f"{name}: {reasons.get(code) or one_line(error)}")


def _recipe(channel: object) -> str:
    if re.fullmatch(r"can\d+", str(channel)):
        return (
            f"is the adapter plugged in and its driver loaded? sudo ip link set {channel} up type "
            "can bitrate 500000; ip -brief link show type can lists those that are there"
        )
    return (
        f"sudo modprobe vcan; sudo ip link add dev {channel} type vcan; "
        f"sudo ip link set up {channel}"
    )


def _explain(name: str, interface: str, channel: object, error: Exception) -> str:
    """The cause and the user's remedy, in one line."""
    if interface == "socketcan" and isinstance(error, OSError):
        if error.errno in _NO_CAN:
            return (
                f"bus {name!r}: this kernel has no CAN support; the bus 'local' needs none, "
                "and tools/vcan_guest runs a command in a kernel that has it"
            )
        if error.errno == errno.ENODEV:
            return f"no such CAN interface {channel}: {_recipe(channel)}"
    reason = one_line(error)
    if isinstance(error, TypeError) and (missing := _MISSING.search(reason)):
        keys = re.findall(r"'(\w+)'", missing[1])
        given = f":{channel}" if channel is not None else ":CHANNEL"
        query = "&".join(f"{key}={key.upper()}" for key in keys if key != "channel")
        example = f"{interface}{given}{'?' if query else ''}{query}"
        return f"bus {name!r}: must say {' and '.join(keys)}, as in {example}"
    if isinstance(error, can.CanInterfaceNotImplementedError) and interface in _EXTRAS:
        reason += f": pip install 'python-can[{_EXTRAS[interface]}]'"
    return f"cannot open bus {name!r}: {reason}"
