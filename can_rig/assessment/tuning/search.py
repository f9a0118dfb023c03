"""The search behind ``can-rig tune``: τ, α, τ_q, α_q for a tick, a latency, limits and a box.

Of every candidate, on a grid that follows the tick:

1. the design exists, and the nominal car is stable healthy and lost with the ticks to spare;
2. the noise in both commands, exactly, and the loss of the torque channel in a held curve, with the
   scenario's limits, rates, latency and decision on d̂;
3. only of those that no accepted one beats in both noise and peak: the vertices of the box, their
   margins and their answer to the step. A loop that is stable may still run back and forth between
   the limits of its torque for ever, once the step has sent it there.

Step 3 goes from the least peak upwards, so it looks at the trade-off alone and at little besides.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from can_rig.assessment.tuning.box import Car, delay_margin, survives
from can_rig.assessment.tuning.candidate import Tuning, Values, assess, grid, settles, table_of
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.plant_settings import CAR
from can_rig.scenario.settings import Scenario

ALIKE = 1.05  # peaks within this factor are told apart by their noise


@dataclass(frozen=True)
class Tunings:
    """What was found: ``front`` from the least peak to the least noise, and all that was tried."""

    scenario: Scenario
    spare_ticks: int
    cars: int
    noise_limit_n: float | None
    tried: int
    nominal: list[Tuning]
    front: list[Tuning]

    @property
    def chosen(self) -> Tuning:
        """The least noise among the peaks that are as good as the least one within the limit."""
        quiet = [tuning for tuning in self.front if self.is_quiet(tuning)]
        if not quiet:
            return self.front[-1]
        least = min(tuning.peak_mps2 for tuning in quiet)
        alike = [tuning for tuning in quiet if tuning.peak_mps2 <= ALIKE * least]
        return min(alike, key=lambda tuning: tuning.noise_to_force)

    def is_quiet(self, tuning: Tuning) -> bool:
        """Whether the noise in X_diff is within the limit, where there is one."""
        limit = math.inf if self.noise_limit_n is None else self.noise_limit_n
        return tuning.noise_to_force * self.scenario.noise.dstar_rms_mps2 <= limit


def tune(
    scenario: Scenario,
    cars: Sequence[Car],
    spare_ticks: int = 1,
    noise_limit_n: float | None = None,
    torque_noise_limit_nm: float | None = None,
    candidates: Sequence[Values] | None = None,
    on_candidate: Callable[[int, int], None] = lambda done, of: None,
) -> Tunings:
    """Search the trade-off.

    Args:
        scenario: everything but the four numbers; its reference is a step of its amplitude.
        cars: the nominal one first (``box.cars``).
        spare_ticks: more ticks of delay than the controller knows of that have to be survived.
        noise_limit_n: rms of X_diff that ``noise.dstar_rms_mps2`` may cause, N.
        torque_noise_limit_nm: the same of the torque, N m; nothing above it is looked at.
        candidates: instead of ``grid``.
        on_candidate: told how many are done, of how many.

    Raises:
        ScenarioError: nothing to tune, or nothing that survives.
    """
    _refuse(scenario, spare_ticks)
    for option, limit in (
        ("--noise-limit", noise_limit_n),
        ("--torque-noise-limit", torque_noise_limit_nm),
    ):
        _refuse_limit(scenario, option, limit)
    loudest = math.inf if torque_noise_limit_nm is None else torque_noise_limit_nm
    candidates = grid(scenario.tick_s) if candidates is None else candidates
    own = (
        [] if scenario.plant == scenario.model else [Car("plant", continuous_plant(scenario.plant))]
    )
    nominal: list[Tuning] = []
    for done, values in enumerate(candidates, 1):
        tuning = assess(scenario, values, (cars[0], *own), spare_ticks)
        if tuning is not None and tuning.noise_to_torque * scenario.noise.dstar_rms_mps2 <= loudest:
            nominal.append(tuning)
        on_candidate(done, len(candidates))
    # What fits below the limits comes first; what does not, only where nothing does.
    for some in ([t for t in nominal if t.within_limits], nominal):
        front = _front(scenario, some, (*cars, *own), spare_ticks)
        if front:
            return Tunings(
                scenario, spare_ticks, len(cars), noise_limit_n, len(candidates), nominal, front
            )
    raise ScenarioError(
        f"scenario {scenario.name}: of {len(candidates)} tunings {len(nominal)} are stable at the "
        f"nominal car with {spare_ticks} ticks to spare and quiet enough, and none over the box; a "
        "smaller --box, fewer --spare-ticks, a smaller latency or less noise is right"
    )


def _front(
    scenario: Scenario, some: Iterable[Tuning], cars: Sequence[Car], spare_ticks: int
) -> list[Tuning]:
    """Those that are stable and settle over the box, and that no such one beats in noise and peak.

    Least peak first.
    """
    front: list[Tuning] = []
    for tuning in sorted(some, key=lambda t: (t.peak_mps2, t.noise_to_force)):
        if front and tuning.noise_to_force >= front[-1].noise_to_force:
            continue
        table = table_of(replace(scenario, design=tuning.design))
        if (
            table is not None
            and survives(table, cars, scenario.tick_s, spare_ticks)
            and all(settles(scenario, table, car) for car in cars)
        ):
            margin = delay_margin(table, cars, scenario.tick_s, spare_ticks)
            front.append(replace(tuning, delay_margin_ticks=margin))
    return front


def _refuse(scenario: Scenario, spare_ticks: int) -> None:
    where = f"scenario {scenario.name}:"
    if not scenario.model.is_car:
        raise ScenarioError(
            f"{where} model.kind = {scenario.model.kind!r}: must be a car, such as {CAR}"
        )
    if scenario.design.compensation == "off":
        raise ScenarioError(f"{where} design.compensation = 'off': on-confirmation is right")
    if scenario.reference.amplitude_mps2 == 0.0:
        raise ScenarioError(f"{where} reference.amplitude_mps2 = 0: a loss would not show")
    if spare_ticks < 0:
        raise ScenarioError(f"--spare-ticks {spare_ticks}: 0 or above is right")


def _refuse_limit(scenario: Scenario, option: str, limit: float | None) -> None:
    if limit is not None and not (limit > 0.0 and scenario.noise.dstar_rms_mps2 > 0.0):
        raise ScenarioError(
            f"{option} {limit:g}: above 0 is right, with noise.dstar_rms_mps2 above 0"
        )
