"""The run folder: made once, never overwritten unasked, completed from its ``bus.log``."""

from __future__ import annotations

import json
import platform
import shutil
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from can_rig import paged
from can_rig.errors import LogError, RunFolderError
from can_rig.files import atomic
from can_rig.frames.network import Network
from can_rig.logs.compression import compress, stored
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.summary import RunColumns
from can_rig.results.fault_metrics import fault_metrics
from can_rig.results.isolation.verdicts import with_verdict
from can_rig.results.isolation.words import whose_fault
from can_rig.results.metrics import Metrics, metrics
from can_rig.results.signals import Signals, read_signals, signals_of_columns
from can_rig.scenario.settings import Scenario

LOG, SIGNALS, SUMMARY = "bus.log", "signals.csv", "run.json"
REPORT, PAGE = "report.png", "report.html"
PACKAGES = (
    "fault-tolerant-steering",
    "numpy",
    "scipy",
    "numba",
    "control",
    "python-can",
    "cantools",
    "autosar-e2e",
)


@dataclass
class Outcome:
    """How a run went, apart from what its log says."""

    bus: str
    outcome: str = "complete"
    ticks: int = 0
    wall_s: float = 0.0
    rejected_frames: dict[str, dict[str, int]] = field(default_factory=dict)
    bus_events: dict[str, dict[str, int]] = field(default_factory=dict)
    faults: list[dict[str, Any]] = field(default_factory=list)
    """What each fault did, from the log."""
    whose_fault: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Each verdict that was a fault; see ``results.isolation``."""
    realtime: dict[str, Any] | None = None
    """Of a real-time run; empty where it ended without figures."""

    @property
    def ticks_per_s(self) -> float:
        """Rate of the loop in wall-clock time."""
        return self.ticks / self.wall_s if self.wall_s > 0.0 else 0.0


class RunFolder:
    """A run folder in the making: where it will stand, and where it is made until it is whole.

    A new run is made in its place. One that replaces another is made beside it, as
    ``NAME.unfinished``, and the other stands until ``publish``.

    Attributes:
        path: where it will stand.
        making: where it is now.
    """

    def __init__(self, path: Path, making: Path) -> None:
        self.path = path
        self.making = making

    @classmethod
    def create(cls, path: Path | None, scenario: Scenario, force: bool) -> RunFolder:
        """Make the folder; without a name it is ``runs/SCENARIO-DATE-TIME``.

        Raises:
            RunFolderError: it is there already and ``force`` is not given, or cannot be made.
        """
        if path is None:
            path = Path("runs") / f"{scenario.name}-{time.strftime('%Y%m%d-%H%M%S')}"
        making = path.with_name(f"{path.name}.unfinished") if path.exists() else path
        if making != path:
            _refuse_to_replace(path, making, force)
        try:
            making.mkdir(parents=True)
        except OSError as error:
            raise RunFolderError(f"{making}: cannot be made: {error.strerror}") from None
        return cls(path, making)

    def give_up(self) -> None:
        """Take away the folder of a run that recorded nothing."""
        shutil.rmtree(self.making, ignore_errors=True)

    def publish(self) -> None:
        """Put the folder, now whole, in its place, and take away the run that it replaces.

        Raises:
            RunFolderError: it cannot be renamed; both runs are still there.
        """
        if self.making == self.path:
            return
        old = self.path.with_name(f"{self.path.name}.replaced")
        try:
            self.path.rename(old)
            self.making.rename(self.path)
        except OSError as error:
            if old.is_dir() and not self.path.exists():
                old.rename(self.path)
            raise RunFolderError(
                f"{self.path}: cannot be replaced: {error.strerror}; the new run is {self.making}"
            ) from None
        self.making = self.path
        shutil.rmtree(old, ignore_errors=True)


def _refuse_to_replace(path: Path, making: Path, force: bool) -> None:
    if not force:
        raise RunFolderError(
            f"{path}: there already, and no run is overwritten; "
            "choose another --out, or --force to replace it"
        )
    if not log_of(path).is_file():
        raise RunFolderError(f"{path}: not a run folder, so --force does not replace it")
    if making.exists():
        raise RunFolderError(
            f"{making}: holds what an earlier run recorded and could not finish; "
            "move it away, or choose another --out"
        )


def finish(
    folder: Path,
    scenario: Scenario,
    network: Network,
    outcome: Outcome,
    recorded: Scenario | None = None,
    report: bool = True,
    columns: RunColumns | None = None,
) -> Metrics:
    """Write ``signals.csv``, ``run.json`` and both reports from the log, however it ended.

    Args:
        folder: has ``bus.log``.
        scenario: what ran.
        network: its frames.
        outcome: how it went.
        recorded: the scenario for ``run.json``, where its paths will be others; None: what ran.
        report: draw ``report.png`` and ``report.html``.
        columns: what the log says, of a run without a bus; None: it is read.

    Raises:
        LogError: the log cannot be read.
        RunFolderError: one of them cannot be written; what was recorded stays.
    """
    if columns is None:
        signals = signals_of_log(folder, scenario, network, outcome.realtime)
    else:
        signals = signals_of_columns(columns, scenario.tick_s, folder / LOG)
    values = metrics(scenario, signals)
    outcome.faults = fault_metrics(scenario, signals)
    signals = with_verdict(scenario, network, signals)
    outcome.whose_fault = whose_fault(scenario, signals)
    summary: dict[str, Any] = {
        "scenario": (recorded or scenario).as_dict(),
        "seed": scenario.seed,
        "metrics": values,
        **asdict(outcome),
        "ticks_per_s": outcome.ticks_per_s,
        "real_time_factor": outcome.ticks_per_s * scenario.tick_s,
        "versions": {
            "python": platform.python_version(),
            **_versions(),
        },
    }
    if outcome.realtime is None:
        del summary["realtime"]
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with atomic(folder / SUMMARY) as part:  # first: what it says, the log alone does not
            part.write_text(text + "\n", encoding="utf-8")
        with atomic(folder / SIGNALS) as part:
            signals.write_csv(part, scenario.plant)
        if report:
            # matplotlib, when the nodes are done
            from can_rig.results.report.page import draw_report  # noqa: PLC0415
            from can_rig.results.report.web_page import web_page  # noqa: PLC0415

            with atomic(folder / REPORT) as part:
                draw_report(part, scenario, network, signals, outcome.realtime)
            with atomic(folder / PAGE) as part:
                text = web_page(scenario, network, signals, values, outcome.faults)
                part.write_text(text, encoding="utf-8")
        if outcome.ticks > paged.PAGED_ROWS:  # 8 minutes at 1 kHz
            for name in (SIGNALS, plant_signals_path(folder / LOG).name, LOG):
                compress(folder / name)
    except LogError as error:
        raise RunFolderError(f"{error}; what was recorded is in {folder / LOG}") from None
    return values


def log_of(folder: Path) -> Path:
    """The log of a run folder, which of a long run is gzipped; it need not be there."""
    return stored(folder / LOG)


def signals_of_log(
    folder: Path, scenario: Scenario, network: Network, realtime: dict[str, Any] | None
) -> Signals:
    """What was on the bus of a run, read from its log; a real-time run has its own idea of late."""
    in_time_ticks = 1 if realtime is None else scenario.latency_ticks
    return read_signals(log_of(folder), network, scenario.tick_s, in_time_ticks)


def _versions() -> dict[str, str]:
    """Of the packages that are installed: one that an extra brings may not be."""
    found = {}
    for package in PACKAGES:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
