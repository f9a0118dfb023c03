"""``can-rig tune``: the search behind a progress bar, its table, picture and JSON."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from can_rig.assessment.tuning.box import cars, parameter_ranges
from can_rig.assessment.tuning.refusals import NoTuningError, refusal_rows, refusals_as_dict
from can_rig.assessment.tuning.report import (
    HEADINGS,
    UNITS,
    as_dict,
    noise_unit,
    options,
    rows,
    why,
)
from can_rig.assessment.tuning.search import Tunings, tune
from can_rig.files import atomic, refuse_existing
from can_rig.nodes.nodes import json_line
from can_rig.scenario import loading as scenarios

PICTURE = "tuning.png"


def tune_command(
    name: str,
    settings: Sequence[str],
    box: tuple[float, Sequence[str]],
    limits: tuple[int, float | None, float | None],
    out: Path,
    force: bool,
    as_json: bool,
) -> int:
    """``can-rig tune``: the exit status, 1 where no tuning passes or none is quiet enough.

    ``box`` is what ``parameter_ranges`` takes, ``limits`` are the ticks to spare, the noise in
    X_diff, N, and that in the torque, N m.
    """
    from can_rig.assessment.tuning.picture import draw_tunings  # noqa: PLC0415 (matplotlib: slow to import)

    scenario = scenarios.load(name, settings)
    path = out / PICTURE
    refuse_existing(path, force, "--out")
    some = cars(scenario.model, parameter_ranges(scenario.model, *box))
    try:
        with _progress() as on_progress:
            found = tune(scenario, some, *limits, on_progress=on_progress)
    except NoTuningError as error:
        if as_json:
            refused = refusals_as_dict(error.refusals)
            json_line(scenario=scenario.name, chosen=None, refused=refused, advice=error.advice)
        else:
            _print_refusals(error)
        return error.exit_status
    with atomic(path) as part:
        draw_tunings(part, found)
    if as_json:
        json_line(**as_dict(found), picture=str(path))
    else:
        _print(found, path)
    return 0 if found.within_noise_limit(found.chosen) else 1


def _print(found: Tunings, path: Path) -> None:
    force = noise_unit(found)
    units = (*UNITS[:-3], f"rms {force}", f"rms {force.replace('N', 'N m', 1)}", UNITS[-1])
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for heading, unit in zip(HEADINGS, units, strict=True):
        table.add_column(f"{heading}\n{unit}", justify="right")
    for tuning, cells in rows(found):
        chosen = tuning is found.chosen
        table.add_row(">" if chosen else "", *cells, style="bold" if chosen else None)
    console = Console()
    console.print(table)
    for line in (f"chosen: {why(found)}", options(found, found.chosen), f"picture  {path}"):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _print_refusals(error: NoTuningError) -> None:
    table = Table(box=None, pad_edge=False)
    table.add_column("tunings", justify="right")
    table.add_column("refused because")
    for reason, count in refusal_rows(error.refusals):
        table.add_row(str(count), reason)
    console = Console()
    console.print(table)
    line = f"none of {error.refusals.total()} tunings passes: {error.advice}"
    console.print(line, soft_wrap=True, markup=False, highlight=False)


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each stage of the search, on standard error; none where that is no terminal."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("tunings"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        tasks: dict[str, TaskID] = {}

        def on_progress(what: str, done: int, of: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what)
            bars.update(tasks[what], completed=done, total=of)

        yield on_progress
