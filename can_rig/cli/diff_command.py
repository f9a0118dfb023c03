"""``can-rig diff``: a table, a picture and an exit status of what two runs differ in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.scenario import loading as scenarios
from can_rig.views.run_diff import Difference, compare, tolerances_of
from can_rig.views.settings_diff import SettingDifference, written
from can_rig.views.signal_table import SignalTable, read_table


def diff_command(
    paths: tuple[Path, Path],
    tolerances: Sequence[str],
    scenario: str,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """``can-rig diff``: 0 the same within tolerance, 1 different.

    Raises:
        LogError: one cannot be read, or the picture not be written.
        ScenarioError: no such scenario.
    """
    if out is not None:
        refuse_picture(out, force)
    allowed = tolerances_of(tolerances)
    chosen = scenarios.load(scenario)
    a, b = (read_table(path, chosen) for path in paths)
    difference = compare(a, b, allowed)
    if out is not None:
        from can_rig.views.diff_picture import draw_difference  # noqa: PLC0415 (matplotlib)

        with atomic(out) as part:
            draw_difference(part, a, b, difference)
    if as_json:
        print(json.dumps({"a": a.label, "b": b.label, **difference.as_dict()}))
    else:
        print_difference(difference, (a.label, b.label), a)
    return 0 if difference.same else 1


def refuse_picture(path: Path, force: bool) -> None:
    """Refuse a picture that cannot be one, or is there.

    Raises:
        LogError: the reason.
    """
    if path.suffix.lower() != ".png":
        raise LogError(f"{path}: a picture is written as FILE.png")
    refuse_existing(path, force, "--out")


def print_difference(difference: Difference, labels: tuple[str, str], a: SignalTable) -> None:
    """The table, and what it cannot say."""
    console = Console(soft_wrap=True, highlight=False)
    console.width = max(console.width, 120)
    table = Table(box=None, pad_edge=False)
    headings = ("signal", "largest difference", "at s", "tolerance", "rows beyond", "first at s")
    for heading in (*headings, *labels):
        left = heading == "signal"
        table.add_column(heading, justify="left" if left else "right", overflow="fold")
    for signal in difference.signals:
        _, unit = a.name_and_unit(signal.signal)
        row = [signal.signal, f"{signal.largest:.4g} {unit}".rstrip()]
        row += [_time(signal.largest_at_s) if signal.largest else "", f"{signal.tolerance:g}"]
        row += [str(signal.beyond), _time(signal.first_at_s)]
        if signal.beyond:
            row += [_number(signal.first_a), _number(signal.first_b)]
        table.add_row(*row)
    console.print(table)
    if difference.settings:
        console.print(_settings_table(difference.settings, labels))
    for line in _lines(difference, labels):
        console.print(line, markup=False)


def _settings_table(settings: Sequence[SettingDifference], labels: tuple[str, str]) -> Table:
    """What the two runs were asked to do differently."""
    table = Table("setting", *labels, box=None, pad_edge=False)
    for setting in settings:
        table.add_row(setting.key, written(setting.a), written(setting.b))
    return table


def _lines(difference: Difference, labels: tuple[str, str]) -> Iterator[str]:
    columns = (difference.columns_a, difference.columns_b)
    rows = (difference.only_a, difference.only_b)
    for label, names, number in zip(labels, columns, rows, strict=True):
        if names:
            yield f"only {label} has {', '.join(names)}"
        if number:
            yield f"{number} rows are of times that only {label} has"
    if difference.first_at_s is not None:
        yield f"different from {difference.first_at_s:.6f} s on, in {difference.rows} common rows"
    elif difference.same:
        yield f"the same in all {difference.rows} rows"
    else:
        yield f"the same in the {difference.rows} rows that both have"


def _time(time_s: float | None) -> str:
    return "" if time_s is None else f"{time_s:.6f}"


def _number(value: float | None) -> str:
    return "no value" if value is None else f"{value:.9g}"
