"""A recorded drive: a car's own signals in a log, on the ticks of a controller.

**The rule.** A tick takes the last sample of each signal at its time or before, never a later one.
A sample older than ``max_age_s`` counts as missing, and so does one for which the database has a
word, such as "not available". A tick without D* is BLIND.

Every signal has the times of its own frames, whatever the message, the bus and the rate.
"""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database
from numpy.typing import NDArray

from can_rig.decoding.decode import Decoder
from can_rig.decoding.message_decoder import MessageColumns, joined
from can_rig.errors import DbcError, LogError, ScenarioError
from can_rig.frames.databases import load_for
from can_rig.frames.foreign_frames import nearest
from can_rig.logs.frames import NS_PER_S
from can_rig.results.source import Reading, Source
from can_rig.scenario.log_signals import ROLES, LogSignal, terms, unit_factor
from can_rig.scenario.settings import MAX_TICKS, Scenario
from firmware_model.design.vehicle import dstar
from firmware_model.law.structs import FloatArray

AGE_IN_PERIODS: Final = 5.0
"""Without ``max_age_s``: a sample is missing once this many periods of its signal have passed."""

DISORDER_NS: Final = NS_PER_S // 10
"""Frames of several buses may be out of order by this much; they are sorted."""

Buses = Mapping[str, Path]
"""The database of each bus; "" for the buses without an entry."""


@dataclass(frozen=True)
class Samples:
    """One signal of a log.

    Attributes:
        of: the signal, as the scenario has it.
        bus: the bus of its frames.
        unit: the unit of the log's values.
        time_ns: (n,) not falling.
        values: (n,) in the role's unit; nan for "not available".
        max_age_ns: how long a sample holds.
    """

    role: str
    of: LogSignal
    bus: str
    unit: str
    time_ns: NDArray[np.int64]
    values: FloatArray
    max_age_ns: int

    @property
    def period_s(self) -> float:
        """The median interval of the samples; nan for a single sample."""
        return float(np.median(np.diff(self.time_ns))) / NS_PER_S if len(self.time_ns) > 1 else 0.0

    def held(self, at_ns: NDArray[np.int64]) -> FloatArray:
        """(m,) the last sample at ``at_ns`` (m,) or before; nan where it is too old."""
        last = np.searchsorted(self.time_ns, at_ns, side="right") - 1
        known = last >= 0
        age_ns = at_ns - self.time_ns[last]
        return np.where(known & (age_ns <= self.max_age_ns), self.values[last], math.nan)

    def gaps(self) -> list[tuple[int, int]]:
        """Begin and end [ns] of each interval in which no sample holds."""
        wide = np.flatnonzero(np.diff(self.time_ns) > self.max_age_ns)
        return [(int(self.time_ns[i]) + self.max_age_ns, int(self.time_ns[i + 1])) for i in wide]


@dataclass(frozen=True)
class Drive:
    """A recorded drive on the ticks of a scenario, each column (ticks,); nan without a value.

    Attributes:
        time_ns: of each tick, on the log's clock.
        samples: every signal of the log that was used.
        columns: by role, in the role's unit.
    """

    time_ns: NDArray[np.int64]
    samples: tuple[Samples, ...]
    columns: dict[str, FloatArray]

    def dstar_mps2(self, lateral_weight: float) -> FloatArray:
        """D* of each tick: as measured, or made of yaw rate, lateral acceleration and speed."""
        if "feedback" in self.columns:
            return self.columns["feedback"]
        return dstar(
            lateral_weight,
            self.columns["lateral_acceleration"],
            self.columns["yaw_rate"],
            self.columns["speed"],
        )


def recorded_drive(
    source: Source, dbc: Buses, max_age_s: float | None = None, reading: Reading = iter
) -> Drive:
    """Read the signals of ``source.scenario`` from its log.

    Args:
        source: the log and a scenario with ``network.signals``.
        dbc: databases in place of ``network.dbc``.
        max_age_s: how long a sample holds; None: ``AGE_IN_PERIODS`` of its signal.
        reading: iterates over the log and shows the progress.

    Raises:
        LogError: the log cannot be read, lacks a signal, or has no tick with all inputs.
        DbcError: a database cannot be read, or lacks a signal.
        ScenarioError: no signals of a car, or a unit that is unknown.
    """
    scenario = source.scenario
    if not scenario.model.is_car:
        raise ScenarioError(
            f"scenario {scenario.name}: model.kind = {scenario.model.kind!r}: must be a car: a "
            "recorded drive has the signals of a car"
        )
    wanted = {
        role: terms(getattr(scenario.network.signals, role))
        for role in ROLES
        if getattr(scenario.network.signals, role)
    }
    for measured, sent in (("torque", "command_1"), ("force_difference", "command_2")):
        if measured in wanted:
            wanted.pop(sent, None)
    if "feedback" in wanted:
        for role in ("yaw_rate", "lateral_acceleration"):
            wanted.pop(role, None)
    databases = _databases(scenario, dbc, [each for of in wanted.values() for each in of])
    decoded = _decode(source, databases, wanted, reading)
    samples = tuple(
        _samples(scenario, source.log.path, decoded, role, each, max_age_s)
        for role, of in wanted.items()
        for each in of
    )
    time_ns = _ticks(source, samples)
    columns: dict[str, FloatArray] = {}
    for each in samples:
        held = each.held(time_ns)
        columns[each.role] = columns[each.role] + held if each.role in columns else held
    drive = Drive(time_ns, samples, columns)
    inputs = [column for role, column in columns.items() if role != "reference"]
    if not np.isfinite(np.sum(inputs, axis=0)).any():
        raise _no_overlap(source, samples)
    return drive


def _databases(
    scenario: Scenario, dbc: Buses, used: Sequence[LogSignal]
) -> dict[str, tuple[Path, Database]]:
    """The databases by bus, "" for all other buses."""
    files = {"": Path(scenario.network.dbc), **dbc}
    names = {each.message for each in used}
    return {bus: (file, load_for(file, names)) for bus, file in files.items()}


def _decode(
    source: Source,
    databases: Mapping[str, tuple[Path, Database]],
    wanted: Mapping[str, Sequence[LogSignal]],
    reading: Reading,
) -> dict[tuple[str, str], MessageColumns]:
    """The columns of the wanted messages, by bus and message."""
    used = [each for of in wanted.values() for each in of]
    for each in used:
        _require(databases, wanted, each)
    decoders: dict[str, Decoder | None] = {}
    parts: dict[tuple[str, str], list[MessageColumns]] = defaultdict(list)
    for frames in source.frames(reading):
        for bus in dict.fromkeys(frames.channels):
            if bus not in decoders:
                decoders[bus] = _decoder(databases, used, bus)
            decoder = decoders[bus]
            if decoder is not None:
                for message, columns in decoder.decode(frames).items():
                    parts[bus, message].append(columns)
    for each in used:
        if each.bus and each.bus not in decoders:
            raise LogError(
                f"{source.log.path}: no frame is of bus {each.bus}, which has {each.signal}; the "
                f"log has {', '.join(decoders) or 'none'}"
            )
    return {key: joined(columns) for key, columns in parts.items()}


def _decoder(
    databases: Mapping[str, tuple[Path, Database]], used: Sequence[LogSignal], bus: str
) -> Decoder | None:
    """A decoder for the frames of a bus; None if no wanted signal can be on the bus."""
    _, database = databases.get(bus, databases[""])
    there = {message.name for message in database.messages}
    own = [each for each in used if each.message in there and each.bus in ("", bus)]
    names = dict.fromkeys(name for each in own for name in (each.signal, each.sign) if name)
    return Decoder(database, {each.message for each in own}, names, bus) if own else None


def _require(
    databases: Mapping[str, tuple[Path, Database]],
    wanted: Mapping[str, Sequence[LogSignal]],
    each: LogSignal,
) -> None:
    """Refuse a signal that no database of its buses has."""
    some = [databases.get(each.bus, databases[""])] if each.bus else list(databases.values())
    for name in filter(None, (each.signal, each.sign)):
        of, _, signal = name.rpartition(".")
        found = [m for _, database in some for m in database.messages if m.name == of]
        inside = [s.name for message in found for s in message.signals]
        if signal in inside:
            continue
        role = next(role for role, of_role in wanted.items() if each in of_role)
        there = inside if found else [m.name for _, db in some for m in db.messages]
        hint = nearest(signal if found else of, there)
        what = f"message {of} has no signal {signal}" if found else f"no message {of}"
        files = ", ".join(str(file) for file, _ in some)
        raise DbcError(f"network.signals.{role} = {name!r}: {files}: {what}; {hint}")


def _samples(
    scenario: Scenario,
    log: Path,
    decoded: Mapping[tuple[str, str], MessageColumns],
    role: str,
    of: LogSignal,
    max_age_s: float | None,
) -> Samples:
    """The samples of one signal.

    Raises:
        LogError: no frame, several buses, or times that go back.
        ScenarioError: an unknown unit.
    """
    where = f"network.signals.{role} = {of.signal!r}"
    buses = [bus for bus, message in decoded if message == of.message and of.bus in ("", bus)]
    if not buses:
        raise LogError(
            f"{log}: has no frame of {of.message}"
            + f" on bus {of.bus}" * bool(of.bus)
            + f"; {where}"
        )
    if len(buses) > 1:
        raise LogError(
            f"{log}: {of.message} is on buses {', '.join(buses)}; {where}: must be a table with "
            f"bus = {buses[0]!r} or another"
        )
    columns, signal = decoded[buses[0], of.message], of.signal.rpartition(".")[2]
    layout = columns.layout[signal]
    unit = of.unit or layout.unit
    factor = unit_factor(ROLES[role], unit, f"scenario {scenario.name}: {where}")
    column = columns.signals[signal]
    values = np.ma.getdata(column).astype(np.float64) * factor * of.factor
    if signal in columns.codes and not layout.is_enumeration:  # a word such as "not available"
        worded = np.isin(np.ma.getdata(columns.codes[signal]), list(layout.choices))
        values[worded & (values != 0.0)] = math.nan
    if of.sign:
        sign = np.ma.getdata(columns.signals[of.sign.rpartition(".")[2]])
        values = np.where(sign != 0, -values, values)
    there = ~np.ma.getmaskarray(column)
    time_ns, values = columns.time_ns[there], values[there] + of.offset
    if not len(time_ns):
        raise LogError(f"{log}: no frame of {of.message} has the signal {signal}; {where}")
    back_ns = int(np.diff(time_ns).min(initial=0))
    if back_ns < -DISORDER_NS:
        at = int(np.argmin(np.diff(time_ns))) + 1
        raise LogError(
            f"{log}: the times of {of.message} go back by {-back_ns / NS_PER_S:g} s at "
            f"{time_ns[at - 1] / NS_PER_S:.6f} s; must be one recording (--from and --to choose it)"
        )
    if back_ns < 0:
        order = np.argsort(time_ns, kind="stable")
        time_ns, values = time_ns[order], values[order]
    period_ns = float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0
    age_ns = max(AGE_IN_PERIODS * period_ns, 2.0 * scenario.tick_ns)
    if max_age_s is not None:
        age_ns = max_age_s * NS_PER_S
    return Samples(role, of, buses[0], unit, time_ns, values, round(age_ns))


def _ticks(source: Source, samples: Sequence[Samples]) -> NDArray[np.int64]:
    """The times of the ticks, counted from the start of the recording.

    The first tick is that in which every input has had a sample, the last that of the last sample.
    """
    tick_ns = source.scenario.tick_ns
    inputs = [each for each in samples if each.role != "reference"]
    begin = max(int(each.time_ns[0]) for each in inputs) - source.log.start_ns
    end = max(int(each.time_ns[-1]) for each in inputs) - source.log.start_ns
    first, last = -(-begin // tick_ns), end // tick_ns
    if last < first:
        raise _no_overlap(source, samples)
    if last - first >= MAX_TICKS:
        raise LogError(
            f"{source.log.path}: {(end - begin) / NS_PER_S:g} s are more than {MAX_TICKS} ticks; "
            "--from and --to choose a part"
        )
    return source.log.start_ns + np.arange(first, last + 1, dtype=np.int64) * tick_ns


def _no_overlap(source: Source, samples: Sequence[Samples]) -> LogError:
    start_ns = source.log.start_ns
    spans = ", ".join(
        f"{each.of.signal} from {(each.time_ns[0] - start_ns) / NS_PER_S:.3f} to "
        f"{(each.time_ns[-1] - start_ns) / NS_PER_S:.3f} s"
        for each in samples
        if each.role != "reference"
    )
    return LogError(f"{source.log.path}: no tick has all of its inputs: {spans}")
