"""The look of every picture: few colours, of different greys in print, few dashes; scales."""

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from can_rig.drawing.names import fault_label, names_of, printed
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import FloatArray

INK: Final = "#1b1b1b"
BLUE, ORANGE, GREEN = "#0b4f8a", "#b8461a", "#2f7d4f"
PALE_BLUE, PALE_ORANGE = "#a9bccd", "#e3b49c"
"""Wide curves below dark curves."""
SHADE: Final = "#efe9e2"
"""Shade of a fault's time."""
SKY: Final = "#bcd9e880"
"""Shade of a disturbance's time, transparent above a fault's."""

DASHED: Final = (0, (4, 3))
DOTTED: Final = (0, (1, 2))
DASH_DOTTED: Final = (0, (6, 2, 1, 2))

SERIES: Final[tuple[dict[str, Any], ...]] = (
    {"color": BLUE, "lw": 1.6},
    {"color": ORANGE, "lw": 1.2, "ls": DASHED},
    {"color": GREEN, "lw": 1.2, "ls": DOTTED},
    {"color": INK, "lw": 1.0, "ls": DASH_DOTTED},
)
"""Styles of curves with equal rank in a panel."""

A4_WIDTH_IN: Final = 8.27
COLUMN_WIDTH_IN: Final = 6.9
"""Of a picture between the margins of a page."""


def page(height_in: float, width_in: float = A4_WIDTH_IN, constrained: bool = True) -> Figure:
    """An empty page, drawn without a display.

    Args:
        height_in: its height in inches.
        width_in: its width in inches.
        constrained: matplotlib finds the margins, which takes as long as drawing everything.
    """
    figure = Figure(figsize=(width_in, height_in), layout="constrained" if constrained else None)
    FigureCanvasAgg(figure)
    return figure


def margins(
    height_in: float, left_in: float, right_in: float, top_in: float, bottom_in: float
) -> dict[str, float]:
    """The margins of a grid on an A4 page of this height, in shares of the page."""
    return {
        "left": left_in / A4_WIDTH_IN, "right": 1.0 - right_in / A4_WIDTH_IN,
        "top": 1.0 - top_in / height_in, "bottom": bottom_in / height_in,
    }  # fmt: skip


def ruled(axis: Axes) -> None:
    """A faint grid, and curves from edge to edge."""
    axis.grid(alpha=0.3, lw=0.5)
    axis.margins(x=0.0, y=0.08)


def labelled(name: str, unit: str) -> str:
    """The label of an axis: the name, and the unit below."""
    return f"{name}\nin {printed(unit)}" if unit else name


def in_a_line(name: str, unit: str) -> str:
    """A name with the unit."""
    return plain(f"{name} in {printed(unit)}" if unit else name)


def plain(text: str) -> str:
    """A text of the user, in which $ begins no formula."""
    return text.replace("$", r"\$")


def legend_above(axis: Axes, side: Literal["left", "right"] = "right", raised: float = 0.0) -> None:
    """The legend above the panel, clear of curves.

    ``raised`` is a share of the panel's height.
    """
    axis.legend(
        loc="lower left" if side == "left" else "lower right",
        bbox_to_anchor=(0.0 if side == "left" else 1.0, 1.0 + raised),
        ncols=4,
        frameon=False,
        fontsize=9,
        borderpad=0.2,
        borderaxespad=0.0,
        columnspacing=1.5,
    )


def shade_all(axis: Axes, scenario: Scenario | None) -> None:
    """Shade the times of all faults and disturbances that the axis shows; a line where each begins.

    A log without a scenario has no known faults.
    """
    low, high = axis.get_xlim()
    for each in () if scenario is None else scenario.spells:
        start_s = max(low, each.at_s)
        if each.at_s < high and each.end_s > low:
            color = SHADE if isinstance(each, FaultSettings) else SKY
            axis.axvspan(start_s, min(high, each.end_s), color=color, lw=0, zorder=0)
            axis.axvline(start_s, color=INK, lw=0.8, zorder=1)


def mark_faults(axes: Sequence[Axes], scenario: Scenario) -> None:
    """Shade the times, and name each fault above the first panel; several by their numbers."""
    low, high = axes[0].get_xlim()
    several, names = len(scenario.faults) > 1, names_of(scenario.plant)
    for axis in axes:
        shade_all(axis, scenario)
    for number, fault in enumerate(scenario.faults, 1):
        if not (fault.at_s < high and fault.end_s > low):
            continue
        start_s = max(low, fault.at_s)
        late = start_s > low + 0.8 * (high - low)
        axes[0].annotate(
            str(number) if several else fault_label(fault, names),
            (start_s, 1.0),
            (-4 if late else 4, 4),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            ha="right" if late else "left",
            fontsize=9,
            annotation_clip=False,
        )


FAR: Final = 3.0
"""Curves that reach this many times further than the panel do not set its scale."""


def include_zero(axis: Axes, values: FloatArray) -> None:
    """Let the axis begin or end at zero at least."""
    if np.isfinite(values).any():
        axis.update_datalim([(axis.dataLim.x0, 0.0)])
        axis.autoscale_view()


def reach_for(axis: Axes, values: FloatArray) -> None:
    """Widen the limits for ``values``, except for remote values."""
    low, high = axis.get_ylim()
    finite, span = values[np.isfinite(values)], high - low
    if len(finite) and np.ptp(finite) <= FAR * span:
        room = 0.05 * span
        axis.set_ylim(min(low, finite.min() - room), max(high, finite.max() + room))
    else:
        axis.set_ylim(low, high)


def clip_spikes(axis: Axes, time_s: FloatArray, values: FloatArray, unit: str) -> None:
    """Write a spike of a few samples on the axis instead of letting it set the scale."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return
    include_zero(axis, values)
    largest = float(np.abs(finite).max())
    if largest == 0.0:
        axis.set_ylim(-1.0, 1.0)
        return
    low, high = min(0.0, np.quantile(finite, 0.005)), max(0.0, np.quantile(finite, 0.995))
    span = high - low
    if largest <= FAR * span or span == 0.0:
        return
    axis.set_ylim(low - 0.25 * span, high + 0.25 * span)
    at = int(np.nanargmax(np.abs(values)))
    spike = f"{float(f'{values[at]:.3g}'):g} {printed(unit)}".rstrip()
    axis.text(
        0.0, 1.03, f"peak {spike} at {time_s[at]:g} s",  # beside a legend
        transform=axis.transAxes, fontsize=9,
    )  # fmt: skip


def logarithmic(axis: Axes, size: FloatArray, floor: float) -> None:
    """Decades from ``floor`` to above 1 and the largest of ``size``."""
    axis.set_yscale("log")
    largest = float(np.nanmax(size)) if np.isfinite(size).any() else 1.0
    axis.set_ylim(0.7 * floor, max(1.0, 3.0 * largest))
    axis.yaxis.set_major_formatter(FuncFormatter(_as_power))
    axis.yaxis.set_major_locator(LogLocator(100.0, numticks=12))
    axis.yaxis.set_minor_locator(LogLocator(10.0, numticks=24))
    axis.yaxis.set_minor_formatter(NullFormatter())


def _as_power(value: float, _place: int | None = None) -> str:
    """A power of 10, without matplotlib's parser of formulas, which takes 0.1 s to start."""
    return "10" + str(round(np.log10(value))).translate(_RAISED)


_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
