"""Both nodes as separate processes: forked from this process, watched, and their exits judged.

Forking gives a node every imported module and all compiled code of this process. This process runs
no thread at the time of a fork, so a child never inherits a locked lock.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any, Final

from can_rig.errors import RigError, SilentNodeError, one_line
from can_rig.nodes.agreement import is_shared
from can_rig.nodes.bursts import warm_up
from can_rig.nodes.bus_access import OnTick, Progress, StopRequest, Throttled, no_progress
from can_rig.nodes.runner import RunOptions, run_controller, run_plant
from can_rig.nodes.scheduling import one_core
from can_rig.nodes.ticks import NodeSummary, without_garbage_pauses
from can_rig.scenario.settings import Scenario

ENDS_WITHIN_S: Final = 4.0
"""The watchdog of a node, and its bus that waits 2 s for slow listeners."""

STOPPING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Report = Callable[..., None]
"""Tells the parent process something by name: ``ready``, ``ticks``, ``summary``, ``error``."""

Node = Callable[[StopRequest, Report], NodeSummary]


@dataclass
class NodeProcess:
    """The process of one node, and its messages so far."""

    name: str
    process: ForkProcess
    connection: Connection
    said: dict[str, Any] = field(default_factory=dict)
    ended_s: float = math.inf

    @classmethod
    def fork(cls, name: str, node: Node, others: list[NodeProcess]) -> NodeProcess:
        """Fork ``node``; ``others`` are the processes forked before."""
        here, there = multiprocessing.Pipe(duplex=False)
        readers = [here, *(other.connection for other in others)]
        # Block signals until the node has a session and signal handlers of its own.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        arguments = (name, node, there, readers, before, os.getpid())
        process = multiprocessing.get_context("fork").Process(
            target=_node_main, args=arguments, name=f"{name} node", daemon=True
        )
        try:
            with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
                process.start()  # Python 3.12 warns of any thread; OpenBLAS restarts its own
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        there.close()
        return cls(name, process, here)

    def listen(self) -> bool:
        """Receive one message of the node; returns False at the end."""
        try:
            self.said.update(self.connection.recv())
        except (EOFError, OSError):
            return False
        return True

    @property
    def ticks(self) -> int:
        """The number of completed ticks in the node's reports."""
        summary: NodeSummary | None = self.said.get("summary")
        return int(self.said.get("ticks", 0)) if summary is None else summary.ticks

    def kill(self) -> None:
        """Leave nothing behind."""
        if self.process.is_alive():
            self.process.kill()
        self.process.join()
        self.connection.close()


def _node_main(
    name: str,
    node: Node,
    connection: Connection,
    readers: list[Connection],
    signals: set[signal.Signals],
    parent: int,
) -> None:
    """Run the forked process in a new session, so that Ctrl-C reaches the parent only.

    ``readers`` are the parent's pipe ends: a child that kept the ends open would miss the parent's
    death. ``signals`` are the blocked ones from now on.
    """
    os.setsid()
    with suppress(OSError):  # Linux alone has it
        Path("/proc/self/comm").write_text(f"rig-{name}", encoding="ascii")
    for reader in readers:
        reader.close()
    stop = StopRequest(parent).on_signals()
    signal.pthread_sigmask(signal.SIG_SETMASK, signals)

    def report(**said: object) -> None:
        try:
            connection.send(said)
        except OSError:  # the parent has been killed
            stop.wanted = True

    try:
        report(summary=node(stop, report))
    except (RigError, OSError) as error:  # of the system: too many open files, for one
        refused = error if isinstance(error, RigError) else RigError(one_line(error))
        report(error=refused)
        sys.exit(refused.exit_status)


def run_processes(
    scenario: Scenario,
    bus: str,
    log: Path,
    stop: StopRequest,
    options: RunOptions,
    progress: Progress = no_progress,
) -> NodeSummary:
    """Run the plant and the controller as two processes, in lockstep on one core where possible.

    In real time each node has a core of its own if possible. ``progress`` is entered after both
    forks. A stopped run has fewer ticks than the scenario.

    Raises:
        SilentNodeError: a node died or stayed silent for too long; the message names the node.
        RigError: a node refused to start; the node's error line gives the reason.
    """
    processes: list[NodeProcess] = []
    options = replace(options, shared=is_shared(bus))

    def controller(stop: StopRequest, report: Report) -> NodeSummary:
        ready, on_tick = partial(report, ready=True), Throttled(lambda tick: report(ticks=tick))
        return run_controller(scenario, bus, stop, ready, on_tick, options)

    def plant(stop: StopRequest, report: Report) -> NodeSummary:
        on_tick = Throttled(lambda tick: report(ticks=tick))
        return run_plant(scenario, bus, log, stop, on_tick, options)

    if options.bursts:
        warm_up()
    try:
        # Forked processes search no garbage among the objects of this process either.
        with nullcontext() if options.real_time else one_core(), without_garbage_pauses():
            first = NodeProcess.fork("controller", controller, processes)
            processes.append(first)  # first: a waiting plant repeats its offer on the bus
            _watch(processes, stop, until=lambda: "ready" in first.said)
            if "ready" in first.said and not stop.wanted:
                processes.append(NodeProcess.fork("plant", plant, processes))
        with progress() as on_tick:
            _watch(processes, stop, on_tick=on_tick)
        return _conclude(processes)
    finally:
        for process in processes:
            process.kill()


def in_another_process(
    work: Callable[[OnTick], None], called: str, stop: StopRequest, silence_s: float
) -> None:
    """Do ``work`` in a process of its own, because code of the user's may crash or never return.

    Args:
        work: is given a function to call again and again.
        called: names the user's code in an error.
        stop: ends the work at once; the caller looks at ``stop`` afterwards.
        silence_s: the longest permitted time between two such calls.

    Raises:
        SilentNodeError: the process died or fell silent.
        RigError: from ``work``.
    """

    def node(_: StopRequest, report: Report) -> NodeSummary:
        work(Throttled(lambda done: report(ticks=done), stride=1))
        return NodeSummary(0, 0.0, {}, {})

    check = NodeProcess.fork("check", node, [])

    def is_done() -> bool:
        return "summary" in check.said or "error" in check.said

    try:
        _watch([check], StopRequest(), lambda: stop.wanted or is_done(), silence_s=silence_s)
        if is_done():
            check.process.join(ENDS_WITHIN_S)  # Python waits for a thread of the user's
        status = check.process.exitcode
        if "summary" in check.said or stop.wanted:
            return
        if "error" in check.said:
            raise check.said["error"]
        end = f"did not answer for {silence_s:g} s" if status is None else _ending(status)
        raise SilentNodeError(f"the check before the run, which calls {called}, {end}")
    finally:
        check.kill()


def _watch(
    processes: list[NodeProcess],
    stop: StopRequest,
    until: Callable[[], bool] = lambda: False,
    on_tick: OnTick = lambda tick: None,
    silence_s: float = math.inf,
) -> None:
    """Receive the nodes' messages until ``until()`` is true or all nodes have ended.

    A stop request ends the plant after its tick, then the controller. After the end of one node,
    the other node gets the time of its own watchdog to end. ``silence_s`` without any message ends
    the wait.
    """
    deadline_s = math.inf
    asked = False
    open_: dict[Any, NodeProcess] = {each.connection: each for each in processes}
    heard_s = time.monotonic()
    while open_ and not until() and time.monotonic() < min(deadline_s, heard_s + silence_s):
        if stop.wanted and not asked:
            asked = True
            deadline_s = time.monotonic() + ENDS_WITHIN_S
            processes[-1].process.terminate()  # the node ends after its tick
        for ready in wait(list(open_), timeout=0.1):
            process, heard_s = open_[ready], time.monotonic()
            if not process.listen():
                del open_[ready]
                process.process.join()
                process.ended_s = time.monotonic()
                deadline_s = process.ended_s + ENDS_WITHIN_S
                if stop.wanted:
                    processes[0].process.terminate()
        on_tick(processes[-1].ticks)


def _ending(status: int) -> str:
    """How a process with this exit status ended."""
    if status < 0:
        return f"was ended by {signal.Signals(-status).name}"
    return f"ended with exit status {status}"


def _conclude(processes: list[NodeProcess]) -> NodeSummary:
    """The summary of a run after all nodes ended, or the error of the first node that failed."""
    for each in sorted(processes, key=lambda each: each.ended_s):
        if "summary" in each.said:
            continue  # ended, or waits for a thread of a user's controller
        status = each.process.exitcode
        if "error" in each.said:
            error = each.said["error"]
            raise type(error)(f"{each.name} node: {error}")
        if status is None:
            raise SilentNodeError(f"the {each.name} node does not end")
        if status < 0:  # the number of ticks is reported at times
            raise SilentNodeError(
                f"the {each.name} node {_ending(status)} after {processes[-1].ticks} ticks or more"
            )
        raise SilentNodeError(f"{each.name} node: {_ending(status)}")
    summaries: list[NodeSummary] = [each.said["summary"] for each in processes]
    total = NodeSummary(processes[-1].ticks, summaries[-1].wall_s, {}, {})
    for one in summaries:
        total.rejected_frames |= one.rejected_frames
        total.bus_events |= one.bus_events
        if one.realtime is not None:
            before = total.realtime or {"scheduling": {}}
            scheduling = before["scheduling"] | one.realtime["scheduling"]
            total.realtime = {**before, **one.realtime, "scheduling": scheduling}
    return total
