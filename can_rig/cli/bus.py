"""``can-rig bus``: the bus timing of a scenario, or of any DBC."""

import sys
from collections.abc import Iterator
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import click

from can_rig.assessment.network_notes import frame_notes
from can_rig.cli.options import json_option, scenario_options
from can_rig.cli.output import json_line, say, show, table
from can_rig.frames.bus_timing import BusTiming, dbc_timing, network_timing
from can_rig.plant.protocol import load_plant
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import LATENCY, load

COLUMNS = ("frame", "identifier", "bits", "time", "released", "response", "arrives", "slack")
NO_BOUND = "∞"


@click.command("bus")
@scenario_options
@click.option(
    "--dbc",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Look at all messages of this database that have a cycle time, not at the scenario.",
)
@click.option(
    "--bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Nominal bit rate.  [default: the scenario's bus.bitrate]",
)
@click.option(
    "--data-bitrate",
    type=click.IntRange(min=1),
    metavar="BIT/S",
    help="Bit rate of the data phase of FD frames.  [default: they do not switch]",
)
@json_option("One line of JSON.")
def command(
    scenario: str,
    settings: tuple[str, ...],
    dbc: Path | None,
    bitrate: int | None,
    data_bitrate: int | None,
    as_json: bool,
) -> None:
    """Compute worst-case arrival times of the frames, and the resulting latency in ticks.

    Exit status: 0 if every frame meets its deadline, 1 if a frame may miss the deadline.
    """
    chosen = load(scenario, [*settings, f"{LATENCY}=0"])  # what is computed here
    bitrate = bitrate or chosen.bus.bitrate
    notes: list[str] = []
    if dbc is not None:
        timing = dbc_timing(dbc, bitrate, data_bitrate)
    else:
        if chosen.plant.is_own:
            load_plant(chosen.plant.kind, chosen.plant)  # no timing for what cannot run
        compute_s = chosen.bus.compute_s
        network = network_of(chosen)
        timing = network_timing(network, bitrate, chosen.tick_s, compute_s)
        notes += frame_notes(network)
    if as_json:
        json_line(**as_dict(timing), network=notes)
    else:
        _print(timing, None if dbc else chosen.tick_s)
        say(*notes)
    sys.exit(0 if timing.schedulable else 1)


def as_dict(timing: BusTiming) -> dict[str, Any]:
    """The table as JSON: seconds as numbers, null without a bound."""
    frames = (
        {**asdict(each), "arrival_s": each.arrival_s, "slack_s": each.slack_s}
        for each in timing.frames
    )
    return {
        "bitrate": timing.bitrate,
        "schedulable": timing.schedulable,
        "utilisation": float(timing.utilisation),
        "latency_ticks": timing.latency_ticks,
        "frames": [
            {key: float(of) if isinstance(of, Fraction) else of for key, of in frame.items()}
            for frame in frames
        ],
        "left_out": list(timing.left_out),
    }


def table_rows(timing: BusTiming) -> Iterator[tuple[str, ...]]:
    """One row a frame, with the columns of `COLUMNS`; times in µs."""
    for frame in timing.frames:
        digits = 8 if frame.extended else 3
        times = (frame.transmission_s, frame.release_s, frame.response_s, frame.arrival_s)
        row = [NO_BOUND if t is None else f"{float(t) * 1e6:.1f}" for t in (*times, frame.slack_s)]
        yield frame.name, f"0x{frame.frame_id:0{digits}X}", str(frame.bits), *row


def _print(timing: BusTiming, tick_s: float | None) -> None:
    shown = table(*COLUMNS, title="worst case, times in µs")
    for row in table_rows(timing):
        shown.add_row(*row)
    show(shown)
    say(f"utilisation {float(timing.utilisation):.1%} of {timing.bitrate} bit/s")
    if tick_s is not None and timing.latency_ticks is not None:
        say(f"latency_ticks = {timing.latency_ticks} at a tick of {tick_s * 1e3:g} ms")
    if timing.left_out:
        say(f"left out: {', '.join(timing.left_out)}")
    late = [f.name for f in timing.frames if f.slack_s is None or f.slack_s < 0]
    missed = f"not schedulable: {', '.join(late)} may miss the deadline"
    say(missed if late else "every frame meets its deadline")
