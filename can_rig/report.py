"""``report.png``: reference and output, error, both commands and the fault estimate of one run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from can_rig.messages import Network
from can_rig.scenario import Scenario
from can_rig.signals import Signals
from firmware_model.sections import FloatArray

INK = "#1b1b1b"
BLUE, ORANGE, GREEN = "#0b5fa5", "#c8501e", "#2f7d4f"


def draw_report(path: Path, scenario: Scenario, network: Network, signals: Signals) -> None:
    """Five panels over one time axis, the fault marked, readable in print."""
    figure = Figure(figsize=(8.3, 10.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes: list[Axes] = list(figure.subplots(5, 1, sharex=True))
    time_s = signals.time_s
    feedback, command_1, command_2 = network.feedback, network.command_1, network.command_2

    axes[0].plot(time_s, signals.reference_mps2, color=INK, lw=1.0, ls="--", label="reference")
    axes[0].plot(time_s, signals.dstar_mps2, color=BLUE, lw=1.2, label=feedback.signal_name)
    axes[0].legend(loc="upper right", ncols=2, frameon=False)
    axes[0].set_ylabel(_label("output", feedback.unit))

    axes[1].plot(time_s, signals.error_mps2, color=BLUE, lw=0.9)
    axes[1].set_yscale("symlog", linthresh=1e-6)
    axes[1].set_yticks([s * 10.0**k for s in (-1, 1) for k in (-6, -4, -2, 0)] + [0.0])
    axes[1].set_ylabel(_label("error", feedback.unit))

    for axis, values, codec in (
        (axes[2], signals.torque_nm, command_1),
        (axes[3], signals.force_difference_n, command_2),
    ):
        axis.plot(time_s, values, color=ORANGE, lw=1.0)
        axis.set_ylabel(_label(_words(codec.signal_name), codec.unit))
        _clip(axis, values)
    axes[4].plot(time_s, signals.fault_estimate_mps2, color=GREEN, lw=1.1)
    threshold = scenario.design.fault_threshold_mps2
    for level in (-threshold, threshold):
        axes[4].axhline(level, color=INK, lw=0.6, ls=":")
    axes[4].set_ylabel(_label("fault estimate", feedback.unit))
    axes[4].set_xlabel("time in s")

    for axis in axes:
        axis.grid(alpha=0.25, lw=0.5)
        axis.margins(x=0.0)
        _mark_fault(axis, scenario, time_s)
    figure.align_ylabels(axes)
    fault = scenario.fault
    what = "no fault" if fault.kind == "none" else f"{fault.kind}, {fault.channel}"
    figure.suptitle(
        f"{scenario.name}: {what}; tick {scenario.tick_s * 1e3:g} ms, "
        f"latency {scenario.latency_ticks} ticks",
        fontsize=11,
    )
    figure.savefig(path, dpi=150)


def _label(name: str, unit: str) -> str:
    return f"{name}\nin {unit}" if unit else name


def _words(name: str) -> str:
    """``SteerTorque`` → ``steer torque``."""
    return "".join(f" {c.lower()}" if c.isupper() else c for c in name).strip()


def _clip(axis: Axes, values: FloatArray) -> None:
    """Show what lasts: a start-up spike of a few samples is written on the axis, not drawn."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    low, high = min(0.0, np.quantile(finite, 0.005)), max(0.0, np.quantile(finite, 0.995))
    span = high - low
    if np.abs(finite).max() <= 3.0 * span or span == 0.0:
        return
    axis.set_ylim(low - 0.25 * span, high + 0.25 * span)
    at = int(np.nanargmax(np.abs(values)))
    axis.text(
        0.012,
        0.95,
        f"off the scale: {values[at]:.3g} at tick {at}",
        transform=axis.transAxes,
        fontsize=8,
        va="top",
    )


def _mark_fault(axis: Axes, scenario: Scenario, time_s: FloatArray) -> None:
    """Shade the time in which the channel is lost."""
    fault = scenario.fault
    if fault.kind == "none" or not len(time_s) or fault.at_s > time_s[-1]:
        return
    end_s = float(time_s[-1]) if fault.for_s is None else fault.at_s + fault.for_s
    axis.axvspan(fault.at_s, end_s, color=ORANGE, alpha=0.07, lw=0)
    axis.axvline(fault.at_s, color=ORANGE, lw=0.9)
