"""What the tests of the rig share: the command line as a process, and both nodes in this one."""

import os
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest
from click.testing import CliRunner

from can_rig.cli.main import main
from can_rig.controllers.making import PEER
from can_rig.controllers.our_law import PYTHON
from can_rig.controllers.protocol import Supplied
from can_rig.errors import RigError, ScenarioError
from can_rig.nodes.bus_access import StopRequest
from can_rig.nodes.runner import RunOptions, run_controller, run_in_process, run_plant
from can_rig.nodes.ticks import NodeSummary
from can_rig.nodes.without_bus import run_without_bus
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from tests.processes import rig, start

__all__ = ["DBC", "NAMES", "asked", "decoded", "on_a_bus", "on_no_bus", "record", "refused",
           "refuses", "rig", "sets", "start", "succeeded", "two_nodes"]  # fmt: skip

DBC = Path(__file__).parents[1] / "dbc"
NAMES = (
    "DSTAR_REFERENCE", "DSTAR_FEEDBACK", "STEER_TORQUE_CMD", "FORCE_DIFF_CMD", "CONTROLLER_STATUS",
)  # fmt: skip


def asked(*arguments: object) -> subprocess.CompletedProcess[str]:
    """``can-rig`` with ``arguments`` in this process: for what ends soon and starts no node."""
    words = list(map(str, arguments))
    result = CliRunner().invoke(main, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return subprocess.CompletedProcess(words, result.exit_code, result.stdout, result.stderr)


def succeeded(*arguments: object) -> subprocess.CompletedProcess[str]:
    """The same of a command that succeeds."""
    done = asked(*arguments)
    assert done.returncode == 0, done.stderr
    return done


def refused(*arguments: object) -> str:
    """The one line with which ``can-rig`` refuses ``arguments``."""
    done = asked(*arguments)
    assert done.returncode == 2, done.stderr
    (line,) = done.stderr.splitlines()
    return line


def sets(*settings: str) -> list[str]:
    """The words that give ``settings`` to a command."""
    return [word for setting in settings for word in ("--set", setting)]


@contextmanager
def refuses(
    text: str, kind: type[RigError] | tuple[type[RigError], ...] = ScenarioError
) -> Iterator[pytest.ExceptionInfo[RigError]]:
    """The block must raise a refusal of one line with ``text``."""
    with pytest.raises(kind) as caught:
        yield caught
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def on_a_bus(
    scenario: Scenario,
    log: Path,
    controller: Supplied = PYTHON,
    bus: str = "virtual:test",
    **more: Any,
) -> NodeSummary:
    """Both nodes in this process."""
    stop = StopRequest()
    return run_in_process(scenario, bus, log, stop, lambda tick: None, controller, **more)


@contextmanager
def two_nodes(
    plant: Scenario, controller: Scenario, bus: str, log: Path | None, options: RunOptions
) -> Iterator[dict[str, Future[NodeSummary]]]:
    """Both nodes in threads; the block begins when the controller listens, which it does first."""
    stop, ready = StopRequest(), threading.Event()

    def run_the_plant() -> NodeSummary:
        ready.wait()
        return run_plant(plant, bus, log, stop, lambda tick: None, options)

    with ThreadPoolExecutor() as threads:
        run = controller, bus, stop, ready.set, lambda tick: None, options
        listening = threads.submit(run_controller, *run)
        listening.add_done_callback(lambda _: ready.set())
        ended = {"controller": listening, "plant": threads.submit(run_the_plant)}
        ready.wait()
        try:
            yield ended
        except BaseException:
            stop.wanted = True
            raise


def on_no_bus(scenario: Scenario, log: Path) -> NodeSummary:
    """The same without a bus."""
    return run_without_bus(scenario, log, StopRequest(), lambda tick: None)


def record(
    folder: Path, *settings: str, bus: str = "virtual:test", name: str = "thesis-step"
) -> tuple[Path, NodeSummary, Scenario]:
    """Both nodes in this process; where the log is, and how it went."""
    scenario = load(name, settings)
    log = folder / f"{len(os.listdir(folder))}.log"  # noqa: PTH208
    controller = PYTHON if scenario.controller.is_ours else PEER
    return log, on_a_bus(scenario, log, controller, bus), scenario


def decoded(log: Path, dbc: str = "steer_by_wire.dbc") -> dict[str, np.ndarray]:
    """The one value of every frame of ``log`` by message, by cantools alone; checks nothing."""
    database = cantools.database.load_file(DBC / dbc)
    values: dict[str, list[float]] = {message.name: [] for message in database.messages}
    for frame in can.LogReader(log):
        message = database.get_message_by_frame_id(frame.arbitration_id)
        signals = message.decode(frame.data, decode_choices=False)
        values[message.name].append(signals[message.signals[-1].name])
    return {name: np.array(column) for name, column in values.items()}
