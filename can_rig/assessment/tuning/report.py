"""``can-rig tune``: what a person sees of the search, and its JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from can_rig.assessment.resolve import load
from can_rig.assessment.tuning.box import MOST_DELAY_TICKS, cars, parameter_ranges
from can_rig.assessment.tuning.candidate import Tuning
from can_rig.assessment.tuning.search import ALIKE, Tunings, tune
from can_rig.errors import RunFolderError
from can_rig.nodes.nodes import json_line

PICTURE = "tuning.png"
APART = 1.6  # factor in peak or noise from one row of the table to the next
HEADINGS = ("τ", "τ_q", "α", "α_q", "margin", "peak", "of least", "X_diff", "torque", "torque")
UNITS = ("ms", "ms", "", "", "ticks", "m/s²", "possible", "rms", "rms", "peak N m")


def tune_command(
    name: str,
    settings: Sequence[str],
    box: tuple[float, Sequence[str]],
    limits: tuple[int, float | None, float | None],
    out: Path,
    force: bool,
    as_json: bool,
) -> int:
    """``can-rig tune``: the exit status, 1 where no tuning is as quiet as wanted.

    ``box`` is what ``ranges`` takes, ``limits`` are the ticks to spare, the noise in X_diff, N, and
    that in the torque, N m.
    """
    from can_rig.assessment.tuning.picture import draw_tunings  # noqa: PLC0415 (matplotlib: slow to import)

    scenario = load(name, settings)
    path = out / PICTURE
    if path.exists() and not force:
        raise RunFolderError(
            f"{path}: there already; another --out, or --force to replace it, is right"
        )
    some = cars(scenario.model, parameter_ranges(scenario.model, *box))
    with _progress(scenario.name) as on_candidate:
        found = tune(scenario, some, *limits, on_candidate=on_candidate)
    try:
        out.mkdir(parents=True, exist_ok=True)
        draw_tunings(path, found)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be written: {error.strerror}") from None
    if as_json:
        json_line(**as_dict(found), picture=str(path))
    else:
        _print(found, path)
    return 0 if found.is_quiet(found.chosen) else 1


def options(found: Tunings, tuning: Tuning) -> str:
    """The ``--set`` options that choose ``tuning`` in its scenario."""
    keys = ("tau_s", "alpha", "tau_q_s", "alpha_q")
    return " ".join(f"--set design.{key}={getattr(tuning.design, key):g}" for key in keys)


def why(found: Tunings) -> str:
    """One sentence: what makes the chosen tuning the one."""
    chosen, limit = found.chosen, found.noise_limit_n
    least = found.front[0].peak_mps2
    if not found.is_quiet(chosen):
        reason = f"none is within {limit:g} N of X_diff noise; this is the quietest"
    elif limit is not None and chosen.peak_mps2 > ALIKE * least:
        reason = f"the least peak within {limit:g} N rms of X_diff noise"
    elif chosen is found.front[0]:
        reason = "the least peak"
    else:
        reason = f"within {ALIKE - 1.0:.0%} of the least peak, and the quietest of those"
    held = "" if chosen.within_limits else "; its commands reach the limits, as all of these do"
    ticks = "tick" if found.spare_ticks == 1 else "ticks"
    return (
        f"{reason}, stable with {found.spare_ticks} {ticks} to spare healthy and with the torque "
        f"lost, for {_cars(found.cars)}{held}"
    )


def as_dict(found: Tunings) -> dict[str, Any]:
    """For JSON: what was asked, the whole trade-off, the choice and how to use it."""
    return {
        "scenario": found.scenario.name,
        "compensation": found.scenario.design.compensation,
        "tried": found.tried,
        "stable_at_the_nominal_car": len(found.nominal),
        "cars": found.cars,
        "spare_ticks": found.spare_ticks,
        "noise_limit_n": found.noise_limit_n,
        "dstar_noise_rms_mps2": found.scenario.noise.dstar_rms_mps2,
        "chosen": _values(found.chosen),
        "why": why(found),
        "options": options(found, found.chosen),
        "front": [_values(tuning) for tuning in found.front],
    }


def rows(found: Tunings) -> Iterator[tuple[Tuning, tuple[str, ...]]]:
    """The trade-off in steps that matter, and the chosen one in any case."""
    last: Tuning | None = None
    for tuning in found.front:
        near = last is not None and (
            tuning.peak_mps2 < APART * last.peak_mps2
            and last.noise_to_force < APART * tuning.noise_to_force
        )
        if near and tuning is not found.chosen:
            continue
        last, design = tuning, tuning.design
        margin = tuning.delay_margin_ticks
        yield (
            tuning,
            (
                f"{1e3 * design.tau_s:g}",
                f"{1e3 * design.tau_q_s:g}",
                str(design.alpha),
                str(design.alpha_q),
                str(margin) if margin is None or margin < MOST_DELAY_TICKS else f"{margin}+",
                f"{tuning.peak_mps2:.2e}",
                f"x {tuning.peak_ratio:.2f}",
                f"{noise_n(found, tuning):.3g}",
                f"{tuning.noise_to_torque * (found.scenario.noise.dstar_rms_mps2 or 1.0):.3g}",
                f"{tuning.torque_peak_nm:.4g}",
            ),
        )


def noise_n(found: Tunings, tuning: Tuning) -> float:
    """Rms of X_diff in N at the scenario's noise; per m/s² of noise where it has none."""
    return tuning.noise_to_force * (found.scenario.noise.dstar_rms_mps2 or 1.0)


def noise_unit(found: Tunings) -> str:
    """The unit of ``noise_n``."""
    return "N" if found.scenario.noise.dstar_rms_mps2 else "N/(m/s²)"


def _print(found: Tunings, path: Path) -> None:
    force = noise_unit(found)
    units = (*UNITS[:-3], f"rms {force}", f"rms {force.replace('N', 'N m', 1)}", UNITS[-1])
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for heading, unit in zip(HEADINGS, units, strict=True):
        table.add_column(f"{heading}\n{unit}", justify="right")
    for tuning, cells in rows(found):
        chosen = tuning is found.chosen
        table.add_row(">" if chosen else "", *cells, style="bold" if chosen else None)
    console = Console()
    console.print(table)
    for line in (f"chosen: {why(found)}", options(found, found.chosen), f"picture  {path}"):
        console.print(line, soft_wrap=True, markup=False, highlight=False)


def _values(tuning: Tuning) -> dict[str, Any]:
    design, values = tuning.design, vars(tuning).copy()
    del values["design"]
    margin = tuning.delay_margin_ticks
    return {
        "tau_s": design.tau_s,
        "alpha": design.alpha,
        "tau_q_s": design.tau_q_s,
        "alpha_q": design.alpha_q,
        **{
            k: v if not isinstance(v, float) or math.isfinite(v) else None
            for k, v in values.items()
        },
        "delay_margin_is_at_least": margin is not None and margin >= MOST_DELAY_TICKS,
        "peak_ratio": tuning.peak_ratio,
    }


def _cars(count: int) -> str:
    return "the nominal car" if count == 1 else f"the nominal car and {count - 1} around it"


@contextmanager
def _progress(name: str) -> Iterator[Callable[[int, int], None]]:
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("tunings"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)
