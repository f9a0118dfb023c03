"""Refused tunings counted by reason, and the most helpful change."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum

from can_rig.assessment.tuning.box import Car
from can_rig.drawing.names import names_of, with_unit
from can_rig.errors import ScenarioError
from can_rig.scenario.plant_settings import PlantSettings
from can_rig.scenario.settings import Scenario


class Refusal(StrEnum):
    """The first test that a tuning fails, in the order of the tests."""

    DESIGN = "no such design, or none that can be discretised"
    NOMINAL = "unstable with the nominal {car}"
    NOMINAL_SPARE = "unstable with the nominal {car}, only because of the ticks to spare"
    THIN = "the peak |S| above budget.peak_sensitivity with the nominal {car}"
    NOISE = "noise in a command without bound"
    TORQUE_NOISE = "{first} noise above --torque-noise-limit"
    FORCE_NOISE = "{second} noise above --noise-limit"
    TRANSIENT = "the transient after the loss does not decay with the nominal {car}"
    BOX = "unstable with a {car} of the box"
    BOX_SPARE = "unstable with a {car} of the box, only because of the ticks to spare"
    FALSE_ALARM = "a {car} of the box is taken for one that has lost {first_said}"
    REST_SPARE = "a {car} of the box does not come to rest, only because of the ticks to spare"
    REST = "a {car} of the box does not come to rest"
    BOTH_LIMITS = "a {car} of the box does not come to rest because of the limits of both commands"
    TORQUE_LIMIT = "a {car} of the box does not come to rest because of the limit of {first_said}"
    FORCE_LIMIT = "a {car} of the box does not come to rest because of the limit of {second}"

    def text(self, plant: PlantSettings) -> str:
        """In the words of ``plant``."""
        _, first, second = names_of(plant)
        return str(self).format(
            car=plant.noun,
            first=first.short,
            first_said=first.said,
            second=second.short,
        )


class NoTuningError(ScenarioError):
    """No tuning passes every test.

    Attributes:
        refusals: how many fail each test; ``rows`` in words, in the order of the tests.
        advice: which change would help most.
    """

    exit_status = 1

    def __init__(self, scenario: Scenario, refusals: Counter[Refusal], advice: str) -> None:
        self.refusals = refusals
        self.rows = [
            (reason.text(scenario.plant), refusals[reason])
            for reason in Refusal
            if refusals[reason]
        ]
        self.advice = advice
        tried = refusals.total()
        most, count = refusals.most_common(1)[0]
        super().__init__(
            f"scenario {scenario.name}: none of {tried} tunings passes; {count}: "
            f"{most.text(scenario.plant)}; {advice}"
        )


def refusals_as_dict(refusals: Counter[Refusal]) -> dict[str, int]:
    """For JSON: numbers by the names of the reasons."""
    return {reason.name.lower(): refusals[reason] for reason in Refusal if refusals[reason]}


def advice(scenario: Scenario, cars: Iterable[Car], refusals: Counter[Refusal]) -> str:
    """The change that admits the tunings with the most tests passed.

    A tuning that fails a late test has passed all earlier tests, so a single change suffices.
    """
    furthest = [reason for reason in Refusal if refusals[reason]][-1]
    if furthest in _AT_REST:
        furthest = max(_AT_REST, key=lambda reason: refusals[reason])
    needs = zip(
        *(car.steady_commands(scenario.reference.amplitude_mps2) for car in cars), strict=True
    )
    torque_nm, force_n = (max(need) for need in needs)
    limits, (_, first, second) = scenario.limits, names_of(scenario.plant)
    car = scenario.plant.noun

    def need(size: float, unit: str) -> str:
        return f"the most demanding {car} needs {with_unit(f'{size:.4g}', unit)} to hold the step"

    return _ADVICE[furthest].format(
        car=car,
        torque=_limit("limits.torque_nm", limits.torque_nm, torque_nm, need(torque_nm, first.unit)),
        force=_limit(
            "limits.force_difference_n",
            limits.force_difference_n,
            force_n,
            need(force_n, second.unit),
        ),
    )


def _limit(key: str, limit: float | None, needed: float, need: str) -> str:
    if limit is None:
        return f"{key} is not set, and {need}"
    if needed > limit:
        return f"{key} = {limit:g} must be larger: {need}"
    return f"{key} = {limit:g} must leave more room for the transient: {need}"


_AT_REST = (Refusal.FORCE_LIMIT, Refusal.TORQUE_LIMIT, Refusal.BOTH_LIMITS, Refusal.REST)
_FASTER = "a smaller latency_ticks or a shorter tick_s would help most"
_SMALLER = "a smaller --box or a smaller reference.amplitude_mps2 would help too"
_ADVICE = {
    Refusal.DESIGN: "the {car} must be one that can be designed for; can-rig check says why",
    Refusal.NOMINAL: _FASTER,
    Refusal.NOMINAL_SPARE: "fewer --spare-ticks would help most",
    Refusal.THIN: "a larger budget.peak_sensitivity would help most, or " + _FASTER,
    Refusal.NOISE: _FASTER,
    Refusal.TORQUE_NOISE: "a larger --torque-noise-limit would help most",
    Refusal.FORCE_NOISE: "a larger --noise-limit would help most",
    Refusal.TRANSIENT: "wider limits would help most: {torque}; {force}",
    Refusal.BOX: "a smaller --box would help most",
    Refusal.BOX_SPARE: "fewer --spare-ticks or a smaller --box would help most",
    Refusal.FALSE_ALARM: "a larger budget.box, or a smaller --box, would help most",
    Refusal.REST_SPARE: "fewer --spare-ticks or a smaller --box would help most",
    Refusal.REST: "a smaller --box would help most",
    Refusal.BOTH_LIMITS: "{torque}; {force}; " + _SMALLER,
    Refusal.TORQUE_LIMIT: "{torque}; " + _SMALLER,
    Refusal.FORCE_LIMIT: "{force}; " + _SMALLER,
}
