"""``report.html``: the curves of a run to zoom, its metrics, events and scenario, in one file.

The page opens without network: uPlot, the numbers and the look are part of the file.
"""

import html
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from can_rig.drawing.bench import Chart, Curve, Recording, recorded
from can_rig.drawing.html import Code, page, table
from can_rig.drawing.names import Names, disturbance_label, fault_label, metric_in_words, names_of
from can_rig.drawing.style import FAR
from can_rig.frames.network import Network
from can_rig.logs.columns import SPEED, TRUE_OUTPUT, VERDICT
from can_rig.results.counterfactual import applied_commands
from can_rig.results.curves import curves_of
from can_rig.results.isolation import in_words
from can_rig.results.metrics import Metrics
from can_rig.results.motion import scene
from can_rig.results.report.page import apart, compared_with, counterpart, page_title
from can_rig.results.signals import Signals
from can_rig.results.state_changes import Event, StateChanges
from can_rig.scenario.fault_settings import CHANNELS
from can_rig.scenario.settings import Scenario, leaves
from can_rig.storage import paged
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

DISTANCE: Final = "distance"
"""The curve whose chart has decades."""


def _panels(
    scenario: Scenario, network: Network, signals: Signals
) -> list[tuple[str, list[tuple[Curve, FloatArray]]]]:
    """The panels of ``report.png``, and the state of the controller: title, curves with values."""
    names = names_of(scenario.plant)
    looks = {curve.key: curve for curve in curves_of(names, network, None)}
    beside, label, distance = compared_with(scenario, signals)
    unit = names.output.unit
    output = [
        (looks["output"], signals.dstar_mps2),
        (replace(looks["reference"], label=label), beside),
    ]
    if TRUE_OUTPUT in signals.plant and not scenario.design.feedback:
        true = Curve("true_output", f"true {names.output.name}", unit, "green")
        output.append((true, signals.plant[TRUE_OUTPUT]))
    other = counterpart(scenario, names, signals)
    if other is not None:
        near = not _remote(other[0], signals.dstar_mps2)
        curve = Curve("other", other[1], unit, "orange", 1.2, (2, 2), sets_scale=near)
        output.append((curve, other[0]))
    far = apart(beside, signals, scenario)
    far = np.maximum(far, network.feedback.lsb, out=far)
    found = [
        (names.output.name, output),
        (distance, [(Curve(DISTANCE, distance, unit, "blue", 0.8), far)]),
    ]
    applied = applied_commands(scenario, signals)
    commanded = signals.torque_nm, signals.force_difference_n
    for n, pair in enumerate(zip(commanded, applied, strict=True), 1):
        keys = f"command_{n}", f"applied_{n}"
        found.append((names[n].name, [(looks[k], of) for k, of in zip(keys, pair, strict=True)]))
    found += [
        ("fault estimate", [(looks["estimate"], signals.fault_estimate_mps2)]),
        ("mode", [(looks["mode"], signals.mode)]),
        ("fault state", [(looks["fault_state"], signals.fault_state)]),
    ]
    if SPEED in signals.plant:
        found.append(("speed", [(Curve("speed", "speed", "m/s"), signals.plant[SPEED])]))
    return found


def _remote(values: FloatArray, other: FloatArray) -> bool:
    """Whether a curve reaches so far that the axis would hide the other curve."""
    reach, size = _span(values), _span(other)
    return size >= 0.0 and reach > FAR * size


def _span(values: FloatArray) -> float:
    """From the least to the greatest finite value; negative without any."""
    least, greatest = np.inf, -np.inf
    for rows in paged.blocks(len(values)):
        finite = values[rows][np.isfinite(values[rows])]
        least = min(least, finite.min(initial=np.inf))
        greatest = max(greatest, finite.max(initial=-np.inf))
    return float(greatest - least)


def recording(scenario: Scenario, network: Network, signals: Signals) -> Recording:
    """What the bench shows of a run."""
    charts, curves = [], []
    for title, pairs in _panels(scenario, network, signals):
        keys = tuple(curve.key for curve, _ in pairs)
        charts.append(Chart(title, keys, "log" if DISTANCE in keys else "linear"))
        curves += pairs
    return Recording(
        signals.time_s,
        curves,
        charts,
        [
            {"begin": each.at_s, "end": each.for_s and each.end_s, "colour": colour}
            for colour, every in (("confirmed", scenario.faults), ("sky", scenario.disturbances))
            for each in every
        ],
        [event._asdict() for event in events(scenario, network, signals)],
        scene(scenario, signals),
        CHART_HEIGHT,
    )


CHART_HEIGHT: Final = 150
"""Of a chart of the page, in pixels."""


def events(scenario: Scenario, network: Network, signals: Signals) -> list[Event]:
    """Faults and disturbances from begin to end, and each change of the state, in time order."""
    names = names_of(scenario.plant)
    end_s = float(signals.time_s[-1]) + scenario.tick_s if len(signals) else 0.0
    found: list[Event] = []
    labels = [fault_label(each, names) for each in scenario.faults]
    labels += map(disturbance_label, scenario.disturbances)
    for each, label in zip(scenario.spells, labels, strict=True):
        if each.at_s < end_s:
            found.append(Event(each.at_s, f"{each.noun} begins: {label}"))
        if each.end_s < end_s:
            found.append(Event(each.end_s, f"{each.noun} ends: {label}"))
    changes = StateChanges(names, network)
    found += changes.of("mode", signals.time_s, signals.mode)
    found += changes.of("fault state", signals.time_s, signals.fault_state)
    if VERDICT in signals.whose_fault:
        found += changes.of("whose fault", signals.time_s, signals.whose_fault[VERDICT])
    return sorted(found, key=lambda event: event.time_s)


STYLE: Final = """
.hint { color: var(--soft); }
#marks { columns: 22rem; max-height: 14rem; overflow: auto; font-variant-numeric: tabular-nums; }
@media (max-width: 800px) { #marks { max-height: none; } }
#play input { flex: 1; padding: 0; }
.key { border: 0; background: none; text-align: left; text-decoration: underline; }
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
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        *(f"<p>{html.escape(line)}</p>" for line in lines),
        '<p class="hint">Drag or turn the wheel to zoom, shift and drag to pan, double-click for '
        "the whole run, click to set a mark and read differences. A name hides its curve.</p>",
        *recorded(recording(scenario, network, signals)),
        "<h2>Metrics</h2>",
        table(("metric", "value", "unit", "key in run.json"), _in_units(_known(values), names)),
    ]
    for number, fault in enumerate(faults, 1):
        heads = ("fault", "value", "unit", "key in run.json")
        parts += [f"<h2>Fault {number}</h2>", table(heads, _in_units(_known(fault), names))]
    settings = ((k, Code(v) if isinstance(v, str) else v) for k, v in _known(leaves(said)))
    parts += ["<details><summary>Scenario</summary>", table(("key", "value"), settings)]
    parts.append("</details>")
    return page(title, parts, STYLE)


def _in_units(
    values: Iterable[tuple[str, Any]], names: Names
) -> Iterator[tuple[str, Any, str, Code]]:
    """Name, value, unit of the plant, and key of each metric."""
    for key, value in values:
        words, unit = metric_in_words(key, names)
        shown = ("no", "yes")[value] if isinstance(value, bool) else value
        shown = in_words(Verdict[value], names) if key == "verdict" else shown
        shown = names.at(value).name if key == "place" and value in CHANNELS else shown
        yield words, shown, unit, Code(key)


def _known(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    yield from ((key, value) for key, value in values.items() if value is not None)
