"""A campaign in its folder: planned, computed block by block, gone on with, put together."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.run import requirements_of
from can_rig.campaigns.table import put_together, schema, write_block
from can_rig.campaigns.workers import Range, in_processes, serially
from can_rig.errors import LogError, RunFolderError, require
from can_rig.files import atomic

TABLE, PLAN, BLOCKS = "runs.parquet", "campaign.json", "blocks"
MOST_IN_A_BLOCK: Final = 256
BLOCKS_WANTED: Final = 64
"""So that few runs keep several workers busy, and many make few files."""

OnRun = Callable[[int], None]


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
    def table(self) -> Path:
        """All runs, once they are done."""
        return self.path / TABLE

    @property
    def blocks(self) -> dict[Range, Path]:
        """Every block and its file, in the order of the runs."""
        runs = self.plan.runs
        size = min(MOST_IN_A_BLOCK, max(1, runs // BLOCKS_WANTED))
        ranges = [(begin, min(begin + size, runs)) for begin in range(0, runs, size)]
        return {each: self.path / BLOCKS / f"{each[0]:08d}.parquet" for each in ranges}

    @property
    def done(self) -> int:
        """How many runs are done."""
        if self.table.is_file():
            return self.plan.runs
        return sum(end - begin for (begin, end), file in self.blocks.items() if file.is_file())


def open_folder(path: Path | None, plan: Plan, *, resume: bool, force: bool) -> CampaignFolder:
    """The folder of a campaign, new or gone on with.

    Raises:
        MissingExtraError: pyarrow is not installed.
        ScenarioError: a requirement that is none.
        RunFolderError: it is there already, is not that of this campaign, or cannot be made.
    """
    require("pyarrow", extra="logs")
    requirements_of(plan)
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
        "versions": {
            package: version(package)
            for package in ("fault-tolerant-steering", "numpy", "scipy", "numba")
        },
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


def execute(
    folder: CampaignFolder, workers: int, stopped: Callable[[], bool], on_done: OnRun
) -> bool:
    """Compute what is not there yet; whether all is.

    Args:
        folder: of the campaign.
        workers: processes; 1: this one.
        stopped: asked between blocks; what is done is kept.
        on_done: called with the number of runs that are done.

    Raises:
        RigError: workers die again and again.
        LogError: a file cannot be written.
    """
    if folder.table.is_file():
        return True
    blocks, columns = folder.blocks, schema(folder.plan)
    todo = [each for each, file in blocks.items() if not file.is_file()]
    done = folder.done
    computed = (
        serially(folder.plan, todo, stopped)
        if workers == 1
        else in_processes(folder.plan, todo, workers, stopped)
    )
    for block, rows in computed:
        write_block(blocks[block], rows, columns)
        done += block[1] - block[0]
        on_done(done)
    if done < folder.plan.runs:
        return False
    put_together(list(blocks.values()), folder.table)
    shutil.rmtree(folder.path / BLOCKS)
    return True
