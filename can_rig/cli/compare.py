"""``can-rig compare``: several controllers through the same faults, weather and cars."""

import sys
from collections.abc import Sequence
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from can_rig.assessment.stability import finite_or_null
from can_rig.cli.options import force_option, json_option, out_option, set_option
from can_rig.cli.output import json_line, note, progress, say, show, table
from can_rig.errors import ScenarioError
from can_rig.scenario.loading import change, load
from can_rig.storage.files import refuse_picture
from can_rig.views.controllers_compared import CASES, Compared, compare, known_controllers


def _controllers(_c: click.Context, _p: click.Parameter, begun: str) -> list[CompletionItem]:
    return [CompletionItem(name) for name in known_controllers() if name.startswith(begun)]


USUAL = "faults"
"""The group of cases without ``--cases`` and ``--case``."""

SMALL, TINY, HUGE = 100.0, 1e-3, 1e6
"""A command below the first and an error below the second have three digits, as 0.4 rad does, and
so has everything from the third on, as of a loop that diverges."""


@click.command("compare")
@click.argument("controllers", nargs=-1, required=True, shell_complete=_controllers)
@click.option("--scenario", default="default", show_default=True, metavar="NAME", help="Scenario.")
@click.option(
    "--cases", "groups", metavar=",".join(CASES), help=f"Groups of cases.  [default: {USUAL}]"
)
@click.option(
    "--case",
    "own",
    multiple=True,
    metavar="NAME:KEY=VALUE,KEY=VALUE",
    help="A case of your own, in place of the groups; repeatable.",
)
@set_option("Change one key of every run")
@out_option("Draw the errors: FILE.png, .svg or .pdf.")
@json_option("A JSON object for each run.")
@force_option
def command(
    controllers: tuple[str, ...],
    scenario: str,
    groups: str | None,
    own: tuple[str, ...],
    settings: tuple[str, ...],
    out: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Compare CONTROLLERS: ours, pi, module:Class, c:FILE.so, or FILE.toml with a [controller].

    Every controller drives every case, without frames. Figures are from the fault or the
    disturbance on; a case without either counts from 2 s on.
    """
    if out is not None:
        refuse_picture(out, force)
    cases = _cases(groups, own)
    with progress("compare", "runs") as bar:
        found = compare(
            controllers, lambda own: load(scenario, [*settings, *own]), cases, bar.count
        )
    if out is not None:
        found.draw(out, force=force)
    failed = any(row.failure for row in found.rows)
    if as_json:
        for row in found.rows:
            json_line(**finite_or_null(vars(row)))
        sys.exit(failed)
    figures = table("case", "controller", "peak", "rms", "settled", "confirmed", "|u1|", "|u2|",
                    left=2)  # fmt: skip
    before = ""
    for row in found.rows:
        figures.add_row("" if row.case == before else row.case, row.controller, *_cells(row))
        before = row.case
    show(figures, wide=True)
    say("|r - y| in the output's unit; confirmed: s after the fault; u1, u2: peaks of the commands")
    say(*(f"{row.case}, {row.controller}: {row.failure}" for row in found.rows if row.failure))
    note(*dict.fromkeys(f"{row.case}: {row.never}" for row in found.rows if row.never))
    sys.exit(failed)


def _cells(row: Compared) -> Sequence[str]:
    if row.failure:
        return ("failed",)
    sizes = (row.error_peak_mps2, row.error_rms_mps2, row.error_settled_mps2)
    alarm = "false alarm" if row.false_alarm else ""
    if row.false_alarm is None:
        alarm = "not said"
    elif row.confirmed_after_s is not None and not alarm:
        alarm = f"{row.confirmed_after_s:.3f}"
    peaks = row.torque_peak_nm, row.force_difference_peak_n
    commands = (f"{peak:.0f}" if SMALL <= peak < HUGE else f"{peak:.3g}" for peak in peaks)
    errors = (f"{size:.4f}" if TINY <= size < HUGE else f"{size:.3g}" for size in sizes)
    return (*errors, alarm, *commands)


def _cases(groups: str | None, own: Sequence[str]) -> dict[str, dict[str, object]]:
    """The cases by name."""
    if own and groups is not None:
        raise ScenarioError(f"--cases {groups}: must not stand beside --case")
    cases: dict[str, dict[str, object]] = {}
    for text in own:
        name, colon, changes = text.partition(":")
        if not (name and colon):
            raise ScenarioError(f"--case {text}: must be NAME:KEY=VALUE,KEY=VALUE")
        if name in cases:
            raise ScenarioError(f"--case {text}: must have another name than an earlier case")
        cases[name] = {}
        for setting in filter(None, changes.split(",")):
            change(cases[name], setting)
    if cases:
        return cases
    for group in (USUAL if groups is None else groups).split(","):
        if group not in CASES:
            raise ScenarioError(f"--cases {group}: must be {', '.join(CASES)}")
        cases |= {name: dict(changes) for name, changes in CASES[group].items()}
    return cases
