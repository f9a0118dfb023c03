"""``can-rig tune``: what it promises of its choice, checked by other means than its own."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from functools import partial
from itertools import product

import matplotlib.image
import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.assessment.tuning.box import (
    MOST_DELAY_TICKS,
    Car,
    cars,
    delay_margin,
    laws,
    parameter_ranges,
    survives,
)
from can_rig.assessment.tuning.candidate import Tuning, assess, grid, with_tuning
from can_rig.assessment.tuning.report import as_dict, options, rows, why
from can_rig.assessment.tuning.search import ALIKE, Tunings, tune
from can_rig.errors import ScenarioError
from can_rig.scenario.build import continuous_design, continuous_plant, target
from can_rig.scenario.settings import Scenario
from firmware_model.analysis.delay_margin import delay_margins
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, law_in
from firmware_model.analysis.sampled_loop import linear_controller, sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.discretisation.tables import build
from tests.helpers import rig

SMALL = list(product((0.0002, 0.001), (1, 2), (0.001, 0.0033, 0.01, 0.05), (2, 3)))
SETTINGS = [
    "latency_ticks=1", "design.estimator=zoh", "design.compensation=on-confirmation",
    "design.fault_threshold_mps2=1e-5", "design.confirm_s=0.0",
    "limits.torque_nm=400.0", "limits.force_difference_n=6000.0",
]  # fmt: skip
ALWAYS = "design.compensation=always"
interpreted = os.environ.get("NUMBA_DISABLE_JIT") == "1"
pytestmark = pytest.mark.skipif(interpreted, reason="half a million ticks")


def scenario_of(*settings: str) -> Scenario:
    return load("thesis-step", [*SETTINGS, *settings])


def found_for(  # type: ignore[no-untyped-def]
    *settings: str, share: float = 0.2, spare: int = 1, limit=None, torque_limit=None
) -> Tunings:
    scenario = scenario_of(*settings)
    some = cars(scenario.model, parameter_ranges(scenario.model, share))
    return tune(scenario, some, spare, limit, torque_limit, SMALL)


@pytest.fixture(scope="module", params=["on-confirmation", "always"])
def found(request: pytest.FixtureRequest) -> Tunings:
    return found_for(f"design.compensation={request.param}")


def table_of(scenario: Scenario, tuning: Tuning):  # type: ignore[no-untyped-def]
    chosen = dataclasses.replace(scenario, design=tuning.design)
    return build(continuous_design(chosen), target(chosen, None))


def crossover_margin(table, car: Car, tick_s: float) -> float:  # type: ignore[no-untyped-def]
    """Whole ticks, by the crossovers of the loop gain, of the worse of the two states."""
    margins = []
    for state in (HEALTHY, TORQUE_DEAD):
        late = partial(sampled_loop, law_in(table, state), car.plant, tick_s, state)
        whole, _ = delay_margins(late(), lambda d, late=late: late(d).spectral_radius() < 1.0)  # type: ignore[misc]
        margins.append(math.inf if whole is None else whole)
    return min(margins)


def test_every_offer_has_the_delay_margin_at_every_vertex(found: Tunings) -> None:
    """By ``delay_margins``, which comes from the loop gain's crossovers."""
    scenario = found.scenario
    some = cars(scenario.model, parameter_ranges(scenario.model, 0.2))
    assert len(some) == found.cars == 17
    chosen, table = found.chosen, table_of(scenario, found.chosen)
    margin = chosen.delay_margin_ticks
    assert margin is not None
    assert 1 <= margin < MOST_DELAY_TICKS
    worst = [car for car in some if not survives(table, [car], scenario.tick_s, margin + 1)]
    assert min(crossover_margin(table, car, scenario.tick_s) for car in worst[:2]) == margin
    for car in (some[0], some[6]):
        assert crossover_margin(table, car, scenario.tick_s) >= margin
    if table.compensator.on_confirmation:
        law = linear_controller(table, confirmed=1.0)
        false_alarms = [sampled_loop(law, car.plant, scenario.tick_s) for car in some]
        assert max(loop.spectral_radius() for loop in false_alarms) < 1.0


def test_cars_from_inside_the_box_are_stable_too(found: Tunings) -> None:
    """What the vertices do not prove."""
    scenario, generator = found.scenario, np.random.default_rng(5)
    box, table = parameter_ranges(scenario.model, 0.2), table_of(found.scenario, found.chosen)
    for draw in generator.uniform(size=(60, len(box))):
        values = {
            key: low + part * (high - low)
            for part, (key, (low, high)) in zip(draw, box.items(), strict=True)
        }
        car = Car("drawn", continuous_plant(dataclasses.replace(scenario.model, **values)))
        assert survives(table, [car], scenario.tick_s, 1)
        assert delay_margin(table, [car], scenario.tick_s) >= found.chosen.delay_margin_ticks


def test_the_front_is_the_front_of_all_that_would_do(found: Tunings) -> None:
    """No tuning that is stable with all the cars beats one of it in both; brute force."""
    scenario = found.scenario
    some = cars(scenario.model, parameter_ranges(scenario.model, 0.2))
    good = [
        t for t in found.nominal
        if t.within_limits and survives(table_of(scenario, t), some, scenario.tick_s, 1)
    ]  # fmt: skip
    best = {
        t.design for t in good
        if not any(
            o is not t and o.peak_mps2 <= t.peak_mps2 and o.noise_to_force <= t.noise_to_force
            for o in good
        )
    }  # fmt: skip
    assert {tuning.design for tuning in found.front} == best
    assert len(best) < len(good)


def test_the_peak_is_that_of_a_run_and_the_unavoidable_is_below_it(found: Tunings) -> None:
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
    unavoidable = 0.5 * 2.00930 / 1.0 * steady_nm * 0.002**2  # trap 11: N1's leading term
    assert chosen.unavoidable_mps2 == pytest.approx(unavoidable, rel=1e-4)
    assert chosen.peak_ratio >= 1.0


def test_the_noise_is_that_of_a_long_run(found: Tunings) -> None:
    """Statistics of a simulation against the covariance equation, in the worse of the states."""
    scenario = dataclasses.replace(found.scenario, limits=load("thesis-step").limits)
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
        if table.compensator.on_confirmation and left == 1.0:
            continue  # the noise crosses its threshold of 1e-5: compensated, but not lost
        forces.append(np.std((noisy.command_2 - run.command_2)[10_000:]) / 1e-4)
        torques.append(np.std((noisy.command_1 - run.command_1)[10_000:]) / 1e-4)
    assert max(forces) == pytest.approx(chosen.noise_to_force, rel=0.05)
    if len(torques) == 2:
        assert max(torques) == pytest.approx(chosen.noise_to_torque, rel=0.05)


def test_the_goal_at_one_and_two_ticks_of_latency() -> None:
    for latency in (1, 2):
        chosen = found_for(f"latency_ticks={latency}", share=0.0).chosen
        assert chosen.peak_ratio < 4.0
        assert chosen.delay_margin_ticks is not None
        assert chosen.delay_margin_ticks >= 1


def test_on_confirmation_beats_always() -> None:
    assert found_for().chosen.peak_mps2 < 0.5 * found_for(ALWAYS).chosen.peak_mps2


def test_a_noise_limit_is_kept_or_said_to_be_impossible() -> None:
    noisy = ("noise.dstar_rms_mps2=0.005", "design.fault_threshold_mps2=0.02")
    free, limited = found_for(*noisy), found_for(*noisy, limit=20.0)
    assert limited.chosen.noise_to_force * 0.005 <= 20.0 < free.chosen.noise_to_force * 0.005
    assert limited.chosen.peak_mps2 > ALIKE * free.chosen.peak_mps2
    assert "within 20 N rms" in why(limited)
    never = found_for(*noisy, limit=1e-3)
    assert not never.is_quiet(never.chosen)
    assert never.chosen == never.front[-1]
    assert why(never).startswith("none is within 0.001 N")


def test_a_noise_limit_of_the_torque_is_kept() -> None:
    noisy = ("noise.dstar_rms_mps2=0.005", "design.fault_threshold_mps2=0.02")
    free, limited = found_for(*noisy), found_for(*noisy, torque_limit=20.0)
    assert all(t.noise_to_torque * 0.005 <= 20.0 for t in limited.front)
    assert free.chosen.noise_to_torque * 0.005 > 20.0
    with pytest.raises(ScenarioError, match="quiet enough"):
        found_for(*noisy, torque_limit=1e-6)


def test_designs_that_reach_a_limit_are_the_last_resort() -> None:
    """42.5 N m hold 1 m/s²: a limit of 46 leaves room for slow designs alone."""
    tight = found_for("limits.torque_nm=46.0", share=0.0)
    assert all(t.within_limits and t.torque_after_nm < 46.0 for t in tight.front)
    assert any(not t.within_limits for t in tight.nominal)
    noisy = found_for("limits.torque_nm=60.0", "noise.dstar_rms_mps2=0.001", share=0.0)
    for tuning in noisy.front:
        assert tuning.torque_after_nm + 3.0 * 0.001 * tuning.noise_to_torque < 60.0
    over = found_for("limits.force_difference_n=3500.0", share=0.0)  # 3754 N at the peak
    assert not any(t.within_limits for t in over.front)
    assert "reach the limits" in why(over)


def test_more_ticks_to_spare_cost_peak() -> None:
    one, seven = found_for(share=0.0), found_for(share=0.0, spare=7)
    assert seven.chosen.delay_margin_ticks is not None
    assert seven.chosen.delay_margin_ticks >= 7
    assert seven.chosen.peak_mps2 > one.chosen.peak_mps2


def test_a_grid_of_round_numbers_follows_the_tick() -> None:
    for tick_s in (0.0001, 0.001, 0.002):
        values = grid(tick_s)
        assert len(set(values)) == len(values) < 3000
        for tau_s, alpha, tau_q_s, alpha_q in values:
            assert 0.0999 * tick_s < tau_s < 20.01 * tick_s
            assert 0.999 * tick_s < tau_q_s < 100.1 * tick_s
            assert (alpha in (1, 2)) and (alpha_q in (2, 3, 4))
    assert (0.0022, 2, 0.0047, 3) in grid(0.001)


def test_an_unstable_or_impossible_candidate_is_none() -> None:
    scenario = scenario_of(ALWAYS, "latency_ticks=2")
    car = cars(scenario.model, {})
    assert assess(scenario, (0.0002, 1, 0.001, 2), car, 0) is None  # trap 1
    assert assess(scenario, (0.02, 1, 0.02, 1), car, 0) is None  # q̂/G1 improper


def test_the_box() -> None:
    model = load("thesis-step").model
    box = parameter_ranges(model, 0.2)
    assert box["mass_kg"] == pytest.approx((1120.0, 1680.0))
    some = cars(model, box)
    assert [car.label for car in some[:1]] == ["the nominal car"]
    assert len({car.label for car in some}) == 17
    heavy = dataclasses.replace(model, **{key: high for key, (_, high) in box.items()})
    np.testing.assert_array_equal(some[-1].plant.a, continuous_plant(heavy).a)
    one = parameter_ranges(model, 0.0, ["plant.speed_mps=8..12", "trail_m=0.04..0.06"])
    assert one == {"speed_mps": (8.0, 12.0), "trail_m": (0.04, 0.06)}
    assert len(cars(model, one)) == 5
    assert len(cars(model, {})) == 1


BAD = {
    "share": (["--box", "1"], "0 to below 1"),
    "negative share": (["--box", "-0.1"], "0 to below 1"),
    "nan": (["--box", "nan"], "0 to below 1"),
    "no such key": (["--box-set", "plant.sped=1..2"], "KEY=LOW..HIGH"),
    "no range": (["--box-set", "plant.speed_mps=12"], "KEY=LOW..HIGH"),
    "turned round": (["--box-set", "plant.speed_mps=12..8"], "KEY=LOW..HIGH"),
    "no car": (["--box-set", "plant.mass_kg=-1..8"], "box: mass_kg = -1"),
    "a car that is unstable": (
        ["--box", "0", "--box-set", "rear_cornering_stiffness_n_per_rad=1e3..5e4",
         "--set", "plant.speed_mps=60"], "box: rear_cornering.*pole",
    ),
    "noise limit without noise": (["--noise-limit", "300"], "noise.dstar_rms_mps2 above 0"),
    "spare": (["--spare-ticks", "-1"], "0 or above"),
    "chapter 2": (["chapter-2", "--box", "0"], "chapter-2"),
    "off": (["--set", "design.compensation=off"], "compensation = 'off'"),
    "no reference": (["--set", "reference.amplitude_mps2=0"], "would not show"),
}  # fmt: skip


@pytest.mark.parametrize(("arguments", "reason"), BAD.values(), ids=BAD)
def test_what_is_wrong_is_one_line_with_exit_status_2(arguments: list[str], reason: str) -> None:
    import re

    done = rig("tune", *arguments)
    assert done.returncode == 2, done.stderr
    (line,) = [line for line in done.stderr.splitlines() if "error:" in line]
    assert re.search(reason, line), line
    assert "Traceback" not in done.stderr


def test_nothing_survives() -> None:
    with pytest.raises(ScenarioError, match=r"none over the box; a *smaller --box"):
        tune(scenario_of(ALWAYS), cars(load("thesis-step").model, {}), 1, None, None, SMALL[:2])


def test_the_command_writes_the_picture_the_table_and_the_options(
    tmp_path, monkeypatch, capsys
) -> None:  # type: ignore[no-untyped-def]
    from can_rig.assessment.tuning import search
    from can_rig.assessment.tuning.report import tune_command

    monkeypatch.setattr(search, "grid", lambda tick_s: SMALL)
    monkeypatch.setenv("COLUMNS", "80")
    arguments = ("thesis-step", SETTINGS, (0.1, ()), (1, None), tmp_path)
    assert tune_command(*arguments, False, True) == 0
    values = json.loads(capsys.readouterr().out)
    image = matplotlib.image.imread(tmp_path / "tuning.png")
    assert image.shape[0] > 800
    assert image[..., :3].std() > 0.05
    with pytest.raises(Exception, match="there already"):
        tune_command(*arguments, False, True)
    assert tune_command(*arguments, True, False) == 0
    shown = capsys.readouterr().out
    assert values["options"] in shown
    assert max(len(line) for line in shown.splitlines()[:-3]) <= 80
    assert sum(line.startswith(">") for line in shown.splitlines()) == 1
    # What the options choose is what was chosen.
    settings = [*SETTINGS, *values["options"].replace("--set ", "").split()]
    chosen = load("thesis-step", settings).design
    assert (chosen.tau_s, chosen.tau_q_s) == (
        values["chosen"]["tau_s"], values["chosen"]["tau_q_s"]
    )  # fmt: skip


def test_json_and_table_tell_of_the_same_front(found: Tunings) -> None:
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
    assert options(found, found.chosen).count("--set design.") == 4


def test_the_loops_that_are_judged_are_those_of_the_law() -> None:
    scenario = with_tuning(scenario_of(), (0.0002, 1, 0.0033, 2))
    table = build(continuous_design(scenario), target(scenario, None))
    (car,) = cars(scenario.model, {})
    radius = [
        sampled_loop(law, car.plant, 1e-3, left, 1).spectral_radius() for law, left in laws(table)
    ]
    assert (max(radius) < 1.0) == survives(table, [car], 1e-3, 1)
