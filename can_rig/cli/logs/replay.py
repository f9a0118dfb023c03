"""``can-rig replay``: a log through today's controller, onto a bus, or through another scenario."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from can_rig.cli.logs.comparison import print_comparison, summary
from can_rig.cli.logs.pace import pace, speed_of
from can_rig.cli.options import (
    bus_name,
    channel_option,
    force_option,
    json_option,
    log_argument,
    set_option,
    window_options,
)
from can_rig.cli.output import json_line
from can_rig.cli.progress import reading
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.logs.frames import Frames
from can_rig.logs.log import ALL, window_of
from can_rig.replay.gaps import Gap, write_gaps
from can_rig.replay.replay import OpenLoop
from can_rig.replay.rig_frames import recorded
from can_rig.results.source import Source, source_of
from can_rig.scenario.build import network_of


@click.command("replay")
@log_argument
@click.option(
    "--scenario",
    "scenario_name",
    metavar="NAME",
    help="Whose controller: a shipped scenario or a TOML file.  [default: the run folder's own]",
)
@set_option("Change one key of the scenario")
@channel_option
@window_options
@click.option(
    "--gaps",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE.csv",
    help="List everything that is wrong in the log.",
)
@click.option(
    "--bus",
    callback=bus_name,
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
@json_option()
@force_option
def command(
    log: Path,
    scenario_name: str | None,
    settings: tuple[str, ...],
    channel: str | None,
    from_s: float | None,
    to_s: float | None,
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
    rules and firmware, frame by frame; the answers are compared with the log, as on the wire.
    --bus puts the log on a bus instead, --what-if runs the closed loop of a changed scenario.
    Frames before --from go through the controller without comparison.

    Exit status: 0 no comparable signal differs, 1 a signal differs.
    """
    window = window_of(from_s, to_s)
    if bus is not None:
        _refuse_together("--bus", scenario=scenario_name, set=settings, gaps=gaps, what_if=what_if)
        sys.exit(pace(log, bus, speed_of(speed or "1"), channel, window, as_json))
    if speed is not None:
        raise click.UsageError("--speed is the pace of a replay onto a --bus; name one")
    if what_if:
        from can_rig.cli.logs.what_if import what_if_command  # noqa: PLC0415 (matplotlib)

        _refuse_together("--what-if", gaps=gaps)
        sys.exit(
            what_if_command(
                log, scenario_name, settings, channel, window, out, force, allow_unstable, as_json
            )
        )
    if out is not None:
        raise click.UsageError("--out is the run folder of a --what-if")
    before = window._replace(begin_ns=ALL.begin_ns)  # also replayed, but not compared
    source = source_of(log, scenario_name, settings, channel, before)
    sys.exit(_open_loop(source, window.begin_ns, gaps, force, as_json))


def _refuse_together(option: str, **others: object) -> None:
    for name, value in others.items():
        if value:
            raise click.UsageError(f"{option} and --{name.replace('_', '-')} do not go together")


def _open_loop(source: Source, begin_ns: int, gaps: Path | None, force: bool, as_json: bool) -> int:
    """Run a log through today's controller; returns 0 without a difference, else 1.

    Args:
        source: the log, from its first frame on.
        begin_ns: start of the comparison within the recording.
        gaps: the file of the gaps.
        force: replace the file of the gaps.
        as_json: print an object.

    Raises:
        LogError: the log cannot be read, or has no comparable frame.
        ScenarioError: the design fails.
    """
    if gaps is not None:
        refuse_existing(gaps, force, "--gaps")
    with _all_gaps(gaps, force) as write:
        network, answers = network_of(source.scenario), None
        if source.is_realtime:
            looking = source.frames(lambda log: reading(log, "looking through"))
            answers = recorded(looking, network, source.scenario)
        loop = OpenLoop(source.scenario, network, answers)
        loop.run(_compared_from(begin_ns, source, loop))
        listed = loop.account.gaps
        write(listed)
    if not any(signal.compared for signal in loop.comparison.signals):
        raise LogError(
            f"{source.log.path}: no frame of a controller in it that could be compared "
            f"({loop.comparison.ticks} ticks were replayed); must be a log of both nodes"
        )
    if as_json:
        json_line(**summary(source, loop, listed))
    else:
        print_comparison(source, loop, listed, gaps)
    return 0 if loop.comparison.identical else 1


def _compared_from(begin_ns: int, source: Source, loop: OpenLoop) -> Iterator[Frames]:
    """The chunks of the log; the first chunk fixes the zero of the time stamps."""
    for frames in source.frames(lambda log: reading(log, "replaying")):
        if begin_ns != ALL.begin_ns:
            loop.compare_from_ns = source.log.start_ns + begin_ns
        yield frames


@contextmanager
def _all_gaps(path: Path | None, force: bool) -> Iterator[Callable[[list[Gap]], None]]:
    """Writes the list, or nothing; an unwritable file is refused before the replay."""
    if path is None:
        yield lambda gaps: None
        return
    with (
        atomic(path, force=force) as part,
        part.open("w", encoding="utf-8", newline="") as file,
    ):
        yield lambda gaps: write_gaps(file, gaps)
