"""What the tests on vcan0 share: interfaces of their own, can-utils beside the loop, its log."""

import shutil
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from can_rig.controllers.our_law import PYTHON
from can_rig.nodes.bus_access import StopRequest, Timeouts
from can_rig.nodes.runner import RunOptions, run_controller, run_plant
from can_rig.nodes.ticks import NodeSummary
from can_rig.scenario.loading import load

TIMEOUT_S = 120.0  # for what must come; the guest is slow, an import takes up to 20 s
PATIENT = RunOptions(timeouts=Timeouts(first_s=TIMEOUT_S, silence_s=TIMEOUT_S), controller=PYTHON)


def tool(*command: object, **options: object) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; a machine with vcan0 has its package, so no test skips."""
    return subprocess.run(
        list(map(str, command)), check=True, timeout=TIMEOUT_S, text=True, capture_output=True,
        **options,
    )  # fmt: skip


@pytest.fixture
def own_can(request):
    """An interface of the test's own, up."""
    name = f"vcan{90 + len(request.node.name) % 10}"
    try:
        tool("ip", "-batch", "-", input=f"link add dev {name} type vcan\nlink set up {name}\n")
    except subprocess.CalledProcessError:
        pytest.skip("NOT TESTED: only root makes CAN interfaces; tools/vcan_guest has one")
    yield name
    tool("ip", "link", "del", name)


def listeners() -> int:
    """How many raw sockets and gateway rules are on CAN interfaces."""
    lists = Path("/proc/net/can").glob("rcvlist_*")
    return sum(line.count("  vcan") for path in lists for line in path.read_text().splitlines())


@contextmanager
def beside(*command: object, listens: bool = True, **options: object):
    """A program on the bus, there when the block begins; ended as Ctrl-C ends it."""
    assert shutil.which(str(command[0])), f"{command[0]} is missing: apt-get install can-utils"
    before = listeners()
    process = subprocess.Popen(
        list(map(str, command)),
        **{"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, **options},
    )
    try:
        deadline = time.monotonic() + TIMEOUT_S
        while listens and listeners() == before:
            assert process.poll() is None, f"{command} has ended"
            assert time.monotonic() < deadline
            time.sleep(0.01)
        yield process
    finally:
        process.send_signal(2)
        try:
            process.wait(TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


def on_two_buses(
    plant_bus: str, controller_bus: str, log: Path, *settings: str, on_tick=lambda tick: None
) -> NodeSummary:
    """Both nodes in this process, each on its own bus; ``on_tick`` runs while both wait."""
    scenario, stop = load("thesis-step", settings), StopRequest()
    ended: list[NodeSummary] = []
    ready = threading.Event()

    def plant() -> None:
        ready.wait()
        ended.append(run_plant(scenario, plant_bus, log, stop, lambda tick: None, PATIENT))

    thread = threading.Thread(target=plant)
    thread.start()
    try:
        other = run_controller(scenario, controller_bus, stop, ready.set, on_tick, PATIENT)
    except BaseException:
        stop.wanted = True
        raise
    finally:
        ready.set()
        thread.join()
    (summary,) = ended
    summary.rejected_frames |= other.rejected_frames
    summary.bus_events |= other.bus_events
    return summary


def frames(log: Path) -> list[list[str]]:
    """Of each line of a log that candump or the rig wrote, frame and mark; without its time."""
    return [line.split()[2:] for line in log.read_text().splitlines()]


def frame(identifier: int, data: bytes = b"", **kwargs: object) -> can.Message:
    return can.Message(
        **{"arbitration_id": identifier, "is_extended_id": False, "data": data, **kwargs}
    )
