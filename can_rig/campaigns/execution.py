"""A campaign computed block by block: drawn runs, a search, and in the end one table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from itertools import takewhile
from typing import Final

from can_rig.campaigns.campaign import BLOCKS, CampaignFolder
from can_rig.campaigns.computing.workers import Compute
from can_rig.campaigns.run import Row, Task
from can_rig.campaigns.search import GENERATION, Search
from can_rig.campaigns.statistics import margin_column
from can_rig.campaigns.table import put_together, read_columns, schema, write_block
from can_rig.files import tidy
from can_rig.folders import remove

Stopped = Callable[[], bool]
OnRun = Callable[[int], None]

PART: Final = 16
"""Runs given to a worker at once: little work is lost with a block."""


def execute(
    folder: CampaignFolder,
    workers: AbstractContextManager[Compute],
    stopped: Stopped,
    on_done: OnRun,
) -> bool:
    """Compute the missing blocks; returns whether all blocks are done.

    Args:
        folder: of the campaign.
        workers: computes the runs.
        stopped: asked before a block is begun; blocks under way are finished.
        on_done: receives the number of finished runs.

    Raises:
        RigError: workers die again and again.
        LogError: a file cannot be written.
    """
    if folder.table.is_file():
        return True
    blocks, columns, searched = folder.blocks, schema(folder.plan), folder.plan.searched
    with workers as compute:
        found = not searched or search(folder, compute, stopped, on_done)
        drawn = (task for task in blocks if found and task.begin >= searched)
        missing = (task for task in drawn if not blocks[task].is_file())
        todo = takewhile(lambda _: not stopped(), missing)
        for task, rows in computed(todo, compute, PART):
            write_block(blocks[task], rows, columns)
            on_done(folder.done)
    if folder.done < folder.plan.runs:
        return False
    put_together(list(blocks.values()), folder.table)
    tidy(folder.blocks_path)
    remove(folder.path, [*(f"{BLOCKS}/{file.name}" for file in blocks.values()), BLOCKS])
    return True


def search(folder: CampaignFolder, compute: Compute, stopped: Stopped, on_done: OnRun) -> bool:
    """Compute all generations, or read finished generations.

    Returns whether the last generation is done.
    """
    settings, columns = folder.plan.settings, schema(folder.plan)
    searcher = Search(len(settings.axes), settings.seed)
    margin = margin_column(folder.plan)
    for task, file in folder.blocks.items():
        if task.begin >= folder.plan.searched:
            break
        points = searcher.ask()[: task.end - task.begin]
        if not file.is_file():
            if stopped():
                return False
            for _, rows in computed([task._replace(points=tuple(points))], compute, 1):
                write_block(file, rows, columns)
                on_done(folder.done)
        if len(points) == GENERATION:
            searcher.tell(read_columns(file, [margin])[margin])
    return True


def computed(
    blocks: Iterable[Task], compute: Compute, most: int
) -> Iterator[tuple[Task, list[Row]]]:
    """Complete blocks; workers compute parts of at most ``most`` runs in any order."""
    wholes: dict[Task, Task] = {}
    rows: dict[Task, dict[int, Row]] = {}

    def parts() -> Iterator[Task]:
        for block in blocks:
            rows[block] = {}
            for part in block.parts(most):
                wholes[part] = block
                yield part

    for part, some in compute(parts()):
        block = wholes.pop(part)
        known = rows[block]
        known |= dict(zip(range(part.begin, part.end), some, strict=True))
        if len(known) == block.end - block.begin:
            del rows[block]
            yield block, [known[run] for run in range(block.begin, block.end)]
