"""The law on plants that are not stable: its loop against python-control, drives by hand."""

from dataclasses import replace

import control
import numpy as np
import pytest

from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, law_in
from firmware_model.analysis.sampled_loop import sampled_loop
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import Plant, steer_by_wire
from firmware_model.design.vehicle import TABLE_3_2
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.sections import Sections
from firmware_model.discretisation.tables import build, discretise
from firmware_model.discretisation.targets import Target
from firmware_model.firmware import Firmware
from tests.firmware.discretisation.test_coprime import (
    PENDULUM,
    SATELLITE,
    SWINGING,
    TICK_S,
    WEAVING,
)

SPECIFICATION = DesignSpecification(tau_s=0.005, alpha=2, tau_q_s=0.05, alpha_q=3)
OVERSTEERING = steer_by_wire(
    replace(
        TABLE_3_2,
        front_axle_distance_m=1.4,
        rear_axle_distance_m=1.2,
        front_cornering_stiffness_n_per_rad=50e3,
        rear_cornering_stiffness_n_per_rad=40e3,
        steering_damping_nms_per_rad=1000.0,
        speed_mps=45.0,
    )
)
TARGET = Target(TICK_S, estimator="zoh")
ANY = [PENDULUM, WEAVING, SATELLITE, SWINGING]


def cascade(sections: Sections) -> control.StateSpace:
    """A filter as python-control has it."""
    whole = control.ss([], [], [], 1.0, TICK_S)
    for row in sections.sos:
        whole = control.tf2ss(control.tf(row[:3], row[3:], TICK_S)) * whole
    return whole


def named(system: control.StateSpace, name: str, entry: str, output: str) -> control.StateSpace:
    return control.ss(system, inputs=[entry], outputs=[output], name=name)


def held_by(stabiliser: control.StateSpace) -> control.StateSpace:
    return control.feedback(control.ss([], [], [], 1.0, TICK_S), stabiliser, sign=1)


def loop_by_control(plant: Plant, target: Target, left: tuple[float, float]) -> np.ndarray:
    """Poles of the loop of the discretised filters, put together by names."""
    made = design(plant, SPECIFICATION)
    filters = discretise(made, target)
    assert filters.stabiliser is not None
    held = control.c2d(control.ss(plant.a, plant.b * left, plant.c, 0.0), TICK_S)
    blocks = [
        control.ss(held, inputs=["u1", "u2"], outputs=["y"], name="plant"),
        named(cascade(filters.tracking), "U", "w", "v"),
        named(held_by(cascade(filters.stabiliser)), "1/(1 - R)", "v", "u1"),
        named(cascade(filters.estimator_1), "N1", "u1", "n1"),
        named(cascade(filters.estimator_2), "N2", "u2", "n2"),
        named(cascade(filters.measurement), "M", "y", "m"),
        named(cascade(filters.compensator), "F", "d", "u2"),
        control.summing_junction(["r", "-y", "n1"], "w", name="error"),
        control.summing_junction(["n1", "n2", "-m"], "d", name="residual"),
    ]
    loop = control.interconnect(blocks, inplist=["r"], outlist=["y"])
    return np.asarray(loop.poles())


@pytest.mark.parametrize("left", [HEALTHY, TORQUE_DEAD])
@pytest.mark.parametrize("plant", ANY, ids=[plant.name for plant in ANY])
def test_the_loop_is_python_controls_and_stable(plant, left):
    specification = SPECIFICATION
    table = build(design(plant, specification), TARGET)
    loop = sampled_loop(law_in(table, left), plant, TICK_S, left)
    own, expected = np.abs(loop.poles()), np.abs(loop_by_control(plant, TARGET, left))
    assert own.max() < 1.0
    assert own.max() == pytest.approx(expected.max(), abs=1e-6)
    assert np.prod(own[own > 0.5]) == pytest.approx(np.prod(expected[expected > 0.5]), rel=1e-4)


@pytest.mark.compiled
@pytest.mark.parametrize("latency", [0, 2])
@pytest.mark.parametrize("plant", [PENDULUM, OVERSTEERING, SATELLITE], ids=lambda plant: plant.name)
def test_the_loss_of_channel_1_is_carried(plant, latency):
    """d̂ is silent to rounding, the step is followed as T says, and channel 2 alone holds it."""
    made = design(plant, SPECIFICATION)
    assert made.tracking is not None
    ticks = 2500
    left = np.ones((ticks, 2))
    left[ticks // 2 :, 0] = 0.0
    table = build(made, replace(TARGET, latency_ticks=latency))
    run = simulate(table, sample(plant, TICK_S), np.ones(ticks), effectiveness=left)
    healthy, lost = run.measurement[: ticks // 2], run.measurement[ticks // 2 :]
    assert np.abs(run.fault_estimate[: ticks // 2]).max() < 1e-9
    step = control.zpk(
        made.tracking.complementary.zeros,
        made.tracking.complementary.poles,
        made.tracking.complementary.gain,
    )
    _, expected = control.step_response(step, np.arange(ticks // 2) * TICK_S)
    apart = healthy[latency:] - expected[: ticks // 2 - latency]
    assert np.abs(apart).max() < 0.07 * np.abs(expected).max()  # T knows of no hold
    assert abs(healthy[-1] - 1.0) < 1e-3
    assert np.abs(lost - 1.0).max() < 0.15 and abs(lost[-1] - 1.0) < 1e-4


def test_without_compensation_the_loss_runs_away():
    table = build(design(PENDULUM, replace(SPECIFICATION, compensation=False)), TARGET)
    loop = sampled_loop(law_in(table, TORQUE_DEAD), PENDULUM, TICK_S, TORQUE_DEAD)
    assert loop.spectral_radius() == pytest.approx(np.exp(3.0 * TICK_S), rel=1e-9)


@pytest.mark.parametrize("plant", [PENDULUM, SATELLITE], ids=lambda plant: plant.name)
def test_reset_is_the_steady_state_of_its_first_ticks(plant):
    firmware = Firmware(build(design(plant, SPECIFICATION), TARGET))
    firmware.reset(0.7)
    assert firmware.commands[0] == pytest.approx(0.7 / plant.g1.dc_gain, rel=1e-9)
    for _ in range(3):
        answer = firmware.step(0.7, 0.7)
        assert answer.command_1 == pytest.approx(firmware.commands[0], abs=1e-9)
        assert abs(answer.fault_estimate) < 1e-12


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [PENDULUM, SATELLITE], ids=lambda plant: plant.name)
def test_reset_is_bumpless_and_a_gap_of_ticks_bears_the_motion(plant):
    """A plant that integrates is held at any place by no command at all."""
    firmware = Firmware(build(design(plant, SPECIFICATION), TARGET))
    firmware.reset(0.7)
    before = firmware.commands
    assert before[0] == pytest.approx(0.7 / plant.g1.dc_gain, rel=1e-9)
    answers = [firmware.step(0.7, 0.7) for _ in range(300)]
    assert np.ptp([answer.command_1 for answer in answers]) < 1e-9 * max(abs(before[0]), 1.0)
    assert max(abs(answer.fault_estimate) for answer in answers) < 1e-12
    # In motion, ten ticks without a measurement: M goes on with what the model expects of it.
    held, x = sample(plant, TICK_S), np.zeros(len(plant.a))
    firmware.reset(0.0)
    estimates = []
    for k in range(200):
        y = float(held.c @ x)
        missing = 60 <= k < 70
        answer = firmware.step(1.0, np.nan if missing else y)
        estimates.append(answer.fault_estimate)
        x = held.phi @ x + held.gamma @ [answer.command_1, answer.command_2]
    assert np.abs(estimates).max() < 1e-9


def test_a_zero_in_the_right_half_plane_and_gains_of_either_sign():
    plant = Plant.from_transfer_functions(
        "right zero", ZeroPoleGain((40,), (2, -5, -9), -3.0), ZeroPoleGain((), (2, -7), -4.0)
    )
    table = build(design(plant, replace(SPECIFICATION, tau_q_s=0.1)), TARGET)
    for left in (HEALTHY, TORQUE_DEAD):
        assert sampled_loop(law_in(table, left), plant, TICK_S, left).spectral_radius() < 1.0
