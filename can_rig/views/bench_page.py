"""A page that shows a run or a log: every signal, charts added and removed, the plant in motion."""

import html
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from can_rig.decoding.message_decoder import MessageColumns
from can_rig.decoding.trace import PROTECTION, Collected, Kinds
from can_rig.drawing import bench
from can_rig.drawing.bench import Chart, Curve, Recording, at_times, on_one_axis, recorded
from can_rig.drawing.html import page
from can_rig.drawing.names import names_of, printed
from can_rig.frames import operator_frames
from can_rig.frames.databases import load_database, shipped_dbc
from can_rig.frames.network import Network
from can_rig.logs.columns import APPLIED, EVIDENCE, SPEED, TRUE_OUTPUT
from can_rig.logs.frames import Log
from can_rig.results.curves import curves_of
from can_rig.results.report.web_page import recording
from can_rig.results.signals import Signals
from can_rig.scenario.build import dbc_of
from can_rig.scenario.settings import Scenario
from can_rig.views.pictures import curve as curve_of
from can_rig.views.signal_table import table_of

AT_FIRST: Final = 4
"""Charts of a log at the beginning."""

SHOWN: Final = (TRUE_OUTPUT, SPEED, *APPLIED)
"""Reports of the plant that the charts of the report have already."""

DOTTED: Final = (2, 3)
"""Dashes of a second run's curves."""

CONTROL: Final = shipped_dbc(operator_frames.DBC)

COLOURS: Final = ("blue", "orange", "green", "violet", "gold", "pink", "grey")


def recording_of_run(scenario: Scenario, network: Network, signals: Signals, log: Log) -> Recording:
    """What the page shows of a run: the charts of its report, and further signals on demand."""
    names = names_of(scenario.plant)
    of, shown = recording(scenario, network, signals), table_of(signals, "", scenario)
    of.height = 0
    states = {each.key for each, _ in of.curves if each.words and len(of.charts) >= 6}
    of.charts[:] = [chart for chart in of.charts if chart.keys[0] not in states]
    looks = {each.key: each for each in curves_of(names, network, 0.0)}
    for key in EVIDENCE:
        if key in signals.whose_fault:
            look = replace(looks[key], label=f"evidence: {looks[key].label}")
            of.curves.append((look, signals.whose_fault[key]))
    for name, values in {**signals.plant, **signals.sensors}.items():
        label, unit = shown.name_and_unit(name)
        if name not in SHOWN:
            of.curves.append((Curve(name, label, unit, COLOURS[len(of.curves) % 7]), values))
    databases = [(None, load_database(dbc, strict=False)) for dbc in (dbc_of(scenario), CONTROL)]
    first_s = float(signals.time_s[0]) if len(signals) else 0.0
    collected = Collected(Kinds(databases), log, first_s)
    for chunk in log:
        collected.take(chunk)
        if collected.is_full:
            break
    of.frames = collected.for_page()
    return of


def recording_of_log(
    messages: Mapping[str, MessageColumns], start_ns: int, frames: Collected
) -> Recording:
    """What the page shows of a log: its signals by message, at times from the log's start."""
    pairs = [(name, signal) for name, columns in messages.items() for signal in columns.signals]
    drawn = [curve_of(messages[name], signal, start_ns) for name, signal in pairs]
    some = [at for at, (time_s, _) in enumerate(drawn) if len(time_s)]
    time_s, columns = on_one_axis([drawn[at] for at in some])
    curves = []
    for at, values in zip(some, columns, strict=True):
        name, signal = pairs[at]
        layout = messages[name].layout[signal]
        words = dict(layout.choices) if layout.is_enumeration else None
        unit = printed(layout.unit or "")
        look = Curve(f"{name}.{signal}", f"{name}.{signal}", unit, COLOURS[at % 7], words=words)
        curves.append((look, values))
    first = [each for each, _ in curves if each.key.partition(".")[2] not in PROTECTION]
    charts = [Chart(each.label, (each.key,)) for each in first[:AT_FIRST]]
    return Recording(time_s, curves, charts, span_gaps=True, frames=frames.for_page())


def overlaid(a: Recording, b: Recording) -> Recording:
    """The page of ``a`` with the curves of ``b`` dotted beside, the events and the cars of both.

    A signal that ``a`` lacks, or has with another name or unit, becomes a curve of its own.
    """
    time_s = np.union1d(a.time_s, b.time_s)
    said = {(curve.key, curve.label, curve.unit) for curve, _ in a.curves}
    both = {curve.key for curve, _ in b.curves if (curve.key, curve.label, curve.unit) in said}
    curves = []
    for curve, values in a.curves:
        beside = f"b:{curve.key}" if curve.key in both else ""
        curves.append((replace(curve, beside=beside), at_times(time_s, a.time_s, values)))
    for curve, values in b.curves:
        look = replace(curve, key=f"b:{curve.key}", label=f"B: {curve.label}", dash=DOTTED)
        curves.append((look, at_times(time_s, b.time_s, values)))
    charts = [
        replace(chart, keys=(*chart.keys, *(f"b:{key}" for key in chart.keys if key in both)))
        for chart in a.charts
    ]
    of_b = [{**mark, "text": f"B: {mark['text']}"} for mark in b.marks]
    marks = sorted([*a.marks, *of_b], key=lambda mark: float(mark["time_s"]))
    gaps = a.span_gaps or len(time_s) > max(len(a.time_s), len(b.time_s))
    return replace(
        a,
        time_s=time_s,
        curves=curves,
        charts=charts,
        marks=marks,
        span_gaps=gaps,
        scene=_two_cars(a.scene, b.scene),
    )


def _two_cars(a: dict[str, Any] | None, b: dict[str, Any] | None) -> dict[str, Any] | None:
    """The scene of ``a``, with the car of ``b`` as the other car."""
    if a is None or b is None or not a["kind"] == b["kind"] == "car":
        return a
    own, its = a["columns"], b["columns"]
    track = {
        f"other_{name}": np.interp(own["time"], its["time"], its[name])
        for name in ("x", "y", "heading")
    }
    return {**a, "other": "B", "columns": {**own, **track}}


def page_of(title: str, of: Recording) -> str:
    """The page, in HTML."""
    canvas, charts, events, *scripts = recorded(of)
    return page(
        title,
        [
            f"<h1>{html.escape(title)}</h1>",
            '<nav id="list" aria-label="signals"></nav>',
            f'<section id="view">{canvas}{charts}</section>',
            f'<section id="events">{events}</section>',
            *scripts,
        ],
        bench.text("view.css"),
    )
