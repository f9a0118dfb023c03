"""A campaign of short runs, computed here or by workers, and its table."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from pyarrow import parquet

from can_rig.campaigns.execution import CampaignFolder, OnRun, execute, open_folder
from can_rig.campaigns.plan import Plan, plan
from can_rig.campaigns.settings import campaign_of
from can_rig.campaigns.workers import Compute, in_processes, serially

WhoComputes = Callable[[Plan], AbstractContextManager[Compute]]

SHORT: dict[str, Any] = {
    "settings": {"duration_s": 0.06, "fault.at_s": 0.03, "fault.kind": "actuator-dead"},
    "axes": {"plant.mass_kg": {"share": 0.2}, "fault.left": {"range": [0.0, 0.9]},
             "design.compensation": {"values": ["always", "on-confirmation"]}},
    "requirements": {"small": "deviation_peak_after_fault_mps2 <= 1e-3 or missed_detection"},
    "runs": 12,
}  # fmt: skip


def planned(**values: Any) -> Plan:
    """``SHORT`` with other keys."""
    return plan(campaign_of("some", {**SHORT, **values}))


def never() -> bool:
    """Nobody stops the campaign."""
    return False


def ran(
    path: Path, some: Plan, who: WhoComputes = serially, stops: int = 0, on_done: OnRun = str
) -> CampaignFolder:
    """The campaign, stopped so often after two blocks, and resumed."""
    folder = open_folder(path, some, resume=False, force=False)
    for _ in range(stops):
        left = iter([False] * 2)
        assert not execute(folder, who(some), lambda left=left: next(left, True), on_done)
        assert 0 < folder.done < some.runs
        folder.made.close()  # as the end of a process does
        folder = open_folder(path, some, resume=True, force=False)
    assert execute(folder, who(some), never, on_done)
    return folder


def in_two_processes(some: Plan) -> AbstractContextManager[Compute]:
    """Two workers."""
    return in_processes(some, 2)


def rows(folder: CampaignFolder) -> list[dict[str, Any]]:
    """The table, a dictionary a run."""
    table: list[dict[str, Any]] = parquet.read_table(folder.table).to_pylist()
    return table
