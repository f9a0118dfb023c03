"""What ``can-rig check`` and ``can-rig scenarios`` print."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from can_rig.assessment.check import check, table_rows
from can_rig.nodes.progress import json_line
from can_rig.scenario import loading as scenarios


def check_command(name: str, settings: Sequence[str], as_json: bool) -> int:
    """``can-rig check``: the exit status, 0 for a stable loop and 1 for one that is not."""
    result = check(scenarios.load(name, settings))
    if as_json:
        json_line(**result.as_dict())
        return 0 if result.stable else 1
    headings, *rows_of_figures = table_rows(result)
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    for row in rows_of_figures:
        table.add_row(*row)
    console = Console()
    console.print(table)
    for note in result.notes:
        console.print(note, markup=False, highlight=False)
    console.print(result.verdict, soft_wrap=True, markup=False, highlight=False)
    return 0 if result.stable else 1


def scenarios_command() -> None:
    """``can-rig scenarios``."""
    table = Table("scenario", "what it shows", box=None, pad_edge=False)
    for name, path in scenarios.shipped().items():
        table.add_row(name, tomllib.loads(path.read_text(encoding="utf-8"))["description"])
    Console().print(table)
