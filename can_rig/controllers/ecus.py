"""A controller node in C: in this process, on an emulated board, or on a board at a serial port.

Frames in, frames out. Boards answer a bench over a link of bytes: ``support/bench.h`` says how.
"""

import ctypes
import os
import select
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final, Protocol

from can_rig.controllers import SERIAL
from can_rig.controllers.compiled_law import CompiledLaw
from can_rig.controllers.our_law import in_node
from can_rig.controllers.protocol import COUNTS, Sent, Supplied, WholeNode
from can_rig.errors import ExportError, require
from can_rig.export.application import (
    IDENTITY_BYTES,
    ORDER_HEAD,
    SENT_HEAD,
    application,
    bench,
    identity,
)
from can_rig.export.boards import (
    COUNT,
    EMULATOR,
    RESTART,
    SURVIVE,
    emulation,
    firmware_image,
    frame_order,
    order,
)
from can_rig.export.compiler import host_compiler, loaded, shared_library
from can_rig.export.network_code import frame_bytes, sensors_of
from can_rig.frames.codec import FRAME_BYTES
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario

MOST_SENT: Final = 3


def in_c(name: str, scenario: Scenario) -> Supplied:
    """The rig's own law as C, or the whole node in C; see ``making.controller_of``."""
    if name == "c":
        return in_node(
            CompiledLaw(scenario.design.precision, changes_speed=scenario.drive.is_given)
        )
    network = network_of(scenario)
    receivers = network.offered + len(sensors_of(scenario, network))
    room = frame_bytes(network)
    if name == "ecu":
        library = host_library(scenario)
        return WholeNode(lambda: HostEcu(library, room))
    if name.startswith(SERIAL):
        expected = identity(application(scenario))
        port = name.removeprefix(SERIAL)
        return WholeNode(lambda: serial_ecu(port, expected, scenario.name, receivers, room))
    board = name.removeprefix("arm:")
    image = firmware_image(scenario, board)
    return WholeNode(lambda: BenchEcu(EmulatedBoard(image, board), receivers, room))


def sent(memory: bytes, n: int, room: int) -> Sent:
    """The first ``n`` frames that the harness has written, each with ``room`` for its data."""
    size = SENT_HEAD + room
    frames = (memory[i * size : (i + 1) * size] for i in range(n))
    return [
        (int.from_bytes(each[:4], "little"), each[SENT_HEAD : SENT_HEAD + each[4]])
        for each in frames
    ]


# --- in this process -----------------------------------------------------------------------------


def host_library(scenario: Scenario) -> Path:
    """The controller node of ``scenario`` as a library.

    Raises:
        ExportError: no compiler, or a compiler error.
    """
    node = application(scenario)
    harness = {name: text for name, text in bench(node).items() if name.startswith("harness")}
    return shared_library(node | harness)


class HostEcu:
    """``harness.c`` in this process; see ``Ecu``.

    Args:
        library: of ``host_library``.
        room: bytes of its longest frame; see ``frame_bytes``.

    Raises:
        ExportError: loading fails.
    """

    def __init__(self, library: Path, room: int = FRAME_BYTES) -> None:
        code = loaded(library)
        code.harness_size.restype = ctypes.c_size_t
        self._frame, self._counts = code.harness_frame, code.harness_counts
        self._frame.restype = ctypes.c_uint8
        self._receivers = int(code.harness_receivers())
        self._memory = ctypes.create_string_buffer(code.harness_size())
        self._sent = ctypes.create_string_buffer(MOST_SENT * (SENT_HEAD + room))
        self._room = room
        self._restart = code.harness_restart
        self._restart.restype = ctypes.c_bool
        self.restart()

    def restart(self, state_survives: bool = False) -> None:
        """See ``Ecu``."""
        if not self._restart(self._memory, state_survives):
            raise ExportError(
                f"{' '.join(host_compiler())}: the self-test of the controller in C failed: "
                "CC must be a compiler, with options, that computes as Python does"
            )

    def take(self, frame_id: int, data: bytes) -> Sent:
        """See ``Ecu``."""
        n = self._frame(self._memory, frame_id, len(data), data, self._sent)
        return sent(self._sent.raw, n, self._room)

    def counts(self) -> list[int]:
        """See ``Ecu``."""
        found = (ctypes.c_uint32 * (self._receivers * COUNTS))()
        self._counts(self._memory, found)
        return list(found)

    def close(self) -> None:
        """Nothing to do: the node ends with the process."""


# --- over a link ---------------------------------------------------------------------------------


class Link(Protocol):
    """Bytes to and from a program, in order."""

    def write(self, data: bytes) -> None:
        """Send all bytes."""

    def read(self, size: int) -> bytes:
        """The next ``size`` bytes.

        Raises:
            ExportError: the bytes do not arrive.
        """

    def close(self) -> None:
        """Close the link."""


class BenchEcu:
    """The program at the other end of ``link``; see ``Ecu``.

    Args:
        link: the link to the program.
        receivers: number of received frames: reference, feedback, speed, and each heard sensor's.
        room: bytes of its longest frame; see ``frame_bytes``.
    """

    def __init__(self, link: Link, receivers: int = 2, room: int = FRAME_BYTES) -> None:
        self._link, self._room = link, room
        self._receivers = receivers

    def restart(self, state_survives: bool = False) -> bytes:
        """See ``Ecu``; returns the controller's identity, 8 bytes."""
        return self._ask(order(SURVIVE if state_survives else RESTART, self._room), IDENTITY_BYTES)

    def take(self, frame_id: int, data: bytes) -> Sent:
        """See ``Ecu``."""
        (n,) = self._ask(frame_order(frame_id, data, self._room), 1)
        if n > MOST_SENT:
            raise ExportError(f"the controller says that it sent {n} frames: must be 0 to 3")
        return sent(self._link.read(n * (SENT_HEAD + self._room)), n, self._room)

    def counts(self) -> list[int]:
        """See ``Ecu``."""
        answer = self._ask(order(COUNT, self._room), 4 * self._receivers * COUNTS)
        return [int.from_bytes(answer[i : i + 4], "little") for i in range(0, len(answer), 4)]

    def close(self) -> None:
        """See ``Ecu``."""
        self._link.close()

    def _ask(self, said: bytes, size: int) -> bytes:
        self._link.write(said)
        return self._link.read(size)


# --- on a Cortex-M that QEMU emulates ------------------------------------------------------------

LOOK_S: Final = 0.5
MOST_WAITING: Final = 1 << 12


class EmulatedBoard:
    """A program of ``firmware_image`` on its board, by two named pipes; see ``Link``.

    Args:
        image: the program.
        board: a key of ``BOARDS``.

    Raises:
        ExportError: the emulator does not start.
    """

    def __init__(self, image: Path, board: str) -> None:
        self._folder = tempfile.mkdtemp(prefix="can-rig-")
        for pipe in ("orders", "answers"):
            os.mkfifo(Path(self._folder) / pipe)
        self._process = subprocess.Popen(
            emulation(image, board),
            cwd=self._folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
        )
        # Open for both directions: opening then never waits for the other side.
        self._orders = os.open(Path(self._folder) / "orders", os.O_RDWR)
        self._answers = os.open(Path(self._folder) / "answers", os.O_RDWR | os.O_NONBLOCK)
        self._waiting = b""

    def write(self, data: bytes) -> None:
        """See ``Link``."""
        os.write(self._orders, data)

    def read(self, size: int) -> bytes:
        """See ``Link``; looks now and then whether the emulator still runs."""
        while len(self._waiting) < size:
            ready, _, _ = select.select([self._answers], [], [], LOOK_S)
            if ready:
                self._waiting += os.read(self._answers, MOST_WAITING)
            elif self._process.poll() is not None:
                assert self._process.stderr is not None
                said = self._process.stderr.read().decode(errors="replace").strip()
                raise ExportError(f"{EMULATOR} has ended: {said or self._process.returncode}")
        answer, self._waiting = self._waiting[:size], self._waiting[size:]
        return answer

    def close(self) -> None:
        """See ``Link``."""
        for pipe in (self._orders, self._answers):
            os.close(pipe)
        self._process.kill()
        self._process.communicate()
        shutil.rmtree(self._folder, ignore_errors=True)


# --- at a serial port ----------------------------------------------------------------------------

BAUD: Final = 115_200
SILENCE_S: Final = 2.0
QUIET_S: Final = 0.1


class SerialLink:
    """A serial port with 8 data bits, no parity, 115200 baud; see ``Link``.

    Args:
        port: its device.
        room: bytes of the longest frame of the board's node.

    Raises:
        ExportError: opening fails.
        MissingExtraError: pyserial is not installed.
    """

    def __init__(self, port: str, room: int = FRAME_BYTES) -> None:
        require("serial", extra="serial")
        import serial  # noqa: PLC0415

        self._name = port
        self._failure: type[Exception] = serial.SerialException
        try:
            self._port = serial.Serial(port, BAUD, exclusive=True)
        except (OSError, ValueError) as error:
            raise ExportError(f"{port}: cannot be opened as a serial port: {error}") from None
        self.forget(ORDER_HEAD + room)

    def forget(self, longest: int) -> None:
        """End an interrupted order, and discard the rest of the last answer."""
        self.write(bytes(longest))
        self._port.timeout = QUIET_S
        while self._port.read(1 << 12):
            pass
        self._port.timeout = SILENCE_S

    def write(self, data: bytes) -> None:
        """See ``Link``."""
        try:
            self._port.write(data)
        except self._failure as error:
            raise ExportError(f"{self._name}: {error}") from None

    def read(self, size: int) -> bytes:
        """See ``Link``."""
        try:
            answer: bytes = self._port.read(size)
        except self._failure as error:
            raise ExportError(f"{self._name}: {error}") from None
        if len(answer) < size:
            raise ExportError(
                f"{self._name}: {len(answer)} of {size} bytes within {SILENCE_S:g} s; "
                "the board must run bench_run() of the exported controller at 115200 baud"
            )
        return answer

    def close(self) -> None:
        """See ``Link``."""
        self._port.close()


def serial_ecu(
    port: str, identity: bytes, scenario: str, receivers: int = 2, room: int = FRAME_BYTES
) -> BenchEcu:
    """The controller node on the board at ``port``, started again.

    Args:
        port: device of the serial port.
        identity: of the required controller.
        scenario: its name.
        receivers: see ``BenchEcu``.
        room: likewise.

    Raises:
        ExportError: no such port, no answer, or another controller on the board.
        MissingExtraError: pyserial is not installed.
    """
    ecu = BenchEcu(SerialLink(port, room), receivers, room)
    if ecu.restart() != identity:
        ecu.close()
        raise ExportError(
            f"{port}: another controller answers; it must be built from what "
            f"`can-rig export` writes now for scenario {scenario} with the same settings"
        )
    return ecu
