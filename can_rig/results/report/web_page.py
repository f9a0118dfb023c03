"""``report.html``: the curves of a run to zoom, its metrics, events and scenario, in one file.

It opens without network: uPlot, the numbers and the look are in it.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from can_rig.drawing import style, uplot
from can_rig.drawing.fault_words import disturbance_label, fault_label
from can_rig.drawing.html import Code, page, table
from can_rig.drawing.names import Names, names_of
from can_rig.frames.network import Network
from can_rig.results.metrics import Metrics
from can_rig.results.report.curves import packed, panels
from can_rig.results.report.events import events
from can_rig.results.report.title import page_title
from can_rig.results.signals import Signals
from can_rig.scenario.disturbance_settings import DisturbanceSettings
from can_rig.scenario.fault_settings import FaultSettings
from can_rig.scenario.settings import Scenario

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
        scenario: what ran.
        network: its frames.
        signals: what was recorded.
        values: the metrics of the run.
        faults: of each fault; see ``fault_metrics``.
        said: the scenario as ``run.json`` has it.
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
        f"<script>{uplot.script()}</script>",
        f"<script>{_own_script()}</script>",
    ]
    return page(title, parts, uplot.style() + STYLE)


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
    """Every key of the scenario that is set."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            numbered = {str(number): each for number, each in enumerate(value)}
            yield from _leaves(numbered, f"{prefix}{key}.")
        elif value is not None:
            yield f"{prefix}{key}", Code(value) if isinstance(value, str) else value


def _in_a_script(values: dict[str, Any]) -> str:
    """JSON that cannot end the element it stands in."""
    return json.dumps(values, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")


@cache
def _own_script() -> str:
    return Path(__file__).with_name("report.js").read_text(encoding="utf-8")
