"""A board on a serial port, as a link to a bench."""

from __future__ import annotations

from typing import Final

from can_rig.errors import ExportError, require
from can_rig.export.running.bench_ecu import ORDER_BYTES, BenchEcu

BAUD: Final = 115_200
SILENCE_S: Final = 2.0
QUIET_S: Final = 0.1


class SerialLink:
    """A serial port with 8 data bits, no parity, 115200 baud; see ``Link``.

    Args:
        port: its device.

    Raises:
        ExportError: opening fails.
        MissingExtraError: pyserial is not installed.
    """

    def __init__(self, port: str) -> None:
        require("serial", extra="serial")
        import serial  # noqa: PLC0415

        self._name = port
        self._failure: type[Exception] = serial.SerialException
        try:
            self._port = serial.Serial(port, BAUD, exclusive=True)
        except (OSError, ValueError) as error:
            raise ExportError(f"{port}: cannot be opened as a serial port: {error}") from None
        self.forget()

    def forget(self) -> None:
        """End an interrupted order, and discard the rest of the last answer."""
        self.write(bytes(ORDER_BYTES))
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


def serial_ecu(port: str, identity: bytes, scenario: str, receivers: int = 2) -> BenchEcu:
    """The controller node on the board at ``port``, started again.

    Args:
        port: device of the serial port.
        identity: of the required controller.
        scenario: its name.
        receivers: see ``BenchEcu``.

    Raises:
        ExportError: no such port, no answer, or another controller on the board.
        MissingExtraError: pyserial is not installed.
    """
    ecu = BenchEcu(SerialLink(port), receivers)
    if ecu.restart() != identity:
        ecu.close()
        raise ExportError(
            f"{port}: another controller answers; it must be built from what "
            f"`can-rig export` writes now for scenario {scenario} with the same settings"
        )
    return ecu
