"""The whole node in C at the other end of a serial port: a program behind a pseudo-terminal."""

from __future__ import annotations

import os
import subprocess
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.errors import ExportError
from can_rig.export import SERIAL, ecus
from can_rig.export.application import application, exported, identity, write
from can_rig.export.controllers import PYTHON, controller_of
from can_rig.export.ecus import ORDER_BYTES, BenchEcu, SerialLink, serial_ecu
from tests.rig.export.test_controller_c import log_of

SETTINGS = ["duration_s=1.2", 'fault.kind="frames-corrupted"', "fault.at_s=0.5", "fault.for_s=0.3"]
SCENARIO = load("default", SETTINGS)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("serial") / "out"
    write(exported(SCENARIO), folder, force=False)
    subprocess.run(["make", "-s", "-C", str(folder), "bench"], check=True, timeout=120)
    return folder / "bench"


@contextmanager
def board(*command: str | Path) -> Iterator[str]:
    """A port with a program at its other end."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    running = subprocess.Popen([*map(str, command)], stdin=ours, stdout=ours)
    try:
        yield os.ttyname(theirs)
    finally:
        running.kill()
        running.wait()
        os.close(ours)
        os.close(theirs)


def test_a_board_sends_the_same_bytes(program: Path, tmp_path: Path) -> None:
    python = log_of("default", SETTINGS, PYTHON, tmp_path / "python")
    with board(program) as port:
        node = controller_of(f"{SERIAL}{port}", SCENARIO)
        assert python == log_of("default", SETTINGS, node, tmp_path / "first")
        assert python == log_of("default", SETTINGS, node, tmp_path / "again")


@pytest.mark.parametrize("cut_short", [b"F", b"F\x01\x02", b"C", b"R" + bytes(10), b"xyz"])
def test_what_was_cut_short_is_forgotten(
    program: Path, cut_short: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ecus, "QUIET_S", 0.5)  # the board is a program on a busy machine
    with board(program) as port:
        link = SerialLink(port)
        link.write(cut_short)
        link.close()
        ecu = serial_ecu(port, identity(application(SCENARIO)), "default")
        assert ecu.take(0x7FF, b"12345678") == []
        assert ecu.counts() == [0] * 20
        ecu.close()


def test_another_controller_is_refused(program: Path) -> None:
    with board(program) as port, pytest.raises(ExportError, match="another controller answers"):
        serial_ecu(port, identity(application(load("noisy", []))), "noisy")


def test_a_board_that_is_silent_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ecus, "SILENCE_S", 0.05)
    with board("sleep", "60") as port, pytest.raises(ExportError, match=f"{port}: 0 of 8 bytes"):
        serial_ecu(port, bytes(8), "default")


def test_an_answer_that_is_none_is_one_line() -> None:
    asked_for = f"head -c {ORDER_BYTES + 1} > /dev/null"  # what clears the line, and an order
    with board("sh", "-c", f"{asked_for}; printf '%s' xxxxxxxxxxxxx; sleep 60") as port:
        ecu = BenchEcu(SerialLink(port))
        with pytest.raises(ExportError, match="sent 120 frames"):
            ecu.take(0x100, bytes(8))


def test_a_port_that_is_none_is_one_line(tmp_path: Path) -> None:
    controller = f"{SERIAL}{tmp_path}/none"
    command = ["run", "default", "--in-process", "--controller", controller]
    done = CliRunner().invoke(main, [*command, "--out", str(tmp_path / "run")])
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert f"{tmp_path}/none: cannot be opened as a serial port" in line


@pytest.mark.parametrize("name", ["arm:serial:", "arm:m3", "fortran"])
def test_a_controller_that_is_none_is_refused(name: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(main, ["run", "--controller", name, "--out", str(tmp_path / "run")])
    assert done.exit_code == 2
    said = f"{name!r} is not one of python, c, ecu, arm:m4f, arm:m7, arm:serial:PORT."
    assert said in done.stderr
