"""Plants beside the model: varying parameters, ranges, and settings of a plant in the box.

For a car, mass, both cornering stiffnesses and speed vary between cars and between days; the rest
of Table 3.1 is known. For a plant by numbers, the varying parameters are the strength of each input
(``gain_1``, ``gain_2``) and the plant's pace: the frequency of every pole and zero, at constant
damping and steady gain. Channels with separate transfer functions vary separately (``speed_1``,
``speed_2``); channels with a shared state, and unstable modes, vary together (``speed``).
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from operator import methodcaller
from typing import Any, Final

from pydantic import ValidationError

from can_rig.errors import ScenarioError
from can_rig.scenario.plant_settings import STATE_SPACE, TRANSFER_FUNCTIONS, PlantSettings
from can_rig.scenario.refusal import refusal
from firmware_model.design.factors import unstable

CAR: Final = (
    "mass_kg",
    "front_cornering_stiffness_n_per_rad",
    "rear_cornering_stiffness_n_per_rad",
    "speed_mps",
)
FACTORS: Final = {
    TRANSFER_FUNCTIONS: ("gain_1", "gain_2", "speed_1", "speed_2"),
    STATE_SPACE: ("gain_1", "gain_2", "speed"),
}
"""Factors on the given plant, 1 at the centre, by kind."""


@contextmanager
def plant_of_box(place: str, remedy: str) -> Iterator[None]:
    """Refuse an impossible plant of a box in one line: ``place``, the fault, a smaller ``remedy``.

    Raises:
        ScenarioError: the plant within has a value out of bounds, or is refused.
    """
    try:
        yield
    except (ValidationError, ScenarioError) as error:
        reason = refusal(error, PlantSettings) if isinstance(error, ValidationError) else error
        raise ScenarioError(f"{place}: {reason}; a smaller {remedy} may help") from None


def uncertain(settings: PlantSettings) -> dict[str, float]:
    """The varying parameters, with the values in ``settings``."""
    if settings.is_car:
        return {key: float(getattr(settings, key)) for key in CAR}
    kind = settings.kind
    if kind == TRANSFER_FUNCTIONS and any(p != 0.0 for p in unstable(settings.g1.factored)):
        kind = STATE_SPACE  # a common speed keeps the modes shared
    return dict.fromkeys(FACTORS[kind], 1.0)


def with_values(settings: PlantSettings, values: Mapping[str, float]) -> PlantSettings:
    """``settings`` with other values of varying parameters, or of other parameters of a car."""
    if settings.is_car:
        changes: dict[str, Any] = dict(values)
        return replace(settings, **changes)
    gain_1, gain_2 = values.get("gain_1", 1.0), values.get("gain_2", 1.0)
    speed = values.get("speed", 1.0)
    if settings.kind == TRANSFER_FUNCTIONS:
        return replace(
            settings,
            g1=settings.g1.scaled(gain_1, values.get("speed_1", speed)),
            g2=settings.g2.scaled(gain_2, values.get("speed_2", speed)),
            gw=settings.gw.scaled(1.0, speed) if settings.gw else settings.gw,
        )
    return replace(
        settings,
        a=tuple(tuple(speed * each for each in row) for row in settings.a or ()),
        b=tuple(
            (speed * gain_1 * first, speed * gain_2 * second) for first, second in settings.b or ()
        ),
        e=None if settings.e is None else tuple(speed * each for each in settings.e),
    )


def in_box(
    settings: PlantSettings, shares: Mapping[str, float], lags: float = 0.0
) -> PlantSettings:
    """``settings`` with varying parameters and ``lags`` increased by these shares; 0.2: 20 %.

    Raises:
        ScenarioError: see ``plant_of_box``.
    """
    nominal = uncertain(settings)
    values = {key: nominal[key] * (1.0 + share) for key, share in shares.items()}
    with plant_of_box("a plant of budget.box", "box"):
        car = with_values(settings, values)
        return with_actuators(car, methodcaller("slower", 1.0 + lags)) if lags else car


def with_actuators(settings: PlantSettings, changed: Callable[[Any], Any]) -> PlantSettings:
    """``settings`` with both actuators ``changed``."""
    return replace(
        settings,
        torque_actuator=changed(settings.torque_actuator),
        force_difference_actuator=changed(settings.force_difference_actuator),
    )
