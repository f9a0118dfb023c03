"""The output of an open-loop ``can-rig replay``, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from can_rig.cli.output import note, table, wide
from can_rig.replay.gaps import Gap, seconds
from can_rig.replay.replay import OpenLoop, Place, SignalComparison
from can_rig.results.source import Source

SHOWN: Final = 12
"""Gaps in the table; --gaps has all."""

KEPT: Final = 1000
"""Gaps in the JSON object."""


def summary(source: Source, loop: OpenLoop, listed: list[Gap]) -> dict[str, Any]:
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
            for gap in listed[:KEPT]
        ],
        "rejected_frames": loop.rejected(),
        "notice": source.log.notice,
    }


def _counts(loop: OpenLoop) -> dict[str, dict[str, int]]:
    counts: dict[str, dict[str, int]] = {}
    for (message, what), number in sorted(loop.account.counts.items()):
        counts.setdefault(message, {})[what] = number
    return counts


def print_comparison(source: Source, loop: OpenLoop, listed: list[Gap], gaps: Path | None) -> None:
    """Print tables of signals and gaps, and a verdict; the file ``gaps`` lists every gap."""
    console = wide()
    console.print(_signal_table(loop.comparison.signals))
    if loop.account.counts:
        console.print()
        console.print(_count_table(loop))
        _list(console, loop, listed, gaps)
    console.print()
    for line in _verdict(loop):
        console.print(line, markup=False)
    note(source.log.notice)


def _signal_table(signals: Sequence[SignalComparison]) -> Table:
    headings = ("signal", "compared", "different", "first tick", "log", "replay", "largest", "at")
    rows = _no_wrap(table(*headings))
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


def _both(place: Place, unit: str) -> tuple[str, str]:
    shown = [
        value if isinstance(value, str) else f"{value:.9g} {unit}".rstrip()
        for value in (place.logged, place.replayed)
    ]
    return shown[0], shown[1]


def _count_table(loop: OpenLoop) -> Table:
    counts = _counts(loop)
    words = list(dict.fromkeys(word for row in counts.values() for word in row))
    rows = _no_wrap(table("wrong in the log", *words))
    for message, row in counts.items():
        rows.add_row(message, *(str(row.get(word, "")) for word in words))
    return rows


def _no_wrap(rows: Table) -> Table:
    """Set every column to the width of the longest cell."""
    for column in rows.columns:
        column.no_wrap = True
    return rows


def _list(console: Console, loop: OpenLoop, listed: list[Gap], gaps: Path | None) -> None:
    console.print()
    rows = _no_wrap(table("tick", "at s", "message", "what"))
    rows.columns[0].justify = "right"
    for column in rows.columns[2:]:
        column.justify = "left"
    for gap in listed[:SHOWN]:
        tick = str(gap.tick) if gap.ticks == 1 else f"{gap.tick}..{gap.tick + gap.ticks - 1}"
        what = f"{gap.what}: {gap.detail}" if gap.detail else gap.what
        rows.add_row(tick, seconds(gap.time_ns), gap.message, what)
    console.print(rows)
    if gaps is not None:
        console.print(f"all of them in {gaps}", markup=False)
    elif len(listed) > SHOWN:
        console.print("…, and more: --gaps FILE.csv lists all", markup=False)


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
