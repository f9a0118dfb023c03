"""The run folder: made once, never overwritten, finished from its ``bus.log``."""

from __future__ import annotations

import json
import platform
import shutil
import time
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from can_rig.errors import LogError, RunFolderError
from can_rig.files import atomic
from can_rig.frames.network import Network
from can_rig.results.metrics import Metrics, metrics
from can_rig.results.signals import read_signals
from can_rig.scenario.settings import Scenario

LOG, SIGNALS, SUMMARY, REPORT = "bus.log", "signals.csv", "run.json", "report.png"
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
    realtime: dict[str, Any] | None = None
    """Of a real-time run; empty where it ended without figures."""

    @property
    def ticks_per_s(self) -> float:
        """Rate of the loop in wall-clock time."""
        return self.ticks / self.wall_s if self.wall_s > 0.0 else 0.0


def create(folder: Path | None, scenario: Scenario, force: bool) -> Path:
    """Make the folder; without a name it is ``runs/SCENARIO-DATE-TIME``.

    A run that it replaces is only set aside: ``finish`` removes it, ``give_up`` brings it back.

    Raises:
        RunFolderError: it is there already and ``force`` is not given, or cannot be made.
    """
    if folder is None:
        folder = Path("runs") / f"{scenario.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    try:
        if folder.exists():
            if not force:
                raise RunFolderError(
                    f"{folder}: there already, and no run is overwritten; "
                    "another --out, or --force to replace it, is right"
                )
            if not (folder / LOG).is_file():
                raise RunFolderError(f"{folder}: not a run folder, so --force does not replace it")
            folder.rename(_replaced(folder))
        folder.mkdir(parents=True)
    except OSError as error:
        raise RunFolderError(f"{folder}: cannot be made: {error.strerror}") from None
    return folder


def give_up(folder: Path) -> None:
    """Take away the folder of a run that recorded nothing; the one that it replaced comes back."""
    folder.rmdir()
    if _replaced(folder).is_dir():
        _replaced(folder).rename(folder)


def _replaced(folder: Path) -> Path:
    """Where the run that ``--force`` replaces waits until there is another."""
    return folder.with_name(f"{folder.name}.replaced")


def finish(folder: Path, scenario: Scenario, network: Network, outcome: Outcome) -> Metrics:
    """Write ``signals.csv``, ``run.json`` and ``report.png`` from the log, however it ended.

    Raises:
        LogError: the log cannot be read.
        RunFolderError: one of them cannot be written; what was recorded stays.
    """
    from can_rig.results.report import draw_report  # noqa: PLC0415 (matplotlib, when nodes are done)

    in_time_ticks = 1 if outcome.realtime is None else scenario.latency_ticks
    signals = read_signals(folder / LOG, network, scenario.tick_s, in_time_ticks)
    values = metrics(scenario, signals)
    summary: dict[str, Any] = {
        "scenario": scenario.as_dict(),
        "seed": scenario.seed,
        "metrics": values,
        **asdict(outcome),
        "ticks_per_s": outcome.ticks_per_s,
        "real_time_factor": outcome.ticks_per_s * scenario.tick_s,
        "versions": {
            "python": platform.python_version(),
            **{package: version(package) for package in PACKAGES},
        },
    }
    if outcome.realtime is None:
        del summary["realtime"]
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with atomic(folder / SUMMARY) as part:  # first: what it says, the log alone does not
            part.write_text(text + "\n", encoding="utf-8")
        with atomic(folder / SIGNALS) as part:
            signals.write_csv(part)
        with atomic(folder / REPORT) as part:
            draw_report(part, scenario, network, signals, outcome.realtime)
    except LogError as error:
        raise RunFolderError(f"{error}; what was recorded is in {folder / LOG}") from None
    shutil.rmtree(_replaced(folder), ignore_errors=True)
    return values
