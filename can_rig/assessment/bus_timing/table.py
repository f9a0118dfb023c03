"""``can-rig bus``: the bus timing of a scenario, or of any DBC, for a person or as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from can_rig.assessment.bus_timing.timing import BusTiming, FrameTiming, dbc_timing, network_timing
from can_rig.nodes.progress import json_line
from can_rig.plant.protocol import load_plant
from can_rig.scenario import loading as scenarios
from can_rig.scenario.build import network_of

COLUMNS = ("frame", "identifier", "bits", "time", "released", "response", "arrives", "slack")
NO_BOUND = "∞"


def bus_command(
    name: str,
    settings: Sequence[str],
    dbc: Path | None,
    rates: tuple[int | None, int | None],
    as_json: bool,
) -> int:
    """``can-rig bus``: the exit status, 0 where every frame is sure to be sent in time, else 1.

    Args:
        name: scenario whose five frames are looked at.
        settings: changes to it.
        dbc: another network to look at instead.
        rates: nominal and data bit rate [bit/s]; None for the scenario's, and for no data phase.
        as_json: one line of JSON instead of a table.
    """
    # The latency is what is asked for; a scenario that wants it from the bus must not stop that.
    scenario = scenarios.load(name, [*settings, "latency_ticks=0"])
    bitrate, data_bitrate = rates[0] or scenario.bus.bitrate, rates[1]
    if dbc is not None:
        timing = dbc_timing(dbc, bitrate, data_bitrate)
    else:
        if scenario.plant.is_class:
            load_plant(scenario.plant.kind, scenario.plant)  # no timing for what cannot run
        compute_s = scenario.bus.compute_s
        timing = network_timing(network_of(scenario), bitrate, scenario.tick_s, compute_s)
    if as_json:
        json_line(**as_dict(timing))
    else:
        _print(timing, None if dbc else scenario.tick_s)
    return 0 if timing.schedulable else 1


def as_dict(timing: BusTiming) -> dict[str, Any]:
    """For JSON: seconds as numbers, null where there is no bound."""
    return {
        "bitrate": timing.bitrate,
        "schedulable": timing.schedulable,
        "utilisation": float(timing.utilisation),
        "latency_ticks": timing.latency_ticks,
        "frames": [
            {
                "name": frame.name,
                "frame_id": frame.frame_id,
                "extended": frame.extended,
                "bits": frame.bits,
                "transmission_s": _seconds(frame.transmission_s),
                "release_s": _seconds(frame.release_s),
                "response_s": _seconds(frame.response_s),
                "arrival_s": _seconds(frame.arrival_s),
                "deadline_s": _seconds(frame.deadline_s),
                "slack_s": _seconds(frame.slack_s),
            }
            for frame in timing.frames
        ],
        "left_out": list(timing.left_out),
    }


def table_rows(timing: BusTiming) -> Iterator[tuple[str, ...]]:
    """One row a frame, of the columns of `COLUMNS`; times in µs."""
    for frame in timing.frames:
        times = (frame.transmission_s, frame.release_s, frame.response_s, frame.arrival_s)
        row = [NO_BOUND if t is None else f"{float(t) * 1e6:.1f}" for t in (*times, frame.slack_s)]
        yield (frame.name, _identifier(frame), str(frame.bits), *row)


def _print(timing: BusTiming, tick_s: float | None) -> None:
    console = Console()
    table = Table(title="worst case, times in µs", box=None, pad_edge=False)
    table.add_column(COLUMNS[0], overflow="fold")  # gives way, where a name is long, to numbers
    for heading in COLUMNS[1:]:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in table_rows(timing):
        table.add_row(*row)
    console.print(table)
    lines = [f"utilisation {float(timing.utilisation):.1%} of {timing.bitrate} bit/s"]
    if tick_s is not None and timing.latency_ticks is not None:
        lines.append(f"latency_ticks = {timing.latency_ticks} at a tick of {tick_s * 1e3:g} ms")
    if timing.left_out:
        lines.append(f"left out: {', '.join(timing.left_out)}")
    verdict = "every frame meets its deadline" if timing.schedulable else _late(timing)
    for line in (*lines, verdict):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _late(timing: BusTiming) -> str:
    late = [f.name for f in timing.frames if f.slack_s is None or f.slack_s < 0]
    return f"not schedulable: {', '.join(late)} may miss the deadline"


def _identifier(frame: FrameTiming) -> str:
    return f"0x{frame.frame_id:08X}" if frame.extended else f"0x{frame.frame_id:03X}"


def _seconds(time: Fraction | None) -> float | None:
    return None if time is None else float(time)
