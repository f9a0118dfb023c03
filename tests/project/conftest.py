"""The guest of ``tools/vcan_guest``, for every test of it."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

GUEST = Path(__file__).parents[2] / "tools" / "vcan_guest"


@pytest.fixture
def guest(tmp_path):
    """Starts it in a session and with a TMPDIR of its own; nothing of it is there afterwards."""
    if shutil.which("linux.uml") is None and os.environ.get("CAN_RIG_VCAN") != "required":
        pytest.skip("NOT TESTED: no user-mode-linux here: apt-get install user-mode-linux")
    temporary, started = tmp_path / "tmp", []
    temporary.mkdir()

    def start(*arguments, **options):
        environment = {**os.environ, "TMPDIR": str(temporary), **options.pop("env", {})}
        process = subprocess.Popen(
            [GUEST, *map(str, arguments)], env=environment, text=True, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options,
        )  # fmt: skip
        started.append(process)
        return process

    yield start
    running = [process for process in started if process.poll() is None]
    for process in running:
        process.terminate()
        process.communicate(timeout=60)
    assert running == []
    assert list(temporary.iterdir()) == []
    name = f"VCAN_GUEST={temporary}".encode()  # a command line has any bytes
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            assert name not in path.read_bytes()
        except OSError:
            continue  # it has just ended
