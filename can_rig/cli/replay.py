"""``can-rig replay``: a log through today's controller, onto a bus, or through another scenario."""

import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Final

import click
from rich.table import Table

from can_rig.buses.bus import open_bus
from can_rig.cli.decoding import bus_and_file
from can_rig.cli.diff import print_difference
from can_rig.cli.options import (
    above_zero,
    bus_name,
    channel_option,
    force_option,
    json_option,
    log_argument,
    set_option,
    window_options,
)
from can_rig.cli.output import counting, json_line, note, reading, say, show, table, tell
from can_rig.cli.run import closing_table
from can_rig.errors import INTERRUPTED, LogError
from can_rig.logs.frames import ALL, NS_PER_S, Frames, Window, window_of
from can_rig.logs.reading import read_log
from can_rig.nodes.bus_access import StopRequest
from can_rig.replaying.estimator import refuse_output, replay_drive, write
from can_rig.replaying.gaps import Gap, seconds, write_gaps
from can_rig.replaying.pace import Paced, Pacer
from can_rig.replaying.replay import OpenLoop, Place, SignalComparison
from can_rig.replaying.rig_frames import recorded
from can_rig.results.source import Source, log_path, only_channel, source_of
from can_rig.scenario.build import network_of
from can_rig.storage.files import atomic, refuse_existing, refuse_itself


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
    "outs",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="PATH",
    help="Of a recorded drive: the answers as FILE.csv, .parquet or .mf4, or a picture as .png, "
    ".svg or .pdf; repeatable.  With --what-if: the run folder.  [default: runs/SCENARIO-TIME]",
)
@click.option(
    "--dbc",
    multiple=True,
    metavar="[BUS=]FILE",
    help="Of a recorded drive: in place of network.dbc; of one bus alone with its name before it, "
    "as in can0=car.dbc.  Repeatable.",
)
@click.option(
    "--max-age",
    "max_age_s",
    type=float,
    callback=above_zero,
    metavar="S",
    help="Of a recorded drive: how long a sample holds.  [default: five periods of its signal]",
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
    outs: tuple[Path, ...],
    dbc: tuple[str, ...],
    max_age_s: float | None,
    allow_unstable: bool,
    as_json: bool,
    force: bool,
) -> None:
    """Feed LOG, a log of any format or a run folder, to today's controller.

    Open loop (the default): the logged reference and feedback go through the controller's receive
    rules and firmware, frame by frame; the answers are compared with the log, as on the wire.
    Where network.signals of the scenario name a car's own signals (yaw_rate, torque, ...), the
    recorded drive goes through the estimator: --out writes d̂, mode, verdict, commands and inputs.
    --bus puts the log on a bus instead, --what-if runs the closed loop of a changed scenario.
    Frames before --from go through the controller without comparison.

    Exit status: 0 no comparable signal differs, 1 a signal differs.
    """
    window = window_of(from_s, to_s)
    if bus is not None:
        _refuse_together("--bus", scenario=scenario_name, set=settings, gaps=gaps, what_if=what_if)
        sys.exit(_pace(log, bus, _speed_of(speed or "1"), channel, window, as_json))
    if speed is not None:
        raise click.UsageError("--speed is the pace of a replay onto a --bus; name one")
    if what_if:
        _refuse_together("--what-if", gaps=gaps, dbc=dbc, max_age=max_age_s)
        if len(outs) > 1:
            raise click.UsageError("--out of a --what-if is one run folder")
        out = next(iter(outs), None)
        sys.exit(
            _what_if(
                log, scenario_name, settings, channel, window, out, force, allow_unstable, as_json
            )
        )
    source = source_of(log, scenario_name, settings, channel, window)
    if source.scenario.network.signals.are_of_a_drive:
        _refuse_together("a recorded drive", gaps=gaps)
        _recorded_drive(source, dbc, outs, max_age_s, force, as_json)
        return
    if outs or dbc or max_age_s:
        raise click.UsageError(
            "--out, --dbc and --max-age are of a recorded drive: network.signals of the scenario "
            "must name a car's signals, as yaw_rate; --out is the run folder of a --what-if too"
        )
    before = window._replace(begin_ns=ALL.begin_ns)  # also replayed, but not compared
    part = partial(source_of, log, scenario_name, settings, channel)
    sys.exit(_open_loop(part(before), partial(part, window), window.begin_ns, gaps, force, as_json))


def _refuse_together(option: str, **others: object) -> None:
    for name, value in others.items():
        if value:
            raise click.UsageError(f"{option} and --{name.replace('_', '-')} do not go together")


def _open_loop(
    source: Source,
    later: Callable[[], Source],
    begin_ns: int,
    gaps: Path | None,
    force: bool,
    as_json: bool,
) -> int:
    """Run a log through today's controller; returns 0 without a difference, else 1.

    ``later`` is the log from ``begin_ns`` on, for a comparison within another run of the log.
    """
    if gaps is not None:
        refuse_existing(gaps, force, "--gaps")
        refuse_itself(source.log.path, gaps)
    with _all_gaps(gaps, force) as write:
        loop = _replayed(source, begin_ns)
        if loop.left_out and not loop.comparison.ticks and begin_ns != ALL.begin_ns:
            source = later()
            loop = _replayed(source, ALL.begin_ns)
        listed = loop.account.gaps
        write(listed)
    if not any(signal.compared for signal in loop.comparison.signals):
        raise LogError(
            f"{source.log.path}: no frame of a controller in it that could be compared "
            f"({loop.comparison.ticks} ticks were replayed); must be a log of both nodes, or "
            "network.signals must name a car's own signals, as yaw_rate and torque"
        )
    if as_json:
        json_line(**_summary(source, loop, listed))
    else:
        _print_comparison(source, loop, listed, gaps)
    return 0 if loop.comparison.identical else 1


def _replayed(source: Source, begin_ns: int) -> OpenLoop:
    network, answers = network_of(source.scenario), None
    if source.is_realtime:
        looking = source.frames(lambda log: reading(log, "looking through"))
        answers = recorded(looking, network, source.scenario)
    loop = OpenLoop(source.scenario, network, recorded=answers)
    loop.run(_compared_from(begin_ns, source, loop))
    return loop


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
    with atomic(path, force=force) as part, part.open("w", encoding="utf-8", newline="") as file:
        yield lambda gaps: write_gaps(file, gaps)


def _recorded_drive(
    source: Source,
    dbc: Sequence[str],
    outs: Sequence[Path],
    max_age_s: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Run a recorded drive through the firmware, and write and print what came of the drive."""
    for path in outs:
        refuse_output(path, force)
    refuse_itself(source.log.path, *outs)
    replayed = replay_drive(
        source,
        {bus or "": Path(file) for bus, file in map(bus_and_file, dbc)},
        max_age_s,
        lambda log: reading(log, "reading"),
        lambda ticks: counting(source.scenario.name, "ticks", ticks),
    )
    for path in outs:
        write(replayed, path, force=force)
    summary = replayed.summary()
    if as_json:
        json_line(
            log=str(source.log.path),
            **summary,
            out=[str(path) for path in outs],
            notice=source.log.notice,
        )
        return
    headings = ("role", "signal", "bus", "unit", "samples", "period", "gaps", "least", "largest")
    rows = table(*headings, left=4, no_wrap=True)
    for each in summary["signals"]:
        ends = (
            "" if each[key] is None else f"{each[key]:.4g} {each['unit_of_role']}"
            for key in ("least", "largest")
        )
        period, counts = f"{1e3 * each['period_s']:.4g} ms", (each["samples"], each["gaps"])
        rows.add_row(
            *(each[key] for key in ("role", "signal", "bus", "unit")),
            str(counts[0]), period, str(counts[1]), *ends,
        )  # fmt: skip
    show(rows, wide=True)
    say(*_of_drive(summary), *(f"written  {path}" for path in outs))
    note(source.log.notice, *replayed.notes())


def _of_drive(summary: dict[str, Any]) -> Iterator[str]:
    yield ""
    yield from summary["rules"]
    speeds = summary["design_speeds_mps"]
    several = f"{len(speeds)} designs from {speeds[0]:.3g} to {speeds[-1]:.3g} m/s"
    yield (
        f"{summary['ticks']} ticks of {1e3 * summary['tick_s']:g} ms from {summary['from_s']:.3f} "
        f"to {summary['to_s']:.3f} s: {summary['ticks_run']} RUN, {summary['ticks_blind']} BLIND, "
        f"{summary['ticks_standby']} STANDBY; "
        + (several if len(speeds) > 1 else f"designed for {speeds[0]:.3g} m/s")
    )
    if summary["ticks_run"]:
        yield (
            f"d̂ {summary['fault_estimate_rms_mps2']:.3g} m/s² rms, at most "
            f"{summary['fault_estimate_peak_mps2']:.3g} m/s²; D* "
            f"{summary['dstar_rms_mps2']:.3g} m/s² rms"
        )
    events = summary["events"]
    for event in events[:_SHOWN]:
        verdict = event["verdict"].replace("_", " ").lower()
        yield f"{event['time_s']:10.3f} s  {event['fault_state'].replace('_', ' '):<12} {verdict}"
    if len(events) > _SHOWN:
        yield f"…, {len(events)} changes in all: --out FILE.csv has every tick"


_SHOWN: Final = 12
"""Gaps in the table; --gaps has all."""

_KEPT: Final = 1000
"""Gaps in the JSON object."""


def _summary(source: Source, loop: OpenLoop, listed: list[Gap]) -> dict[str, Any]:
    """For JSON."""
    comparison = loop.comparison
    return {
        "log": str(source.log.path),
        "scenario": source.scenario.name,
        "identical": comparison.identical,
        "ticks": comparison.ticks,
        "first_tick": loop.first_tick,
        "compared_ticks": comparison.compared,
        "ticks_left_out": loop.left_out,
        "ticks_without_input": comparison.without_input,
        "ticks_without_answer": comparison.without_answer,
        "frames_before_start": loop.before_start,
        "first_different_tick": comparison.first_different_tick,
        "first_input_gap_tick": loop.account.first_input_gap,
        "first_answer_gap_tick": loop.account.first_answer_gap,
        "signals": {
            f"{signal.message}.{signal.signal}": signal.as_dict() for signal in comparison.signals
        },
        "frames_of_the_same_bytes": comparison.same_bytes,
        "frames_of_another_counter": comparison.other_counter,
        "gaps": _counts(loop),
        "first_gaps": [
            {**gap._asdict(), "time_ns": gap.time_ns, "time_s": float(seconds(gap.time_ns))}
            for gap in listed[:_KEPT]
        ],
        "rejected_frames": loop.rejected(),
        "notice": source.log.notice,
    }


def _counts(loop: OpenLoop) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for (message, what), number in sorted(loop.account.counts.items()):
        counts.setdefault(message, {})[what] = number
    return counts


def _print_comparison(source: Source, loop: OpenLoop, listed: list[Gap], gaps: Path | None) -> None:
    """Print tables of signals and gaps, and a verdict; the file ``gaps`` lists every gap."""
    show(_signal_table(loop.comparison.signals), wide=True)
    if loop.account.counts:
        say("")
        show(_count_table(loop), wide=True)
        _list(listed, gaps)
    say("", *_verdict(loop))
    note(source.log.notice)


def _signal_table(signals: Sequence[SignalComparison]) -> Table:
    headings = ("signal", "compared", "different", "first tick", "log", "replay", "largest", "at")
    rows = table(*headings, no_wrap=True)
    for signal in signals:
        row = [signal.signal, str(signal.compared), str(signal.different)]
        if signal.first is not None and signal.largest_at is not None:
            tick = f"{signal.first.tick} ({signal.first.time_s:.6f} s)"
            row += [tick, *_both(signal.first, signal.unit)]
            if not math.isnan(signal.largest):  # codes have no distance
                size = f"{signal.largest:.4g} {signal.unit}".rstrip()
                row += [size, str(signal.largest_at.tick)]
        rows.add_row(*row)
    return rows


def _both(place: Place, unit: str) -> Iterator[str]:
    for value in (place.logged, place.replayed):
        yield value if isinstance(value, str) else f"{value:.9g} {unit}".rstrip()


def _count_table(loop: OpenLoop) -> Table:
    counts = _counts(loop)
    words = list(dict.fromkeys(word for row in counts.values() for word in row))
    rows = table("wrong in the log", *words, no_wrap=True)
    for message, row in counts.items():
        rows.add_row(message, *(str(row.get(word, "")) for word in words))
    return rows


def _list(listed: list[Gap], gaps: Path | None) -> None:
    say("")
    rows = table("tick", "at s", "message", "what", no_wrap=True)
    rows.columns[0].justify = "right"
    for column in rows.columns[2:]:
        column.justify = "left"
    for gap in listed[:_SHOWN]:
        tick = str(gap.tick) if gap.ticks == 1 else f"{gap.tick}..{gap.tick + gap.ticks - 1}"
        what = f"{gap.what}: {gap.detail}" if gap.detail else gap.what
        rows.add_row(tick, seconds(gap.time_ns), gap.message, what)
    show(rows, wide=True)
    if gaps is not None:
        say(f"all of them in {gaps}")
    elif len(listed) > _SHOWN:
        say("…, and more: --gaps FILE.csv lists all")


def _verdict(loop: OpenLoop) -> Iterator[str]:
    comparison, gap = loop.comparison, loop.account.first_input_gap
    first, ticks = comparison.first_different_tick, comparison.ticks
    yield (
        f"{comparison.compared} of {ticks + loop.left_out} ticks compared as a whole"
        + f"; {loop.left_out} do not go on from those before, as in another run"
        * bool(loop.left_out)
        + (f"; {comparison.without_input} lack an input" * bool(comparison.without_input))
        + "".join(f"; {n} lack {name}" for name, n in comparison.without_answer.items() if n)
    )
    if loop.first_tick:
        yield (
            f"the log begins at tick {loop.first_tick}: what the recorded controller remembered "
            "then is not known, and what differs may come from that"
        )
    if any(loop.rejected().values()):
        yield "not used by the controller's receivers: " + "; ".join(
            f"{name} " + ", ".join(f"{n} {word.replace('_', ' ')}" for word, n in counts.items())
            for name, counts in loop.rejected().items()
            if counts
        )
    if first is None:
        same = "bit for bit" if not comparison.other_counter else "but for alive counters"
        yield f"identical, {same}: " + (
            f"{ticks} of {ticks + loop.left_out} ticks; --from and --to choose another run"
            if loop.left_out
            else "all that could be compared"
        )
        return
    if gap is not None and gap <= first:
        yield (
            f"different from tick {first} on; from tick {gap} on this controller did not get "
            "what the recorded one may have got, so the log itself may be the reason"
        )
        return
    skipped = loop.account.first_answer_gap
    if skipped is not None and skipped <= first:
        yield (
            f"different from tick {first} on; from tick {skipped} on answers are missing or late, "
            "and a controller in real time goes on otherwise after that"
        )
        return
    yield f"different from tick {first} on"


_CHUNK_FRAMES = 256
"""Small, so that the bar moves while a slow log is played."""


def _speed_of(text: str) -> Fraction | None:
    """A factor above zero, exact; None for ``max``."""
    if text == "max":
        return None
    try:
        speed = Fraction(text)
    except (ValueError, ZeroDivisionError):
        speed = Fraction(0)
    if speed <= 0:
        raise click.UsageError(f"--speed {text}: must be a number above 0, as in 0.5, or max")
    return speed


def _pace(
    path: Path, bus: str, speed: Fraction | None, channel: str | None, window: Window, as_json: bool
) -> int:
    """Put every frame of the log on the bus, for other programs to see; returns the exit status."""
    log = read_log(log_path(path), _CHUNK_FRAMES, window)
    stop = StopRequest().on_signals()
    with open_bus(bus) as opened:
        pacer = Pacer(opened, speed, stop)
        result = pacer.send_all(only_channel(reading(log, f"to {bus}"), channel, log.path))
    if as_json:
        json_line(log=str(log.path), **asdict(result), notice=log.notice)
    else:
        tell(*_pace_lines(result, speed))
        note(log.notice)
    return INTERRUPTED if stop.wanted else 0


def _pace_lines(result: Paced, speed: Fraction | None) -> Iterator[str]:
    log_s, wall_s = result.log_ns / NS_PER_S, result.wall_ns / NS_PER_S
    pace = f", {log_s / wall_s:.3g} x its own pace" if wall_s and log_s else ""
    yield f"{result.sent} frames sent: {log_s:.6f} s of the log in {wall_s:.6f} s{pace}"
    if speed is not None:
        yield f"the most that a frame was late: {result.late_ns / 1e6:.3f} ms"
    if result.fd_frames:
        yield (
            f"{result.fd_frames} CAN FD frames not sent, the bus is a classic one; "
            "?fd=true after its name opens one that is not"
        )
    if result.error_frames:
        yield f"{result.error_frames} error frames not sent: only a bus itself makes them"


def _what_if(
    path: Path,
    name: str | None,
    settings: Sequence[str],
    channel: str | None,
    window: Window,
    out: Path | None,
    force: bool,
    allow_unstable: bool,
    as_json: bool,
) -> int:
    """Answer --what-if, and print what differs: the exit status."""
    from can_rig.replaying.what_if import LABELS, question, what_if  # noqa: PLC0415 (matplotlib)

    asked = question(path, name, settings, channel, lambda log: reading(log, "reading"), window)
    found = what_if(
        asked,
        out,
        StopRequest().on_signals(),
        force=force,
        allow_unstable=allow_unstable,
        progress=lambda: counting(asked.scenario.name, "ticks", asked.scenario.ticks),
    )
    if found is None:
        return INTERRUPTED
    run = found.execution
    if as_json:
        json_line(run_folder=str(run.folder), metrics=run.metrics, **found.difference.as_dict())
    else:
        print_difference(found.difference, LABELS, found.before)
        say("")
        closing_table(run.happened, run.metrics, run.outcome, run.folder)
    if run.failure is not None:
        raise run.failure
    return run.exit_status
