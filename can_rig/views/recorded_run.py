"""A run as an object: its scenario, signals as a table, metrics, and its picture."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import shutil
import weakref
from functools import cached_property
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Final

from can_rig.errors import (
    LogError,
    RigError,
    RunFolderError,
    ScenarioError,
    did_you_mean,
    in_python,
)
from can_rig.nodes.bus_access import StopRequest
from can_rig.results.execution import Options, execute, refuse
from can_rig.results.metrics import Metrics, rows
from can_rig.results.run_folder import REPORT, RUN_FOLDER, SUMMARY, signals_of_log
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from can_rig.storage.folders import NewFolder
from can_rig.views.signal_table import SignalTable, read_table, scenario_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

PICTURE_DPI: Final = 80


class RecordedRun:
    """A run in its folder; the folder is temporary until ``save``.

    Attributes:
        folder: with ``bus.log``, ``signals.csv`` and ``run.json``.
        scenario: the executed scenario, with all defaults.
        summary: the content of ``run.json``.
    """

    def __init__(self, folder: Path, scenario: Scenario, temporary: Path | None = None) -> None:
        self.folder = folder
        self.scenario = scenario
        self.summary: dict[str, Any] = json.loads((folder / SUMMARY).read_text("utf-8"))
        if temporary is not None:  # removed with this object
            weakref.finalize(self, shutil.rmtree, temporary, ignore_errors=True)

    @classmethod
    def load(cls, folder: Path) -> RecordedRun:
        """The run of a finished run folder.

        Raises:
            LogError: not a finished run.
            ScenarioError: the folder lacks a readable scenario.
        """
        if not (folder / SUMMARY).is_file():
            raise LogError(f"{folder}: not a finished run folder, it has no {SUMMARY}")
        scenario = scenario_of(folder)
        if scenario is None:
            raise ScenarioError(f"{folder / SUMMARY}: has no scenario that can be read")
        return cls(folder, scenario)

    @property
    def metrics(self) -> Metrics:
        """Errors in m/s², times in s, commands in N m and N.

        None: the run lacks the moment in question.
        """
        values: Metrics = self.summary["metrics"]
        return values

    def metric(self, name: str) -> float:
        """A metric as a number; not a number where the run lacks the moment in question.

        Raises:
            RigError: no such metric, or a metric in words.
        """
        if name not in self.metrics:
            raise RigError(
                f"metric {name}: no such metric; {did_you_mean(name, self.metrics, '', 0.0)}"
            )
        value = self.metrics[name]
        if isinstance(value, str):
            raise RigError(f"metric {name} = {value!r}: must be a metric that is a number")
        return math.nan if value is None else float(value)

    @cached_property
    def table(self) -> SignalTable:
        """The columns of ``signals.csv`` as arrays, with names and units."""
        return read_table(self.folder, self.scenario)

    @cached_property
    def signals(self) -> pd.DataFrame:
        """The columns of ``signals.csv``, a row a tick; the index is ``time_s``.

        ``attrs["units"]`` has the unit of each column, ``attrs["names"]`` the printed name.
        """
        import pandas as pd  # noqa: PLC0415 (slow to import)

        table = self.table
        frame = pd.DataFrame(table.columns, index=pd.Index(table.time_s, name="time_s"), copy=False)
        printed = {column: table.name_and_unit(column) for column in table.columns}
        frame.attrs["names"] = {column: name for column, (name, _) in printed.items()}
        frame.attrs["units"] = {column: unit for column, (_, unit) in printed.items()}
        return frame

    def plot(self) -> Figure:
        """The page of ``report.png`` as a matplotlib figure."""
        from can_rig.results.report.page import page  # noqa: PLC0415 (matplotlib)

        realtime = self.summary.get("realtime")
        network = network_of(self.scenario)
        signals = signals_of_log(self.folder, self.scenario, network, realtime)
        return page(self.scenario, network, signals, realtime)

    @in_python
    def save(self, folder: str | Path, *, force: bool = False) -> Path:
        """Copy the run into a folder of its own, with ``report.png``; returns the folder.

        Args:
            folder: where; its parents are made.
            force: replace an existing run.

        Raises:
            RunFolderError: the folder already exists, or cannot be written.
        """
        with NewFolder.create(Path(folder), RUN_FOLDER, force) as made:
            try:
                shutil.copytree(self.folder, made.making, dirs_exist_ok=True)
                if not (made.making / REPORT).is_file():
                    self.plot().savefig(made.making / REPORT, dpi=150)
            except OSError as error:
                made.give_up()
                raise RunFolderError(f"{folder}: cannot be written: {error.strerror}") from None
            made.publish()
        return made.path

    def __getstate__(self) -> dict[str, Any]:
        """All files of the folder: a pickled run needs no folder."""
        files = {file.name: file.read_bytes() for file in self.folder.iterdir() if file.is_file()}
        return {"name": self.folder.name, "scenario": self.scenario, "files": files}

    def __setstate__(self, state: dict[str, Any]) -> None:
        temporary = Path(mkdtemp(prefix="can-rig-"))
        folder = temporary / state["name"]
        folder.mkdir()
        for name, content in state["files"].items():
            (folder / name).write_bytes(content)
        RecordedRun.__init__(self, folder, state["scenario"], temporary)

    def __repr__(self) -> str:
        """Scenario, ticks, end of the run."""
        return f"<run of {self.scenario.name}: {self.summary['ticks']} ticks, {self._outcome}>"

    @property
    def _outcome(self) -> str:
        return str(self.summary["outcome"])

    def _repr_html_(self) -> str:
        """The metrics beside the picture, for a notebook."""
        picture = io.BytesIO()
        self.plot().savefig(picture, dpi=PICTURE_DPI, format="png")
        encoded = base64.b64encode(picture.getvalue()).decode()
        lines = [("scenario", self.scenario.name), ("outcome", self._outcome)]
        lines += rows(self.metrics, self.scenario.plant)
        table = "".join(
            f"<tr><th style='text-align:left'>{html.escape(label)}</th>"
            f"<td>{html.escape(text)}</td></tr>"
            for label, text in lines
        )
        return f"<table>{table}</table><img src='data:image/png;base64,{encoded}'>"


def record(scenario: Scenario, *, allow_unstable: bool = False) -> RecordedRun:
    """Run a scenario in this process, in lockstep, into a temporary folder.

    Raises:
        ScenarioError: see ``execution.refuse``.
        RigError: the run ended early.
    """
    refuse(scenario, allow_unstable)
    temporary = Path(mkdtemp(prefix="can-rig-"))
    try:
        done = execute(scenario, temporary / "run", StopRequest(), Options(report=False))
        if done is None or done.failure is not None:
            raise (done and done.failure) or LogError(f"{scenario.name}: nothing was recorded")
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise
    return RecordedRun(done.folder, scenario, temporary)
