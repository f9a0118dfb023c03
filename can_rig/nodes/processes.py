"""Start both nodes as processes, watch both, and tell what happened to either."""

from __future__ import annotations

import json
import math
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from can_rig.errors import RigError, SilentNodeError
from can_rig.nodes.lockstep import StopRequest, Waiting
from can_rig.nodes.nodes import NodeName, NodeSummary

ENDS_WITHIN_S = 4.0  # the watchdog of a node, and its bus that waits 2 s for slow listeners


@dataclass
class Child:
    """One node's process and what it has said so far."""

    name: NodeName
    process: subprocess.Popen[bytes]
    unread: bytes = b""
    said: dict[str, Any] = field(default_factory=dict)
    ended_s: float = math.inf

    @classmethod
    def start(cls, name: NodeName, arguments: Sequence[str]) -> Child:
        """Start ``can-rig NAME`` in a session of its own, so that Ctrl-C reaches only us."""
        command = [sys.executable, "-m", "can_rig", name, *arguments, "--json"]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, start_new_session=True
        )
        return cls(name, process)

    def read(self) -> bool:
        """Take in what it has printed; False at the end of its output."""
        assert self.process.stdout is not None
        text = os.read(self.process.stdout.fileno(), 65536)
        *lines, self.unread = (self.unread + text).split(b"\n")
        for line in lines:
            self.said.update(json.loads(line))
        return bool(text)

    def ask_to_stop(self) -> None:
        """The node ends after its tick, or at once where it is still starting."""
        self.process.terminate()

    def kill(self) -> None:
        """Leave nothing behind."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()


def run_processes(
    arguments: Sequence[str],
    log: Path,
    stop: StopRequest,
    on_tick: Callable[[int], None],
    real_time: bool = False,
) -> NodeSummary:
    """Run the plant and the controller as two processes, in lockstep on one core where possible.

    Args:
        arguments: scenario, ``--set`` and bus options, as each node takes them.
        log: where the plant node records.
        stop: ends the run after a tick.
        on_tick: called now and then with the number of ticks completed.
        real_time: by the wall clock, each on a core of its own where possible.

    Returns:
        The summary; fewer ticks than the scenario's where the run was stopped.

    Raises:
        SilentNodeError: a node died or said nothing for too long; the message names it.
        RigError: a node refused to start; its own line says why.
    """
    children: list[Child] = []
    to_plant = ["--log", str(log)]
    if real_time:
        arguments = [*arguments, "--realtime"]
        to_plant += ["--silence", f"{Waiting().silence_s:g}"]  # by hand it would drive on alone
    try:
        with nullcontext() if real_time else _one_core():
            controller = Child.start("controller", arguments)
            children.append(controller)  # first: a plant that waits repeats its offer on the bus
            _watch(children, stop, until=lambda: "ready" in controller.said)
            if "ready" in controller.said and not stop.wanted:
                children.append(Child.start("plant", [*arguments, *to_plant]))
        _watch(children, stop, progress=lambda: on_tick(_ticks(children)))
        return _conclude(children, stop)
    finally:
        for child in children:
            child.kill()


def _watch(
    children: list[Child],
    stop: StopRequest,
    until: Callable[[], bool] = lambda: False,
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Read what the nodes say until ``until()`` or all have ended.

    A stop request ends the plant after its tick, then the controller. When one node has ended, the
    other gets as long as its own watchdog needs.
    """
    deadline = math.inf
    asked = False
    with selectors.DefaultSelector() as selector:
        for child in children:
            assert child.process.stdout is not None
            selector.register(child.process.stdout, selectors.EVENT_READ, child)
        while selector.get_map() and not until() and time.monotonic() < deadline:
            if stop.wanted and not asked:
                asked = True
                deadline = time.monotonic() + ENDS_WITHIN_S
                children[-1].ask_to_stop()
            for key, _ in selector.select(timeout=0.1):
                child = key.data
                if not child.read():
                    selector.unregister(key.fileobj)
                    child.process.wait()
                    child.ended_s = time.monotonic()
                    deadline = child.ended_s + ENDS_WITHIN_S
                    if stop.wanted:
                        children[0].ask_to_stop()
            progress()


def _conclude(children: list[Child], stop: StopRequest) -> NodeSummary:
    """The summary of a run whose nodes have ended, or the error of the first that ended badly."""
    for child in sorted(children, key=lambda child: child.ended_s):
        status = child.process.poll()
        if status is None:
            raise SilentNodeError(f"the {child.name} node does not end")
        if status in (-signal.SIGTERM, -signal.SIGINT) and stop.wanted:
            continue  # it was still starting, or not yet in a session of its own
        if status < 0:
            raise SilentNodeError(
                f"the {child.name} node was ended by {signal.Signals(-status).name} "
                f"after {_ticks(children)} ticks"
            )
        if status > 0:
            error = child.said.get("error", f"exit status {status}")
            kind = SilentNodeError if status == SilentNodeError.exit_status else RigError
            raise kind(f"{child.name} node: {error}")
    rejected: dict[str, dict[str, int]] = {}
    events: dict[str, dict[str, int]] = {}
    realtime: dict[str, Any] | None = None
    for child in children:
        rejected |= child.said.get("rejected_frames", {})
        events |= child.said.get("bus_events", {})
        if figures := child.said.get("realtime"):
            scheduling = (realtime or {}).get("scheduling", {}) | figures["scheduling"]
            realtime = {**(realtime or {}), **figures, "scheduling": scheduling}
    wall_s = children[-1].said.get("wall_s", 0.0)
    return NodeSummary(_ticks(children), wall_s, rejected, events, realtime)


def _ticks(children: list[Child]) -> int:
    return int(children[-1].said.get("ticks", 0))


@contextmanager
def _one_core() -> Iterator[None]:
    """Let children started inside share one core and leave it only when they wait.

    Nodes in lockstep alternate, and waking another core costs more than the tick. Under SCHED_BATCH
    a frame does not preempt its sender, so a tick is two switches and not up to five. Runs side by
    side get different cores, as far as there are.
    """
    if not hasattr(os, "sched_setaffinity"):  # Linux alone has it
        yield
        return
    cores, policy, priority = (
        os.sched_getaffinity(0),
        os.sched_getscheduler(0),
        os.sched_getparam(0),
    )
    os.sched_setaffinity(0, {sorted(cores)[os.getpid() % len(cores)]})
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)
        os.sched_setaffinity(0, cores)
