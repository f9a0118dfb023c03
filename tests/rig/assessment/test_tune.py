"""``can-rig tune``: what it promises of its choice, checked by other means than its own."""

import dataclasses
import json
import math
from functools import partial
from operator import attrgetter

import numpy as np
import pytest

from can_rig.assessment.tuning.candidate import (
    MAX_DELAY_TICKS,
    Car,
    Tuning,
    box_refusal,
    cars,
    delay_margin,
    is_stable,
    laws,
    parameter_ranges,
    trusting_table,
    with_tuning,
)
from can_rig.assessment.tuning.report import as_dict, options, rows
from can_rig.assessment.tuning.search import LONGEST_FRONT, tune
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, delay_margins, law_in
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from tests.rig.assessment.tuned import SMALL, compiled_only, found_for, scenario_of

pytestmark = compiled_only


BOTH = ("on-confirmation", "always")


@pytest.fixture(scope="module", params=BOTH)
def found(request):
    return found_for(f"design.compensation={request.param}")


def table_of(scenario: Scenario, tuning: Tuning):  # type: ignore[no-untyped-def]
    return trusting_table(dataclasses.replace(scenario, design=tuning.design))


def crossover_margin(table, car: Car, tick_s: float) -> float:  # type: ignore[no-untyped-def]
    """Whole ticks, by the crossovers of the loop gain, of the worse of the two states."""
    margins = []
    for state in (HEALTHY, TORQUE_DEAD):
        late = partial(sampled_loop, law_in(table, state), car.plant, tick_s, state)
        whole, _ = delay_margins(late(), lambda d, late=late: late(d).spectral_radius())  # type: ignore[misc]
        margins.append(math.inf if whole is None else whole)
    return min(margins)


def test_every_offer_has_the_delay_margin_at_every_vertex(found):
    """By ``delay_margins``, which comes from the loop gain's crossovers."""
    scenario = found.scenario
    some = cars(scenario.model, parameter_ranges(scenario.model, 0.2))
    assert len(some) == found.cars == 17
    chosen, table = found.chosen, table_of(scenario, found.chosen)
    margin = chosen.delay_margin_ticks
    assert margin is not None
    assert 1 <= margin <= MAX_DELAY_TICKS
    if margin < MAX_DELAY_TICKS:
        worst = [car for car in some if delay_margin(table, [car], scenario.tick_s) == margin]
        assert crossover_margin(table, worst[0], scenario.tick_s) == margin
    for car in (some[0], some[6]):
        assert crossover_margin(table, car, scenario.tick_s) >= margin
    if table.compensator.on_confirmation:
        law = linear_controller(table, confirmed=1.0)
        false_alarms = [sampled_loop(law, car.plant, scenario.tick_s) for car in some]
        assert max(loop.spectral_radius() for loop in false_alarms) < 1.0


def test_a_cell_that_ends_with_it_shows_what_to_run(found):
    chosen, said = found.chosen.design, repr(found)
    assert f"{len(found.front)} tunings of {found.tried} tried for" in said
    assert f"chosen: design.tau_s = {chosen.tau_s:g}, design.alpha = {chosen.alpha}, " in said
    design = load("thesis-step", [f"{k}={v}" for k, v in found.chosen.changes.items()]).design
    keys = attrgetter("tau_s", "alpha", "tau_q_s", "alpha_q")
    assert keys(design) == keys(chosen)


def test_cars_from_inside_the_box_are_stable_too(found):
    """What the vertices do not prove."""
    scenario, generator = found.scenario, np.random.default_rng(5)
    box, table = parameter_ranges(scenario.model, 0.2), table_of(found.scenario, found.chosen)
    for draw in generator.uniform(size=(60, len(box))):
        values = {
            key: low + part * (high - low)
            for part, (key, (low, high)) in zip(draw, box.items(), strict=True)
        }
        settings = dataclasses.replace(scenario.model, **values)
        car = Car("drawn", continuous_plant(settings), settings)
        assert is_stable(table, [car], scenario.tick_s, 1)
        assert delay_margin(table, [car], scenario.tick_s) >= found.chosen.delay_margin_ticks


def test_the_front_is_the_front_of_all_that_would_do():
    """By brute force: no robust tuning beats a tuning of the front in both measures."""
    scenario = scenario_of()
    some = cars(scenario.model, parameter_ranges(scenario.model, 0.0, ["speed_mps=8..12"]))
    found = tune(scenario, some, 1, candidates=SMALL)
    good = []
    for t in found.nominal:
        tuned = dataclasses.replace(scenario, design=t.design)
        if t.within_limits and box_refusal(tuned, table_of(scenario, t), some, 1) is None:
            good.append(t)
    best = [
        t for t in sorted(good, key=lambda t: t.peak_mps2)
        if not any(
            o is not t and o.peak_mps2 <= t.peak_mps2 and o.noise_to_force <= t.noise_to_force
            for o in good
        )
    ]  # fmt: skip
    assert [tuning.design for tuning in found.front] == [t.design for t in best[:LONGEST_FRONT]]
    assert len(best) < len(good)


def test_what_passes_comes_to_rest_in_drives_with_its_spare_tick(found):
    """Two vertices, D* a tick later than is known, the loss in the middle; ``simulate`` alone."""
    scenario = found.scenario
    table = controller_table(dataclasses.replace(scenario, design=found.chosen.design), None)
    some = cars(scenario.model, parameter_ranges(scenario.model, 0.2))
    left = np.ones((10_000, 2))
    left[5000:, 0] = 0.0
    for car in (some[1], some[-1]):
        late = dataclasses.replace(
            car.settings, sensor=dataclasses.replace(car.settings.sensor, dead_time_s=1e-3)
        )
        plant = sample(continuous_plant(late), 1e-3)
        trace = simulate(table, plant, np.ones(10_000), effectiveness=left)
        for rest in (trace.error[4900:5000], trace.error[9900:]):
            assert np.abs(rest).max() < 0.05


def test_the_peak_is_that_of_a_run_and_the_unavoidable_is_below_it(found):
    scenario, chosen = found.scenario, found.chosen
    loss, ticks = 2500, 4000
    left = np.ones((ticks, 2))
    left[loss:, 0] = 0.0
    car = continuous_plant(scenario.plant)
    trace = simulate(
        table_of(scenario, chosen), sample(car, 1e-3), np.ones(ticks), effectiveness=left
    )
    assert np.abs(trace.error[loss:]).max() == pytest.approx(chosen.peak_mps2, rel=1e-3)
    steady_nm = 1.0 / car.g1.dc_gain
    unavoidable = 0.5 * 2.00930 / 1.0 * steady_nm * 0.002**2  # N1's leading term
    assert chosen.unavoidable_mps2 == pytest.approx(unavoidable, rel=5e-3)
    assert chosen.peak_ratio >= 1.0 - 1e-9


def test_the_noise_is_that_of_a_long_run(found):
    """Statistics of a simulation against the covariance equation, in the worse of the states."""
    sensor = dataclasses.replace(found.scenario.model.sensor, noise_mps2=1e-4)
    scenario = dataclasses.replace(
        found.scenario,
        limits=load("thesis-step").limits,
        model=dataclasses.replace(found.scenario.model, sensor=sensor),
    )
    ticks, noise = 200_000, 1e-4 * np.random.default_rng(1).standard_normal(200_000)
    chosen, table = found.chosen, table_of(scenario, found.chosen)
    forces, torques = [], []
    for left in (1.0, 0.0):
        effectiveness = np.ones((ticks, 2))
        effectiveness[:, 0] = left
        effectiveness[:5000] = 1.0
        plant = sample(continuous_plant(scenario.plant), 1e-3)
        run = simulate(table, plant, np.ones(ticks), effectiveness=effectiveness)
        noisy = simulate(table, plant, np.ones(ticks), effectiveness=effectiveness, noise=noise)
        forces.append(np.std((noisy.command_2 - run.command_2)[10_000:]) / 1e-4)
        torques.append(np.std((noisy.command_1 - run.command_1)[10_000:]) / 1e-4)
    assert max(forces) == pytest.approx(chosen.noise_to_force, rel=0.05)
    assert max(torques) == pytest.approx(chosen.noise_to_torque, rel=0.05)


def test_the_goal_at_one_and_two_ticks_of_latency():
    for latency in (1, 2):
        chosen = found_for(f"latency_ticks={latency}", share=0.0).chosen
        assert chosen.peak_ratio < 4.0
        assert chosen.delay_margin_ticks is not None
        assert chosen.delay_margin_ticks >= 1


def test_on_confirmation_beats_always():
    confirmed, always = (found_for(f"design.compensation={each}") for each in BOTH)
    assert confirmed.chosen.peak_mps2 < 0.5 * always.chosen.peak_mps2


def test_json_and_table_tell_of_the_same_front(found):
    values = as_dict(found)
    assert json.loads(json.dumps(values, allow_nan=False)) == values
    assert len(values["front"]) == len(found.front)
    shown = [tuning for tuning, _ in rows(found)]
    assert found.chosen in shown
    assert shown == [tuning for tuning in found.front if tuning in shown]
    tuned = with_tuning(
        found.scenario,
        tuple(values["chosen"][key] for key in ("tau_s", "alpha", "tau_q_s", "alpha_q")),
    )
    assert tuned.design == found.chosen.design
    assert options(found.chosen).count("--set design.") == 4


def test_the_loops_that_are_judged_are_those_of_the_law():
    scenario = with_tuning(scenario_of(), (0.0002, 1, 0.0033, 2))
    table = trusting_table(scenario)
    (car,) = cars(scenario.model, {})
    radius = [
        sampled_loop(law, car.plant, 1e-3, left, 1).spectral_radius() for law, left in laws(table)
    ]
    assert (max(radius) < 1.0) == is_stable(table, [car], 1e-3, 1)
