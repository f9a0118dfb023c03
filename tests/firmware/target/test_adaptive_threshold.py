"""A car that is not the model is no fault, and a fault in such a car is found all the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from firmware_model.target.fault_decision.adaptive_threshold import (
    adapt,
    settle_threshold,
    would_exceed_threshold,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import dlsim, lfilter

from firmware_model.analysis.sampled_plant import SampledPlant, sample
from firmware_model.analysis.simulation import Trace, simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.tables import CHANGE_MEMORY_S, PEAK_MEMORY_S, build
from firmware_model.discretisation.targets import Target
from firmware_model.target import controller
from firmware_model.target.status import FaultState, Mode
from firmware_model.target.structs import FloatArray

TICK_S, LATENCY, LOST, TICKS = 1e-3, 1, 10_000, 12_000  # a step is forgotten by then
CAR = steer_by_wire()
DESIGN = design(CAR, DesignSpecification(tau_s=0.0001, tau_q_s=0.01))
STEP, SINE = np.ones(TICKS), np.sin(0.003 * np.arange(TICKS))
UNHURT = (FaultState.CLEAR, FaultState.CANNOT_TELL)


def target(share: float, **changes: object) -> Target:
    """Compensation on confirmation at once, with a threshold that no rounding reaches."""
    chosen: dict[str, object] = {"threshold": 1e-6, "on_confirmation": True, **changes}
    return Target(TICK_S, LATENCY, "zoh", model_share=share, **chosen)  # type: ignore[arg-type]


def with_gain(gain: float) -> SampledPlant:
    """The car, but for a torque that does ``gain`` times as much."""
    plant = sample(CAR, TICK_S)
    return dataclasses.replace(plant, gamma=plant.gamma * np.array([[gain, 1.0]]))


def heavy() -> Plant:
    return steer_by_wire(VehicleParameters(mass_kg=1.2 * VehicleParameters().mass_kg))


def drive(
    table_target: Target,
    plant: SampledPlant,
    reference: FloatArray = STEP,
    left: float = 1.0,
    until: int = TICKS,
) -> Trace:
    effectiveness = np.ones((len(reference), 2))
    effectiveness[LOST:until, 0] = left
    return simulate(build(DESIGN, table_target), plant, reference, effectiveness=effectiveness)


def by_scipy(trace: Trace, threshold: float) -> float:
    """The share that explains every d̂ of ``trace``: model, change and fading maximum, again."""
    late = np.concatenate([np.zeros(LATENCY), trace.command_1[:-LATENCY]])
    plant = sample(CAR, TICK_S)
    _, answer, _ = dlsim((plant.phi, plant.gamma[:, :1], plant.c[None, :], [[0.0]], TICK_S), late)

    def change(signal: FloatArray) -> FloatArray:
        return lfilter([1.0, -1.0], [1.0, -np.exp(-TICK_S / CHANGE_MEMORY_S)], signal)

    def peak(signal: FloatArray) -> FloatArray:
        age = np.arange(len(signal)) * TICK_S / PEAK_MEMORY_S
        return np.exp(np.maximum.accumulate(np.log(np.abs(signal) + 1e-300) + age) - age)

    expected, estimate = answer[:, 0], trace.fault_estimate
    shares = [
        np.maximum(np.abs(part(estimate)) - threshold, 0.0)
        / np.maximum(peak(part(expected)), 1e-12)
        for part in (lambda signal: signal, change)
    ]
    return float(np.max(shares))


@pytest.mark.long
@pytest.mark.parametrize("reference", [STEP, SINE], ids=["step", "sine"])
def test_the_share_that_is_shown_is_that_of_another_computation(reference: FloatArray) -> None:
    trace = drive(target(1e9), sample(heavy(), TICK_S), reference)
    assert trace.share_shown.max() == pytest.approx(by_scipy(trace, 1e-6), rel=1e-6)
    assert trace.share_shown.max() > 0.1


@pytest.mark.long
@settings(max_examples=20)
@given(gain=st.floats(0.6, 1.5), pace=st.floats(0.001, 0.02))
def test_a_torque_of_another_gain_shows_its_share_and_no_more(gain: float, pace: float) -> None:
    """G1' = k G1: d̂ = (1 + Q)(1 - k) G1 u1 exactly, and 1 + Q passes on no more."""
    wrong = abs(1.0 - gain)
    reference = np.sin(pace * np.arange(1500))
    for share, alarms in ((1.01 * wrong + 1e-9, False), (0.9 * wrong - 1e-3, True)):
        table = build(DESIGN, target(max(share, 0.0)))
        states = simulate(table, with_gain(gain), reference).fault_state
        if wrong > 0.01:
            assert np.isin(states, UNHURT).all() != alarms


@pytest.mark.long
@pytest.mark.parametrize("share", [0.0, 0.6, 1.25])
@pytest.mark.parametrize("left", [0.0, 0.5, 0.75])
def test_a_loss_in_a_steady_bend_is_found_at_its_first_sample(share: float, left: float) -> None:
    trace = drive(target(share), sample(CAR, TICK_S), left=left)
    assert np.isin(trace.fault_state[: LOST + 1], UNHURT).all()
    assert trace.fault_state[LOST + 1] == FaultState.CONFIRMED


@pytest.mark.long
@pytest.mark.parametrize("plant", [sample(heavy(), TICK_S), with_gain(0.75)], ids=["heavy", "weak"])
def test_so_it_is_in_another_car_and_there_is_no_alarm_before(plant: SampledPlant) -> None:
    trusting = drive(target(0.0), plant)
    assert FaultState.CONFIRMED in trusting.fault_state[:LOST]
    trace = drive(target(0.6), plant, left=0.0)
    assert np.isin(trace.fault_state[: LOST + 1], UNHURT).all()
    assert (trace.fault_state[LOST + 1 :] == FaultState.CONFIRMED).all()
    assert np.abs(trace.error[-100:]).max() < 1e-4


@pytest.mark.long
def test_in_a_turn_it_takes_until_the_loss_is_more_than_other_cars_show() -> None:
    """d̂ grows as ½ g u1 t²: no sooner than its change is the share of that of G1 u1."""
    states = drive(target(0.6), sample(CAR, TICK_S), SINE, left=0.0).fault_state
    found = int(np.argmax(states == FaultState.CONFIRMED))
    assert LOST + 1 < found < LOST + 60


@pytest.mark.long
@pytest.mark.parametrize("share", [0.6, 1.25])
@pytest.mark.parametrize("gain", [1.0, 0.8, 1.2])
def test_half_a_loss_stays_confirmed_and_a_recovery_does_not(share: float, gain: float) -> None:
    """Less is lost than a share of 0.6 allows other cars: confirmed by its change, it stays."""
    chosen = target(share, clear_ticks=300)
    stays = drive(chosen, with_gain(gain), left=0.5)
    assert (stays.fault_state[LOST + 1 :] == FaultState.CONFIRMED).all()
    assert np.abs(stays.error[-100:]).max() < 1e-4
    back = drive(chosen, with_gain(gain), left=0.5, until=LOST + 500)
    assert back.fault_state[-1] == FaultState.CLEAR
    assert np.abs(back.command_2[-1]) < 0.02 * np.abs(back.command_2).max()  # fading
    cleared = int(np.argmax(back.fault_state[LOST + 500 :] == FaultState.CLEAR)) + LOST + 500
    assert (back.fault_state[cleared:] == FaultState.CLEAR).all()


def test_after_a_reset_a_loss_is_found_at_its_first_sample() -> None:
    """A bend that has been driven for long is no change."""
    table = build(DESIGN, target(0.6))
    state = controller.init(table)[0]
    controller.reset(table, state, 1.0)
    states = []
    for y in (1.0, 1.0, 1.0 - 1e-4):
        controller.step(table, state, 1.0, y)
        states.append(state.fault_state)
    assert states == [FaultState.CLEAR, FaultState.CLEAR, FaultState.CONFIRMED]


@pytest.mark.long
def test_where_channel_1_does_little_it_cannot_tell() -> None:
    trace = drive(target(0.6), sample(CAR, TICK_S), np.where(np.arange(TICKS) < 6000, 1.0, 0.0))
    assert trace.fault_state[5999] == FaultState.CLEAR
    assert trace.fault_state[-1] == FaultState.CANNOT_TELL


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_changes_that_leave_the_numbers_are_forgotten(precision: str) -> None:
    huge = 3e38 if precision == "float32" else 1.5e308
    table = build(DESIGN, target(0.6, precision=precision, threshold=1e-3))
    state = controller.init(table)[0]
    with np.errstate(all="ignore"):
        for y in (0.0, huge, -huge, huge, *[0.0] * 3000):
            controller.step(table, state, 0.0, y)
            watched = state.adaptive_threshold
            assert np.isfinite(
                [watched.change, watched.model_change, watched.peak_model_output]
            ).all()
    assert state.mode == Mode.RUN


def test_its_memories_are_a_high_pass_and_fading_maxima() -> None:
    """Of noise with an offset, from a settled start, against scipy's filter and a plain maximum."""
    table = build(DESIGN, target(0.6))
    constants, of = table.adaptive_threshold, controller.init(table)[0].adaptive_threshold
    estimate, output = np.random.default_rng(2).standard_normal((2, 300))
    output += 3.0
    settle_threshold(of, 3.0)
    seen = []
    for d, y in zip(estimate, output, strict=True):
        adapt(constants, of, d, y, False)
        seen.append((of.change, of.model_change, of.peak_model_output, of.peak_model_change))
    memory, fading = np.exp(-TICK_S / CHANGE_MEMORY_S), np.exp(-TICK_S / PEAK_MEMORY_S)
    change = lfilter([1.0, -1.0], [1.0, -memory], estimate)
    model_change = lfilter([1.0, -1.0], [1.0, -memory], output - 3.0)
    peaks = [
        [max(abs(signal[: k + 1]) * fading ** np.arange(k, -1, -1.0)) for k in range(300)]
        for signal in (output, model_change)
    ]
    peaks[0] = np.maximum(peaks[0], 3.0 * fading ** np.arange(1.0, 301.0)).tolist()
    expected = np.stack([change, model_change, *peaks], axis=1)
    np.testing.assert_allclose(seen, expected, rtol=1e-9, atol=1e-12)


def test_a_confirmed_loss_is_no_evidence_of_another() -> None:
    """Its own change, or that of its end, takes part in the peak that later ones must exceed."""
    table = build(DESIGN, target(0.6))
    constants, of = table.adaptive_threshold, controller.init(table)[0].adaptive_threshold
    settle_threshold(of, 1.0)
    adapt(constants, of, 0.5, 1.0, True)
    assert of.peak_model_change == 0.5
    adapt(constants, of, -2.0, 1.0, False)
    assert of.peak_model_change < 0.5


@pytest.mark.parametrize("ratio", [0.0, 0.25, 0.9])
@pytest.mark.parametrize("share", [0.0, 0.6])
def test_how_much_of_a_loss_would_show(share: float, ratio: float) -> None:
    """In a transient the loss has to exceed the threshold in size, or by its change."""
    table = build(DESIGN, target(share, threshold=0.01, clear_ratio=ratio))
    constants, of = table.adaptive_threshold, controller.init(table)[0].adaptive_threshold
    of.peak_model_output, of.peak_model_change = 1.0, 0.1
    by_size = 0.01 + share
    by_change = (0.01 + share * 0.1) / ratio if ratio > 0.0 and share > 0.0 else np.inf
    least = min(by_size, by_change)
    assert would_exceed_threshold(constants, of, -1.001 * least)
    assert not would_exceed_threshold(constants, of, 0.999 * least)
