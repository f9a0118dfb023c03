"""What the page needs before the first row: curves, charts, and faults with the plant's names."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from can_rig.drawing.names import HOW, NUMBERS, Names, in_words, names_of, with_unit
from can_rig.frames import operator_frames
from can_rig.frames.network import Network
from can_rig.plant.faults.injection import Injection, kinds_of, sizes_of
from can_rig.results.curves import charts_of, curves_of
from can_rig.results.motion import dead_of, setting_of
from can_rig.scenario.fault_settings import CHANNELS, PLACES, SENSOR, SWAPPED, key_of
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario

MOVED_BY: Final = 2.0
"""Largest shift of the reference, in amplitudes of the scenario's reference."""


def setup(scenario: Scenario, network: Network, confirm: float | None) -> dict[str, Any]:
    """Curves, charts, faults and the range of the reference's shift, for JSON.

    Args:
        scenario: the run.
        network: the frames.
        confirm: the evidence that confirms a loss; None: the controller has no evidence.
    """
    names = names_of(scenario.plant)
    curves, charts = curves_of(names, network, confirm), charts_of(names, confirm)
    amplitude = float(np.nanmax(np.abs(reference(scenario)), initial=0.0)) or 1.0
    return {
        "curves": [asdict(curve) for curve in curves],
        "charts": [asdict(chart) for chart in charts],
        "confirm": confirm,
        "places": _places(scenario, names),
        "quick": _quick(names),
        "moved_by": float(f"{MOVED_BY * amplitude:.2g}"),
        "output": names.output._asdict(),
        "scene": setting_of(scenario),
        "dead": dead_of(scenario),
    }


def _places(scenario: Scenario, names: Names) -> list[dict[str, Any]]:
    """Every place that can fail, with the faults of the place."""
    its = [each.measures for each in scenario.sensors]
    return [
        {
            "place": place,
            "words": f"{names.at(place).name}{'' if place in CHANNELS else ' sensor'}",
            "kinds": list(_kinds(place, names.at(place).unit, its)),
        }
        for place in (*PLACES, *its)
    ] + _world(scenario)


def _world(scenario: Scenario) -> list[dict[str, Any]]:
    """The disturbances that can push the plant, as one more place; none without any."""
    kinds = []
    for kind in kinds_of(operator_frames.WORLD):
        some = operator_frames.Command("INJECT", kind, operator_frames.WORLD, 0.5)
        if Injection(scenario).inject(some, 0):
            words, unit = ("factor", "") if kind == "friction" else in_words(sizes_of(kind)[0])
            kinds.append(
                {"kind": kind, "words": kind.replace("-", " "), "value": with_unit(words, unit)}
            )
    words = "wind and road" if scenario.plant.is_car else "disturbance"
    return [{"place": operator_frames.WORLD, "words": words, "kinds": kinds}] if kinds else []


def _kinds(place: str, unit: str, sensors: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The faults of a place; two swapped sensors are a fault for each other sensor."""
    for kind in kinds_of(place):
        how = kind.removeprefix("actuator-" if place in CHANNELS else "sensor-").replace("-", " ")
        if kind == SWAPPED:
            for other in sensors:
                if other != place:
                    pair = f"{how} with the {other.replace('-', ' ')}"
                    number = operator_frames.places().index(other)
                    yield {"kind": kind, "words": pair, "value": None, "number": number}
            continue
        value = None
        if key := key_of(kind, place):
            name, its_unit, _ = NUMBERS[key]
            value = with_unit(name, its_unit.format(unit=unit))
        yield {"kind": kind, "words": how, "value": value}


def _quick(names: Names) -> list[dict[str, Any]]:
    """The faults of one click."""
    output, *commands = (signal.name for signal in names)
    lost = HOW["actuator-dead"]
    return [
        *(
            {"words": f"{name} {lost}", "kind": "actuator-dead", "place": place, "value": 0}
            for name, place in zip(commands, CHANNELS, strict=True)
        ),
        {
            "words": f"half of {commands[0]} {lost}",
            "kind": "actuator-dead",
            "place": CHANNELS[0],
            "value": 0.5,
        },
        {"words": f"{output} sensor biased", "kind": "sensor-biased", "place": SENSOR},
    ]
