"""``can-rig stats``: what is in a log."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import click

from can_rig.cli.decoding import Asked, decoding_options, hint
from can_rig.cli.options import force_option, json_option
from can_rig.cli.output import json_line, note, say, show, table
from can_rig.decoding.decode import Decoder
from can_rig.frames.frame_length import FrameError
from can_rig.storage.files import atomic, refuse_picture
from can_rig.views.log_statistics import LogStatistics
from can_rig.views.signal_table import scenario_of

USUAL_BITRATE: Final = 500_000


@click.command("stats")
@decoding_options
@click.option(
    "--bitrate",
    type=int,
    help="Of the buses, in bit/s.  [default: that of a run folder's scenario, otherwise 500000]",
)
@click.option(
    "--data-bitrate", default=2_000_000, show_default=True, help="Of CAN FD's data phase, in bit/s."
)
@click.option(
    "--out", type=click.Path(path_type=Path), metavar="FILE", help="The load over time, drawn."
)
@force_option
@json_option()
def command(
    asked: Asked,
    bitrate: int | None,
    data_bitrate: int,
    out: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Summarise LOG: identifiers, rates, cycle times, jitter, gaps, bus load, E2E errors.

    The load is an upper bound: every frame counts with the largest possible number of stuff bits.
    """
    if out is not None:
        refuse_picture(out, force)
    run = scenario_of(asked.path)
    known = run.bus.bitrate if bitrate is None and run is not None else bitrate
    bitrate = USUAL_BITRATE if known is None else known
    try:
        statistics = LogStatistics(bitrate, data_bitrate)
    except FrameError as error:
        raise click.UsageError(str(error)) from None
    source = asked.log()
    decoder = Decoder(asked.databases())
    for frames in asked.frames(source, "counting"):
        statistics.add(frames)
        decoder.decode(frames)
    statistics.finish()
    assumed = known is None
    result = {"bitrate": bitrate, "bitrate_assumed": assumed, **_summary(statistics, decoder)}
    if out is not None:
        from can_rig.views.pictures import load_page  # noqa: PLC0415 (matplotlib)

        with atomic(out, force=force) as part:
            load_page(statistics).savefig(part, dpi=150)
    if as_json:
        json_line(log=str(source.path), **result, notice=source.notice)
        return
    _print(result)
    note(source.notice, hint(asked, decoder))
    if out is not None:
        say(f"picture in {out}")


def _summary(statistics: LogStatistics, decoder: Decoder) -> dict[str, Any]:
    rows = []
    for found in sorted(statistics.identifiers.values(), key=lambda one: (one.bus, one.identifier)):
        row = found.as_dict()
        row["message"] = decoder.name_of(found.identifier, found.is_extended, found.bus) or ""
        row["per_s"] = found.frames / statistics.span_s if statistics.span_s else None
        rows.append(row)
    load, span_s = {}, statistics.span_s or 1.0
    for bus in statistics.buses:
        share = statistics.load(bus)[1]
        load[bus] = {
            "mean": float(share.sum()) / span_s,
            "most": float(share.max()) / min(span_s, 1.0),
        }
    errors = {
        name: {"wrong_crc": c.wrong_crc, "repeated": c.repeated, "gaps": c.gaps, "lost": c.lost}
        for name, c in decoder.counts.items()
        if c.wrong_crc or c.repeated or c.gaps
    }
    return {
        "frames": statistics.frames,
        "error_frames": statistics.error_frames,
        "span_s": statistics.span_s,
        "identifiers": rows,
        "load": load,
        "e2e": errors,
    }


def _print(result: dict[str, Any]) -> None:
    shown = table(
        "bus", "identifier", "message", "frames", "1/s", "cycle ms", "jitter", "least", "most",
        "gaps", "bytes", left=3,
    )  # fmt: skip
    for row in result["identifiers"]:
        times = [row[name] for name in ("cycle_ms", "jitter_ms", "least_ms", "most_ms")]
        low, high = row["bytes"]
        shown.add_row(
            row["bus"],
            row["identifier"],
            row["message"],
            f"{row['frames']}",
            "" if row["per_s"] is None else f"{row['per_s']:.1f}",
            *("" if value is None else f"{value:.3f}" for value in times),
            f"{row['gaps']}",
            f"{low}" if low == high else f"{low}..{high}",
        )
    show(shown, wide=True)
    say(*_lines(result))


def _lines(result: dict[str, Any]) -> Iterator[str]:
    yield f"{result['frames']} frames in {result['span_s']:.3f} s"
    if result["error_frames"]:
        yield f"error frames: {result['error_frames']}"
    for bus, load in result["load"].items():
        yield (
            f"load of {bus} at {result['bitrate'] / 1000:g} kbit/s: "
            f"at most {100 * load['mean']:.1f} %, "
            f"{100 * load['most']:.1f} % in its busiest second"
        )
    if result["bitrate_assumed"] and result["load"]:
        yield "the log has no bit rate, and the load follows from it: --bitrate gives another"
    for name, counts in result["e2e"].items():
        said = ", ".join(f"{what.replace('_', ' ')} {n}" for what, n in counts.items() if n)
        yield f"end-to-end protection of {name}: {said}"
