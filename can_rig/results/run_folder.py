"""The run folder: its files, and their completion from ``bus.log``."""

import json
import platform
from dataclasses import asdict, dataclass, field
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.errors import LogError, RunFolderError, ScenarioError
from can_rig.frames.network import Network
from can_rig.logs.compression import compress, stored
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.ticks import RunColumns
from can_rig.results.isolation import whose_fault, with_verdict
from can_rig.results.metrics import Metrics, fault_metrics, metrics
from can_rig.results.signals import Signals, read_signals, signals_of_columns
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from can_rig.storage.files import atomic
from can_rig.storage.folders import Kind

LOG, SIGNALS, SUMMARY = "bus.log", "signals.csv", "run.json"
REPORT, PAGE = "report.png", "report.html"
REFERENCE: Final = "reference.csv"
"""The run's own reference, in the folder."""
WHAT_IF: Final = "what-if.png"
"""The differences of a what-if from the log."""
_TEXT: Final = (LOG, plant_signals_path(Path(LOG)).name, SIGNALS)
"""Files that a long run gzips."""
OWN: Final = (*_TEXT, *(f"{name}.gz" for name in _TEXT), SUMMARY, REPORT, PAGE, REFERENCE, WHAT_IF)
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
    """The facts of a run that the log lacks, and the results per fault."""

    bus: str
    outcome: str = "complete"
    ticks: int = 0
    wall_s: float = 0.0
    rejected_frames: dict[str, dict[str, int]] = field(default_factory=dict)
    bus_events: dict[str, dict[str, int]] = field(default_factory=dict)
    faults: list[dict[str, Any]] = field(default_factory=list)
    """The effect of each fault, from the log."""
    whose_fault: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Each verdict of a fault; see ``results.isolation``."""
    realtime: dict[str, Any] | None = None
    """Figures of a real-time run; empty after an early end."""

    @property
    def ticks_per_s(self) -> float:
        """Rate of the loop in wall-clock time."""
        return self.ticks / self.wall_s if self.wall_s > 0.0 else 0.0


def _recorded(folder: Path) -> bool:
    """Whether a folder holds recorded data."""
    log = log_of(folder)
    return (log.is_file() and log.stat().st_size > 0) or (folder / SUMMARY).exists()


@cache
def _versions() -> dict[str, str]:
    return {"python": platform.python_version()} | {name: version(name) for name in PACKAGES}


RUN_FOLDER: Final = Kind("a run folder", LOG, lambda _: OWN, _recorded)


def finish(
    folder: Path,
    scenario: Scenario,
    network: Network,
    outcome: Outcome,
    recorded: Scenario | None = None,
    report: bool = True,
    columns: RunColumns | None = None,
) -> Metrics:
    """Write ``signals.csv``, ``run.json`` and both reports from the log.

    Args:
        folder: the folder with ``bus.log``.
        scenario: the executed scenario.
        network: the frames.
        outcome: completed here.
        recorded: the scenario for ``run.json``, if its paths differ; None: ``scenario``.
        report: draw ``report.png`` and ``report.html``.
        columns: data of a run without a bus; None: read the log.

    Raises:
        LogError: the log cannot be read.
        RunFolderError: a file cannot be written; the recorded data stay.
    """
    if columns is None:
        signals = signals_of_log(folder, scenario, network, outcome.realtime)
    else:
        signals = signals_of_columns(columns, scenario.tick_s, folder / LOG)
    if not outcome.ticks and len(signals):  # a killed node sends no summary
        outcome.ticks = len(signals) - bool(np.isnan(signals.fault_state[-1]))
    values = metrics(scenario, signals)
    said = recorded or scenario
    outcome.faults = fault_metrics(scenario, signals)
    signals = with_verdict(scenario, network, signals)
    outcome.whose_fault = whose_fault(scenario, signals)
    summary: dict[str, Any] = {
        "scenario": said.as_dict(),
        "seed": scenario.seed,
        "metrics": values,
        **asdict(outcome),
        "ticks_per_s": outcome.ticks_per_s,
        "real_time_factor": outcome.ticks_per_s * scenario.tick_s,
        "versions": _versions(),
    }
    if outcome.realtime is None:
        del summary["realtime"]
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with atomic(folder / SUMMARY, force=True) as part:  # first: the log lacks these facts
            part.write_text(text + "\n", encoding="utf-8")
        with atomic(folder / SIGNALS, force=True) as part:
            signals.write_csv(part, scenario.plant)
        if report:
            # matplotlib, when the nodes are done
            from can_rig.results.report.page import page  # noqa: PLC0415
            from can_rig.results.report.web_page import web_page  # noqa: PLC0415

            with atomic(folder / REPORT, force=True) as part:
                page(scenario, network, signals, outcome.realtime).savefig(part, dpi=150)
            with atomic(folder / PAGE, force=True) as part:
                text = web_page(scenario, network, signals, values, outcome.faults, said)
                part.write_text(text, encoding="utf-8")
        if outcome.ticks > paged.PAGED_ROWS:  # 8 minutes at 1 kHz
            for name in reversed(_TEXT):
                compress(folder / name)
    except LogError as error:
        raise RunFolderError(f"{error}; what was recorded is in {folder / LOG}") from None
    return values


def recorded_scenario(folder: Path) -> tuple[dict[str, Any], bool]:
    """The scenario of a run folder, as plain values, and whether it ran in real time.

    The path of the folder's own reference follows the folder to a new place.

    Raises:
        ScenarioError: no readable scenario.
    """
    file = folder / SUMMARY
    try:
        summary = json.loads(file.read_text("utf-8"))
        values = summary["scenario"]
        if isinstance(values, dict):
            reference = values.get("reference")
            own = (folder / REFERENCE).is_file()
            if own and isinstance(reference, dict) and reference.get("file") == REFERENCE:
                reference["file"] = str(folder / REFERENCE)
            return values, summary.get("realtime") is not None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass
    raise ScenarioError(f"{file}: has no scenario that can be read; name it with --scenario NAME")


def log_of(folder: Path) -> Path:
    """The log of a run folder, gzipped for a long run; the log may be missing."""
    return stored(folder / LOG)


def signals_of_log(
    folder: Path, scenario: Scenario, network: Network, realtime: dict[str, Any] | None
) -> Signals:
    """The signals of a run, read from the log."""
    in_time_ticks = 1 if realtime is None else scenario.latency_ticks
    return read_signals(log_of(folder), network, scenario.tick_s, in_time_ticks)
