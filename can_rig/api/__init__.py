"""The rig from Python, in a notebook or a script: ``import can_rig`` offers these names.

    run = can_rig.run("default", {"fault.at_s": 5.0})
    run.metrics["dstar_peak_mps2"]
    run.signals["error_mps2"].plot()
    run.save("runs/early-loss")

A scenario is the name of a shipped one, a TOML file, or a ``Scenario``; changes are a mapping of
its keys, as ``--set`` of the command line has them, to values or to objects of Python: arrays,
linear systems, filters, classes, functions (``scenario.from_python``). Bad input raises a
``can_rig.errors.RigError`` with one line.

The package imports every room below; only commands may import it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral, Real
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import tomli_w

from can_rig.assessment.speeds import check as check_speeds
from can_rig.assessment.stability import StabilityCheck
from can_rig.assessment.tuning.candidate import cars_of
from can_rig.assessment.tuning.search import Tunings, tune as search
from can_rig.campaigns.execution import execute, open_folder
from can_rig.campaigns.plan import plan
from can_rig.campaigns.report import write_report
from can_rig.campaigns.settings import read_campaign
from can_rig.campaigns.statistics import Summary
from can_rig.campaigns.workers import in_processes, serially
from can_rig.decoding.decode import decode_log
from can_rig.errors import LogError, RigError, ScenarioError, WorkersLostError, in_python
from can_rig.logs.frames import window_of
from can_rig.logs.reading import read_log
from can_rig.replaying.estimator import Replayed, replay_drive, write
from can_rig.replaying.replay import Comparison as OpenLoopComparison, OpenLoop
from can_rig.replaying.rig_frames import recorded
from can_rig.results.source import Source, log_path, source_of
from can_rig.scenario import loading
from can_rig.scenario.build import network_of
from can_rig.scenario.from_python import kind_of, settings_of
from can_rig.scenario.loading import Changes, written_by
from can_rig.scenario.settings import Scenario
from can_rig.storage.files import atomic
from can_rig.views.controllers_compared import CASES, Comparison, compare as compare_controllers
from can_rig.views.diff import Difference, compare as difference_of
from can_rig.views.log_statistics import LogStatistics
from can_rig.views.recorded_run import RecordedRun, record
from can_rig.views.signal_table import SignalTable, read_table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


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
    return _scenario(name, settings_of(changes))


def _scenario(name: str | Path | Scenario, settings: Sequence[str]) -> Scenario:
    if not isinstance(name, str | Path | Scenario):
        raise ScenarioError(f"scenario {name!r}: must be a name, a path or a Scenario")
    if isinstance(name, Scenario):
        return loading.load_run(name.as_dict(), settings) if settings else name
    return loading.load(str(name), settings)


@in_python
def save_scenario(scenario: Scenario, path: str | Path, *, force: bool = False) -> Path:
    """Write a scenario as TOML, without defaults; returns the path.

    Args:
        scenario: of ``load_scenario`` or of a run.
        path: where; the file's name is the scenario's name from then on.
        force: replace an existing file.

    Raises:
        ScenarioError: not a scenario, or a scenario that no file gives.
        LogError: the file exists, or cannot be written.
    """
    if not isinstance(scenario, Scenario):
        raise ScenarioError(f"scenario = {scenario!r}: must be a Scenario")
    text = tomli_w.dumps(written_by(scenario))
    with atomic(_path("path", path), force=force) as part:
        part.write_text(text, "utf-8")
    return Path(path)


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
) -> StabilityCheck:
    """Whether the sampled loop is stable, healthy and after the fault, and by what margin.

    The result has ``stable``, ``verdict``, ``healthy`` and ``faulted``; ``as_dict()`` has every
    figure. Of a drive, ``healthy`` and ``faulted`` are the margins at the fastest speed.

    Raises:
        ScenarioError: as ``load_scenario``, or no such design.
    """
    return check_speeds(load_scenario(name, changes))


@in_python
def compare(
    controllers: Sequence[object],
    name: str | Path | Scenario = "default",
    changes: Changes | None = None,
    *,
    cases: Mapping[str, Changes] | str = "faults",
) -> Comparison:
    """Several controllers through the same cases, without frames.

    The result has ``rows``, a ``table`` of pandas, and ``draw(path)``.

    Args:
        controllers: each a ``controller.kind``, a class or function, or a TOML file with a
            ``[controller]``.
        name: see ``load_scenario``.
        changes: of every run; see ``load_scenario``.
        cases: changes by name, or a group: ``faults``, ``weather`` or ``cars``.

    Raises:
        ScenarioError: as ``load_scenario``, or an unknown group.
    """
    if isinstance(cases, str):
        cases = CASES.get(cases, cases)
    if not (isinstance(cases, Mapping) and all(isinstance(v, Mapping) for v in cases.values())):
        raise ScenarioError(f"cases = {cases!r}: must be {', '.join(CASES)}, or changes by name")
    settings = settings_of(changes)
    if not isinstance(controllers, list | tuple):
        raise ScenarioError(f"controllers = {controllers!r}: must be a list, as ['ours', 'pi']")
    kinds = [kind_of("controllers", each) for each in controllers]
    return compare_controllers(kinds, lambda own: _scenario(name, [*settings, *own]), cases)


@in_python
def diff(
    a: RecordedRun | str | Path,
    b: RecordedRun | str | Path,
    *,
    tolerances: Mapping[str, float] | None = None,
) -> Difference:
    """Two runs compared signal by signal, in the rows of the same time.

    Args:
        a: a run, its folder, or a ``signals.csv``.
        b: likewise.
        tolerances: largest difference that counts as none, by signal and in its unit.

    Raises:
        LogError: no such run, no row of the same time, or a tolerance of no signal.
    """
    if not isinstance(tolerances, Mapping | None):
        raise LogError(f"tolerances = {tolerances!r}: must be numbers by signal")
    allowed = {name: _number(name, each) for name, each in (tolerances or {}).items()}
    return difference_of(_table(a), _table(b), allowed)


@in_python
def plot(runs: Mapping[str, RecordedRun | str | Path], signals: Sequence[str]) -> Figure:
    """Several runs in one picture: a panel for each signal, a curve for each run.

    Args:
        runs: runs or folders, by the names of their curves.
        signals: columns of ``signals.csv``.

    Raises:
        LogError: no such run, or a signal that a run lacks.
    """
    from can_rig.views.pictures import overlay  # noqa: PLC0415 (matplotlib)

    if not (isinstance(runs, Mapping) and runs and isinstance(signals, list | tuple) and signals):
        raise LogError("plot: must have runs by their names, one at least, and a list of signals")
    return overlay({name: _table(run) for name, run in runs.items()}, signals)


def _table(run: RecordedRun | str | Path) -> SignalTable:
    if isinstance(run, RecordedRun):
        return run.table
    return read_table(_path("run", run), loading.load("default"))


@in_python
def stats(
    log: str | Path, *, bitrate: int = 500_000, data_bitrate: int = 2_000_000
) -> LogStatistics:
    """What is in a log: ``frames``, ``span_s``, ``identifiers`` with their rates, ``load(bus)``.

    Args:
        log: of any format that ``can-rig decode`` reads, or a run folder.
        bitrate: of the buses, in bit/s.
        data_bitrate: of CAN FD's data phase, in bit/s.

    Raises:
        LogError: the log cannot be read.
        RigError: impossible bit rates.
    """
    statistics = LogStatistics(_number("bitrate", bitrate), _number("data_bitrate", data_bitrate))
    for frames in read_log(log_path(_path("log", log))):
        statistics.add(frames)
    statistics.finish()
    return statistics


@dataclass(frozen=True)
class Campaign:
    """A finished campaign.

    Attributes:
        summary: pass rates, spreads, the worst runs and the tables, as ``summary.json`` has them.
        runs: a row for each run: what tells the run apart, the metrics, the requirements.
    """

    summary: Summary
    runs: pd.DataFrame


@in_python
def campaign(
    name: str | Path,
    changes: Changes | None = None,
    *,
    scenario: str | Path | None = None,
    runs: int | None = None,
    seed: int | None = None,
    search: str | None = None,
    workers: int = 1,
    folder: str | Path | None = None,
    force: bool = False,
    resume: bool = False,
) -> Campaign:
    """Thousands of runs of one scenario, in this process or in several.

    Args:
        name: of a shipped campaign, or a path to a TOML file.
        changes: of the scenario in every run; see ``load_scenario``.
        scenario: in place of the campaign's own; a shipped one or a path.
        runs: in place of the campaign's own number.
        seed: in place of the campaign's own.
        search: a requirement whose worst runs are looked for.
        workers: processes; a script with more than one needs ``if __name__ == "__main__":``.
        folder: for table and report; None: nothing is left on disk. Finished runs stay in the
            folder after Ctrl-C.
        force: replace an existing folder of a campaign.
        resume: continue the campaign in ``folder``.

    Raises:
        ScenarioError: no such campaign or scenario, an unknown key, a bad value.
        RunFolderError: the folder already exists, or cannot be written.
    """
    import pandas as pd  # noqa: PLC0415 (slow to import)

    scenarios = None if scenario is None else [str(_path("scenario", scenario))]
    keys = {"scenario": scenarios, "runs": _number("runs", runs, WHOLE, Integral),
            "seed": _number("seed", seed, WHOLE, Integral), "search": search}  # fmt: skip
    workers = _number("workers", workers, WHOLE, Integral)
    if workers < 1:
        raise ScenarioError(f"workers = {workers}: must be at least 1")
    if resume and (folder is None or force):
        raise ScenarioError("resume = True: must come with folder, and not with force")
    planned = plan(read_campaign(str(_path("name", name)), settings_of(changes), **keys))
    with TemporaryDirectory(prefix="can-rig-") as temporary:
        where = Path(temporary) / "campaign" if folder is None else _path("folder", folder)
        made = open_folder(where, planned, resume=resume, force=force)
        try:
            compute = serially(planned) if workers == 1 else in_processes(planned, workers)
            execute(made, compute, lambda: False, lambda done: None)
            summary = write_report(made)
            table = pd.read_parquet(made.table)
            made.made.publish()
        except BaseException as error:
            if isinstance(error, WorkersLostError):
                error.args = (f'{error} A script needs if __name__ == "__main__":',)
            if made.done == 0:
                made.made.give_up()
            raise
        finally:
            made.made.close()
    return Campaign(summary, table)


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
    box = _number("box", box, "a share, as in 0.2 for ±20 %")
    spare_ticks = _number("spare_ticks", spare_ticks, "a whole number of ticks", Integral)
    if not isinstance(ranges, Mapping | None):
        raise ScenarioError(f"ranges = {ranges!r}: must be pairs by key")
    for key, pair in (ranges or {}).items():
        if not (isinstance(pair, tuple | list) and len(pair) == 2):
            raise ScenarioError(f"ranges: {key} = {pair!r}: must be a pair, lowest and highest")
    limits = [f"{key}={low}..{high}" for key, (low, high) in (ranges or {}).items()]
    some = cars_of(chosen, box, limits)
    return search(
        chosen, some, spare_ticks, _number("noise_limit_n", noise_limit_n),
        _number("torque_noise_limit_nm", torque_noise_limit_nm),
    )  # fmt: skip


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
    decoded = decode_log(
        log, dbc, _names("messages", messages), _names("signals", signals),
        from_s=_number("from_s", from_s), to_s=_number("to_s", to_s),
    )  # fmt: skip
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
            "as yaw_rate and torque; can_rig.verify replays a run of the rig"
        )
    named = dbc if isinstance(dbc, Mapping) else {} if dbc is None else {"": dbc}
    files = {str(bus): _path("dbc", file) for bus, file in named.items()}
    path = _path("log", log)
    window = window_of(_number("from_s", from_s), _number("to_s", to_s))
    source = Source(read_log(log_path(path), window=window), scenario)
    return ReplayedDrive(replay_drive(source, files, _number("max_age_s", max_age_s)))


@in_python
def verify(
    run: RecordedRun | str | Path, name: str | Path | None = None, changes: Changes | None = None
) -> OpenLoopComparison:
    """A run's log through today's controller, compared with the log as on the wire.

    The result has ``identical``, ``ticks``, ``compared``, ``first_different_tick`` and ``signals``.

    Args:
        run: a run, its folder, or a log.
        name: a scenario in place of the run's own; a log alone needs one.
        changes: see ``load_scenario``.

    Raises:
        LogError: the log cannot be read, or has no comparable frame.
        ScenarioError: as ``load_scenario``, or a log without a scenario.
    """
    path = run.folder if isinstance(run, RecordedRun) else _path("run", run)
    scenario = None if name is None else str(_path("name", name))
    source = source_of(path, scenario, settings_of(changes))
    network = network_of(source.scenario)
    answers = recorded(source.frames(), network, source.scenario) if source.is_realtime else None
    loop = OpenLoop(source.scenario, network, recorded=answers)
    loop.run(source.frames())
    if not any(signal.compared for signal in loop.comparison.signals):
        raise LogError(f"{source.log.path}: no frame of a controller in it that could be compared")
    return loop.comparison


def _path(argument: str, value: object) -> Path:
    if not isinstance(value, str | Path):
        raise RigError(f"{argument} = {value!r}: must be the path of one file or folder")
    return Path(value)


WHOLE = "a whole number"


def _number(argument: str, value: Any, must: str = "a number", kind: type = Real) -> Any:
    """A number of Python or of NumPy as one of Python; None stays."""
    plain = value.item() if getattr(value, "ndim", None) == 0 else value
    if plain is not None and (isinstance(plain, bool) or not isinstance(plain, kind)):
        raise ScenarioError(f"{argument} = {value!r}: must be {must}")
    return plain


def _names(argument: str, value: Any) -> list[str] | None:
    if isinstance(value, str) or not isinstance(value, Iterable | None):
        raise LogError(f"{argument} = {value!r}: must be a list of names")
    return None if value is None else list(value)
