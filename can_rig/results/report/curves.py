"""The curves of a run as a page for a browser has them: panels, and their numbers packed."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from can_rig import paged
from can_rig.drawing import style
from can_rig.drawing.names import names_of, printed
from can_rig.frames.network import Network
from can_rig.logs.columns import SPEED, TRUE_OUTPUT
from can_rig.results.applied import applied_commands
from can_rig.results.report.page import apart, compared_with, counterpart
from can_rig.results.signals import Signals
from can_rig.scenario.settings import Scenario
from firmware_model.target.structs import FloatArray

MOST_POINTS: Final = 100_000
"""Of a curve; of a longer run the least and the greatest value of equal parts are drawn."""


@dataclass(frozen=True)
class Curve:
    """One line of a panel; ``values`` are what ``extremes`` leaves of those of the ticks."""

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
    """Those of ``report.png``, and the state of the controller."""

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
    """Panels as JSON has them; ``data`` are their numbers in single precision, deflated.

    First the time, in double precision, then each curve; see ``report.js``.
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
    """Of which the least and the greatest value are drawn, in a run of so many ticks."""
    return -(-2 * ticks // MOST_POINTS) if ticks > MOST_POINTS else 1


def extremes(values: FloatArray, ticks: int) -> FloatArray:
    """The least and the greatest of each ``ticks`` values, in this order; all of them for 1.

    nan where all of a part are.
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
    """Where ``extremes`` are drawn: the start and the middle of each part."""
    if ticks == 1:
        return time_s
    starts = time_s[::ticks]
    half = 0.5 * ticks * (time_s[1] - time_s[0])
    return np.stack([starts, starts + half], axis=1).ravel()
