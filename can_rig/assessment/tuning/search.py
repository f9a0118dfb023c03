"""The search behind ``can-rig tune``: τ, α, τ_q, α_q for a tick, a latency, limits and a box.

The candidates are on a grid that follows the tick. For each of them:

1. the design must exist, and the nominal car must be stable, healthy and lost, with the ticks to
   spare;
2. the noise in both commands is computed exactly, and the loss of the torque channel during a
   settled step is simulated with the scenario's limits, rates, latency and decision on d̂;
3. unless an accepted one has both less noise and less peak: the vertices of the box must be stable,
   and in a drive with limits and noise come to rest at the step, before and after the loss, without
   a false alarm, and come to rest with the ticks to spare too.

Step 3 goes from the least peak upwards, so that it looks at little more than the trade-off.
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial

from can_rig.assessment.tuning.box import Car, delay_margin
from can_rig.assessment.tuning.candidate import (
    Tuning,
    Values,
    assess,
    grid,
    trusting_table,
)
from can_rig.assessment.tuning.refusals import NoTuningError, Refusal, advice
from can_rig.assessment.tuning.robustness import box_refusal, has_control_authority
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.settings import Scenario

FEWEST_A_WORKER = 16  # candidates, of which one takes some 20 ms
LONGEST_FRONT = 6  # from the least peak on
EQUAL_PEAKS = 1.05  # of peaks within this factor the one with the least noise is chosen


@dataclass(frozen=True)
class Tunings:
    """What was found: ``front`` from the least peak to the least noise, and all that was tried.

    ``nominal`` are those that pass steps 1 and 2, ``refusals`` how many fail each test.
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
        """How many were tried and are left, and the one to use."""
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
        """Rms of X_diff in N at the scenario's noise; per m/s² of noise where it has none."""
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
        scenario: everything but the four numbers; its reference is a step of its amplitude.
        cars: the nominal one first (``box.cars``).
        spare_ticks: additional ticks of delay, unknown to the controller, with which the loop must
            be stable.
        noise_limit_n: largest rms of X_diff that ``plant.sensor.noise_mps2`` may cause, N.
        torque_noise_limit_nm: the same of the torque, N m; a tuning beyond it is refused.
        candidates: in place of ``grid``.
        on_progress: told how many tests are done, and of how many: those of the nominal car, and
            those over the box that they leave.

    Raises:
        ScenarioError: nothing to tune; NoTuningError: no candidate passes.
    """
    _refuse(scenario, spare_ticks)
    for option, limit in (
        ("--noise-limit", noise_limit_n),
        ("--torque-noise-limit", torque_noise_limit_nm),
    ):
        _refuse_limit(scenario, option, limit)
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

    # Those that reach a limit come last, and only where no other passes.
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
    """``assess`` for each of ``candidates``, in their order, on every processor there is."""
    work = partial(_assess, scenario, tuple(some), spare_ticks)
    workers = min(os.cpu_count() or 1, len(candidates) // FEWEST_A_WORKER)
    if workers < 2:
        yield from map(work, candidates)
        return
    with ProcessPoolExecutor(workers, multiprocessing.get_context("fork")) as pool:
        yield from pool.map(work, candidates, chunksize=FEWEST_A_WORKER)


def _assess(
    scenario: Scenario, some: tuple[Car, ...], spare_ticks: int, values: Values
) -> Tuning | Refusal:
    return assess(scenario, values, some, spare_ticks)


def _front(
    scenario: Scenario,
    some: Sequence[Tuning],
    cars: Sequence[Car],
    spare_ticks: int,
    refusals: Counter[Refusal],
    on_tested: Callable[[], None],
) -> list[Tuning]:
    """Those that pass with all ``cars`` and that no such one beats in both noise and peak.

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
                if car is not None:  # it will be the first to fail with the next tuning too
                    order.remove(car)
                    order.insert(0, car)
        on_tested()
    return front


def _refuse(scenario: Scenario, spare_ticks: int) -> None:
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
    if spare_ticks < 0:
        raise ScenarioError(f"--spare-ticks {spare_ticks}: must be 0 or above")


def _refuse_limit(scenario: Scenario, option: str, limit: float | None) -> None:
    if limit is not None and not (limit > 0.0 and scenario.model.sensor.noise_mps2 > 0.0):
        raise ScenarioError(
            f"{option} {limit:g}: must be above 0, and so must plant.sensor.noise_mps2"
        )
