"""``bus.log`` → ``signals.csv``: frames and the plant's reports, one row a tick."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from can import Message

from can_rig.controllers.protocol import ages_of
from can_rig.drawing.names import column_names
from can_rig.frames.codec import NO_DECISION, WIRE_TICKS, Hearing, Receiver, tick_at, ticks_ahead
from can_rig.frames.network import Network
from can_rig.logs.columns import ON_THE_BUS
from can_rig.logs.frames import ERROR, REMOTE, Frames
from can_rig.logs.plant_signals import PlantSignals, read_plant_signals
from can_rig.logs.reading import read_log
from can_rig.nodes.ticks import RunColumns
from can_rig.plant.faults.frame_faults import Delivery
from can_rig.plant.frameless import carried
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.sensor_settings import USUAL
from can_rig.storage import paged
from firmware_model.analysis.simulation import Trace
from firmware_model.law.structs import FloatArray

ROLE_COLUMNS: Final = 5  # one column for each frame; the codes of the status frame follow
CODES: Final = 3  # mode, fault state, verdict
OWN: Final = 2  # the first frames of a tick: the plant node's frames, which fix the tick
STATUS: Final = 4
MOST_GAPS: Final = 14  # lost frames after which every alive counter is tolerated


@dataclass(frozen=True)
class Signals:
    """One value a tick, each of shape (ticks,); nan without a valid frame.

    ``mode``, ``fault_state`` and ``verdict`` are the codes of the status frame's value tables.
    """

    time_s: FloatArray
    reference_mps2: FloatArray
    dstar_mps2: FloatArray
    torque_nm: FloatArray
    force_difference_n: FloatArray
    fault_estimate_mps2: FloatArray
    mode: FloatArray
    fault_state: FloatArray
    verdict: FloatArray | None = None
    """None: the status frame lacks a verdict."""
    plant: PlantSignals = field(default_factory=dict)
    """Further reports of the plant, by name; empty for a log without reports."""
    sensors: PlantSignals = field(default_factory=dict)
    """What the further sensors say, by column."""
    whose_fault: PlantSignals = field(default_factory=dict)
    """The verdict on the fault, and the evidence; see ``results.isolation``."""
    sample_ages: PlantSignals = field(default_factory=dict)
    """Ticks since the sample of each heard sensor, by column."""
    left_out: int = 0
    """Intact feedback frames of other ticks than those under way, as of a second run."""

    @property
    def error_mps2(self) -> FloatArray:
        """e = r - D* (3.41)."""
        return self.reference_mps2 - self.dstar_mps2

    def __len__(self) -> int:
        return len(self.time_s)

    def __getitem__(self, rows: slice) -> Signals:
        """The signals of some ticks."""

        def part(values: Any) -> Any:
            if isinstance(values, dict):
                return {name: column[rows] for name, column in values.items()}
            return values[rows] if isinstance(values, np.ndarray) else values

        return Signals(**{name: part(values) for name, values in vars(self).items()})

    def write_csv(self, path: Path, plant: PlantSettings) -> None:
        """Write the columns of frames, plant, verdict and sensors; an empty cell means nan."""
        further = self.plant | self.whose_fault | self.sensors
        columns = [*(getattr(self, name) for name in ON_THE_BUS), *further.values()]
        names = column_names(plant, self.plant)
        header = [names.get(name, name) for name in (*ON_THE_BUS, *further)]
        whole = ",".join(["%.10g"] * len(columns)) + "\n"
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write(",".join(header) + "\n")
            for rows in paged.blocks(len(self)):
                for row in zip(*(column[rows].tolist() for column in columns), strict=True):
                    line = whole % row
                    file.write(line if "nan" not in line else ",".join(map(cell, row)) + "\n")


def cell(value: float) -> str:
    """A value in ``signals.csv``; nan gives an empty cell."""
    return "" if math.isnan(value) else f"{value:.10g}"


def read_signals(log: Path, network: Network, tick_s: float, in_time_ticks: int = 1) -> Signals:
    """Decode a rig's log through the checks of the plant node, and read the plant's reports.

    The plant node's frames, reference and feedback, fix the current tick; a frame of a different
    tick is ignored, as in the run. The first tick of a log with a late begin follows from the time
    stamps, or, without the rig's time stamps, from the 16 bits of the tick on the wire. Missing
    ticks become rows of nan; the unfinished last line of a killed run is ignored.

    Args:
        log: a log of any format of ``logs.reading``.
        network: the frames.
        tick_s: seconds a tick.
        in_time_ticks: longest time of a command from the start of its tick on, in ticks: one in
            lockstep, the latency in a real-time run.

    Raises:
        LogError: the log cannot be read, or contains a line without a frame.
    """
    signals = signals_of(read_log(log), network, tick_s, in_time_ticks)
    return with_plant_signals(signals, log, tick_s)


def signals_of_columns(columns: RunColumns, tick_s: float, log: Path) -> Signals:
    """Equal to ``read_signals`` of the ``log`` of a run without a bus.

    Raises:
        LogError: the plant's reports cannot be read.
    """
    ticks = len(columns.frames["mode"]) if columns.frames else 0
    frames: Any = columns.frames
    signals = Signals(
        times_s(0, ticks, tick_s),
        **frames,
        sensors=columns.sensors,
        sample_ages=columns.sample_ages,
    )
    if columns.plant is None:
        return with_plant_signals(signals, log, tick_s)
    return replace(signals, plant=columns.plant)


def signals_of_trace(trace: Trace, delivery: Delivery, ticks: int, network: Network) -> Signals:
    """The first ``ticks`` of a loop without frames, as carried by frames; see ``carried``."""
    done = slice(0, ticks)
    frames: Any = carried(trace, delivery, done, network)
    return Signals(time_s=trace.time_s[done], **frames)


def times_s(first_tick: int, ticks: int, tick_s: float) -> FloatArray:
    """(ticks,), the begin of each tick."""
    column = paged.empty(ticks)
    for rows in paged.blocks(ticks):
        column[rows] = np.arange(first_tick + rows.start, first_tick + rows.stop) * tick_s
    return column


def with_plant_signals(signals: Signals, log: Path, tick_s: float) -> Signals:
    """``signals`` of ``log`` with the plant's reports from the file beside the log.

    Raises:
        LogError: the file exists and cannot be read.
    """
    first_tick = round(float(signals.time_s[0]) / tick_s) if len(signals) else 0
    return replace(signals, plant=read_plant_signals(log, first_tick, len(signals)))


def signals_of(
    chunks: Iterable[Frames], network: Network, tick_s: float, in_time_ticks: int = 1
) -> Signals:
    """Signals of the data frames of a log; see ``read_signals``."""
    table = SignalRows(network, tick_s, in_time_ticks)
    width = table.width
    with paged.rows_file(8 * width * paged.PAGED_ROWS) as file:
        for frames in chunks:
            for rows in paged.blocks(len(frames)):
                part = frames[rows]
                for message in part[~part.has(REMOTE | ERROR)].messages():
                    table.take(message)
                paged.append(file, table.take_complete())
        paged.append(file, table.rows)
        columns: Any = paged.columns(file, width)
    ticks = len(columns[0])
    first_tick = table.first_tick + len(table.rows) - ticks
    verdict = columns[ROLE_COLUMNS + CODES - 1] if network.status.verdicts else None
    further = columns[ROLE_COLUMNS + CODES :]
    return replace(
        Signals(times_s(first_tick, ticks, tick_s), *columns[: ROLE_COLUMNS + CODES - 1]),
        verdict=verdict,
        sensors=dict(zip(table.sensors, further, strict=False)),
        sample_ages=dict(zip(table.sample_ages, further[len(table.sensors) :], strict=True)),
        left_out=table.left_out,
    )


class SignalRows:
    """Frames into rows, one a tick: a value for each frame in order, codes, further sensors.

    For the arguments see ``read_signals``.
    """

    def __init__(self, network: Network, tick_s: float, in_time_ticks: int) -> None:
        self.rows: list[list[float]] = []
        self.first_tick = 0
        self._tick_s = tick_s
        self._in_time_ticks = in_time_ticks
        self._receivers = [Receiver(codec) for codec in network]
        self._by_id = {r.codec.frame_id: at for at, r in enumerate(self._receivers)}
        self.sensors: Final = [
            USUAL[codec.role.replace("_", "-")].column for codec in network.witnesses
        ]
        """Columns of the further sensors."""
        timings = [(period, 0, 0) for period in network.periods]
        self.sample_ages: Final = ages_of(self.sensors)
        """Columns of the ages of the samples that the law hears."""
        self._hearing = Hearing(network.witnesses, timings, self.sensors)
        self._tick = -1
        self._marked = False

    @property
    def width(self) -> int:
        """Values of a row."""
        return ROLE_COLUMNS + CODES + len(self.sensors) + len(self.sample_ages)

    @property
    def tick(self) -> int:
        """The current tick; -1 before the first."""
        return self._tick

    @property
    def left_out(self) -> int:
        """Intact feedback frames of other ticks than those under way."""
        return self._receivers[OWN - 1].rejected.get("wrong_tick", 0)

    def take_complete(self) -> list[list[float]]:
        """Remove and return the rows of all ticks that no later frame can change."""
        whole = max(0, len(self.rows) - self._in_time_ticks)
        rows, self.rows = self.rows[:whole], self.rows[whole:]
        self.first_tick += whole
        return rows

    def take(self, message: Message) -> None:
        """Use a frame, or ignore it."""
        at = self._by_id.get(message.arbitration_id)
        if at is None:
            if self._hearing.concerns(message) and not (self._marked and message.is_rx):
                self._hearing.take(message, None)
            return
        if at < OWN:  # once a frame is marked as sent, received ones are foreign
            self._marked |= not message.is_rx
            if self._marked and message.is_rx:
                return
        receiver = self._receivers[at]
        row = -1
        if at >= OWN:
            age = self._age(at, message)
            record = receiver.accept(message, self._tick - age) if self.rows else None
            row -= age
        else:
            ahead = self._ticks_ahead(at, message)
            if ahead and self.rows:
                self._end_ticks(at, ahead)
            record = receiver.accept(message, self._tick_of(at, message, ahead))
            if record is not None and ahead:
                self._begin(at, record.tick, message.timestamp, ahead)
        if record is None:
            return
        if at == STATUS and receiver.codec.modes:
            decided = record.verdict != NO_DECISION
            self.rows[row][ROLE_COLUMNS : ROLE_COLUMNS + CODES] = [
                record.mode,
                record.fault_state if decided else math.nan,
                record.verdict if record.verdict < NO_DECISION else math.nan,
            ]
        if math.isfinite(record.value):
            self.rows[row][at] = record.value

    def _age(self, at: int, message: Message) -> int:
        """Age of a command's tick in ticks; 0 for a late command."""
        says = self._receivers[at].codec.layout.tick(message.data)
        age = 0 if says is None else -ticks_ahead(says, self._tick)
        return age if 0 <= age < min(self._in_time_ticks, len(self.rows)) else 0

    def _ticks_ahead(self, at: int, message: Message) -> int:
        """Ticks from the current tick to the frame's tick; 0 for a current or old frame.

        A frame without a tick begins the next tick if the current tick has the same message.
        """
        if not self.rows:
            return 1
        says = self._receivers[at].codec.layout.tick(message.data)
        if says is None:
            return int(math.isfinite(self.rows[-1][at]))
        return max(0, ticks_ahead(says, self._tick))

    def _tick_of(self, at: int, message: Message, ahead: int) -> int | None:
        """The required tick of a frame; None for a frame that begins its own tick."""
        if not ahead:
            return self._tick
        if self._receivers[at].codec.layout.has_tick:
            return None
        if self.rows:
            return self._tick + ahead
        return round(message.timestamp / self._tick_s) % WIRE_TICKS

    def _begin(self, announced_by: int, wire_tick: int, timestamp_s: float, ahead: int) -> None:
        """Start the row of a new tick, after rows of nan for skipped ticks."""
        if self.rows:
            for at in range(len(self._receivers)):
                if at != announced_by:
                    self._end_ticks(at, ahead)
            self._tick += ahead
        else:
            self._tick = self.first_tick = tick_at(wire_tick, timestamp_s, self._tick_s)
            ahead = 1
        for _ in range(ahead):
            self.rows.append([math.nan] * self.width)
        heard = self._hearing.end_tick(self._tick)
        further = (heard[name] for name in (*self.sensors, *self.sample_ages))
        self.rows[-1][ROLE_COLUMNS + CODES :] = further

    def _end_ticks(self, at: int, ticks: int) -> None:
        """Tell a receiver the end of this tick, and of further ticks without a frame."""
        for _ in range(min(ticks, MOST_GAPS)):
            self._receivers[at].end_tick()
