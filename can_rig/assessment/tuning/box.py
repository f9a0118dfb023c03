"""The cars that every tuning must hold: the nominal car and the vertices of a surrounding box.

The nominal car keeps the design; each vertex supplies the plant. A vertex need only be stable; the
design may be impossible for a vertex (its G1 or G2 may have zeros in the right half plane).
Vertices prove nothing about the inside of the box. The loop of this car is worst at the vertices; a
test confirms this with cars from the inside.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product

from pydantic import ValidationError

from can_rig.errors import ScenarioError
from can_rig.scenario.box import uncertain, with_lags, with_values
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.refusal import refusal
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD
from firmware_model.analysis.sampled_loop import (
    LinearController,
    SampledLoop,
    linear_controller,
    sampled_loop,
)
from firmware_model.design.plants import Plant
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.law.layout import Table

Range = tuple[float, float]
Law = tuple[LinearController, tuple[float, float]]  # and the remaining shares of the actuators
KEYS = tuple(field.name for field in dataclasses.fields(VehicleParameters))
MAX_KEYS = 8  # 256 vertices
MAX_DELAY_TICKS = 8  # largest extra delay of a counted margin


@dataclass(frozen=True)
class Car:
    """A stable plant, its settings, and its difference from the nominal car in words."""

    label: str
    plant: Plant
    settings: PlantSettings

    def steady_commands(self, dstar_mps2: float) -> tuple[float, float]:
        """|Torque| in N m and |X_diff| in N to hold ``dstar_mps2``, each channel alone."""
        size = abs(dstar_mps2)
        return size / abs(self.plant.g1.dc_gain), size / abs(self.plant.g2.dc_gain)


def parameter_ranges(
    nominal: PlantSettings, share: float, settings: Iterable[str] = ()
) -> dict[str, Range]:
    """The box: lowest and highest value of each uncertain parameter.

    Args:
        nominal: the car in its middle.
        share: largest difference of each of ``uncertain``, 0.2 for ±20 %; 0 for no difference.
        settings: ``plant.KEY=LOW..HIGH``, for these parameters or, for a car, other parameters.

    Raises:
        ScenarioError: a share outside 0..1, a setting that cannot be read, too many parameters.
    """
    if not 0.0 <= share < 1.0:
        raise ScenarioError(f"--box {share:g}: must be 0 to below 1, as in 0.2 for ±20 %")
    box: dict[str, Range] = {}
    if share > 0.0:
        for key, value in uncertain(nominal).items():
            box[key] = (value * (1.0 - share), value * (1.0 + share))
    keys = KEYS if nominal.is_car else tuple(uncertain(nominal))
    for setting in settings:
        key, _, text = setting.removeprefix("plant.").partition("=")
        low, _, high = text.partition("..")
        try:
            box[key] = (float(low), float(high))
        except ValueError:
            box[key] = (1.0, 0.0)
        if key not in keys or not box[key][0] <= box[key][1]:
            example = "plant.speed_mps=8..12" if nominal.is_car else f"plant.{keys[0]}=0.8..1.2"
            raise ScenarioError(
                f"--box-set {setting}: must be plant.KEY=LOW..HIGH, as in {example}"
            )
    if len(box) > MAX_KEYS:
        raise ScenarioError(f"box: {len(box)} parameters; must be at most {MAX_KEYS}")
    return box


def cars_of(scenario: Scenario, share: float, settings: Iterable[str] = ()) -> list[Car]:
    """The cars that every tuning of ``scenario`` must hold, including the budget's lags.

    Raises:
        ScenarioError: as ``parameter_ranges`` and ``cars``.
    """
    ranges = parameter_ranges(scenario.model, share, settings)
    return cars(scenario.model, ranges, scenario.budget.actuator_box)


def cars(nominal: PlantSettings, box: Mapping[str, Range], lag_share: float = 0.0) -> list[Car]:
    """The nominal car, then the vertices of ``box``.

    Args:
        nominal: the car in its middle.
        box: from ``parameter_ranges``.
        lag_share: largest difference of both actuators' lags, 0.3 for ±30 %.

    Raises:
        ScenarioError: an unstable car, or an impossible car.
    """
    found = [Car("the nominal car", continuous_plant(nominal), nominal)]
    lags = (lag_share,) if nominal.torque_actuator.lags and lag_share > 0.0 else ()
    corners = product(*box.values(), *((1.0 - share, 1.0 + share) for share in lags))
    for corner in corners if box or lags else ():
        values = dict(zip(box, corner, strict=False))
        label = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        try:
            settings = with_values(nominal, values)
            if lags:
                settings = with_lags(settings, corner[-1])
                label += f", lags × {corner[-1]:g}"
            found.append(Car(label, continuous_plant(settings), settings))
        except ValidationError as error:
            raise _no_car(label, refusal(error, PlantSettings)) from None
        except ScenarioError as error:
            raise _no_car(label, str(error)) from None
    return found


def _no_car(label: str, reason: str) -> ScenarioError:
    return ScenarioError(f"box: {label}: {reason}; a smaller --box or --box-set may help")


def laws(table: Table) -> tuple[Law, Law]:
    """The law and the actuators' remaining shares: healthy, and with the torque channel dead."""
    return (
        (linear_controller(table), HEALTHY),
        (linear_controller(table, confirmed=1.0), TORQUE_DEAD),
    )


def loops(table: Table, car: Car, tick_s: float) -> list[SampledLoop]:
    """The loop with ``car``, healthy and with the torque channel dead."""
    return [sampled_loop(law, car.plant, tick_s, left) for law, left in laws(table)]


def is_stable(table: Table, some: Iterable[Car], tick_s: float, spare_ticks: int) -> bool:
    """Whether all cars are stable, healthy and lost, with up to ``spare_ticks`` of extra delay.

    A false alarm must be stable too, without extra delay: a car other than the nominal car shows
    some d̂, and a table with compensation on confirmation may then compensate for a working
    channel.
    """
    healthy, lost = laws(table)
    needed = [(law, extra) for extra in range(spare_ticks, -1, -1) for law in (healthy, lost)]
    if table.compensator.on_confirmation:
        needed.append(((lost[0], HEALTHY), 0))
    return all(_is_stable(law, car, tick_s, extra) for car in some for law, extra in needed)


def delay_margin(table: Table, some: Iterable[Car], tick_s: float, known: int = -1) -> int:
    """Extra ticks of delay, up to ``MAX_DELAY_TICKS``, through which every car is stable.

    Healthy and lost; -1 for a car unstable without extra delay. All cars are known to be stable
    with ``known`` ticks.
    """
    margin, states = max(MAX_DELAY_TICKS, known), laws(table)
    for car, law in product(some, states):
        for extra in range(known + 1, margin + 1):
            if not _is_stable(law, car, tick_s, extra):
                margin = extra - 1
                break
    return margin


def _is_stable(law: Law, car: Car, tick_s: float, extra_ticks: int) -> bool:
    controller, left = law
    loop = sampled_loop(controller, car.plant, tick_s, left, extra_ticks)
    return loop.spectral_radius() < 1.0
