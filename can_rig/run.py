"""Start both nodes as processes, watch both, and tell what happened to either."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from can_rig.errors import RigError, SilentNodeError
from can_rig.nodes import NodeName, NodeSummary

ENDS_WITHIN_S = 3.0  # the watchdog of a node plus its way out


@dataclass
class Child:
    """One node's process and what it has said so far."""

    name: NodeName
    process: subprocess.Popen[bytes]
    unread: bytes = b""
    said: dict[str, Any] = field(default_factory=dict)

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
        """The node ends after its tick."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)

    def kill(self) -> None:
        """Leave nothing behind."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()

    @property
    def killed_by(self) -> str | None:
        """Name of the signal that ended it, if one did."""
        status = self.process.poll()
        return signal.Signals(-status).name if status is not None and status < 0 else None


def run_processes(
    arguments: Sequence[str], log: Path, on_tick: Callable[[int], None]
) -> tuple[NodeSummary, bool]:
    """Run the plant and the controller as two processes, on one core where that is possible.

    Args:
        arguments: scenario, ``--set`` and bus options, as each node takes them.
        log: where the plant node records.
        on_tick: called now and then with the number of ticks completed.

    Returns:
        The summary, and whether the run was interrupted.

    Raises:
        SilentNodeError: a node died or said nothing for too long; the message names it.
        RigError: a node refused to start; its own line says why.
    """
    children: list[Child] = []
    try:
        with _one_core():
            controller = Child.start("controller", arguments)
            children.append(controller)
            interrupted = _watch(children, until=lambda: "ready" in controller.said)
            if "ready" in controller.said and not interrupted:
                children.append(Child.start("plant", [*arguments, "--log", str(log)]))
        if not interrupted:
            interrupted = _watch(
                children, until=lambda: False, progress=lambda: on_tick(_ticks(children))
            )
        return _conclude(children), interrupted
    finally:
        for child in children:
            child.kill()


def _watch(
    children: list[Child],
    until: Callable[[], bool],
    progress: Callable[[], None] = lambda: None,
) -> bool:
    """Read what the nodes say until ``until()`` or both have ended; whether Ctrl-C was pressed.

    Ctrl-C stops the plant after its tick, then the controller. When one node has ended, the other
    gets as long as its own watchdog needs.
    """
    interrupted = False
    deadline = float("inf")
    with selectors.DefaultSelector() as selector:
        for child in children:
            assert child.process.stdout is not None
            selector.register(child.process.stdout, selectors.EVENT_READ, child)
        while selector.get_map() and not until():
            try:
                for key, _ in selector.select(timeout=0.1):
                    if not key.data.read():
                        selector.unregister(key.fileobj)
                        key.data.process.wait()
                        deadline = time.monotonic() + ENDS_WITHIN_S
                        if interrupted:
                            for child in children:
                                child.ask_to_stop()
                progress()
            except KeyboardInterrupt:
                interrupted = True
                deadline = time.monotonic() + ENDS_WITHIN_S
                children[-1].ask_to_stop()
            if time.monotonic() > deadline:
                break
    return interrupted


def _conclude(children: list[Child]) -> NodeSummary:
    """The summary of a run whose nodes have ended, or the error that says which did not end well."""
    plant = children[-1]
    for child in children:
        if child.killed_by is not None:
            raise SilentNodeError(
                f"the {child.name} node was ended by {child.killed_by} "
                f"after {_ticks(children)} ticks"
            )
        if child.process.poll() is None:
            raise SilentNodeError(f"the {child.name} node does not end")
    for child in reversed(children):
        if child.process.returncode:
            error = child.said.get("error", f"exit status {child.process.returncode}")
            kind = SilentNodeError if child.process.returncode == 3 else RigError
            raise kind(f"{child.name} node: {error}")
    rejected: dict[str, dict[str, int]] = {}
    for child in children:
        rejected |= child.said.get("rejected_frames", {})
    return NodeSummary(_ticks(children), plant.said.get("wall_s", 0.0), rejected)


def _ticks(children: list[Child]) -> int:
    return int(children[-1].said.get("ticks", 0))


@contextmanager
def _one_core() -> Iterator[None]:
    """Children started inside share one core: nodes in lockstep alternate, and waking another
    core costs more than the tick."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {max(before)})
    except OSError:
        yield
        return
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
