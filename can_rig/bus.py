"""Open a CAN bus from a name such as ``local``, ``socketcan:vcan0`` or ``kvaser:0?bitrate=500000``.

A name is ``interface[:channel][?key=value[&key=value ...]]`` with any interface that python-can
knows and any argument of its bus class; values are cast as in python-can's configuration files.
"""

import difflib
import errno
from pathlib import Path
from typing import Any

import can
from can.interfaces import VALID_INTERFACES
from can.util import cast_from_string

from can_rig.errors import BusError

_NETWORK = Path("/sys/class/net")
_IFF_UP = 1
_NO_CAN = {errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT}

# Interfaces of python-can that need a package, with the extra that installs it.
_EXTRAS = {
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
    """The open bus called ``name``; configuration files of python-can have no say.

    :param name: ``local``, ``local:NAME``, ``local:/path``, ``socketcan:vcan0``, ``virtual:x``,
        ``udp_multicast:239.74.163.2``, ``interface:channel?key=value&key=value``.
    :param kwargs: arguments of the bus class, stronger than those in the name.
    :raises BusError: the name is malformed, or there is no such interface, channel or package.
    """
    interface, channel, arguments = _parse(name)
    if interface not in VALID_INTERFACES:
        raise BusError(f"unknown bus interface {interface!r}; {_suggestion(interface)}")
    if interface == "socketcan" and channel:
        _check_is_up(str(channel))
    try:
        return can.Bus(
            channel=channel, interface=interface, ignore_config=True, **{**arguments, **kwargs}
        )
    except Exception as error:  # a backend raises what its driver's library raises
        raise BusError(_explain(name, interface, channel, error)) from error


def _parse(name: str) -> tuple[str, str | int | None, dict[str, Any]]:
    address, _, query = name.partition("?")
    interface, _, channel = address.partition(":")
    arguments = {}
    for item in filter(None, query.split("&")):
        key, equals, value = item.partition("=")
        if not (key.isidentifier() and equals):
            raise BusError(f"bus {name!r}: {item!r} is not of the form key=value")
        arguments[key] = cast_from_string(value)
    return interface, int(channel) if channel.isdecimal() else channel or None, arguments


def _suggestion(interface: str) -> str:
    near = difflib.get_close_matches(interface, VALID_INTERFACES, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(near)}?"
    return f"there are {', '.join(sorted(VALID_INTERFACES))}"


def _check_is_up(channel: str) -> None:
    # The kernel binds to an interface that is down; the first recv() would be the one to fail.
    flags = _NETWORK / channel / "flags"
    if flags.exists() and not int(flags.read_text(), 16) & _IFF_UP:
        raise BusError(f"CAN interface {channel} is down: sudo ip link set up {channel}")


def _explain(name: str, interface: str, channel: object, error: Exception) -> str:
    """What the user can do about it, in one line."""
    if interface == "socketcan" and isinstance(error, OSError):
        if error.errno in _NO_CAN:
            return f"bus {name!r}: this kernel has no CAN support; the bus 'local' needs none"
        if error.errno == errno.ENODEV:
            return (
                f"no such CAN interface {channel}: sudo modprobe vcan; "
                f"sudo ip link add dev {channel} type vcan; sudo ip link set up {channel}"
            )
    reason = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, can.CanInterfaceNotImplementedError) and interface in _EXTRAS:
        reason += f": pip install 'python-can[{_EXTRAS[interface]}]'"
    return f"cannot open bus {name!r}: {reason}"
