"""The folder of a campaign, new or resumed, and the progress of its runs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
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
from can_rig.folders import Kind, NewFolder, default_folder

TABLE, PLAN, BLOCKS = "runs.parquet", "campaign.json", "blocks"
SUMMARY, PICTURE, PAGE = "summary.json", "report.png", "report.html"
BLOCK: Final = re.compile(r"\d{8}\.parquet")
MOST_IN_A_BLOCK: Final = 256
BLOCKS_WANTED: Final = 16
"""Enough blocks that an interruption loses little; writing a file costs as much as several runs."""


def _blocks(folder: Path) -> Iterator[str]:
    if (folder / BLOCKS).is_dir() and not (folder / BLOCKS).is_symlink():
        for path in (folder / BLOCKS).iterdir():
            if BLOCK.fullmatch(path.name):
                yield f"{BLOCKS}/{path.name}"


def _own(folder: Path) -> Iterator[str]:
    yield from _blocks(folder)
    yield from (BLOCKS, PLAN, TABLE, SUMMARY, PICTURE, PAGE)


def _recorded(folder: Path) -> bool:
    return (folder / TABLE).exists() or any(_blocks(folder))


CAMPAIGN_FOLDER: Final = Kind("the folder of a campaign", PLAN, _own, _recorded)


@dataclass(frozen=True)
class CampaignFolder:
    """The progress of a campaign.

    Attributes:
        made: the folder in the making; the report, when written, lets this folder replace an
            earlier one.
        plan: the campaign's plan.
    """

    made: NewFolder
    plan: Plan

    @property
    def path(self) -> Path:
        """The folder's present place."""
        return self.made.making

    @property
    def blocks_path(self) -> Path:
        """Where its blocks are until the table is whole."""
        return self.path / BLOCKS

    @property
    def table(self) -> Path:
        """All runs, after the last run is done."""
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
    """The folder of a campaign, new or resumed.

    Raises:
        MissingExtraError: a search, and cma is not installed.
        ScenarioError: a requirement is invalid.
        RunFolderError: the folder already exists, belongs to another campaign, or cannot be made.
    """
    requirements_of(plan)
    if plan.searched:
        require("cma", extra="search")
    path = path or default_folder("campaigns", plan.settings.name)
    if resume:
        folder = CampaignFolder(NewFolder.resume(path, CAMPAIGN_FOLDER), plan)
        try:
            _require_same(folder.path / PLAN, plan)
        except RunFolderError:
            folder.made.close()
            raise
        return folder
    folder = CampaignFolder(NewFolder.create(path, CAMPAIGN_FOLDER, force), plan)
    try:
        folder.blocks_path.mkdir(exist_ok=True)
        with atomic(folder.path / PLAN, force=True) as part:
            part.write_text(json.dumps(_said(plan), indent=2, ensure_ascii=False) + "\n", "utf-8")
    except (OSError, LogError) as error:
        folder.made.give_up()
        raise RunFolderError(f"{path}: cannot be made: {error}") from None
    return folder


def _said(plan: Plan) -> dict[str, Any]:
    """Everything that determines the runs."""
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
