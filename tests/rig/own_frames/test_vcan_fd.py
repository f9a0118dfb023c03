"""CAN FD on SocketCAN: a network of one's own on vcan0, candump and cantools beside it."""

from pathlib import Path

import pytest

from can_rig.controllers.our_law import PYTHON
from can_rig.errors import RigError
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import run_in_process
from can_rig.scenario.loading import load
from tests.helpers import record
from tests.rig.own_frames.scenarios import FD_SIGNALS, database, options
from tests.rig.own_frames.test_runs import by_cantools
from tests.vcan import TIMEOUT_S, beside, frames, on_two_buses, own_can, tool

pytestmark = pytest.mark.vcan

__all__ = ["own_can"]

TICKS = 60
IDS = {"reference": 1, "feedback": 2, "command_1": 3, "command_2": 4, "status": 5}
VALUE = "64|32@1- (1,0) [0|0]"


def fd_options(folder: Path) -> list[str]:
    """Frames of 12 bytes with floats, 29-bit identifiers and end-to-end protection."""
    path = folder / "fd.dbc"
    path.write_text(database(VALUE, 12, 0x98FF0000, types="1", fd=True))
    return [*options(path, FD_SIGNALS, data_ids=IDS), f"duration_s={TICKS / 1000}"]


def bare(line: list[str]) -> str:
    """A frame without its flags, because newer kernels set a flag for CAN FD."""
    identifier, _, rest = line[0].partition("##")
    return f"{identifier}##{rest[1:]}"


def test_two_nodes_and_what_candump_hears_of_them(tmp_path):
    words = fd_options(tmp_path)
    log = tmp_path / "bus.log"
    candump = ("candump", "-l", "-r", 8 << 20, "-n", 5 * TICKS, "vcan0")
    with beside(*candump, cwd=tmp_path) as heard:
        summary = on_two_buses("socketcan:vcan0", "socketcan:vcan0", log, *words)
        heard.wait(TIMEOUT_S)
    assert summary.ticks == TICKS
    seen = frames(log)
    assert len(seen) == 5 * TICKS and all("##" in frame for frame, *_ in seen)
    (other,) = tmp_path.glob("candump-*.log")
    assert sorted(map(bare, frames(other))) == sorted(map(bare, seen))
    (tmp_path / "logs").mkdir()
    without = record(tmp_path / "logs", *words)[0]
    assert seen == frames(without)
    said = by_cantools(other, tmp_path / "fd.dbc", FD_SIGNALS)
    assert [len(column) for column in said.values()] == [TICKS] * len(FD_SIGNALS)


def test_an_interface_without_can_fd_is_one_line(own_can, tmp_path):
    words = fd_options(tmp_path)
    tool("ip", "link", "set", "down", own_can)
    tool("ip", "link", "set", own_can, "mtu", 16)
    tool("ip", "link", "set", "up", own_can)
    with pytest.raises(RigError, match=rf"^CAN interface {own_can} carries no CAN FD") as caught:
        run_in_process(
            load("default", words), f"socketcan:{own_can}", tmp_path / "bus.log", StopRequest(),
            lambda tick: None, PYTHON,
        )  # fmt: skip
    assert "\n" not in str(caught.value)
