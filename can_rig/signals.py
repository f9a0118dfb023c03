"""``bus.log`` → ``signals.csv``: what was on the bus, one row a tick."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from can import LogReader
from numpy.typing import NDArray

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
        columns = [getattr(self, name) for name in COLUMNS]
        with path.open("w", encoding="ascii", newline="\n") as file:
            file.write(",".join(COLUMNS) + "\n")
            for row in zip(*columns, strict=True):
                file.write(",".join("" if x != x else f"{x:.10g}" for x in row) + "\n")


def read_signals(log: Path, network: Network, tick_s: float) -> Signals:
    """Decode a rig's log through the checks that the plant node makes; ticks start at 0."""
    receivers = [Receiver(codec) for codec in network]
    by_id = {receiver.codec.frame_id: at for at, receiver in enumerate(receivers)}
    reference_at, status_at = 0, len(receivers) - 1
    rows: list[list[float]] = []
    row: list[float] = []
    heard: set[int] = set()
    for message in LogReader(log):
        at = by_id.get(message.arbitration_id)
        if at is None:
            continue
        record = receivers[at].accept(message, len(rows) - (at != reference_at))
        if record is None:
            continue
        if at == reference_at:
            row = [np.nan] * (len(receivers) + 2)
            rows.append(row)
            heard = set()
        row[at] = record.value
        heard.add(at)
        if at == status_at:
            row[-2:] = [record.mode, record.fault_state]
            for missing in set(by_id.values()) - heard:
                receivers[missing].checker.no_new_data()
    columns: NDArray[np.float64] = np.array(rows).reshape(len(rows), len(receivers) + 2).T
    return Signals(np.arange(len(rows)) * tick_s, *columns)
