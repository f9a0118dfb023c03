"""The commands of ``can-rig`` that take a log or a run folder."""

from __future__ import annotations

import sys
from fractions import Fraction
from pathlib import Path

import click

force_option = click.option("--force", is_flag=True, help="Replace outputs that are there.")
log_argument = click.argument("log", type=click.Path(path_type=Path))


def _speed(text: str) -> Fraction | None:
    """A factor above zero, exact; None for ``max``."""
    if text == "max":
        return None
    try:
        speed = Fraction(text)
    except (ValueError, ZeroDivisionError):
        speed = Fraction(0)
    if speed <= 0:
        raise click.UsageError(f"--speed {text}: a number above 0, as in 0.5, or max is right")
    return speed


def _refuse_together(option: str, **others: object) -> None:
    for name, value in others.items():
        if value:
            raise click.UsageError(f"{option} and --{name.replace('_', '-')} do not go together")


@click.command()
@log_argument
@click.option(
    "--scenario",
    "scenario_name",
    metavar="NAME",
    help="Whose controller: a shipped scenario or a TOML file.  [default: the run folder's own]",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="Change one key of the scenario, as in design.tau_s=0.002; repeatable.",
)
@click.option("--channel", metavar="NAME", help="Only frames of this bus, as the log names it.")
@click.option(
    "--gaps",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.csv",
    help="List everything that is wrong in the log.",
)
@click.option(
    "--bus",
    metavar="NAME",
    help="At a pace: put every frame of LOG on this bus, for other programs to see; names as "
    "those of `can-rig run --bus`.",
)
@click.option(
    "--speed",
    metavar="X",
    help="With --bus: times the log's own pace, as in 0.5 or 10; max: as fast as the bus takes "
    "them.  [default: 1]",
)
@click.option(
    "--what-if",
    is_flag=True,
    help="The logged reference through the closed loop, plant and controller, of the scenario as "
    "--scenario and --set change it: an ordinary run folder, and what differs from the log.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="With --what-if: the run folder.  [default: runs/SCENARIO-TIME]",
)
@click.option(
    "--allow-unstable",
    is_flag=True,
    help="With --what-if: run a loop that `can-rig check` refuses.",
)
@click.option("--json", "as_json", is_flag=True, help="The result as one JSON object.")
@force_option
def replay(
    log: Path,
    scenario_name: str | None,
    settings: tuple[str, ...],
    channel: str | None,
    gaps: Path | None,
    bus: str | None,
    speed: str | None,
    what_if: bool,
    out: Path | None,
    allow_unstable: bool,
    as_json: bool,
    force: bool,
) -> None:
    """Drive today's controller with LOG, a log of any format or a run folder.

    Open loop (the default): the logged reference and feedback go through the controller's receive
    rules and firmware, frame by frame; what it answers is compared with the log, as on the wire.
    --bus puts the log on a bus instead, --what-if asks what another scenario would have done.

    Exit status: 0 nothing that can be compared differs, 1 something does.
    """
    if bus is not None:
        from can_rig.cli.pace_command import pace_command  # noqa: PLC0415

        _refuse_together("--bus", scenario=scenario_name, set=settings, gaps=gaps, what_if=what_if)
        sys.exit(pace_command(log, bus, _speed(speed or "1"), channel, as_json))
    if speed is not None:
        raise click.UsageError("--speed is the pace of a replay onto a --bus; name one")
    if what_if:
        from can_rig.cli.what_if_command import what_if_command  # noqa: PLC0415

        _refuse_together("--what-if", gaps=gaps)
        sys.exit(
            what_if_command(
                log, scenario_name, settings, channel, out, force, allow_unstable, as_json
            )
        )
    if out is not None:
        raise click.UsageError("--out is the run folder of a --what-if")
    from can_rig.cli.replay_command import replay_command  # noqa: PLC0415 (imports the controller)
    from can_rig.results.source import source_of  # noqa: PLC0415

    source = source_of(log, scenario_name, settings, channel)
    sys.exit(replay_command(source, gaps, force, as_json))


@click.command()
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
@click.option(
    "--scenario",
    "scenario_name",
    default="default",
    show_default=True,
    metavar="NAME",
    help="Frames and tick of what is a log and no run folder.",
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.png",
    help="Draw where they part.",
)
@click.option("--json", "as_json", is_flag=True, help="The result as one JSON object.")
@force_option
def diff(
    run_a: Path,
    run_b: Path,
    tolerances: tuple[str, ...],
    scenario_name: str,
    out: Path | None,
    as_json: bool,
    force: bool,
) -> None:
    """Compare RUN_A and RUN_B (run folders, signals.csv files or logs), signal by signal.

    Exit status: 0 the same within tolerance, 1 different.
    """
    from can_rig.cli.diff_command import diff_command  # noqa: PLC0415

    sys.exit(diff_command((run_a, run_b), tolerances, scenario_name, out, force, as_json))


@click.command()
@log_argument
@click.argument("signals", nargs=-1, required=True, metavar="SIGNAL...")
@click.option(
    "--dbc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A DBC, or another database that cantools reads.  [default: the rig's own]",
)
@click.option("--no-strict", is_flag=True, help="Accept a DBC whose signals overlap.")
@click.option("--channel", metavar="NAME", help="Only frames of this bus, as the log names it.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.png",
    help="The picture.  [default: the log's name, .png]",
)
@force_option
def plot(
    log: Path,
    signals: tuple[str, ...],
    dbc: Path | None,
    no_strict: bool,
    channel: str | None,
    out: Path | None,
    force: bool,
) -> None:
    """Draw SIGNALs of LOG: MESSAGE.Signal, or Signal where only one message has it."""
    from can_rig.cli.plot_command import plot_command  # noqa: PLC0415

    sys.exit(plot_command(log, signals, dbc, not no_strict, channel, out, force))


@click.command()
@log_argument
@click.option(
    "--dbc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="A DBC, or another database that cantools reads.  [default: the rig's own]",
)
@click.option("--no-strict", is_flag=True, help="Accept a DBC whose signals overlap.")
@click.option(
    "--out",
    "outputs",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="FILE.csv or FILE.parquet: one table, a row a frame; FILE.mf4: a group a message; a "
    "name without suffix: a folder of CSV files, one a message.  Repeatable.",
)
@click.option(
    "--message", "messages", multiple=True, metavar="NAME", help="Only this message; repeatable."
)
@click.option(
    "--signal",
    "signals",
    multiple=True,
    metavar="NAME",
    help="Only this signal, as Signal or Message.Signal; repeatable.",
)
@click.option("--channel", metavar="NAME", help="Only frames of this bus, as the log names it.")
@click.option("--relative", is_flag=True, help="Count time from the start of the recording.")
@click.option("--names", is_flag=True, help="Write the words of value tables, not their codes.")
@force_option
@click.option("--json", "as_json", is_flag=True, help="The counts as one JSON object.")
def decode(
    log: Path,
    dbc: Path | None,
    no_strict: bool,
    outputs: tuple[Path, ...],
    messages: tuple[str, ...],
    signals: tuple[str, ...],
    channel: str | None,
    relative: bool,
    names: bool,
    force: bool,
    as_json: bool,
) -> None:
    """Decode LOG (.log, .asc, .blf, .trc, .mf4, text also .gz; or a run folder) through a DBC.

    Prints of every message how many frames there were and what became of them: too short,
    repeated, damaged, unknown.
    """
    from can_rig.cli.decode_command import Form, Selection, decode_command  # noqa: PLC0415

    selection = Selection(messages or None, signals or None, channel)
    form = Form(relative, names)
    sys.exit(decode_command(log, dbc, not no_strict, outputs, selection, form, as_json, force))
