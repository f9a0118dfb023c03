"""``report.png``: output, error, both commands and the fault estimate of one run, on one page."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import LogLocator, NullFormatter

from can_rig.assessment.control_authority import authority
from can_rig.frames.network import Network
from can_rig.results.counterfactual import fault_free
from can_rig.results.metrics import windows
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import FloatArray

INK = "#1b1b1b"
BLUE, ORANGE, GREEN = "#0b4f8a", "#b8461a", "#2f7d4f"  # of different greys in print
LOST = "#efe9e2"
Side = Literal["lower left", "lower right"]


def draw_report(
    path: Path,
    scenario: Scenario,
    network: Network,
    signals: Signals,
    realtime: dict[str, Any] | None = None,
) -> None:
    """Write ``page`` as a PNG."""
    page(scenario, network, signals, realtime).savefig(path, dpi=150)


def page(
    scenario: Scenario,
    network: Network,
    signals: Signals,
    realtime: dict[str, Any] | None = None,
) -> Figure:
    """Five panels over one time axis, the loss shaded, readable in grey print.

    A closed loop shows r, D* and |r - D*|. An open loop follows nothing: it shows D* beside D* of
    the same run without the fault, and how far apart they are. A real-time run has a sixth panel:
    how late the plant node woke and how long the answers took.
    """
    figure = Figure(figsize=(8.27, 10.6), layout="constrained")
    FigureCanvasAgg(figure)
    signals_part: Figure | SubFigure = figure
    if realtime:
        parts: Any = figure.subfigures(2, 1, height_ratios=(5.25, 1.2))
        signals_part = parts[0]
        _timing(parts[1].subplots(), scenario, realtime)
    axes: list[Axes] = list(
        signals_part.subplots(5, 1, sharex=True, height_ratios=(1.25, 1, 1, 1, 1))
    )
    time_s, unit = signals.time_s, network.feedback.unit
    command_1, command_2 = network.command_1, network.command_2

    for axis in axes:
        axis.grid(alpha=0.3, lw=0.5)
        axis.margins(x=0.0, y=0.08)
    if not scenario.model.closed_loop:
        beside, label, distance = (
            fault_free(scenario, signals).dstar_mps2,
            "without the fault",
            "deviation",
        )
    else:
        beside, label, distance = signals.reference_mps2, "reference", "error"
    name = "D*" if network.feedback.signal_name == "DStar" else "output y"
    late = len(signals) > 0 and scenario.fault.at_s > 0.5 * float(time_s[0] + time_s[-1]) + 1.0
    _output(axes[0], signals, beside, (name, label), "lower left" if late else "lower right")
    axes[0].set_ylabel(_label(name, unit))
    with np.errstate(over="ignore", invalid="ignore"):
        _logarithmic(axes[1], time_s, beside - signals.dstar_mps2, network.feedback.lsb)
    axes[1].set_ylabel(_label(f"|{distance}|", unit))
    for axis, values, codec in (
        (axes[2], signals.torque_nm, command_1),
        (axes[3], signals.force_difference_n, command_2),
    ):
        axis.plot(time_s, values, color=ORANGE, lw=1.0)
        axis.set_ylabel(_label(_words(codec.signal_name), codec.unit))
        _clip(axis, time_s, values, codec.unit)
    _authority(axes[3], scenario, network, signals)
    _estimate(axes[4], scenario, signals)
    axes[4].set_ylabel(_label("fault estimate", unit))
    axes[4].set_xlabel("time in s")
    _mark_loss(axes, scenario, signals)
    signals_part.align_ylabels(axes)
    signals_part.suptitle(_title(scenario), fontsize=11)
    return figure


def _output(
    axis: Axes, signals: Signals, beside: FloatArray, labels: tuple[str, str], side: Side
) -> None:
    axis.plot(signals.time_s, beside, color=INK, lw=1.1, ls=(0, (4, 3)), label=labels[1], zorder=3)
    axis.plot(signals.time_s, signals.dstar_mps2, color=BLUE, lw=1.7, label=labels[0], alpha=0.75)
    _include_zero(axis, signals.dstar_mps2)
    # Above the panel, where no curve can be, and on the side where the loss is not named.
    corner = (0.0 if side == "lower left" else 1.0, 1.0)
    axis.legend(loc=side, bbox_to_anchor=corner, ncols=2, frameon=False, fontsize=9, borderpad=0)


def _include_zero(axis: Axes, values: FloatArray) -> None:
    if np.isfinite(values).any():
        axis.update_datalim([(axis.dataLim.x0, 0.0)])
        axis.autoscale_view()


def _logarithmic(axis: Axes, time_s: FloatArray, values: FloatArray, floor: float) -> None:
    """|values| in decades, nothing below the grid of the frame that brought them."""
    size = np.maximum(np.abs(values), floor)
    axis.plot(time_s, size, color=BLUE, lw=0.8)
    axis.set_yscale("log")
    largest = float(np.nanmax(size)) if np.isfinite(size).any() else 1.0
    axis.set_ylim(0.7 * floor, max(1.0, 3.0 * largest))
    axis.yaxis.set_major_locator(LogLocator(100.0, numticks=12))
    axis.yaxis.set_minor_locator(LogLocator(10.0, numticks=24))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _estimate(axis: Axes, scenario: Scenario, signals: Signals) -> None:
    threshold = scenario.design.fault_threshold_mps2
    axis.plot(signals.time_s, signals.fault_estimate_mps2, color=GREEN, lw=1.2)
    for level, label in ((-threshold, None), (threshold, "fault threshold")):
        axis.axhline(level, color=INK, lw=0.7, ls=(0, (1, 2)), label=label)
    _legend_above(axis)
    _clip(axis, signals.time_s, signals.fault_estimate_mps2, "")


def _authority(axis: Axes, scenario: Scenario, network: Network, signals: Signals) -> None:
    """Where limit and tires end, if X_diff comes near."""
    carried = authority(scenario, network)
    force = np.abs(signals.force_difference_n)
    if carried is None or not np.isfinite(force).any():
        return
    available = carried.available_n
    if np.nanmax(force) < 0.5 * available:
        return
    sign = float(np.sign(signals.force_difference_n[int(np.nanargmax(force))]))
    label = "most that limit and tires allow in this bend"
    axis.axhline(sign * available, color=INK, lw=0.9, ls=(0, (1, 2)), label=label)
    _legend_above(axis)


def _legend_above(axis: Axes) -> None:
    axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), frameon=False, fontsize=9, borderpad=0
    )


def _timing(axis: Axes, scenario: Scenario, realtime: dict[str, Any]) -> None:
    """Two histograms side by side over logarithmic bins of time, and the tick that limits both."""
    for key, label, color, shift in (
        ("wake_up_lateness_us", "wake-up lateness", BLUE, -0.2),
        ("answer_after_us", "answer after", ORANGE, 0.2),
    ):
        counts = realtime[key]["counts"]
        edges = realtime[key]["edges_us"]
        axis.bar(np.arange(len(counts)) + shift, counts, 0.4, color=color, label=label)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_ylim(bottom=0.0)
    axis.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:g}" for edge in edges])
    tick_us = scenario.tick_s * 1e6
    at = float(np.interp(tick_us, edges, np.arange(len(edges)))) - 0.5
    axis.axvline(at, color=INK, lw=0.8, ls=(0, (4, 3)), label="one tick")
    axis.set_xlabel("time in µs, lower edge of the bin")
    axis.set_ylabel("ticks")
    axis.grid(axis="y", alpha=0.3, lw=0.5)
    axis.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, frameon=False, fontsize=9,
        borderpad=0,
    )  # fmt: skip


def _title(scenario: Scenario) -> str:
    fault, plant = scenario.fault, scenario.plant
    if fault.kind == "none":
        what = "no fault"
    else:
        until = "" if fault.for_s is None else f" for {fault.for_s:g} s"
        channel = fault.channel.replace("-", " ")
        left = f", {fault.left:.0%} left" if fault.left else ""
        what = f"{fault.kind.replace('-', ' ')}, {channel}{left}, at {fault.at_s:g} s{until}"
        if not fault.loses_a_channel:
            what = f"sensor biased by {fault.bias_mps2:g} m/s², at {fault.at_s:g} s{until}"
    ticks = "tick" if scenario.latency_ticks == 1 else "ticks"
    rig = f"tick {scenario.tick_s * 1e3:g} ms, latency {scenario.latency_ticks} {ticks}"
    car = f"{plant.kind}, {plant.variant}" if plant.is_car else plant.kind
    return f"{scenario.name}: {what}\n{car}; {rig}; compensation {scenario.design.compensation}"


def _label(name: str, unit: str) -> str:
    return f"{name}\nin {_readable(unit)}" if unit else name


def _readable(unit: str) -> str:
    """A unit as the DBC writes it, as print does."""
    return unit.replace("^2", "²").replace("N.m", "N m")


def _words(name: str) -> str:
    """``SteerTorque`` → ``steer torque``, ``Input1`` → ``input 1``."""
    spaced = "".join(f" {c.lower()}" if c.isupper() or c.isdigit() else c for c in name)
    return spaced.strip()


def _clip(axis: Axes, time_s: FloatArray, values: FloatArray, unit: str) -> None:
    """Show what lasts: a spike of a few samples is written on the axis instead of scaling it."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    _include_zero(axis, values)
    low, high = min(0.0, np.quantile(finite, 0.005)), max(0.0, np.quantile(finite, 0.995))
    span = high - low
    if np.abs(finite).max() <= 3.0 * span or span == 0.0:
        return
    axis.set_ylim(low - 0.25 * span, high + 0.25 * span)
    at = int(np.nanargmax(np.abs(values)))
    axis.text(
        0.0,
        1.03,
        f"off the scale: {values[at]:.3g} {_readable(unit)} at {time_s[at]:g} s".replace("  ", " "),
        transform=axis.transAxes,
        fontsize=9,
    )


def _mark_loss(axes: list[Axes], scenario: Scenario, signals: Signals) -> None:
    """Shade the time in which the channel is lost, and name it once."""
    if not len(signals):
        for axis in axes:
            axis.set_xlim(0.0, scenario.duration_s)
        axes[0].text(0.5, 0.5, "no tick on record", transform=axes[0].transAxes, ha="center")
        return
    first_s, last_s = float(signals.time_s[0]), float(signals.time_s[-1]) + scenario.tick_s
    for axis in axes:
        axis.set_xlim(first_s, last_s)
    if not windows(scenario, signals).after.any():
        return
    fault = scenario.fault
    for_s = math.inf if fault.for_s is None else fault.for_s
    start_s, end_s = max(first_s, fault.at_s), min(last_s, fault.at_s + for_s)
    for axis in axes:
        axis.axvspan(start_s, end_s, color=LOST, lw=0, zorder=0)
        axis.axvline(start_s, color=INK, lw=0.8, zorder=1)
    lost = {"torque": "channel 1 lost", "force-difference": "channel 2 lost"}[fault.channel]
    lost = lost if fault.loses_a_channel else "sensor biased"
    axes[0].annotate(
        lost,
        (start_s, 1.0),
        (4, 4),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        fontsize=9,
        annotation_clip=False,
    )
