"""The run folder: what stands in it, and how it is completed from its ``bus.log``."""

from __future__ import annotations

import json
import platform
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

from can_rig import paged
from can_rig.errors import LogError, RunFolderError, ScenarioError
from can_rig.files import atomic
from can_rig.folders.replacing import Kind
from can_rig.frames.network import Network
from can_rig.logs.compression import compress, stored
from can_rig.logs.plant_signals import plant_signals_path
from can_rig.nodes.ticks import RunColumns
from can_rig.results.fault_metrics import fault_metrics
from can_rig.results.isolation.verdicts import with_verdict
from can_rig.results.isolation.words import whose_fault
from can_rig.results.metrics import Metrics, metrics
from can_rig.results.signals import Signals, read_signals, signals_of_columns
from can_rig.scenario.settings import Scenario

LOG, SIGNALS, SUMMARY = "bus.log", "signals.csv", "run.json"
REPORT, PAGE = "report.png", "report.html"
REFERENCE: Final = "reference.csv"
"""A reference that is the run's own, in its folder."""
WHAT_IF: Final = "what-if.png"
"""How the run of a what-if differs from the log that it was asked about."""
_TEXT: Final = (LOG, plant_signals_path(Path(LOG)).name, SIGNALS)
"""Files that are gzipped in the folder of a long run."""
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


def _recorded(folder: Path) -> bool:
    """Whether a run has got anywhere."""
    log = log_of(folder)
    return (log.is_file() and log.stat().st_size > 0) or (folder / SUMMARY).exists()


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
    """Write ``signals.csv``, ``run.json`` and both reports from the log, however it ended.

    Args:
        folder: has ``bus.log``.
        scenario: what ran.
        network: its frames.
        outcome: how it went.
        recorded: the scenario as the folder says it, where a path in it is another; None: what ran.
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
        "versions": {
            "python": platform.python_version(),
            **_versions(),
        },
    }
    if outcome.realtime is None:
        del summary["realtime"]
    text = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with atomic(
            folder / SUMMARY, force=True
        ) as part:  # first: what it says, the log alone does not
            part.write_text(text + "\n", encoding="utf-8")
        with atomic(folder / SIGNALS, force=True) as part:
            signals.write_csv(part, scenario.plant)
        if report:
            # matplotlib, when the nodes are done
            from can_rig.results.report.page import draw_report  # noqa: PLC0415
            from can_rig.results.report.web_page import web_page  # noqa: PLC0415

            with atomic(folder / REPORT, force=True) as part:
                draw_report(part, scenario, network, signals, outcome.realtime)
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

    The path of a reference that the folder keeps itself leads into the folder, wherever that lies.

    Raises:
        ScenarioError: there is no scenario that can be read.
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
