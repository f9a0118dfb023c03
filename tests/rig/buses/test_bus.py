"""Names of buses, and a line for each error in a name."""

import errno
import logging
from typing import Any

import can
import pytest

from can_rig.buses import bus as bus_module
from can_rig.buses.bus import open_bus, open_for_node
from can_rig.buses.local.bus import LocalBus
from can_rig.errors import BusError, RigError


@pytest.fixture(autouse=True)
def own_buses(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))


@pytest.fixture
def opened(monkeypatch):
    """The arguments for python-can, in place of a bus that this machine may lack."""
    asked: dict[str, Any] = {}

    class Unnamed:
        channel_info = can.BusABC.channel_info

        def __init__(self, **arguments: Any) -> None:
            asked.update(arguments)

    monkeypatch.setattr(can, "Bus", Unnamed)
    return asked


def failure(name: str) -> str:
    with pytest.raises(BusError) as caught:
        open_bus(name)
    assert isinstance(caught.value, RigError)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "channel"), [("local", "rig"), ("local:", "rig"), ("local:x", "x"), ("local:7", "7")]
)
def test_local_by_name(name, channel):
    with open_bus(name) as bus:
        assert isinstance(bus, LocalBus)
        assert bus.channel == channel


def test_arguments_in_the_name_and_beside_it():
    with open_bus("local:x?fd=true&tx_backlog=7", tx_backlog=9) as bus:
        assert isinstance(bus, LocalBus)
        assert bus.protocol is can.CanProtocol.CAN_FD
        assert bus._tx_backlog == 9


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("virtual:x", {"interface": "virtual", "channel": "x"}),
        ("kvaser:0?bitrate=500000", {"interface": "kvaser", "channel": 0, "bitrate": 500000}),
        ("udp_multicast:239.74.163.2", {"interface": "udp_multicast", "channel": "239.74.163.2"}),
        ("udp_multicast:ff15::1", {"interface": "udp_multicast", "channel": "ff15::1"}),
        ("slcan:/dev/tty0@9600", {"interface": "slcan", "channel": "/dev/tty0@9600"}),
        ("pcan?fd=False&x=0.5&y=a=b", {"interface": "pcan", "fd": False, "x": 0.5, "y": "a=b"}),
    ],
)
def test_what_a_name_asks_of_python_can(name, expected, opened):
    assert open_bus(name).channel_info == name  # for error lines, where python-can has no word
    assert opened == {"channel": None, "ignore_config": True, **expected}


def test_a_users_configuration_changes_nothing(monkeypatch):
    monkeypatch.setitem(can.rc, "receive_own_messages", True)
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "elsewhere")
    with open_bus("local:x") as bus:
        assert isinstance(bus, LocalBus)
        assert not bus.receive_own_messages


def test_unknown_interface():
    assert failure("socketscan:vcan0").startswith(
        "unknown bus interface 'socketscan'; did you mean socketcan"
    )
    assert failure("vcan0") == "unknown bus interface 'vcan0'; did you mean socketcan:vcan0?"
    assert failure("can1").endswith("did you mean socketcan:can1?")
    assert "it must be one of canalystii, " in failure("qqqqq")
    assert "unknown bus interface ''" in failure("")


def test_what_a_name_leaves_out_is_named():
    assert failure("socketcan") == "bus 'socketcan': must name a channel, as in socketcan:vcan0"
    assert failure("slcan") == "bus 'slcan': must say channel, as in slcan:CHANNEL"
    assert failure("socketcand:nowhere") == (
        "bus 'socketcand:nowhere': must say host and port, as in "
        "socketcand:nowhere?host=HOST&port=PORT"
    )
    assert "tx_backlog = 'a': must be a whole number" in failure("local:x?tx_backlog=a")
    assert "unknown option foo; must be of fd, preserve_timestamps, " in failure("local:x?foo=1")


def test_the_default_bus_carries_can_fd_where_the_network_has_it():
    frame = can.Message(arbitration_id=1, is_fd=True, data=bytes(16), is_extended_id=False)
    nodes = [open_for_node("local:x", (), True, fd=True) for _ in range(2)]
    with nodes[0], nodes[1]:
        nodes[0].send(frame)
        received = nodes[1].recv(5.0)
    assert received is not None
    assert received.is_fd
    assert len(received.data) == 16


@pytest.mark.parametrize("query", ["fd", "=1", "a-b=1", "fd=true&&x"])
def test_malformed_arguments(query):
    assert "must be of the form key=value" in failure(f"local:x?{query}")


def test_error_of_a_bus_is_one_line():
    assert "must be a name without '/'" in failure("local:a/b")


def raising(error: Exception) -> Any:
    def bus(**kwargs: Any) -> can.BusABC:
        raise error

    return bus


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (
            OSError(errno.EAFNOSUPPORT, "Address family not supported by protocol"),
            "bus 'socketcan:vcan0': this kernel has no CAN support; the bus 'local' needs none, "
            "and tools/vcan_guest runs a command in a kernel that has it",
        ),
        (
            OSError(errno.ENODEV, "No such device"),
            "no such CAN interface vcan0: sudo modprobe vcan; "
            "sudo ip link add dev vcan0 type vcan; sudo ip link set up vcan0",
        ),
        (
            OSError(errno.EPERM, "Operation not permitted"),
            "cannot open bus 'socketcan:vcan0': Operation not permitted",
        ),
        (RuntimeError(), "cannot open bus 'socketcan:vcan0': RuntimeError"),
        (RuntimeError("two\nlines"), "cannot open bus 'socketcan:vcan0': two lines"),
    ],
)
def test_socketcan_tells_what_is_missing(error, expected, monkeypatch):
    monkeypatch.setattr(can, "Bus", raising(error))
    assert failure("socketcan:vcan0") == expected


def test_a_missing_adapter_is_no_case_for_vcan(monkeypatch):
    monkeypatch.setattr(can, "Bus", raising(OSError(errno.ENODEV, "No such device")))
    line = failure("socketcan:can0")
    assert line.startswith("no such CAN interface can0: is the adapter plugged in")
    assert "sudo ip link set can0 up type can bitrate 500000" in line
    assert "vcan" not in line


def test_python_can_says_nothing_beside_our_line(monkeypatch, capfd):
    root, library = logging.getLogger(), logging.getLogger("can")
    monkeypatch.setattr(root, "handlers", [])  # as in a program: pytest's would take the record

    def bus(**kwargs: Any) -> can.BusABC:
        logging.getLogger("can.interfaces.socketcan.socketcan").error("Could not access ...")
        raise OSError(errno.ENODEV, "No such device")

    monkeypatch.setattr(can, "Bus", bus)
    before = library.propagate, list(library.handlers)
    assert failure("socketcan:vcan9").startswith("no such CAN interface vcan9: ")
    assert capfd.readouterr().err == ""
    assert (library.propagate, library.handlers) == before


def test_interface_that_is_down(tmp_path, monkeypatch, opened):
    monkeypatch.setattr(bus_module, "_NETWORK", tmp_path)
    flags = tmp_path / "vcan9" / "flags"
    flags.parent.mkdir()
    flags.write_text("0x80\n")
    expected = "CAN interface vcan9 is down: sudo ip link set up vcan9"
    assert failure("socketcan:vcan9") == expected
    flags.write_text("0x81\n")
    open_bus("socketcan:vcan9")
    assert opened["channel"] == "vcan9"


def test_interface_without_can_fd(tmp_path, monkeypatch, opened):
    monkeypatch.setattr(bus_module, "_NETWORK", tmp_path)
    mtu = tmp_path / "vcan9" / "mtu"
    mtu.parent.mkdir()
    mtu.write_text("16\n")
    open_bus("socketcan:vcan9")
    with pytest.raises(BusError, match=r"^CAN interface vcan9 carries no CAN FD frames: sudo ip "):
        open_bus("socketcan:vcan9", fd=True)
    mtu.write_text("72\n")
    open_bus("socketcan:vcan9", fd=True)
    assert opened["fd"] is True


def test_missing_package_comes_with_its_recipe(monkeypatch):
    error = can.CanInterfaceNotImplementedError("msgpack not installed")
    monkeypatch.setattr(can, "Bus", raising(error))
    assert failure("udp_multicast:239.74.163.2") == (
        "cannot open bus 'udp_multicast:239.74.163.2': msgpack not installed: "
        "pip install 'python-can[multicast]'"
    )
