"""``tuning.png``: noise in X_diff against the peak after the loss, the trade-off of a tuning."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from can_rig.assessment.tuning.search import Tunings
from can_rig.drawing import style
from can_rig.drawing.names import names_of, ticks_text, with_unit


def draw_tunings(path: Path, found: Tunings) -> None:
    """Write ``picture`` as a PNG."""
    picture(found).savefig(path, dpi=200)


def picture(found: Tunings) -> Figure:
    """Every tuning that is stable with the nominal car, the trade-off over the box, the choice."""
    scenario, chosen = found.scenario, found.chosen
    figure = style.page(5.0, style.COLUMN_WIDTH_IN)
    axis = figure.subplots()
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.plot(
        [found.noise_n(t) for t in found.nominal],
        [t.peak_mps2 for t in found.nominal],
        ".",
        color=style.PALE_BLUE,
        ms=4,
        label=f"stable with the nominal {scenario.plant.noun}",
    )
    axis.plot(
        [found.noise_n(t) for t in found.front],
        [t.peak_mps2 for t in found.front],
        "o-",
        color=style.BLUE,
        ms=4,
        lw=1.2,
        label=f"best of those stable with all {found.cars} {scenario.plant.noun}s"
        if found.cars > 1
        else "best of those",
    )
    design = chosen.design
    axis.plot(
        found.noise_n(chosen),
        chosen.peak_mps2,
        "*",
        color=style.ORANGE,
        mec=style.INK,
        ms=16,
        label=f"chosen: τ = {1e3 * design.tau_s:g} ms, $τ_q$ = {1e3 * design.tau_q_s:g} ms, "
        f"α = {design.alpha}, $α_q$ = {design.alpha_q}",
    )
    axis.axhline(
        chosen.unavoidable_mps2,
        color=style.INK,
        lw=1.0,
        ls=style.DASHED,
        label="least possible deviation",
    )
    if found.noise_limit_n is not None:
        axis.axvline(
            found.noise_limit_n, color=style.INK, lw=1.0, ls=style.DOTTED, label="noise limit"
        )
    output, _, second = names_of(scenario.plant)
    unit = f" in {second.unit}" if second.unit else ""
    per = "" if scenario.model.sensor.noise_mps2 else f" per {output.unit or 1} of noise in "
    axis.set_xlabel(f"noise in {_drawn(second.short)}, rms{unit}{per and per + output.name}")
    axis.set_ylabel(with_unit("deviation after the loss, peak in", output.unit or "1"))
    axis.grid(alpha=0.35, lw=0.5)
    axis.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=8, loc="upper right")
    axis.set_title(
        f"{scenario.name}: tick {1e3 * scenario.tick_s:g} ms, latency "
        f"{ticks_text(scenario.latency_ticks)}, {ticks_text(found.spare_ticks)} to spare, "
        f"compensation {scenario.design.compensation.replace('-', ' ')}",
        fontsize=9,
    )
    return figure


def _drawn(name: str) -> str:
    return "$X_{diff}$" if name == "X_diff" else name
