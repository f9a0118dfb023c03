"""Logs written in the formats that `reading` reads, from columns of frames.

    write_log(read_log("runs/demo/bus.log"), Path("demo.blf"))

A frame of a kind that the format lacks is refused. Every other loss is counted. A bus gets the
number at the end of its name, as in python-can, unless another bus already has the number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np
from can.util import channel2int

from can_rig.errors import LogError
from can_rig.logs.frames import (
    CLASSIC_BYTES,
    ERROR,
    FD,
    NS_PER_S,
    REMOTE,
    SENT,
    Format,
    Frames,
    Log,
)
from can_rig.logs.reading import WRITTEN, format_of
from can_rig.storage.files import atomic, refuse_existing

_US: Final = 1_000
_BUSES: Final = 255
_KINDS: Final = {ERROR: "error", REMOTE: "remote", FD: "CAN FD"}

Reading = Callable[[Log], Iterable[Frames]]
"""Goes through the chunks of a log."""


def refuse_log(path: Path, force: bool, option: str = "--log") -> None:
    """Refuse an existing log, or a suffix without a writer.

    Raises:
        LogError: the reason.
    """
    if format_of(path).key != ".log" and path.suffix.lower() == ".gz":
        raise LogError(f"{path}: a compressed log can only be written as .log.gz")
    refuse_existing(path, force, option)


def write_log(log: Log, path: Path, reading: Reading = iter, *, force: bool = False) -> Changes:
    """Write the frames of ``log`` to ``path``, in the format of its suffix; returns the losses.

    ``path`` exists, complete, when this returns, and not before.

    Args:
        log: the log to read.
        path: the log to write.
        reading: iterates over the frames, for example to filter frames or to show progress.
        force: replace an existing log.

    Raises:
        LogError: the format is unknown or cannot hold a frame; a file cannot be read or written, or
            already exists.
    """
    refuse_log(path, force)
    form = format_of(path)
    assert form.write is not None
    source = iter(reading(log))
    first = next(source, None)  # the start of the log is known from here on
    changes = Changes(log, form, path, first)
    chunks = changes.prepare(source if first is None else chain([first], source))
    with atomic(path, force=force) as part:
        form.write(chunks, part, changes.start_ns, path)
    return changes


@dataclass
class Changes:
    """Prepares the frames of ``log`` for a file of a format, and counts what the file loses."""

    log: Log
    keeps: Format
    file: Path
    """Final name of the file."""
    first: Frames | None
    """The first chunk of the log."""
    buses: dict[str, int] = field(default_factory=dict, init=False)
    """The number of each bus by its name, where the format has numbers; numbers are distinct."""
    frames: int = field(default=0, init=False)
    """Number of frames so far."""
    _lost: Counter[str] = field(default_factory=Counter, init=False)
    _first_ns: int = field(default=0, init=False)
    _last: tuple[int, int] = field(default=(-(1 << 63), 0), init=False)
    """Time stamp [ns] and kind of the last frame."""
    _kinds: set[int] = field(default_factory=set, init=False)

    @property
    def start_ns(self) -> int:
        """The start of the recording that the file says [ns]; no later than the first frames."""
        start_ns = self.log.start_ns
        if self.first is not None and len(self.first) and not self.keeps.before_start:
            start_ns = min(start_ns, int(self.first.time_ns.min()))
        return self.keeps.starts(start_ns)

    def prepare(self, chunks: Iterable[Frames]) -> Iterable[Frames]:
        """The frames in the file's form: buses by their numbers.

        Raises:
            LogError: the format cannot hold some frames; the message counts them all.
        """
        chunks = iter(chunks)
        for frames in chunks:
            if frames.has(self.keeps.lacks).any():
                self._refuse_kinds(frames, chunks)
            if not len(frames):
                continue
            earliest_ns = int(frames.time_ns.min())
            if not self.keeps.before_start and earliest_ns < self.start_ns:
                raise LogError(
                    f"{self.file}: {self.keeps.name} holds no frames from before its start, and "
                    f"the clock of {self.log.path} goes back to there; the format must be "
                    f"{_either(s for s, keeps in WRITTEN.items() if keeps.before_start)}"
                )
            if self.keeps.start_ns is None and earliest_ns < 0:
                raise LogError(
                    f"{self.file}: a frame of {self.log.path} is from before the year 1970"
                )
            self._count(frames)
            yield frames if self.keeps.bus_names else self._numbered(frames)

    def lines(self) -> list[str]:
        """The differences between file and log, a line each."""
        name, lost = self.keeps.name, self._lost
        found = []
        if any(bus != str(number) for bus, number in self.buses.items()):
            numbers = ", ".join(f"{bus} is {number}" for bus, number in self.buses.items())
            found.append(f"{name} has numbers for buses: {numbers}")
        if self.frames:
            found += self._moved()
        if lost["rounded"]:
            stamps = _several(lost["rounded"], "time stamp")
            found.append(f"{name} has whole microseconds: {stamps} rounded")
        if lost["places"] and len(self._kinds) > 1:
            frames = _several(lost["places"], "frame")
            found.append(
                f"{name} holds data, long, remote and error frames apart: {frames}, no later than "
                "the frame before, may change places with frames of other kinds"
            )
        for what in ("identifiers", "payloads", "directions"):
            if lost[what]:
                frames = _several(lost[what], "error frame")
                found.append(f"{name} does not keep the {what} of {frames}")
        return found

    def _moved(self) -> list[str]:
        """How far the start of the recording moves."""
        keeps = self.keeps
        start_ns, why = self.start_ns, "has its start in whole milliseconds"
        if keeps.start_ns is None:
            start_ns = (self._first_ns + _US // 2) // _US * _US
            why = "starts with its first frame"
        elif keeps.since_ns is not None and self.log.start_ns < keeps.since_ns:
            why = "has no date so early, and counts from 1970"
        elif start_ns <= self.log.start_ns - keeps.start_ns:
            why = "has no frames from before its start"
        elif keeps.start_ns == _US:
            why = "has its start in whole microseconds"
        moved_ns = start_ns - self.log.start_ns
        if not moved_ns:
            return []
        way = "later" if moved_ns > 0 else "earlier"
        return [
            f"{keeps.name} {why}: the recording starts {abs(moved_ns) / NS_PER_S:.9f} s {way}, "
            "times of frames stay"
        ]

    def _count(self, frames: Frames) -> None:
        keeps, lost = self.keeps, self._lost
        if not self.frames:
            self._first_ns = int(frames.time_ns[0])
        self.frames += len(frames)
        lost["rounded"] += int((frames.time_ns % keeps.time_ns != 0).sum())
        error = frames.has(ERROR)
        if not keeps.order:
            long = frames.length > CLASSIC_BYTES
            kind = np.where(error, 1, np.where(frames.has(REMOTE), 2, 3 * long))
            kinds = np.concatenate([[self._last[1]], kind])
            times_ns = np.concatenate([[self._last[0]], frames.time_ns])
            same = (times_ns[1:] == times_ns[:-1]) & (kinds[1:] != kinds[:-1])
            lost["places"] += int((same | (times_ns[1:] < times_ns[:-1])).sum())
            self._last = int(times_ns[-1]), int(kinds[-1])
            self._kinds.update(kind.tolist())
        if not keeps.error_direction:
            lost["directions"] += int((error & frames.has(SENT)).sum())
        if not keeps.error_content:
            lost["identifiers"] += int((error & (frames.arbitration_id != 0)).sum())
            lost["payloads"] += int((error & (frames.length != 0)).sum())

    def _numbered(self, frames: Frames) -> Frames:
        """Replace bus names by numbers.

        A bus keeps its own number while the number is free, or else gets the lowest free number.
        """
        names = [frames.channels[index] for index in np.unique(frames.channel)]
        new = [name for name in names if name not in self.buses]
        taken = set(self.buses.values())
        for name in new:
            own = channel2int(name)
            if own is not None and own < _BUSES and own not in taken:
                self.buses[name] = own
                taken.add(own)
        for name in new:
            if name not in self.buses:
                self.buses[name] = next(n for n in range(_BUSES + 1) if n not in taken)
                taken.add(self.buses[name])
        numbers = tuple(str(self.buses.get(name, "")) for name in frames.channels)
        return replace(frames, channels=numbers)

    def _refuse_kinds(self, frames: Frames, rest: Iterable[Frames]) -> None:
        """Refuse the frames that the format lacks, all of the log counted."""
        counts: Counter[int] = Counter()
        for part in (frames, *rest):
            left = part.has(self.keeps.lacks)
            for flag in _KINDS:
                counts[flag] += int((left & part.has(flag)).sum())
                left &= ~part.has(flag)
        found = [flag for flag in _KINDS if counts[flag]]
        lacks = _either(name for flag, name in _KINDS.items() if self.keeps.lacks & flag)
        has = " and ".join(_several(counts[flag], _KINDS[flag] + " frame") for flag in found)
        fit = _either(s for s, keeps in WRITTEN.items() if not keeps.lacks & sum(found))
        raise LogError(
            f"{self.file}: {self.keeps.name} holds no {lacks} frames, and {self.log.path} has "
            f"{has}; the format must be {fit}"
        )


def _several(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _either(words: Iterable[str]) -> str:
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last
