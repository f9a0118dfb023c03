"""What ``can-rig tune`` refuses, why, and what limits of noise and commands do to its choice."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from can_rig.assessment.tuning.candidate import (
    NoTuningError,
    Refusal,
    Tuning,
    advice,
    assess,
    cars,
    grid,
    parameter_ranges,
)
from can_rig.assessment.tuning.report import why
from can_rig.assessment.tuning.search import EQUAL_PEAKS
from can_rig.scenario.build import continuous_plant
from can_rig.scenario.loading import load
from tests.rig.assessment.tuned import ALWAYS, SMALL, compiled_only, found_for, scenario_of

pytestmark = compiled_only


NOISY = "plant.sensor.noise_mps2=0.005"


def test_a_noise_limit_of_x_diff_is_kept_or_refuses():
    free, limited = found_for(NOISY, share=0.0), found_for(NOISY, share=0.0, limit=40.0)
    assert all(t.noise_to_force * 0.005 <= 40.0 for t in (*limited.nominal, *limited.front))
    assert free.chosen.noise_to_force * 0.005 > 40.0
    assert "all within 40 N rms of X_diff noise" in why(limited)
    assert limited.chosen.peak_mps2 > EQUAL_PEAKS * free.chosen.peak_mps2
    assert limited.refusals[Refusal.FORCE_NOISE] == len(free.nominal) - len(limited.nominal) > 0
    with pytest.raises(NoTuningError, match="a larger --noise-limit") as refused:
        found_for(NOISY, share=0.0, limit=1e-6)
    assert refused.value.refusals == Counter({Refusal.FORCE_NOISE: len(SMALL)})


def test_a_noise_limit_of_the_torque_is_kept_or_refuses():
    free, limited = found_for(NOISY, share=0.0), found_for(NOISY, share=0.0, torque_limit=20.0)
    assert all(t.noise_to_torque * 0.005 <= 20.0 for t in limited.front)
    assert free.chosen.noise_to_torque * 0.005 > 20.0
    with pytest.raises(NoTuningError, match="a larger --torque-noise-limit") as refused:
        found_for(NOISY, share=0.0, torque_limit=1e-6)
    assert refused.value.refusals[Refusal.TORQUE_NOISE] == len(SMALL)


def test_designs_that_reach_a_limit_are_the_last_resort():
    """42.5 N m hold 1 m/s²: a limit of 46 leaves room for slow designs alone."""
    tight = found_for("limits.torque_nm=46.0", share=0.0)
    assert all(t.within_limits and t.torque_after_nm < 46.0 for t in tight.front)
    assert any(not t.within_limits for t in tight.nominal)
    noisy = found_for("limits.torque_nm=60.0", "plant.sensor.noise_mps2=0.001", share=0.0)
    for tuning in noisy.front:
        assert tuning.torque_after_nm + 3.0 * 0.001 * tuning.noise_to_torque < 60.0
    over = found_for("limits.force_difference_n=3500.0", share=0.0)  # 3754 N at the peak
    assert not any(t.within_limits for t in over.front)
    assert "reach the limits" in why(over)


def test_more_ticks_to_spare_cost_peak():
    one, seven = found_for(share=0.0), found_for("budget.spare_ticks=7", share=0.0)
    assert (one.spare_ticks, seven.spare_ticks) == (1, 7)
    assert seven.chosen.delay_margin_ticks is not None
    assert seven.chosen.delay_margin_ticks >= 7
    assert seven.chosen.peak_mps2 > one.chosen.peak_mps2


def test_a_grid_of_round_numbers_follows_the_tick_and_the_car():
    for tick_s in (0.0001, 0.001, 0.005):
        values = grid(load("thesis-step", [f"tick_s={tick_s}"]))
        assert len(set(values)) == len(values) < 3000
        for tau_s, alpha, tau_q_s, alpha_q in values:
            assert 0.0999 * tick_s < tau_s < 10.01 * tick_s
            assert 0.999 * tick_s < tau_q_s
            assert alpha_q * tau_q_s < 1.001 * max(20 * tick_s, 0.05)
            assert (alpha in (1, 2)) and (alpha_q in (2, 3, 4))
    assert (0.0022, 2, 0.0047, 3) in grid(load("thesis-step"))


def test_a_zero_on_the_right_slows_the_grid():
    """Those of (3.36) lie at 20.2 rad/s: time constants around 50 ms, and none far below."""
    values = grid(load("nonminimum-phase"))
    assert {(0.0047, 1, 0.1, 3), (0.047, 1, 0.1, 2)} <= set(values)
    assert len(values) < 3000 and min(tau_s for tau_s, _, _, _ in values) > 0.0024
    assert max(alpha_q * tau_q_s for _, _, tau_q_s, alpha_q in values) < 0.5


def test_actuators_that_lag_raise_the_orders_of_the_grid():
    """By a lag each: G1 from 2 to 3, G2 from 1 to 2."""
    values = grid(load("default"))
    assert {alpha for _, alpha, _, _ in values} == {2, 3}
    assert {alpha_q for _, _, _, alpha_q in values} == {3, 4, 5}


def test_an_unstable_or_impossible_candidate_is_refused():
    scenario = scenario_of(ALWAYS, "latency_ticks=2")
    car = cars(scenario.model, {})
    assert assess(scenario, (0.0001, 1, 0.0001, 2), car, 0) is Refusal.NOMINAL  # too fast
    assert assess(scenario, (0.02, 1, 0.02, 1), car, 0) is Refusal.DESIGN  # q̂/G1 improper


def test_a_candidate_that_check_calls_thin_is_refused():
    """|S| peaks at 8.3 once the motor of the pendulum is lost, though the loop is stable."""
    scenario, candidate = load("pendulum"), (0.0033, 3, 0.012, 3)
    car = cars(scenario.model, {})
    assert assess(scenario, candidate, car, 1) is Refusal.THIN
    budget = dataclasses.replace(scenario.budget, peak_sensitivity=9.0)
    assert isinstance(
        assess(dataclasses.replace(scenario, budget=budget), candidate, car, 1), Tuning
    )


def test_the_box():
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


def refusals_for(*settings: str, share: float = 0.2, spare: int = 1) -> NoTuningError:
    with pytest.raises(NoTuningError) as raised:
        found_for(*settings, share=share, spare=spare)
    assert raised.value.refusals.total() == len(SMALL)
    assert raised.value.exit_status == 1
    return raised.value


def test_the_limit_of_x_diff_that_no_tuning_can_meet_is_named_with_what_is_needed():
    """22 m/s, 1750 kg: what the worst vertex needs, by a linear equation at rest."""
    heavy = ("plant.speed_mps=22", "plant.mass_kg=1750", "tick_s=0.002")
    error = refusals_for(*heavy, "limits.force_difference_n=4000.0")
    assert error.refusals == Counter({Refusal.FORCE_LIMIT: len(SMALL)})
    nominal = scenario_of(*heavy).model
    box = parameter_ranges(nominal, 0.2)
    needed = 0.0
    for at in np.ndindex(2, 2, 2, 2):
        values = {key: ends[end] for end, (key, ends) in zip(at, box.items(), strict=True)}
        plant = continuous_plant(dataclasses.replace(nominal, **values))
        gain = -plant.c @ np.linalg.solve(plant.a, plant.b[:, 1])  # 0 = A x + b u, y = C x
        needed = max(needed, 1.0 / abs(gain.item()))
    assert 4000.0 < needed < 5000.0
    said = (
        "limits.force_difference_n = 4000 must be larger: the most demanding car needs "
        f"{needed:.4g} N to hold the step"
    )
    assert said in error.advice
    assert said in str(error)
    assert "\n" not in str(error)


def test_what_is_refused_is_counted_by_the_first_test_that_it_fails():
    tiny = refusals_for(ALWAYS, share=0.0, spare=8)
    assert set(tiny.refusals) <= {Refusal.DESIGN, Refusal.NOMINAL, Refusal.NOMINAL_SPARE}
    assert tiny.refusals[Refusal.NOMINAL_SPARE] > 0
    assert "fewer --spare-ticks" in tiny.advice
    ample = found_for(ALWAYS, share=0.0, spare=0)
    assert ample.refusals[Refusal.NOMINAL_SPARE] == 0
    assert [reason for reason, _ in tiny.rows] == [
        reason.text(scenario_of().plant) for reason in Refusal if reason in tiny.refusals
    ]


def test_the_advice_is_about_the_last_test_that_any_reaches():
    scenario, nominal = scenario_of(), cars(scenario_of().model, {})

    def advised(**counts: int) -> str:
        named = {Refusal[name.upper()]: count for name, count in counts.items()}
        return advice(scenario, nominal, Counter(named))

    assert "smaller --box" in advised(nominal=900, box=1)
    assert "--spare-ticks" in advised(box=900, box_spare=1)
    torque = advised(torque_limit=3, rest=1)
    assert "limits.torque_nm = 400 must leave more room" in torque
    assert "42.5" in torque  # N m hold 1 m/s²
    free = load("thesis-step")
    assert "limits.torque_nm is not set" in advice(free, nominal, Counter([Refusal.TRANSIENT]))
    for reason in Refusal:
        assert advice(scenario, nominal, Counter([reason]))


def test_a_car_that_the_budget_does_not_know_of_is_a_false_alarm():
    error = refusals_for("budget.box=0", share=0.3)
    assert error.refusals[Refusal.FALSE_ALARM] > 0.5 * len(SMALL)
    assert "a larger budget.box" in error.advice


def test_a_limit_that_keeps_the_loop_from_resting_is_the_reason():
    """A torque limit just above what holds the step of the nominal car, and a box around that."""
    cause = refusals_for("limits.torque_nm=43.0").refusals
    assert cause[Refusal.TORQUE_LIMIT] > 0
    assert Refusal.FORCE_LIMIT not in cause
