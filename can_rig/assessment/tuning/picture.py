"""``tuning.png``: noise in X_diff against the peak after the loss, the trade-off of a tuning."""

from __future__ import annotations

from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from can_rig.assessment.tuning.report import noise_n
from can_rig.assessment.tuning.search import Tunings

INK, BLUE, ORANGE, PALE = "#101010", "#0b4f8a", "#b8461a", "#b9c2ca"  # of different greys in print


def draw_tunings(path: Path, found: Tunings) -> None:
    """Write ``picture`` as a PNG."""
    picture(found).savefig(path, dpi=200)


def picture(found: Tunings) -> Figure:
    """Everything that the nominal car is stable with, the trade-off over the box, the choice."""
    scenario, chosen = found.scenario, found.chosen
    figure = Figure(figsize=(6.9, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.plot(
        [noise_n(found, t) for t in found.nominal],
        [t.peak_mps2 for t in found.nominal],
        ".",
        color=PALE,
        ms=4,
        label="stable at the nominal car",
    )
    axis.plot(
        [noise_n(found, t) for t in found.front],
        [t.peak_mps2 for t in found.front],
        "o-",
        color=BLUE,
        ms=4,
        lw=1.2,
        label=f"best of those stable with all {found.cars} cars",
    )
    design = chosen.design
    axis.plot(
        noise_n(found, chosen),
        chosen.peak_mps2,
        "*",
        color=ORANGE,
        mec=INK,
        ms=16,
        label=f"chosen: τ = {1e3 * design.tau_s:g} ms, $τ_q$ = {1e3 * design.tau_q_s:g} ms, "
        f"α = {design.alpha}, $α_q$ = {design.alpha_q}",
    )
    axis.axhline(chosen.unavoidable_mps2, color=INK, lw=1.0, ls=(0, (5, 3)), label="unavoidable")
    if found.noise_limit_n is not None:
        axis.axvline(found.noise_limit_n, color=INK, lw=1.0, ls=(0, (1, 2)), label="noise limit")
    per = "" if scenario.noise.dstar_rms_mps2 else " per m/s² of noise in D*"
    axis.set_xlabel(f"noise in $X_{{diff}}$, rms in N{per}")
    axis.set_ylabel("deviation after the loss, peak in m/s²")
    axis.grid(alpha=0.35, lw=0.5)
    axis.legend(frameon=True, framealpha=0.9, edgecolor="none", fontsize=8, loc="upper right")
    ticks = "tick" if scenario.latency_ticks == 1 else "ticks"
    spare = "tick" if found.spare_ticks == 1 else "ticks"
    axis.set_title(
        f"{scenario.name}: tick {1e3 * scenario.tick_s:g} ms, latency {scenario.latency_ticks} "
        f"{ticks}, {found.spare_ticks} {spare} to spare, compensation "
        f"{scenario.design.compensation}",
        fontsize=9,
    )
    return figure
