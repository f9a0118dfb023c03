"""``report.png``: output, error, both commands and the fault estimate of one run, on one page."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.ticker import MaxNLocator

from can_rig.assessment.limitations import control_authority
from can_rig.drawing import style
from can_rig.drawing.names import Names, disturbance_in_words, fault_in_words, names_of, ticks_text
from can_rig.drawing.style import BLUE, DASHED, INK, ORANGE, legend_above
from can_rig.drawing.thinning import thinned
from can_rig.frames.network import Network
from can_rig.logs.columns import SPEED
from can_rig.results.counterfactual import (
    applied_commands,
    fault_free,
    output_of_car,
    uncompensated,
)
from can_rig.results.metrics import windows
from can_rig.results.signals import Signals
from can_rig.scenario.driving import at_speed_of
from can_rig.scenario.fault_settings import SENSOR
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario
from can_rig.storage import paged
from firmware_model.law.status import FaultState
from firmware_model.law.structs import FloatArray

MOST_LINES: Final = 6
"""Lines for faults, and for disturbances."""


def page_title(scenario: Scenario, names: Names, signals: Signals) -> str:
    """The scenario, its faults and disturbances; car, bus and compensation; an early end."""
    tick = f"tick {scenario.tick_s * 1e3:g} ms, latency {ticks_text(scenario.latency_ticks)}"
    compensation = scenario.design.compensation.replace("-", " ")
    return (
        f"{scenario.name}: {_faults(scenario, names, _end_s(scenario, signals))}"
        f"{_disturbances(scenario, _end_s(scenario, signals))}"
        f"\n{_car(scenario.plant)}; {tick}; compensation {compensation}"
        f"{_ended_early(scenario, signals)}"
    )


def _faults(scenario: Scenario, names: Names, end_s: float) -> str:
    """The fault in words; several faults numbered, a line each."""
    words = [fault_in_words(fault, names, end_s) for fault in scenario.faults]
    if len(words) <= 1:
        return "".join(words) or "no fault"
    lines = [f"{number}: {text}" for number, text in enumerate(words, 1)]
    return "\n".join((f"{len(words)} faults", *_some(lines)))


def _disturbances(scenario: Scenario, end_s: float) -> str:
    """The disturbances in words, a line each."""
    lines = [disturbance_in_words(each, end_s) for each in scenario.disturbances]
    return "".join(f"\n{line}" for line in _some(lines))


def _some(lines: list[str]) -> list[str]:
    more = len(lines) - MOST_LINES
    return lines[:MOST_LINES] + [f"and {more} more"] * (more > 0)


def _end_s(scenario: Scenario, signals: Signals) -> float:
    return float(signals.time_s[-1]) + scenario.tick_s if len(signals) else 0.0


def _ended_early(scenario: Scenario, signals: Signals) -> str:
    end_s = _end_s(scenario, signals)
    early = end_s < scenario.duration_s - 1.5 * scenario.tick_s
    return f"\nended at {end_s:.4g} s of {scenario.duration_s:g} s" if early else ""


def _car(plant: PlantSettings) -> str:
    if plant.is_own:
        return Path(plant.kind.partition(":")[2]).name
    return f"{plant.kind}, {plant.variant} model" if plant.is_car else plant.kind


HEIGHT_IN, HEIGHT_WITH_TIMING_IN, TIMING_IN = 10.6, 11.4, 1.8
LEFT_IN, RIGHT_IN, BOTTOM_IN, TITLE_LINE_IN, LABEL_IN = 1.2, 0.2, 0.5, 0.19, 0.6
"""Fixed margins: automatic margins would draw the page twice."""
ZOOM_LABEL_IN: Final = 0.4
BEFORE_S, AFTER_S = 0.05, 0.25
"""Time around the begin of the fault that is drawn beside the whole run."""


def page(
    scenario: Scenario, network: Network, signals: Signals, realtime: dict[str, Any] | None = None
) -> Figure:
    """Five panels over one time axis, the loss shaded, readable in grey print.

    Beside the whole run stand the 0.3 s around the begin of the first fault, with own scales.

    A closed loop shows r, D* and |r - D*|. An open loop shows D*, D* of the same run without the
    fault, and their distance. From the loss on, a thin line is D* of the same run without
    compensation, and the panel of the lost channel shows the applied command beside the sent
    command. A changing speed is drawn beside the estimate. A real-time run has a sixth panel:
    wake-up lateness of the plant node and answer times.
    """
    names = names_of(scenario.plant)
    title = page_title(scenario, names, signals)
    title_in = TITLE_LINE_IN * (1 + title.count("\n"))
    near = around_the_fault(scenario, signals)
    figure = _empty_page(title_in, bool(realtime), near is not None)
    figure.suptitle(style.plain(title), fontsize=11, y=1.0 - 0.08 / figure.get_figheight())
    axes, beside = list(figure.axes[:5]), list(figure.axes[-5:])
    if realtime:
        draw_timing(figure.axes[5], scenario.tick_s, realtime)
    distance = _column(axes, scenario, network, signals)
    _speed(axes[4], signals)
    if near is not None:
        _column(beside, scenario, network, signals[near])
        for axis in beside:
            axis.yaxis.tick_right()
            axis.tick_params(axis="y", labelsize=8)
            legend = axis.get_legend()
            for text in (*axis.texts, *([] if legend is None else [legend])):
                text.remove()  # the panel at the left has the same
        beside[4].ticklabel_format(axis="x", useOffset=False)
        beside[4].locator_params(axis="x", prune="lower")  # where the panel at the left ends
        beside[4].set_xlabel("around the fault, time in s")
    output, *commands = names
    for axis, name, unit in zip(
        axes,
        (_output_name(scenario, names), distance, *(each.name for each in commands),
         "fault estimate"),
        (output.unit, output.unit, *(each.unit for each in commands), output.unit),
        strict=True,
    ):  # fmt: skip
        axis.set_ylabel(style.labelled(name, unit), fontsize=9)
    axes[4].set_xlabel("time in s")
    for line in (line for axis in figure.axes for line in axis.lines):
        if np.size(line.get_xdata()) == 1:  # a run of one tick
            line.set_marker("o")
    figure.align_ylabels(axes)
    return figure


def around_the_fault(scenario: Scenario, signals: Signals) -> slice | None:
    """The ticks around the begin of the first fault within the run; None without a fault."""
    begins = [fault.at_s for fault in scenario.faults]
    if not begins or not len(signals) or not signals.time_s[0] <= min(begins) < signals.time_s[-1]:
        return None
    first, last = np.searchsorted(signals.time_s, [min(begins) - BEFORE_S, min(begins) + AFTER_S])
    return slice(int(first), int(last))


def _column(axes: list[Axes], scenario: Scenario, network: Network, signals: Signals) -> str:
    """Draw the five panels of ``signals``; return the name of the second."""
    names = names_of(scenario.plant)
    beside, label, distance = compared_with(scenario, signals)
    for axis in axes:
        style.ruled(axis)
    _time_axis(axes, scenario, signals)
    _output(axes[0], scenario, names, signals, (beside, label))
    size = apart(beside, signals, scenario)
    _distance(axes[1], signals.time_s, size, network.feedback.lsb)
    _commands(axes[2:4], scenario, signals)
    _estimate(axes[4], signals)
    style.mark_faults(axes, scenario)
    return distance


def _empty_page(title_in: float, timed: bool, zoomed: bool) -> Figure:
    """Five panels over one time axis below the title; a panel for the timing; five beside."""
    height_in, timing_in = (HEIGHT_WITH_TIMING_IN, TIMING_IN) if timed else (HEIGHT_IN, 0.0)
    figure = style.page(height_in, constrained=False)
    left_right = LEFT_IN, RIGHT_IN + zoomed * ZOOM_LABEL_IN
    grid = figure.add_gridspec(
        5,
        2 if zoomed else 1,
        **style.margins(height_in, *left_right, title_in + LABEL_IN, BOTTOM_IN + timing_in),
        height_ratios=(1.25, 1, 1, 1, 1),
        width_ratios=(2, 1) if zoomed else (1,),
        hspace=0.2,
        wspace=0.06,
    )
    _shared(figure, grid, 0)
    if timed:
        top_in = height_in - timing_in + LABEL_IN / 2.0
        around = style.margins(height_in, *left_right, top_in, BOTTOM_IN)
        figure.add_subplot(figure.add_gridspec(1, 1, **around)[0])
    if zoomed:
        _shared(figure, grid, 1)
    return figure


def _shared(figure: Figure, grid: GridSpec, column: int) -> None:
    """Five panels over one time axis."""
    first = figure.add_subplot(grid[0, column])
    panels = [first, *(figure.add_subplot(grid[row, column], sharex=first) for row in range(1, 5))]
    for axis in panels[:-1]:
        axis.tick_params(labelbottom=False)


def compared_with(scenario: Scenario, signals: Signals) -> tuple[FloatArray, str, str]:
    """The curve drawn beside D*, its name, and the name of the rms distance from D*."""
    if scenario.design.feedback:
        return signals.reference_mps2, "reference", "error, rms"
    return fault_free(scenario, signals).dstar_mps2, "without the fault", "deviation, rms"


RMS_S: Final = 0.05
"""Time over which the rms of a distance is taken: longer than noise, shorter than a reaction."""

RMS_TICKS: Final = 10
"""As many ticks at least; a sensor of few steps often says the reference itself."""


AT_ONCE: Final = 4096
"""Ticks whose rms is computed at once."""


def apart(beside: FloatArray, signals: Signals, scenario: Scenario) -> FloatArray:
    """(ticks,), the rms of the distance over the last ``RMS_S``; nan without a known tick.

    At least a tenth of the sensor's step.
    """
    ticks, found = max(RMS_TICKS, round(RMS_S / scenario.tick_s)), paged.empty(len(signals))
    least = 0.1 * scenario.plant.sensor.resolution_mps2
    for begin in range(0, len(signals), AT_ONCE):
        some = slice(max(begin - ticks, 0), min(begin + AT_ONCE, len(signals)))
        with np.errstate(over="ignore", invalid="ignore"):  # a loop that diverges
            square = np.square(beside[some] - signals.dstar_mps2[some])
            known = np.isfinite(square)
            total = np.cumsum(np.where(known, square, 0.0))
            total[ticks:] -= total[:-ticks].copy()
            count = np.cumsum(known)
            count[ticks:] -= count[:-ticks].copy()
            rms = np.sqrt(np.maximum(total, 0.0) / np.where(count, count, np.nan))
        found[begin : some.stop] = np.maximum(rms[begin - some.start :], least)
    return found


def _output_name(scenario: Scenario, names: Names) -> str:
    falsified = any(fault.place == SENSOR for fault in scenario.faults)
    return names.output.name + (" as measured" if falsified else "")


def _output(
    axis: Axes, scenario: Scenario, names: Names, signals: Signals, beside: tuple[FloatArray, str]
) -> None:
    """D* wide, the compared curve dashed, D* without compensation thin."""
    time_s, (values, label) = signals.time_s, beside
    own = _output_name(scenario, names)
    axis.plot(*thinned(time_s, signals.dstar_mps2), color=style.BLUE, lw=2.0, alpha=0.75, label=own)
    axis.plot(*thinned(time_s, values), color=style.INK, lw=1.1, ls=style.DASHED, label=label)
    style.include_zero(axis, signals.dstar_mps2)
    after = windows(scenario, signals).after
    other = counterpart(scenario, names, signals) if after.any() else None
    if other is not None:
        thin, label = other
        first = int(np.argmax(after))
        from_then_on = thinned(time_s[first:], thin[first:])
        style.reach_for(axis, from_then_on[1])
        axis.plot(*from_then_on, color=style.ORANGE, lw=0.95, label=label)
    style.legend_above(axis, "left", raised=0.1)


def counterpart(
    scenario: Scenario, names: Names, signals: Signals
) -> tuple[FloatArray, str] | None:
    """D* of the same run without compensation, or the D* hidden by a faulty sensor."""
    if not any(fault.loses_a_channel for fault in scenario.faults):
        output = paged.column(len(signals), lambda rows: output_of_car(scenario, signals[rows]))
        return output, f"{names.output.name} itself"
    if scenario.design.compensation == "off":
        return None
    return uncompensated(scenario, signals).dstar_mps2, f"{names.output.name} without compensation"


def _distance(axis: Axes, time_s: FloatArray, values: FloatArray, floor: float) -> None:
    """Magnitudes in decades, from the least on, at least the resolution of the frame."""
    time_s, size = thinned(time_s, values)
    if np.isfinite(size).any():
        floor = max(floor, 0.3 * float(np.nanmin(size)))
    size = np.maximum(size, floor)
    with np.errstate(over="ignore", invalid="ignore"):
        axis.plot(time_s, size, color=style.BLUE, lw=0.8)
        style.logarithmic(axis, size, floor)


def _commands(axes: list[Axes], scenario: Scenario, signals: Signals) -> None:
    """Both commands; for a failing channel, also the applied command."""
    names, lost = names_of(scenario.plant), []
    if windows(scenario, signals).after.any():
        lost = [names.hit_by(fault) for fault in scenario.faults if fault.loses_a_channel]
    commanded = (signals.torque_nm, signals.force_difference_n)
    for axis, name, command, applied in zip(
        axes, names[1:], commanded, applied_commands(scenario, signals), strict=True
    ):
        curve = thinned(signals.time_s, command)
        if any(name is each for each in lost):
            acting = thinned(signals.time_s, applied)
            axis.plot(*curve, color=style.PALE_ORANGE, lw=2.4, label="commanded")
            axis.plot(*acting, color=style.ORANGE, lw=1.0, label="applied")
            style.legend_above(axis)
        else:
            axis.plot(*curve, color=style.ORANGE, lw=1.0)
        style.clip_spikes(axis, *curve, name.unit)
    _control_authority(axes[1], scenario)


def _control_authority(axis: Axes, scenario: Scenario) -> None:
    """The limit of actuator and tires, if X_diff as drawn comes near."""
    authority = control_authority(at_speed_of(scenario, scenario.loss))
    low, high = axis.get_ylim()
    if authority is None or max(-low, high) < 0.5 * authority.available_n:
        return
    level = math.copysign(authority.available_n, low + high)
    axis.axhline(level, color=style.INK, lw=0.9, ls=style.DOTTED, label="limit: actuator, tires")
    axis.set_ylim(min(low, 1.1 * level), max(high, 1.1 * level))
    style.legend_above(axis)


def _estimate(axis: Axes, signals: Signals) -> None:
    """d̂, and the moment of the confirmed loss."""
    curve = thinned(signals.time_s, signals.fault_estimate_mps2)
    axis.plot(*curve, color=style.GREEN, lw=1.2)
    confirmed = np.flatnonzero(signals.fault_state == FaultState.CONFIRMED)
    if len(confirmed):
        at_s = float(signals.time_s[confirmed[0]])
        axis.axvline(at_s, color=style.INK, lw=0.9, ls=style.DOTTED, label="loss confirmed")
        style.legend_above(axis)
    style.include_zero(axis, curve[1])


def _speed(axis: Axes, signals: Signals) -> None:
    """A changing speed, with its own scale at the right."""
    speed = signals.plant.get(SPEED)
    if speed is None or not len(speed):
        return
    own = axis.twinx()
    own.plot(*thinned(signals.time_s, speed), color=style.INK, lw=0.9, ls=style.DASHED)
    own.set_ylim(0.0, 1.15 * float(speed.max()) or 1.0)  # a car that stands
    own.tick_params(axis="y", direction="in", pad=-16, labelsize=7)
    own.yaxis.set_major_locator(MaxNLocator(4, prune="lower"))
    for label in own.get_yticklabels():  # over the curves
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5})
    own.annotate(
        "speed in m/s, dashed", (0.0, 1.0), (4, 4), xycoords="axes fraction",
        textcoords="offset points", fontsize=8, annotation_clip=False,
    )  # fmt: skip


def _time_axis(axes: list[Axes], scenario: Scenario, signals: Signals) -> None:
    if len(signals):
        span_s = float(signals.time_s[0]), float(signals.time_s[-1]) + scenario.tick_s
    else:
        span_s = 0.0, scenario.duration_s
        axes[0].text(0.5, 0.5, "no tick on record", transform=axes[0].transAxes, ha="center")
    for axis in axes:
        axis.set_xlim(*span_s)


def draw_timing(axis: Axes, tick_s: float, realtime: dict[str, Any]) -> None:
    """Two histograms side by side over logarithmic bins of time, and the tick that limits both.

    Args:
        axis: the panel.
        tick_s: the tick.
        realtime: see ``Timing.as_dict``.
    """
    for key, label, color, shift in (
        ("wake_up_lateness_us", "wake-up lateness", BLUE, -0.2),
        ("answer_after_us", "answer after", ORANGE, 0.2),
    ):
        counts, edges = realtime[key]["counts"], realtime[key]["edges_us"]
        axis.bar(np.arange(len(counts)) + shift, counts, 0.4, color=color, label=label)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_ylim(bottom=0.0)
    axis.set_xticks(np.arange(len(edges)) - 0.5, [f"{edge:g}" for edge in edges])
    at = float(np.interp(tick_s * 1e6, edges, np.arange(len(edges)))) - 0.5
    axis.axvline(at, color=INK, lw=0.8, ls=DASHED, label="one tick")
    axis.set_xlabel("time in µs, lower edge of the bin")
    axis.set_ylabel("ticks")
    axis.grid(axis="y", alpha=0.3, lw=0.5)
    legend_above(axis)
