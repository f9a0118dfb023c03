"""The folder of a campaign: new or gone on with, and what of it is done."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from can_rig.campaigns.computing.versions import versions
from can_rig.campaigns.plan import Plan
from can_rig.campaigns.run import Task, requirements_of
from can_rig.campaigns.search import GENERATION
from can_rig.errors import LogError, RunFolderError, require
from can_rig.files import atomic

TABLE, PLAN, BLOCKS = "runs.parquet", "campaign.json", "blocks"
MOST_IN_A_BLOCK: Final = 256
BLOCKS_WANTED: Final = 16
"""So that little is lost where few runs are interrupted; a file costs as much as several runs."""


@dataclass(frozen=True)
class CampaignFolder:
    """Where a campaign stands.

    Attributes:
        path: the folder.
        plan: what is run.
    """

    path: Path
    plan: Plan

    @property
    def blocks_path(self) -> Path:
        """Where its blocks are until the table is whole."""
        return self.path / BLOCKS

    @property
    def table(self) -> Path:
        """All runs, once they are done."""
        return self.path / TABLE

    @cached_property
    def blocks(self) -> dict[Task, Path]:
        """Every block and its file, in the order of the runs; of a search, its generations."""
        searched, runs = self.plan.searched, self.plan.runs
        size = min(MOST_IN_A_BLOCK, max(1, (runs - searched) // BLOCKS_WANTED))
        tasks = [*_tasks(0, searched, GENERATION), *_tasks(searched, runs, size)]
        return {each: self.blocks_path / f"{each.begin:08d}.parquet" for each in tasks}

    @property
    def done(self) -> int:
        """How many runs are done."""
        if self.table.is_file():
            return self.plan.runs
        return sum(task.end - task.begin for task, file in self.blocks.items() if file.is_file())


def _tasks(begin: int, end: int, size: int) -> list[Task]:
    return [Task(first, min(first + size, end)) for first in range(begin, end, size)]


def open_folder(path: Path | None, plan: Plan, *, resume: bool, force: bool) -> CampaignFolder:
    """The folder of a campaign, new or gone on with.

    Raises:
        MissingExtraError: a search, and cma is not installed.
        ScenarioError: a requirement that is none.
        RunFolderError: it is there already, is not that of this campaign, or cannot be made.
    """
    requirements_of(plan)
    if plan.searched:
        require("cma", extra="search")
    if path is None:
        path = Path("campaigns") / f"{plan.settings.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, file = CampaignFolder(path, plan), path / PLAN
    if resume:
        if not file.is_file():
            raise RunFolderError(f"{path}: not the folder of a campaign; --resume needs its --out")
        _require_same(file, plan)
        return folder
    if path.exists():
        if not force:
            raise RunFolderError(
                f"{path}: there already; choose another --out, --resume to go on with it, "
                "or --force to replace it"
            )
        if not file.is_file():
            raise RunFolderError(
                f"{path}: not the folder of a campaign, so --force does not replace it"
            )
        shutil.rmtree(path)
    try:
        (path / BLOCKS).mkdir(parents=True)
        with atomic(file) as part:
            part.write_text(json.dumps(_said(plan), indent=2, ensure_ascii=False) + "\n", "utf-8")
    except (OSError, LogError) as error:
        raise RunFolderError(f"{path}: cannot be made: {error}") from None
    return folder


def _said(plan: Plan) -> dict[str, Any]:
    """Everything that the runs follow from."""
    return {
        "campaign": plan.settings.as_dict(),
        "scenario": plan.base.as_dict(),
        "versions": versions(),
    }


def _require_same(file: Path, plan: Plan) -> None:
    try:
        before = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from None
    now = json.loads(json.dumps(_said(plan)))
    for part, what in (("campaign", "campaign"), ("scenario", "scenario"), ("versions", "package")):
        old, new = before.get(part, {}), now[part]
        for key in new:
            if old.get(key) != new[key]:
                raise RunFolderError(
                    f"{file}: {what} {key} is {old.get(key)!r} there and {new[key]!r} now; must be "
                    "the same to go on, or take another --out"
                )
