"""``report.html``: the curves of a run to zoom, its metrics, events and scenario, in one file.

The page opens without network: uPlot, the numbers and the look are part of the file.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from can_rig import paged
from can_rig.drawing import bench, style
from can_rig.drawing.html import Code, page, table
from can_rig.drawing.names import Names, disturbance_label, fault_label, names_of, printed
from can_rig.frames.network import Network
from can_rig.logs.columns import SPEED, TRUE_OUTPUT, VERDICT
from can_rig.results.counterfactual import applied_commands
from can_rig.results.isolation import in_words
from can_rig.results.metrics import Metrics
from can_rig.results.report.page import apart, compared_with, counterpart, page_title
from can_rig.results.signals import Signals
from can_rig.scenario.disturbance_settings import DisturbanceSettings
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

MOST_POINTS: Final = 100_000
"""Points of a curve; longer runs show the least and the greatest value of equal parts."""


@dataclass(frozen=True)
class Curve:
    """One line of a panel; ``values`` come from ``extremes``."""

    label: str
    values: FloatArray
    color: str
    width: float = 1.2
    dash: tuple[int, ...] = ()
    stepped: bool = False


@dataclass(frozen=True)
class Panel:
    """Curves over one axis."""

    name: str
    unit: str
    curves: list[Curve]
    logarithmic: bool = False


def panels(scenario: Scenario, network: Network, signals: Signals) -> list[Panel]:
    """The panels of ``report.png``, and the state of the controller."""

    def curve(label: str, values: FloatArray, *how: Any, **more: Any) -> Curve:
        return Curve(label, extremes(values, ticks_of_a_part(len(signals))), *how, **more)

    names = names_of(scenario.plant)
    beside, label, distance = compared_with(scenario, signals)
    output = [
        curve(names.output.name, signals.dstar_mps2, style.BLUE, 2.0),
        curve(label, beside, style.INK, 1.1, (4, 3)),
    ]
    if TRUE_OUTPUT in signals.plant and not scenario.design.feedback:
        output.append(curve(f"true {names.output.name}", signals.plant[TRUE_OUTPUT], style.GREEN))
    other = counterpart(scenario, names, signals)
    if other is not None:
        output.append(curve(other[1], other[0], style.PALE_BLUE))
    size = curve(distance, apart(beside, signals), style.BLUE, 0.8)
    size = replace(size, values=np.maximum(size.values, network.feedback.lsb))
    commands = [
        Panel(
            name.name,
            printed(name.unit),
            [
                curve("commanded", command, style.PALE_ORANGE, 2.4),
                curve("applied", applied, style.ORANGE, 1.0),
            ],
        )
        for name, command, applied in zip(
            names[1:],
            (signals.torque_nm, signals.force_difference_n),
            applied_commands(scenario, signals),
            strict=True,
        )
    ]
    unit = printed(names.output.unit)
    estimate = curve("fault estimate", signals.fault_estimate_mps2, style.GREEN)
    state = [
        curve("mode", signals.mode, style.BLUE, stepped=True),
        curve("fault state", signals.fault_state, style.ORANGE, stepped=True),
    ]
    speed = signals.plant.get(SPEED)
    return [
        Panel(names.output.name, unit, output),
        Panel(distance, unit, [size], logarithmic=True),
        *commands,
        Panel("fault estimate", unit, [estimate]),
        Panel("state", "", state),
        *([] if speed is None else [Panel("speed", "m/s", [curve("speed", speed, style.INK)])]),
    ]


def packed(time_s: FloatArray, shown: list[Panel]) -> dict[str, Any]:
    """The panels for JSON; ``data`` holds the deflated numbers for ``report.js``.

    First the time in double precision, then each curve in single precision.
    """
    times = extremes_at(time_s, ticks_of_a_part(len(time_s)))
    columns = [curve.values for panel in shown for curve in panel.curves]
    raw = b"".join(
        [times.astype("<f8").tobytes(), *(column.astype("<f4").tobytes() for column in columns)]
    )
    return {
        "points": len(times),
        "panels": [
            {
                "name": panel.name,
                "unit": panel.unit,
                "log": panel.logarithmic,
                "curves": [
                    {
                        "label": curve.label,
                        "color": curve.color,
                        "width": curve.width,
                        "dash": list(curve.dash),
                        "stepped": curve.stepped,
                    }
                    for curve in panel.curves
                ],
            }
            for panel in shown
        ],
        "data": base64.b64encode(zlib.compress(raw, 1)).decode("ascii"),
    }


def ticks_of_a_part(ticks: int) -> int:
    """Ticks of each part of a run with ``ticks`` ticks."""
    return -(-2 * ticks // MOST_POINTS) if ticks > MOST_POINTS else 1


def extremes(values: FloatArray, ticks: int) -> FloatArray:
    """The least and the greatest of each ``ticks`` values, in this order; 1 keeps every value.

    nan for a part of nan only.
    """
    if ticks == 1:
        return values
    found = [np.empty(0)]
    step = ticks * max(1, paged.BLOCK_ROWS // ticks)
    for begin in range(0, len(values), step):
        block = values[begin : begin + step]
        parts = np.pad(block, (0, -len(block) % ticks), constant_values=np.nan).reshape(-1, ticks)
        known = ~np.isnan(parts)
        least = np.where(known, parts, np.inf).min(axis=1)
        greatest = np.where(known, parts, -np.inf).max(axis=1)
        both = np.stack([least, greatest], axis=1)
        both[~known.any(axis=1)] = np.nan
        found.append(both.ravel())
        paged.let_go()
    return np.concatenate(found)


def extremes_at(time_s: FloatArray, ticks: int) -> FloatArray:
    """The times of ``extremes``: start and middle of each part."""
    if ticks == 1:
        return time_s
    starts = time_s[::ticks]
    half = 0.5 * ticks * (time_s[1] - time_s[0])
    return np.stack([starts, starts + half], axis=1).ravel()


class Event(NamedTuple):
    """A moment, with its description."""

    time_s: float
    text: str


def events(scenario: Scenario, network: Network, signals: Signals) -> list[Event]:
    """Faults and disturbances from begin to end, and each change of the state, in time order."""
    names = names_of(scenario.plant)
    end_s = float(signals.time_s[-1]) + scenario.tick_s if len(signals) else 0.0
    found: list[Event] = []
    from_outside: list[tuple[str, FaultSettings | DisturbanceSettings, str]] = [
        *(("fault", each, fault_label(each, names)) for each in scenario.faults),
        *(("disturbance", each, disturbance_label(each)) for each in scenario.disturbances),
    ]
    for noun, each, label in from_outside:
        if each.at_s < end_s:
            found.append(Event(each.at_s, f"{noun} begins: {label}"))
        if each.for_s is not None and each.at_s + each.for_s < end_s:
            found.append(Event(each.at_s + each.for_s, f"{noun} ends: {label}"))
    found += _changes("mode", signals.time_s, signals.mode, network.status.modes)
    states = network.status.fault_states
    found += _changes("fault state", signals.time_s, signals.fault_state, states)
    if VERDICT in signals.whose_fault:
        words = {int(verdict): in_words(verdict, names) for verdict in Verdict}
        found += _changes("whose fault", signals.time_s, signals.whose_fault[VERDICT], words)
    return sorted(found, key=lambda event: event.time_s)


def _changes(
    name: str, time_s: FloatArray, codes: FloatArray, words: Mapping[int, str]
) -> Iterator[Event]:
    last = np.nan
    for rows in paged.blocks(len(codes)):
        known = rows.start + np.flatnonzero(np.isfinite(codes[rows]))
        changed = np.flatnonzero(np.diff(codes[known], prepend=last) != 0.0)
        for row in known[changed].tolist():
            code = int(codes[row])
            yield Event(float(time_s[row]), f"{name}: {words.get(code, code)}")
        last = codes[known[-1]] if len(known) else last


MOST_EVENTS: Final = 200
STYLE: Final = """
body { max-width: 75em; padding: 0 1em; }
#plots { position: relative; }
.uplot { margin-bottom: 0.5em; }
.hint { color: #666; font-size: 85%; }
details { margin: 1em 0; }
"""


def web_page(
    scenario: Scenario,
    network: Network,
    signals: Signals,
    values: Metrics,
    faults: list[dict[str, Any]],
    said: Scenario,
) -> str:
    """The page as text.

    Args:
        scenario: the executed scenario.
        network: the frames.
        signals: the recorded signals.
        values: the metrics of the run.
        faults: see ``fault_metrics``.
        said: the scenario of ``run.json``.
    """
    names = names_of(scenario.plant)
    title, *lines = page_title(scenario, names, signals).split("\n")
    shades = [
        {
            "label": label,
            "color": color,
            "begin": each.at_s,
            "end": None if each.for_s is None else each.at_s + each.for_s,
        }
        for label, color, each in _to_shade(scenario, names)
    ]
    drawn = packed(signals.time_s, panels(scenario, network, signals)) | {"shades": shades}
    happened = events(scenario, network, signals)
    more = len(happened) - MOST_EVENTS
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        *(f"<p>{html.escape(line)}</p>" for line in lines),
        '<p class="hint">Drag over a curve to zoom in, double-click for the whole run; a click on '
        "a name hides its curve.</p>",
        '<div id="plots"></div>',
        "<h2>Metrics</h2>",
        table(("", "value"), _known(values)),
        *_of_faults(faults),
        "<h2>Events</h2>",
        table(("time in s", ""), happened[:MOST_EVENTS]),
        f"<p>and {more} more</p>" if more > 0 else "",
        "<details><summary>Scenario</summary>",
        table(("key", "value"), _leaves(said.as_dict())),
        "</details>",
        f'<script type="application/json" id="run">{_in_a_script(drawn)}</script>',
        f"<script>{bench.text('uPlot.iife.min.js')}</script>",
        f"<script>{_own_script()}</script>",
    ]
    return page(title, parts, bench.text("uPlot.min.css") + STYLE)


def _to_shade(
    scenario: Scenario, names: Names
) -> Iterator[tuple[str, str, FaultSettings | DisturbanceSettings]]:
    """Label and color of every fault and disturbance."""
    for fault in scenario.faults:
        yield fault_label(fault, names), style.SHADE, fault
    for disturbance in scenario.disturbances:
        yield disturbance_label(disturbance), style.SKY, disturbance


def _of_faults(faults: list[dict[str, Any]]) -> Iterator[str]:
    if not faults:
        return
    yield "<h2>Faults</h2>"
    columns = [fault.values() for fault in faults]
    rows = zip(faults[0], *columns, strict=True)
    heads = ("", *(str(number) for number in range(len(faults))))
    yield table(heads, ([_shown(cell) for cell in row] for row in rows))


def _known(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    yield from ((key, value) for key, value in values.items() if value is not None)


def _shown(value: Any) -> Any:
    return "" if value is None else value


def _leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Every set key of the scenario."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            numbered = {str(number): each for number, each in enumerate(value)}
            yield from _leaves(numbered, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", Code(value) if isinstance(value, str) else value


def _in_a_script(values: dict[str, Any]) -> str:
    """JSON that cannot end the surrounding element."""
    return json.dumps(values, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


@cache
def _own_script() -> str:
    return Path(__file__).with_name("report.js").read_text(encoding="utf-8")
