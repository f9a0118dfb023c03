"""``can-rig`` as a process of its own, which no test leaves behind."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

_started: list[subprocess.Popen[str]] = []


def start(*arguments: object, **options: object) -> subprocess.Popen[str]:
    """``can-rig`` with ``arguments``, in a session of its own, its output to be collected."""
    process = subprocess.Popen(
        [sys.executable, "-m", "can_rig", *map(str, arguments)],
        **{
            "stdout": subprocess.PIPE,
            "stderr": subprocess.PIPE,
            "stdin": subprocess.DEVNULL,
            "text": True,
            "start_new_session": True,
            **options,
        },
    )
    _started.append(process)
    return process


def end_all() -> None:
    """Kill what a test has started and not seen to its end, with all that it started itself."""
    while _started:
        process = _started.pop()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def rig(*arguments: object, **options: object) -> subprocess.CompletedProcess[str]:
    """``can-rig`` with ``arguments``, to its end."""
    process = start(*arguments, **options)
    out, err = process.communicate(timeout=300)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def wait_for(condition: Callable[[], Any]) -> Any:
    """The first true value of ``condition()``; never hangs."""
    deadline = time.monotonic() + 60.0
    while not (found := condition()):
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.005)
    return found
