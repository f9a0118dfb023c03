"""The source of a replay or a view: a log or a run folder, with its scenario."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from can_rig.errors import LogError, ScenarioError
from can_rig.frames.network import Network
from can_rig.logs.frames import ALL, Frames, Log, Window
from can_rig.logs.reading import read_log
from can_rig.nodes.operating import done, touches
from can_rig.results.isolation import with_verdict
from can_rig.results.run_folder import LOG, REFERENCE, log_of, recorded_scenario
from can_rig.results.signals import Signals, read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_run
from can_rig.scenario.settings import ReferenceSettings, Scenario
from can_rig.storage import paged
from can_rig.storage.files import atomic

Reading = Callable[[Log], Iterator[Frames]]


@dataclass(frozen=True)
class Source:
    """A log and its scenario."""

    log: Log
    scenario: Scenario
    channel: str | None = None
    """The only bus to read; None: all buses."""
    is_realtime: bool = False
    """Whether the run folder records a real-time run."""

    @property
    def in_time_ticks(self) -> int:
        """Longest time of a command; see `signals.read_signals`."""
        return self.scenario.latency_ticks if self.is_realtime else 1

    def frames(self, reading: Reading = iter) -> Iterator[Frames]:
        """The chunks of the log.

        Args:
            reading: iterates over the log and shows the progress.

        Raises:
            LogError: the log cannot be read, or lacks the bus.
        """
        return only_channel(reading(self.log), self.channel, self.log.path)


def only_channel(chunks: Iterable[Frames], channel: str | None, path: Path) -> Iterator[Frames]:
    """The frames of one bus; None: all buses.

    Raises:
        LogError: at the end, without any frame of the bus.
    """
    named: set[str] = set()
    for frames in chunks:
        named.update(frames.channels)
        if channel is None:
            yield frames
        elif len(frames):
            ours = np.array([name == channel for name in frames.channels])
            yield frames[ours[frames.channel]]
    if channel is not None and channel not in named:
        raise LogError(
            f"{path}: no frame is of bus {channel}; "
            f"the log has {', '.join(sorted(named)) or 'none'}"
        )


def source_of(
    path: Path,
    name: str | None,
    settings: Sequence[str],
    channel: str | None = None,
    window: Window = ALL,
) -> Source:
    """A log file, or the log and the scenario of a run folder.

    Args:
        path: the file or the folder.
        name: a scenario that replaces the folder's scenario; required for a file.
        settings: ``KEY=VALUE`` changes.
        channel: see `Source`.
        window: the part of the log to read.

    Raises:
        LogError: no such log, or not a run folder.
        ScenarioError: a missing or bad scenario.
    """
    log = read_log(log_path(path), window=window)
    if name is not None:
        return Source(log, load(name, settings), channel)
    if not path.is_dir():
        raise ScenarioError(
            f"{path}: a log file does not say which scenario it is of; name it with "
            "--scenario NAME (a run folder brings its own)"
        )
    values, realtime = recorded_scenario(path)
    scenario = load_run(values, settings)
    return Source(log, scenario, channel, realtime)


def log_path(path: Path) -> Path:
    """The log of a run folder, or the file itself; ``-`` is standard input.

    Raises:
        LogError: the log is missing.
    """
    if path.is_dir():
        if not log_of(path).is_file():
            raise LogError(f"{path}: not a run folder, it has no {LOG}")
        return log_of(path)
    if not path.exists():
        if path == Path("-"):
            return Path("/dev/stdin")
        raise LogError(f"{path}: there is no such file")
    return path


def read_run(folder: Path) -> tuple[Scenario, Network, Signals]:
    """A run: its scenario with the commands given during the run, its frames, its signals.

    Raises:
        LogError: not a run folder, or a log that cannot be read.
        ScenarioError: no readable scenario.
    """
    if folder.is_file():
        raise LogError(f"{folder}: is a file; must be a run folder")
    source = source_of(folder, None, ())
    network = network_of(source.scenario)
    scenario = done(source.scenario, touches(source.frames(), network)).scenario
    moved = folder / REFERENCE
    if moved.is_file():
        scenario = replace(scenario, reference=ReferenceSettings(kind="csv", file=str(moved)))
    signals = read_signals(log_of(folder), network, scenario.tick_s, source.in_time_ticks)
    return scenario, network, with_verdict(scenario, network, signals)


def happened(log: Path, scenario: Scenario, network: Network, own_reference: Path) -> Scenario:
    """The scenario with the commands given during the run; the metrics describe this scenario.

    A moved reference is written to ``own_reference``, unless the file exists.

    Raises:
        LogError: the log cannot be read, or the reference cannot be written.
    """
    what = done(scenario, touches(read_log(log), network))
    if not what.moved or own_reference.exists():
        return what.scenario
    signals = read_signals(log, network, scenario.tick_s)
    if not np.isfinite(signals.reference_mps2).any():
        return what.scenario
    with atomic(own_reference, force=False) as part, part.open("w", encoding="utf-8") as file:
        file.writelines(reference_csv(signals))
    own = ReferenceSettings(kind="csv", file=str(own_reference))
    return replace(what.scenario, reference=own)


def reference_csv(logged: Signals) -> Iterator[str]:
    """Lines of a reference file with the logged reference; gaps hold the last value."""
    known = np.isfinite(logged.reference_mps2)
    held = logged.reference_mps2[np.argmax(known)]
    yield "time_s,reference_mps2\n"
    for rows in paged.blocks(len(logged)):
        last = np.maximum.accumulate(np.where(known[rows], np.arange(len(known[rows])), -1))
        values = np.where(last >= 0, logged.reference_mps2[rows][last], held)
        held = values[-1]
        both = zip(logged.time_s[rows].tolist(), values.tolist(), strict=True)
        yield from (f"{time_s!r},{value!r}\n" for time_s, value in both)
