"""``can-rig replay``, open loop: a log through today's controller, and what came out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.table import Table

from can_rig.cli.progress import reading
from can_rig.errors import LogError
from can_rig.files import atomic, refuse_existing
from can_rig.replay.comparison import Place, SignalComparison
from can_rig.replay.gaps import Gap, in_order, seconds, write_gaps
from can_rig.replay.replay import OpenLoop
from can_rig.results.source import Source
from can_rig.scenario.build import network_of

SHOWN: Final = 12
"""Gaps in the table; --gaps has all."""

WIDTH: Final = 120
"""Least characters of a line of output."""

KEPT: Final = 1000
"""Gaps in the JSON object."""


def replay_command(source: Source, gaps: Path | None, force: bool, as_json: bool) -> int:
    """``can-rig replay``, open loop: 0 if nothing differs, else 1.

    Raises:
        LogError: the log cannot be read, or nothing of it can be compared.
        ScenarioError: a design that cannot be made.
    """
    if gaps is not None:
        refuse_existing(gaps, force, "--gaps")
    found: list[Gap] = []
    with _all_gaps(gaps) as write:
        loop = OpenLoop(source.scenario, network_of(source.scenario), found.append)
        loop.run(source.frames(lambda log: reading(log, "replaying")))
        listed = in_order(found)
        write(listed)
    if not any(signal.compared for signal in loop.comparison.signals):
        raise LogError(
            f"{source.log.path}: no frame of a controller in it that could be compared "
            f"({loop.comparison.ticks} ticks were replayed); a log of both nodes is right"
        )
    if as_json:
        print(json.dumps(_summary(source, loop, listed), ensure_ascii=False))
    else:
        _print(source, loop, listed, gaps)
    return 0 if loop.comparison.identical else 1


@contextmanager
def _all_gaps(path: Path | None) -> Iterator[Callable[[list[Gap]], None]]:
    """Writes the list, or does not; what cannot be written is refused before the replay."""
    if path is None:
        yield lambda gaps: None
        return
    with atomic(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        yield lambda gaps: write_gaps(file, gaps)


def _summary(source: Source, loop: OpenLoop, listed: list[Gap]) -> dict[str, Any]:
    comparison = loop.comparison
    return {
        "log": str(source.log.path),
        "scenario": source.scenario.name,
        "identical": comparison.identical,
        "ticks": comparison.ticks,
        "first_tick": loop.first_tick,
        "compared_ticks": comparison.compared,
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


def _print(source: Source, loop: OpenLoop, listed: list[Gap], gaps: Path | None) -> None:
    console = wide_console()
    console.print(_signal_table(loop.comparison.signals))
    if loop.account.counts:
        console.print()
        console.print(_count_table(loop))
        _list(console, loop, listed, gaps)
    console.print()
    for line in _verdict(loop):
        console.print(line, markup=False)
    if source.log.notice:
        note = f"note: {source.log.notice}"
        Console(stderr=True, soft_wrap=True).print(note, style="yellow", markup=False)


def wide_console() -> Console:
    """Standard output, wide enough for a table of differences wherever it goes."""
    console = Console(soft_wrap=True, highlight=False)
    console.width = max(console.width, WIDTH)
    return console


def _signal_table(signals: Sequence[SignalComparison]) -> Table:
    table = _table(
        "signal", "compared", "different", "first tick", "log", "replay", "largest", "at"
    )
    for signal in signals:
        row = [signal.signal, str(signal.compared), str(signal.different)]
        if signal.first is not None and signal.largest_at is not None:
            tick = f"{signal.first.tick} ({signal.first.time_s:.6f} s)"
            row += [tick, *_both(signal.first, signal.unit)]
            if not math.isnan(signal.largest):  # codes have no distance
                size = f"{signal.largest:.4g} {signal.unit}".rstrip()
                row += [size, str(signal.largest_at.tick)]
        table.add_row(*row)
    return table


def _table(*headings: str) -> Table:
    """Every column as wide as it needs; texts to the left."""
    table = Table(box=None, pad_edge=False)
    for heading in headings:
        left = heading in {"signal", "message", "what", "wrong in the log"}
        table.add_column(heading, justify="left" if left else "right", no_wrap=True)
    return table


def _both(place: Place, unit: str) -> tuple[str, str]:
    shown = [
        value if isinstance(value, str) else f"{value:.9g} {unit}".rstrip()
        for value in (place.logged, place.replayed)
    ]
    return shown[0], shown[1]


def _count_table(loop: OpenLoop) -> Table:
    counts = _counts(loop)
    words = list(dict.fromkeys(word for row in counts.values() for word in row))
    table = _table("wrong in the log", *words)
    for message, row in counts.items():
        table.add_row(message, *(str(row.get(word, "")) for word in words))
    return table


def _list(console: Console, loop: OpenLoop, listed: list[Gap], gaps: Path | None) -> None:
    console.print()
    table = _table("tick", "at s", "message", "what")
    for gap in listed[:SHOWN]:
        tick = str(gap.tick) if gap.ticks == 1 else f"{gap.tick}..{gap.tick + gap.ticks - 1}"
        what = f"{gap.what}: {gap.detail}" if gap.detail else gap.what
        table.add_row(tick, seconds(gap.time_ns), gap.message, what)
    console.print(table)
    if gaps is not None:
        console.print(f"all of them in {gaps}", markup=False)
    elif len(listed) > SHOWN:
        console.print("…, and more: --gaps FILE.csv lists all", markup=False)


def _verdict(loop: OpenLoop) -> Iterator[str]:
    comparison, gap = loop.comparison, loop.account.first_input_gap
    first, ticks = comparison.first_different_tick, comparison.ticks
    yield (
        f"{comparison.compared} of {ticks} ticks compared as a whole"
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
        yield f"identical, {same}: all that could be compared"
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
