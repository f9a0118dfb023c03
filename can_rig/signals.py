"""``bus.log`` → ``signals.csv``: what was on the bus, one row a tick."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from can import Message
from numpy.typing import NDArray

from can_rig.errors import RunFolderError
from can_rig.messages import Network, Receiver
from firmware_model.sections import FloatArray

COLUMNS = (
    "time_s",
    "reference_mps2",
    "dstar_mps2",
    "error_mps2",
    "torque_nm",
    "force_difference_n",
    "fault_estimate_mps2",
    "mode",
)
ROLE_COLUMNS: Final = 5  # one of each frame; mode and fault state follow
OWN: Final = 2  # the first frames of a tick: the plant node's, which say what tick it is
STATUS: Final = 4
WIRE_TICKS: Final = 1 << 16
MOST_GAPS: Final = 14  # lost frames after which every alive counter is tolerated


@dataclass(frozen=True)
class Signals:
    """One value a tick, each of shape (ticks,); nan where no valid frame said anything.

    ``mode`` and ``fault_state`` are the codes of the status frame's value tables.
    """

    time_s: FloatArray
    reference_mps2: FloatArray
    dstar_mps2: FloatArray
    torque_nm: FloatArray
    force_difference_n: FloatArray
    fault_estimate_mps2: FloatArray
    mode: FloatArray
    fault_state: FloatArray

    @property
    def error_mps2(self) -> FloatArray:
        """e = r - D* (3.41)."""
        return self.reference_mps2 - self.dstar_mps2

    def __len__(self) -> int:
        return len(self.time_s)

    def write_csv(self, path: Path) -> None:
        """The contract's columns; an empty cell where no valid frame said anything."""
        columns = [getattr(self, name).tolist() for name in COLUMNS]
        with path.open("w", encoding="ascii", newline="\n") as file:
            file.write(",".join(COLUMNS) + "\n")
            for row in zip(*columns, strict=True):
                file.write(",".join("" if math.isnan(x) else f"{x:.10g}" for x in row) + "\n")


def read_signals(log: Path, network: Network, tick_s: float) -> Signals:
    """Decode a rig's log through the checks that the plant node makes.

    The plant node's frames, the reference and the feedback, say what tick is under way; a frame of
    another tick is not used, as it was not used in the run. A log that starts late starts at the
    tick that its time stamps say, or, where they are not those of the rig, at the 16 bits of the
    tick on the wire. Ticks that are missing within it are rows of nan; a last line that a killed
    run left unfinished is not read.

    Raises:
        RunFolderError: the log cannot be read, or a line of it is not candump's.
    """
    table = _Table(network, tick_s)
    for message in read_frames(log):
        table.take(message)
    values: NDArray[np.float64] = np.array(table.rows, dtype=np.float64)
    columns = values.reshape(len(table.rows), ROLE_COLUMNS + 2).T
    ticks = table.first_tick + np.arange(len(table.rows), dtype=np.float64)
    return Signals(ticks * tick_s, *columns)


def read_frames(log: Path) -> Iterator[Message]:
    """Classic data frames with 11-bit identifiers of a candump log (``candump -L``), in order.

    python-can's reader knows every kind of frame and takes three times as long.

    Raises:
        RunFolderError: as ``read_signals``.
    """
    try:
        with log.open(encoding="ascii", newline="\n") as file:
            for number, line in enumerate(file, start=1):
                fields = line.split()
                if not fields:
                    continue
                try:
                    time_s = float(fields[0][1:-1])
                    identifier, text = fields[2].split("#", 1)
                    if len(identifier) != 3 or text[:1] in {"#", "R", "r"}:
                        continue
                    frame_id, data = int(identifier, 16), bytearray.fromhex(text)
                except (IndexError, ValueError):
                    if not line.endswith("\n"):
                        return  # a killed run was writing it
                    raise RunFolderError(
                        f"{log}: line {number}: not a frame as candump -L writes it: {line[:60]!r}"
                    ) from None
                yield Message(time_s, frame_id, is_extended_id=False, data=data)
    except (OSError, UnicodeDecodeError) as error:
        raise RunFolderError(f"{log}: cannot be read: {error}") from None


class _Table:
    """Frames into rows, one a tick."""

    def __init__(self, network: Network, tick_s: float) -> None:
        self.rows: list[list[float]] = []
        self.first_tick = 0
        self._tick_s = tick_s
        self._receivers = [Receiver(codec) for codec in network]
        self._by_id = {r.codec.frame_id: at for at, r in enumerate(self._receivers)}
        self._tick = -1  # the one under way
        self._row: list[float] = []

    def take(self, message: Message) -> None:
        """Use a frame, or not."""
        at = self._by_id.get(message.arbitration_id)
        if at is None:
            return
        receiver = self._receivers[at]
        if at >= OWN:
            record = receiver.accept(message, self._tick) if self.rows else None
        else:
            ahead = self._ticks_ahead(message)
            if ahead and self.rows:
                self._end_ticks(at, ahead)
            record = receiver.accept(message, None if ahead else self._tick)
            if record is not None and ahead:
                self._begin(at, record.tick, message.timestamp, ahead)
        if record is None or not math.isfinite(record.value):
            return
        self._row[at] = record.value
        if at == STATUS:
            self._row[-2:] = [record.mode, record.fault_state]

    def _ticks_ahead(self, message: Message) -> int:
        """How far the frame says that time has gone on; 0: it is of this tick, or of an old one."""
        if not self.rows:
            return 1
        tick = int.from_bytes(message.data[2:4], "little")
        ahead = (tick - self._tick) % WIRE_TICKS
        return ahead if ahead < WIRE_TICKS // 2 else 0

    def _begin(self, announced_by: int, wire_tick: int, timestamp_s: float, ahead: int) -> None:
        """Start the row of another tick, after rows of nan for those in between."""
        if self.rows:
            for at in range(len(self._receivers)):
                if at != announced_by:
                    self._end_ticks(at, ahead)
            self._tick += ahead
        else:
            self._tick = self.first_tick = _absolute(wire_tick, timestamp_s, self._tick_s)
            ahead = 1
        for _ in range(ahead):
            self._row = [math.nan] * (ROLE_COLUMNS + 2)
            self.rows.append(self._row)

    def _end_ticks(self, at: int, ticks: int) -> None:
        """Tell a receiver that this tick is over, and so many more without its frame."""
        for _ in range(min(ticks, MOST_GAPS)):
            self._receivers[at].end_tick()


def _absolute(wire_tick: int, timestamp_s: float, tick_s: float) -> int:
    """The tick of a frame from its 16 bits and its time stamp, if that is in virtual time."""
    tick = round((timestamp_s / tick_s - wire_tick) / WIRE_TICKS) * WIRE_TICKS + wire_tick
    return tick if abs(tick * tick_s - timestamp_s) < tick_s else wire_tick
