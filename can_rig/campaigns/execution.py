"""The folder of a campaign, new or resumed, and its runs: drawn blocks, a search, one table."""

import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.campaigns.plan import Plan
from can_rig.campaigns.rows import (
    Row,
    Task,
    put_together,
    read_columns,
    require_tables,
    requirements_of,
    schema,
    write_block,
)
from can_rig.campaigns.statistics import margin_column
from can_rig.campaigns.workers import Compute, versions
from can_rig.errors import LogError, RunFolderError, require
from can_rig.scenario.own_class import module_file
from can_rig.storage.files import atomic, tidy
from can_rig.storage.folders import Kind, NewFolder, default_folder, remove

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


CAMPAIGN_FOLDER: Final = Kind(
    "the folder of a campaign",
    PLAN,
    own=lambda folder: [*_blocks(folder), BLOCKS, PLAN, TABLE, SUMMARY, PICTURE, PAGE],
    recorded=lambda folder: (folder / TABLE).exists() or any(_blocks(folder)),
)


@dataclass(frozen=True)
class CampaignFolder:
    """The progress of a campaign.

    Attributes:
        made: the folder in the making; the report, when written, lets this folder replace an
            earlier one.
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
        ScenarioError: a requirement or a table is invalid.
        RunFolderError: the folder already exists, belongs to another campaign, or cannot be made.
    """
    requirements_of(plan)
    require_tables(plan)
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
        "campaign": asdict(plan.settings),
        "scenario": {name: base.values for name, base in plan.bases.items()},
        "versions": versions(),
        "files": _digests(plan),
    }


def _digests(plan: Plan) -> dict[str, str]:
    """Digest of each file that a value of a run names: a module, a library, a CSV, a database."""
    digests = {}
    settings = asdict(plan.settings)
    for text in _texts([base.values for base in plan.bases.values()], settings["axes"],
                       settings["choices"]):  # fmt: skip
        for path in (Path(text), Path(text.partition(":")[2]), module_file(text)):
            with suppress(OSError):  # most texts name no file, and some no possible file
                if path.is_file():
                    digests[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    return digests


def _texts(*values: Any) -> Iterator[str]:
    for value in values:
        if isinstance(value, str):
            yield value
        elif isinstance(value, Mapping | list | tuple):
            yield from _texts(*(value.values() if isinstance(value, Mapping) else value))


def _require_same(file: Path, plan: Plan) -> None:
    try:
        before = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise RunFolderError(f"{file}: cannot be read: {error}") from None
    now = json.loads(json.dumps(_said(plan)))
    for part, what in (
        ("campaign", "campaign"), ("scenario", "scenario"), ("versions", "package"),
        ("files", "file"),
    ):  # fmt: skip
        old, new = before.get(part, {}), now[part]
        for key in new:
            if old.get(key) != new[key]:
                raise RunFolderError(
                    f"{file}: {what} {key} is {old.get(key)!r} there and {new[key]!r} now; must be "
                    "the same to go on, or take another --out"
                )


GENERATION: Final = 16
"""Points requested at once, independent of the workers."""
SPREAD: Final = 0.3
"""Standard deviation of the first generation, in parts of each axis."""
LEAST_DIMENSIONS: Final = 2
"""Least dimension for cma; a single axis gets a second axis without effect."""

Point = tuple[float, ...]
"""A place in [0, 1] on each axis."""


class Search:
    """Ask-and-tell search: ``tell`` takes the margins of the points from ``ask``.

    Raises:
        MissingExtraError: cma is not installed.
    """

    def __init__(self, axes: int, seed: int) -> None:
        require("cma", extra="search")
        self._axes = axes
        self._random = np.random.default_rng(seed)
        self._strategy: Any = None
        self._asked: list[Any] = []

    def ask(self) -> list[Point]:
        """The next generation."""
        if self._strategy is None or self._strategy.stop():
            self._strategy = self._begun()
        self._asked = self._strategy.ask()
        return [tuple(point[: self._axes].tolist()) for point in self._asked]

    def tell(self, margins: Sequence[float | None]) -> None:
        """Take the margins of the last generation.

        A run without a margin gets the largest margin of the generation.
        """
        known = [margin for margin in margins if margin is not None]
        none = max(known, default=0.0)
        self._strategy.tell(self._asked, [none if each is None else each for each in margins])

    def _begun(self) -> Any:
        import cma  # noqa: PLC0415 (an extra)

        dimensions = max(self._axes, LEAST_DIMENSIONS)
        return cma.CMAEvolutionStrategy(
            self._random.random(dimensions),
            SPREAD,
            {
                "popsize": GENERATION,
                "bounds": [0.0, 1.0],
                "randn": lambda *shape: self._random.standard_normal(shape),
                "seed": np.nan,  # the generator of all of NumPy is left alone
                "verbose": -9,
                "verb_log": 0,
            },
        )


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
    searcher = Search(folder.plan.dimensions, settings.seed)
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
