"""The search behind ``can-rig tune``: τ, α, τ_q, α_q for a tick, a latency, limits and a box.

The grid of candidates follows the tick. For each of them:

1. the design must exist, and the nominal car must be stable, healthy and lost, with the ticks to
   spare and with the peak |S| of ``budget.peak_sensitivity``;
2. the noise in both commands is computed exactly, and the loss of the torque channel during a
   settled step is simulated with the scenario's limits, rates, latency and decision on d̂;
3. unless an accepted tuning has both less noise and a smaller peak: the vertices of the box must be
   stable; a drive with limits and noise must come to rest at the step, before and after the loss,
   without a false alarm; a drive with the spare ticks must come to rest too.

Step 3 proceeds from the smallest peak upwards, so that few tunings beyond the trade-off are tested.
"""

import math
import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

from can_rig.assessment.tuning.candidate import (
    Car,
    NoTuningError,
    Refusal,
    Tuning,
    Values,
    advice,
    assess,
    box_refusal,
    delay_margin,
    grid,
    has_control_authority,
    trusting_table,
)
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_plant, require_ours
from can_rig.scenario.settings import Scenario
from firmware_model.law.structs import MAX_LATENCY_TICKS

FEWEST_A_WORKER = 16  # candidates; each takes some 20 ms
LONGEST_FRONT = 6  # from the least peak on
EQUAL_PEAKS = 1.05  # among peaks within this factor, the least noise wins


@dataclass(frozen=True)
class Tunings:
    """The result: ``front`` from the smallest peak to the least noise, and all tried candidates.

    ``nominal`` passed steps 1 and 2; ``refusals`` counts the failures of each test.
    """

    scenario: Scenario
    spare_ticks: int
    cars: int
    noise_limit_n: float | None
    tried: int
    nominal: list[Tuning]
    front: list[Tuning]
    refusals: Counter[Refusal] = field(default_factory=Counter)

    def __repr__(self) -> str:
        """Numbers of tried and remaining tunings, and the recommended tuning."""
        said = ", ".join(f"{key} = {value:g}" for key, value in self.chosen.changes.items())
        left = f"{len(self.front)} tunings of {self.tried} tried"
        return f"<{left} for {self.scenario.name}; chosen: {said}>"

    @property
    def chosen(self) -> Tuning:
        """The least noise, among the peaks about as small as the least."""
        least = self.front[0].peak_mps2
        equal = [tuning for tuning in self.front if tuning.peak_mps2 <= EQUAL_PEAKS * least]
        return min(equal, key=lambda tuning: tuning.noise_to_force)

    def noise_n(self, tuning: Tuning) -> float:
        """Rms of X_diff in N at the scenario's noise; without noise, per m/s² of noise."""
        return tuning.noise_to_force * (self.scenario.model.sensor.noise_mps2 or 1.0)


def tune(
    scenario: Scenario,
    cars: Sequence[Car],
    spare_ticks: int = 1,
    noise_limit_n: float | None = None,
    torque_noise_limit_nm: float | None = None,
    candidates: Sequence[Values] | None = None,
    on_progress: Callable[[int, int], None] = lambda done, of: None,
) -> Tunings:
    """Search the trade-off.

    Args:
        scenario: everything except the four numbers; its reference is a step of its amplitude.
        cars: the nominal one first (``box.cars``).
        spare_ticks: extra ticks of delay, unknown to the controller, that the loop must survive;
            at least ``budget.spare_ticks``.
        noise_limit_n: largest allowed rms of X_diff by ``plant.sensor.noise_mps2``, N.
        torque_noise_limit_nm: the same of the torque, N m; a tuning beyond it is refused.
        candidates: in place of ``grid``.
        on_progress: called with finished and total tests: the nominal car's tests, then the box's
            tests of the remaining tunings.

    Raises:
        ScenarioError: nothing to tune; NoTuningError: no candidate passes.
    """
    _refuse(scenario, spare_ticks)
    for option, limit in (
        ("--noise-limit", noise_limit_n),
        ("--torque-noise-limit", torque_noise_limit_nm),
    ):
        _refuse_limit(scenario, option, limit)
    spare_ticks = max(spare_ticks, scenario.budget.spare_ticks)
    loudest = math.inf if torque_noise_limit_nm is None else torque_noise_limit_nm
    loudest_force = math.inf if noise_limit_n is None else noise_limit_n
    candidates = grid(scenario) if candidates is None else candidates
    own = (
        []
        if scenario.plant == scenario.model
        else [Car("plant", continuous_plant(scenario.plant), scenario.plant)]
    )
    box = (*cars, *own)
    if not all(has_control_authority(scenario, car) for car in box):
        none = Counter({Refusal.FORCE_LIMIT: len(candidates)})
        raise NoTuningError(scenario, none, advice(scenario, box, none))
    nominal: list[Tuning] = []
    refusals: Counter[Refusal] = Counter()
    for done, tuning in enumerate(_assessed(scenario, candidates, (cars[0], *own), spare_ticks), 1):
        if isinstance(tuning, Refusal):
            refusals[tuning] += 1
        elif tuning.noise_to_torque * scenario.model.sensor.noise_mps2 > loudest:
            refusals[Refusal.TORQUE_NOISE] += 1
        elif tuning.noise_to_force * scenario.model.sensor.noise_mps2 > loudest_force:
            refusals[Refusal.FORCE_NOISE] += 1
        else:
            nominal.append(tuning)
        on_progress(done, len(candidates) + len(nominal))
    of, done = len(candidates) + len(nominal), len(candidates)

    def on_tested() -> None:
        nonlocal done
        done += 1
        on_progress(done, of)

    # Tunings that reach a limit come last, and only if no other tuning passes.
    for held in (True, False):
        some = [tuning for tuning in nominal if tuning.within_limits is held]
        front = _front(scenario, some, box, spare_ticks, refusals, on_tested)
        if front:
            on_progress(of, of)
            return Tunings(
                scenario, spare_ticks, len(cars), noise_limit_n, len(candidates),
                nominal, front, refusals,
            )  # fmt: skip
    raise NoTuningError(scenario, refusals, advice(scenario, box, refusals))


def _assessed(
    scenario: Scenario, candidates: Sequence[Values], some: Sequence[Car], spare_ticks: int
) -> Iterator[Tuning | Refusal]:
    """``assess`` for each of ``candidates``, in order, on every processor."""
    work = partial(assess, scenario, cars=tuple(some), spare_ticks=spare_ticks)
    workers = min(os.cpu_count() or 1, len(candidates) // FEWEST_A_WORKER)
    if workers < 2:
        yield from map(work, candidates)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("fork")) as pool:
        yield from pool.map(work, candidates, chunksize=FEWEST_A_WORKER)


def _front(
    scenario: Scenario,
    some: Sequence[Tuning],
    cars: Sequence[Car],
    spare_ticks: int,
    refusals: Counter[Refusal],
    on_tested: Callable[[], None],
) -> list[Tuning]:
    """The tunings that pass with all ``cars``, without a passing tuning better in noise and peak.

    Least peak first. Adds to ``refusals``.
    """
    front: list[Tuning] = []
    order = list(cars)
    by_peak = sorted(some, key=lambda tuning: (tuning.peak_mps2, tuning.noise_to_force))
    for tuning in by_peak:
        if len(front) == LONGEST_FRONT:
            on_tested()
            continue
        if not front or tuning.noise_to_force < front[-1].noise_to_force:
            tuned = replace(scenario, design=tuning.design)
            table = trusting_table(tuned)
            refused = box_refusal(tuned, table, order, spare_ticks)
            if refused is None:
                margin = delay_margin(table, cars, scenario.tick_s, spare_ticks)
                front.append(replace(tuning, delay_margin_ticks=margin))
            else:
                refusal, car = refused
                refusals[refusal] += 1
                if car is not None:  # this car will be the first to fail with the next tuning too
                    order.remove(car)
                    order.insert(0, car)
        on_tested()
    return front


def _refuse(scenario: Scenario, spare_ticks: int) -> None:
    require_ours(scenario, "a tuning")
    where = f"scenario {scenario.name}:"
    if not scenario.design.feedback:
        raise ScenarioError(f"{where} design.feedback = false: must be true, for there is no C")
    if scenario.drive.is_given:
        raise ScenarioError(
            f"{where} drive: must not be given, for a tuning is for one speed; the speed is "
            "plant.speed_mps"
        )
    if scenario.design.compensation == "off":
        raise ScenarioError(
            f"{where} design.compensation = 'off': must be on-confirmation or always"
        )
    if scenario.reference.amplitude_mps2 == 0.0:
        raise ScenarioError(
            f"{where} reference.amplitude_mps2 = 0: must not be 0, or a loss would not show"
        )
    if not 0 <= spare_ticks <= MAX_LATENCY_TICKS:
        raise ScenarioError(f"--spare-ticks {spare_ticks}: must be 0 to {MAX_LATENCY_TICKS}")


def _refuse_limit(scenario: Scenario, option: str, limit: float | None) -> None:
    if limit is not None and not (limit > 0.0 and scenario.model.sensor.noise_mps2 > 0.0):
        raise ScenarioError(
            f"{option} {limit:g}: must be above 0, and so must plant.sensor.noise_mps2"
        )
