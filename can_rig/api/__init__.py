"""The rig from Python, in a notebook or a script: ``import can_rig`` offers these names.

    run = can_rig.run("default", {"fault.at_s": 5.0})
    run.metrics["dstar_peak_mps2"]
    run.signals["error_mps2"].plot()
    run.save("runs/early-loss")

A scenario is the name of a shipped one, a TOML file, or a ``Scenario``; changes are a mapping of
its keys, as ``--set`` of the command line has them. Bad input raises a
``can_rig.errors.RigError`` with one line.

The package imports every room below; only commands may import it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from can_rig.assessment import resolve
from can_rig.assessment.speeds import DriveCheck
from can_rig.assessment.speeds import check as check_speeds
from can_rig.assessment.stability import StabilityCheck
from can_rig.assessment.tuning.candidate import cars_of
from can_rig.assessment.tuning.search import Tunings
from can_rig.assessment.tuning.search import tune as search
from can_rig.decoding.decode import decode_log
from can_rig.errors import RigError, ScenarioError, in_python
from can_rig.logs.frames import window_of
from can_rig.logs.reading import read_log
from can_rig.replaying.estimator import Replayed, replay_drive, write
from can_rig.results.source import Source, log_path
from can_rig.scenario.from_python import settings_of
from can_rig.scenario.loading import Changes
from can_rig.scenario.settings import Scenario
from can_rig.views.controllers_compared import CASES, Comparison
from can_rig.views.controllers_compared import compare as compare_controllers
from can_rig.views.recorded_run import RecordedRun, record

if TYPE_CHECKING:
    import pandas as pd

__all__ = [
    "Comparison",
    "RecordedRun",
    "ReplayedDrive",
    "Scenario",
    "check",
    "compare",
    "decode",
    "load",
    "load_scenario",
    "replay",
    "run",
    "tune",
]


@in_python
def load_scenario(
    name: str | Path | Scenario = "default", changes: Changes | None = None
) -> Scenario:
    """A scenario with some keys changed, every default filled in.

    Args:
        name: of a shipped one, a path to a TOML file, or a scenario to change.
        changes: key → value, as in ``{"plant.speed_mps": 20.0, "fault.kind": "none"}``.

    Raises:
        ScenarioError: no such scenario, an unknown key, a bad value.
    """
    settings = settings_of(changes)
    if not isinstance(name, str | Path | Scenario):
        raise ScenarioError(f"scenario {name!r}: must be a name, a path or a Scenario")
    if isinstance(name, Scenario):
        return resolve.load_run(name.as_dict(), settings) if settings else name
    return resolve.load(str(name), settings)


@in_python
def run(
    name: str | Path | Scenario = "default",
    changes: Changes | None = None,
    *,
    allow_unstable: bool = False,
) -> RecordedRun:
    """Both nodes through a scenario, in lockstep and in this process.

    The run needs no bus, and leaves no files until ``save``. The log equals the log of
    ``can-rig run``, byte for byte.

    Args:
        name: see ``load_scenario``.
        changes: see ``load_scenario``.
        allow_unstable: also run an unstable loop.

    Raises:
        ScenarioError: an impossible scenario, or an unstable loop.
        RigError: the run ended before its last tick.
    """
    return record(load_scenario(name, changes), allow_unstable=allow_unstable)


@in_python
def load(folder: str | Path) -> RecordedRun:
    """The run in a folder of ``can-rig run`` or of ``save``.

    Raises:
        LogError: not a finished run folder.
        ScenarioError: ``run.json`` lacks a readable scenario.
    """
    return RecordedRun.load(_path("folder", folder))


@in_python
def check(
    name: str | Path | Scenario = "default", changes: Changes | None = None
) -> StabilityCheck | DriveCheck:
    """Whether the sampled loop is stable, healthy and after the fault, and by what margin.

    The result has ``stable``, ``verdict``, ``healthy`` and ``faulted``; ``as_dict()`` has every
    figure.

    Raises:
        ScenarioError: as ``load_scenario``, or no such design.
    """
    return check_speeds(load_scenario(name, changes))


@in_python
def compare(
    controllers: Sequence[str],
    name: str | Path = "default",
    changes: Changes | None = None,
    *,
    cases: Mapping[str, Changes] | str = "faults",
) -> Comparison:
    """Several controllers through the same cases, without frames.

    The result has ``rows``, a ``table`` of pandas, and ``draw(path)``.

    Args:
        controllers: each a ``controller.kind``, or a TOML file with a ``[controller]``.
        name: of a shipped scenario, or a path to a TOML file.
        changes: of every run; see ``load_scenario``.
        cases: changes by name, or a group: ``faults``, ``weather`` or ``cars``.

    Raises:
        ScenarioError: as ``load_scenario``, or an unknown group.
    """
    if isinstance(cases, str):
        if cases not in CASES:
            raise ScenarioError(f"cases = {cases!r}: must be {', '.join(CASES)}, or a mapping")
        cases = CASES[cases]
    settings = settings_of(changes)
    return compare_controllers(controllers, str(name), cases, settings)


@in_python
def tune(
    name: str | Path | Scenario = "default",
    changes: Changes | None = None,
    *,
    box: float = 0.2,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    spare_ticks: int = 1,
    noise_limit_n: float | None = None,
    torque_noise_limit_nm: float | None = None,
) -> Tunings:
    """The tuning with the least peak after the loss of the torque, for a box of cars.

    The result has this tuning as ``chosen``, and the whole trade-off as ``front``.

    Args:
        name: see ``load_scenario``.
        changes: see ``load_scenario``.
        box: largest share by which mass, cornering stiffnesses and speed differ.
        ranges: lowest and highest value of single parameters, as in
            ``{"plant.speed_mps": (8.0, 12.0)}``.
        spare_ticks: additional delay of a stable loop, beyond the scenario's delay.
        noise_limit_n: largest rms of the force difference due to the sensor's noise; None: any.
        torque_noise_limit_nm: the same limit of the torque.

    Raises:
        NoTuningError: no tuning passes.
        ScenarioError: as ``load_scenario``, or an invalid range.
    """
    chosen = load_scenario(name, changes)
    if not isinstance(box, int | float):
        raise ScenarioError(f"box = {box!r}: must be a share, as in 0.2 for ±20 %")
    if not isinstance(spare_ticks, int):
        raise ScenarioError(f"spare_ticks = {spare_ticks!r}: must be a whole number of ticks")
    for key, pair in (ranges or {}).items():
        if not (isinstance(pair, tuple | list) and len(pair) == 2):
            raise ScenarioError(f"ranges: {key} = {pair!r}: must be a pair, lowest and highest")
    limits = [f"{key}={low}..{high}" for key, (low, high) in (ranges or {}).items()]
    some = cars_of(chosen, box, limits)
    return search(chosen, some, spare_ticks, noise_limit_n, torque_noise_limit_nm)


@in_python
def decode(
    log: str | Path,
    dbc: str | Path,
    *,
    messages: Sequence[str] | None = None,
    signals: Sequence[str] | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> dict[str, pd.DataFrame]:
    """Any log through any database that cantools reads: a table for each message.

    A row is a frame, a column a signal, the index ``time_s``; ``attrs["units"]`` gives units.

    Args:
        log: of any format that ``can-rig decode`` reads.
        dbc: the database.
        messages: only these; None: all.
        signals: only these, as ``Signal`` or ``Message.Signal``; None: all.
        from_s: skip frames before this time, s after the start of the recording.
        to_s: skip frames from this time on, s after the start of the recording.

    Raises:
        LogError: the log cannot be read.
        DbcError: the database cannot be read, or lacks a name.
    """
    tables = {}
    log, dbc = _path("log", log), _path("dbc", dbc)
    decoded = decode_log(log, dbc, messages, signals, from_s=from_s, to_s=to_s)
    for name, columns in decoded.items():
        tables[name] = table = columns.to_pandas()
        units = {signal: layout.unit for signal, layout in columns.layout.items()}
        table.attrs["units"] = {signal: unit or "" for signal, unit in units.items()}
    return tables


class ReplayedDrive:
    """A recorded drive after the estimator.

    Attributes:
        scenario: of the controller, as it was replayed.
        summary: ticks, inputs, d̂ and events, as ``can-rig replay --json`` prints them.
    """

    def __init__(self, replayed: Replayed) -> None:
        self._replayed = replayed
        self.scenario = replayed.scenario
        self.summary: dict[str, Any] = replayed.summary()

    @cached_property
    def signals(self) -> pd.DataFrame:
        """A row a tick; the index ``time_s`` counts from the start of the recording.

        ``attrs["units"]`` has the unit of each column; mode, fault state and verdict are numbers.
        """
        import pandas as pd  # noqa: PLC0415 (slow to import)

        columns = self._replayed.columns
        index = pd.Index(self._replayed.time_s, name="time_s")
        frame = pd.DataFrame(columns.signals, index=index, copy=False)
        frame.attrs["units"] = {name: layout.unit for name, layout in columns.layout.items()}
        return frame

    @in_python
    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write a table by ``.csv``, ``.parquet`` or ``.mf4``, or a picture; returns the path.

        Args:
            path: where.
            force: replace an existing file.

        Raises:
            LogError: an unknown suffix, or the file exists or cannot be written.
        """
        write(self._replayed, _path("path", path), force=force)
        return Path(path)

    def __repr__(self) -> str:
        """Scenario and ticks."""
        ticks, blind = self.summary["ticks"], self.summary["ticks_blind"]
        return (
            f"<recorded drive through {self.scenario.name}: {ticks} ticks, {blind} of them BLIND>"
        )


@in_python
def replay(
    log: str | Path,
    name: str | Path | Scenario,
    changes: Changes | None = None,
    *,
    dbc: str | Path | Mapping[str, str | Path] | None = None,
    max_age_s: float | None = None,
    from_s: float | None = None,
    to_s: float | None = None,
) -> ReplayedDrive:
    """A car's own log through the estimator.

    Args:
        log: of any format that ``can-rig decode`` reads.
        name: a scenario whose ``network.signals`` name the signals of the log; see
            ``load_scenario``.
        changes: see ``load_scenario``.
        dbc: in place of ``network.dbc``; or a database for each bus, as the log names the buses.
        max_age_s: how long a sample holds; None: five periods of its signal.
        from_s: skip frames before this time, s after the start of the recording.
        to_s: skip frames from this time on, s after the start of the recording.

    Raises:
        LogError: the log cannot be read, or lacks an input.
        DbcError: a database cannot be read, or lacks a signal.
        ScenarioError: no signals of a car, an unknown unit, or a failing design.
    """
    scenario = load_scenario(name, changes)
    if not scenario.network.signals.are_of_a_drive:
        raise ScenarioError(
            f"scenario {scenario.name}: network.signals: must name a car's signals in the log, "
            "as yaw_rate and torque"
        )
    named = dbc if isinstance(dbc, Mapping) else {} if dbc is None else {"": dbc}
    files = {str(bus): _path("dbc", file) for bus, file in named.items()}
    path = _path("log", log)
    source = Source(read_log(log_path(path), window=window_of(from_s, to_s)), scenario)
    return ReplayedDrive(replay_drive(source, files, max_age_s))


def _path(argument: str, value: object) -> Path:
    if not isinstance(value, str | Path):
        raise RigError(f"{argument} = {value!r}: must be the path of one file or folder")
    return Path(value)
