"""``can-rig diff``: the differences of two runs as a table, a picture and an exit status."""

import sys
from collections.abc import Iterator
from pathlib import Path

import click

from can_rig.cli.options import force_option, json_option, out_option, window_options
from can_rig.cli.output import json_line, note, say, show, table
from can_rig.logs.frames import window_of
from can_rig.scenario.loading import load
from can_rig.storage.files import atomic, refuse_picture
from can_rig.views.diff import Difference, compare, tolerances_of, written
from can_rig.views.signal_table import SignalTable, read_part


@click.command("diff")
@click.argument("run_a", type=click.Path(path_type=Path))
@click.argument("run_b", type=click.Path(path_type=Path))
@click.option(
    "--tolerance",
    "tolerances",
    multiple=True,
    metavar="SIGNAL=VALUE",
    help="Largest difference of a signal that counts as none, in its unit, as in torque_nm=0.01; "
    "repeatable.  [default: 0]",
)
@window_options
@click.option(
    "--scenario",
    "scenario_name",
    default="default",
    show_default=True,
    metavar="NAME",
    help="Scenario with the frames and the tick of a log; a run folder has its own.",
)
@out_option("Draw the differences: FILE.png, .svg or .pdf.")
@json_option()
@force_option
def command(
    run_a: Path,
    run_b: Path,
    tolerances: tuple[str, ...],
    from_s: float | None,
    to_s: float | None,
    scenario_name: str,
    out: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Compare RUN_A and RUN_B (run folders, signals.csv files or logs), signal by signal.

    Exit status: 0 the same within tolerance, 1 different.
    """
    if out is not None:
        refuse_picture(out, force)
    allowed = tolerances_of(tolerances)
    scenario = load(scenario_name)
    window = window_of(from_s, to_s)
    a, b = (read_part(path, scenario, window) for path in (run_a, run_b))
    difference = compare(a, b, allowed)
    if out is not None:
        from can_rig.views.pictures import difference_page  # noqa: PLC0415 (matplotlib)

        with atomic(out, force=force) as part:
            difference_page(a, b, difference).savefig(part, dpi=150)
    if as_json:
        json_line(a=a.label, b=b.label, **difference.as_dict())
    else:
        print_difference(difference, (a.label, b.label), a)
    for each in (a, b):
        note(each.notice, _left_out(each))
    sys.exit(0 if difference.same else 1)


def _left_out(run: SignalTable) -> str | None:
    if not run.left_out:
        return None
    return (
        f"{run.label}: {run.left_out} ticks are left out; they do not go on from those before, "
        "as in another run, which --from chooses"
    )


def print_difference(difference: Difference, labels: tuple[str, str], a: SignalTable) -> None:
    """Print the table, and the limits of the comparison."""
    headings = ("signal", "largest difference", "at s", "tolerance", "rows beyond", "first at s")
    signals = table(*headings, *labels)
    for column in signals.columns:
        column.overflow = "fold"
    signals.columns[0].no_wrap = True  # a name in two lines is found by no search
    for signal in difference.signals:
        _, unit = a.name_and_unit(signal.signal)
        row = [signal.signal, f"{signal.largest:.4g} {unit}".rstrip()]
        row += [_time(signal.largest_at_s) if signal.largest else "", f"{signal.tolerance:g}"]
        row += [str(signal.beyond), _time(signal.first_at_s)]
        if signal.beyond:
            row += [_number(signal.first_a), _number(signal.first_b)]
        signals.add_row(*row)
    settings = table("setting", *labels)
    for setting in difference.settings or ():
        settings.add_row(setting.key, written(setting.a), written(setting.b))
    show(signals, *([settings] if difference.settings else []), wide=True)
    say(*_lines(difference, labels))


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
