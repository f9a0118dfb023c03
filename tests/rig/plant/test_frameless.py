"""The loop without frames is the run on a bus, to the last bit of every signal."""

import dataclasses
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from can_rig.logs.columns import ON_THE_BUS
from can_rig.plant import in_windows
from can_rig.plant.frameless import frameless, inputs_of
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.fault_settings import OF_FURTHER_SENSORS, PLACES, RESTARTED, FaultKind
from can_rig.scenario.loading import load
from can_rig.scenario.sensor_settings import ECHOES, MEASURED
from firmware_model.analysis.simulation import Trace
from firmware_model.discretisation.schedules import Scheduled
from firmware_model.law.status import Mode
from tests.helpers import on_no_bus, record
from tests.rig.plant.failing import FAILING
from tests.rig.plant.fault_settings import fault_list

KINDS = [kind for kind in get_args(FaultKind) if kind != "none"]
NONLINEAR = "plant.kind=can_rig.plant.nonlinear_car:NonlinearCar"
LINEAR = "plant.kind=tests.rig.plant.linear:LinearPlant"


def compared(folder: Path, name: str, *settings: str) -> Trace:
    """A scenario on a bus, without frames, and without a bus: the same signals and bytes."""
    log, _, scenario = record(folder, *settings, name=name)
    network = network_of(scenario)
    bus, loop = read_signals(log, network, scenario.tick_s), signals_without_log(scenario)
    for column in ON_THE_BUS:
        np.testing.assert_array_equal(getattr(bus, column), getattr(loop, column), column)
    trace = frameless(scenario)
    assert len(bus) == scenario.ticks == len(trace.measured)
    np.testing.assert_array_equal(trace.measured, bus.dstar_mps2)
    if not any(fault.needs_a_bus for fault in scenario.faults):
        other = folder / "other.log"
        on_no_bus(scenario, other)
        assert other.read_bytes() == log.read_bytes()
    return trace


def drawn(seed: int, sensed: bool = False) -> list[str]:
    """Up to four faults with every key drawn, in 0.2 s, perhaps of further sensors too."""
    draw = np.random.default_rng(seed)
    settings = ["duration_s=0.2", f"seed={seed}", "reference.kind=sine"]
    settings += ["reference.frequency_rad_per_s=30", f"latency_ticks={draw.integers(3)}"]
    settings += [f"actuator.hold_s={draw.integers(20) / 1000}"]
    settings += ["plant.torque_actuator.rate_nm_per_s=20000"] if seed % 3 == 0 else []
    settings += [NONLINEAR] if seed % 4 == 0 else []
    faults: list[dict[str, object]] = []
    for at in range(int(draw.integers(1, 5))):
        kind = str(draw.choice(KINDS)) if at else KINDS[seed % len(KINDS)]
        places = [*PLACES[:2]]
        if sensed and not kind.startswith(("actuator-", "controller-")):
            places += ECHOES if kind == "sensor-lying" else MEASURED
        places += ["sensor"] if kind.startswith("frames-") else []
        places = [each for each in places if each in MEASURED or kind not in OF_FURTHER_SENSORS]
        if not places:
            continue
        channel = str(draw.choice(places))
        values = {
            "kind": kind, "channel": channel, "at_s": int(draw.integers(150)) / 1000,
            "for_s": int(draw.integers(1, 150)) / 1000,
            "every": 1 if kind == RESTARTED else int(draw.choice([1, 1, 1, 2, 7])),
            "left": int(draw.integers(10)) / 10, "bias_mps2": 0.05, "offset": float(draw.normal()),
            "drift_per_s": float(10 * draw.normal()), "amplitude": float(draw.normal()),
            "rate_per_s": float(draw.uniform(0.1, 300)), "late_ticks": int(draw.integers(1, 30)),
        }  # fmt: skip
        values["gain"] = float(draw.choice([-1.0, 57.3]))
        if kind == "sensor-swapped":
            values["other"] = str(draw.choice([each for each in MEASURED if each != channel]))
        if draw.random() < 0.5 or kind == "frames-forged":
            values["value"] = float(draw.normal())
        faults.append(values)
    return settings + fault_list(*faults)


@pytest.mark.parametrize("seed", range(12))
def test_any_list_of_faults(seed, tmp_path):
    assert np.isfinite(
        compared(tmp_path, "noisy" if seed % 2 else "ideal", *drawn(seed)).fault_estimate
    ).all()


@pytest.mark.parametrize("seed", range(len(KINDS)))
def test_any_list_of_faults_beside_a_controller_that_hears_the_further_sensors(seed, tmp_path):
    hears = ["controller.kind=tests.rig.nodes.hearing:Hearing", "sensor.1.period_s=0.003"]
    compared(tmp_path, "cluster", *drawn(seed, sensed=True), *hears, "sensor.2.delay_s=0.004")


@pytest.mark.parametrize(
    "faults",
    [
        [{"kind": "sensor-lying", "channel": each, "at_s": 0.05} for each in ECHOES],
        [
            {"kind": "sensor-swapped", "channel": ECHOES[0], "other": ECHOES[1], "at_s": 0.05},
            {"kind": "sensor-biased", "channel": "steering-angle", "at_s": 0.3, "offset": 1.0},
        ],
        [
            {"kind": "sensor-late", "channel": "torque-echo", "at_s": 0.05, "late_ticks": 13},
            {"kind": "sensor-tick-stuck", "channel": "yaw-rate", "at_s": 0.04},
            {"kind": "sensor-invalid", "channel": "force-difference-echo", "at_s": 0.2},
        ],
        [{"kind": "frames-missing", "channel": "torque-echo", "at_s": 0.1, "for_s": 0.3}],
        [{"kind": RESTARTED, "at_s": 0.15, "for_s": 0.02}],
        [{"kind": RESTARTED, "at_s": 0.15, "for_s": 0.02, "state_survives": "true"}],
    ],
)
def test_our_law_hears_further_sensors_with_faults(faults, tmp_path):
    its = ["duration_s=0.5", "sensor.1.delay_s=0.004", "sensor.2.period_s=0.007"]
    dead = {"kind": "actuator-dead", "channel": "torque", "at_s": 0.1}
    found = compared(tmp_path, "cluster", *its, *fault_list(dead, *faults))
    others = fault_list(dead), ["fault.kind=none"]
    for name, other in zip(("cluster", "default"), others, strict=True):
        alone = frameless(load(name, ["duration_s=0.5", *other]))
        assert not np.array_equal(found.fault_state, alone.fault_state)


@pytest.mark.parametrize("at_s", [0.1, 0.5])
@pytest.mark.parametrize("kind", ["actuator-dead", "frames-forged"])
def test_a_loop_in_windows_is_the_whole_one(kind, at_s, monkeypatch):
    """Also where the values of other frames come in some windows only."""
    monkeypatch.setattr(in_windows, "BLOCK_TICKS", 97)
    monkeypatch.setattr(in_windows, "WINDOW_TICKS", 194)
    fault = {"kind": kind, "channel": "torque", "at_s": at_s, "for_s": 0.05, "value": 9.0}
    scenario = load("cluster", ["duration_s=0.7", *fault_list(fault)])
    whole = frameless(scenario)
    for ticks, loop, rows in in_windows.blocks_of(scenario):
        found = loop.trace.evidence[rows]
        np.testing.assert_array_equal(found, whole.evidence[ticks.start : ticks.stop])


def test_a_controller_that_begins_again_knows_no_frame_of_a_sensor(tmp_path):
    """The frame after fourteen missing ones has the counter of the last."""
    missing = {"kind": "frames-missing", "channel": "yaw-rate", "at_s": 0.05, "for_s": 0.014}
    outage = {"kind": RESTARTED, "at_s": 0.055, "for_s": 0.009}
    hears = ["controller.kind=tests.rig.nodes.hearing:Hearing", "sensor.0.period_s=0.001"]
    trace = compared(tmp_path, "cluster", "duration_s=0.1", *fault_list(missing, outage), *hears)
    assert len(trace.measured) == 100


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("default", ["fault.kind=actuator-dead"]),
        ("noisy", ["fault.kind=sensor-biased", "fault.for_s=0.05"]),
        ("slow-bus", ["fault.kind=frames-missing", "fault.for_s=0.06"]),
        ("partial-loss", ["fault.kind=actuator-dead"]),
        ("lane-change", ["latency_ticks=3", "fault.kind=frames-corrupted", "fault.for_s=0.02"]),
        ("chapter-2", ["fault.kind=actuator-dead"]),
        ("default", ["fault.kind=frames-missing", "fault.for_s=0.06", "actuator.hold_s=0.043"]),
        # the counter's 15
        ("default", ["fault.kind=frames-missing", "fault.for_s=0.014", "actuator.hold_s=0.004"]),
        ("default", ["fault.kind=frames-missing", "actuator.hold_s=0.0069999999"]),
        ("thesis-step", ["reference.amplitude_mps2=21"]),  # D* reaches the end of its frame
        ("thesis-step", ["limits.torque_nm=30", "limits.torque_rate_nm_per_s=900"]),
        ("thesis-step", [LINEAR, "plant.force_difference_actuator.rate_n_per_s=900"]),
    ],
)
def test_every_kind_of_scenario(name, settings, tmp_path):
    compared(tmp_path, name, "duration_s=0.25", "fault.kind=none", "fault.at_s=0.1", *settings)


@pytest.mark.parametrize("kind", ["plant.kind=steer-by-wire", LINEAR])
def test_lags_limits_and_a_real_sensor(kind, tmp_path):
    settings = [
        kind, "duration_s=0.6", "fault.at_s=0.3", "latency_ticks=2",
        "design.alpha=3", "design.alpha_q=4", "design.tau_s=0.01", "design.tau_q_s=0.02",
        "plant.torque_actuator.lag_s=0.005", "plant.torque_actuator.dead_time_s=0.0015",
        "plant.torque_actuator.rate_nm_per_s=20000",
        "plant.force_difference_actuator.lag_s=0.015",
        "plant.force_difference_actuator.limit_n=1000",
        "plant.sensor.corner_hz=50", "plant.sensor.dead_time_s=0.0012",
        "plant.sensor.noise_mps2=0.01", "plant.sensor.resolution_mps2=0.005",
    ]  # fmt: skip
    trace = compared(tmp_path, "default", "fault.kind=actuator-dead", *settings)
    assert np.abs(trace.command_2).max() > 100.0
    assert np.abs(trace.measured - trace.measurement).max() > 0.01  # the sensor is not perfect


@pytest.mark.parametrize("kind", sorted({*KINDS} - {*OF_FURTHER_SENSORS}))
def test_every_kind_of_fault_changes_the_run(kind):
    needed = ["fault.value=0.5", "fault.offset=1", "fault.drift_per_s=9", "fault.amplitude=1"]
    needed += ["fault.gain=-1"]
    settings = ["duration_s=0.1", "reference.kind=sine", "fault.rate_per_s=1", *needed]
    settings += ["fault.for_s=0.02"] if kind == RESTARTED else []
    scenario = load("ideal", [*settings, f"fault.kind={kind}", "fault.at_s=0.05"])
    faulty, healthy = (signals_without_log(each) for each in (scenario, scenario.healthy))
    assert not np.array_equal(faulty.plant["true_dstar_mps2"], healthy.plant["true_dstar_mps2"])


def test_a_table_and_inputs_of_one_s_own_are_used():
    short = ["duration_s=0.04", "reference.kind=sine", "fault.kind=none"]
    scenario = load("thesis-step", short)
    network = network_of(scenario)
    inputs = inputs_of(scenario, network)
    zero = dataclasses.replace(inputs, reference=0.0 * inputs.reference)
    assert not frameless(scenario, inputs=zero).command_1.any()
    other = load("thesis-step", [*short, "design.tau_s=0.02"])
    slower = frameless(scenario, Scheduled(None, controller_table(other, network)))
    assert slower.command_1.tolist() == frameless(other).command_1.tolist()
    assert slower.command_1.tolist() != frameless(scenario).command_1.tolist()


def test_a_plant_that_has_failed_says_nothing_any_more_and_the_controller_holds():
    """Not even where its next call would have answered."""
    failing = [FAILING, "plant.parameters.calls=18", "design.tau_s=0.05", "design.tau_q_s=0.05"]
    scenario = load("thesis-step", ["duration_s=0.04", "reference.kind=sine", *failing])
    trace = frameless(scenario)
    assert np.isfinite(trace.measured).tolist() == [True] * 19 + [False] * 21
    assert (trace.mode[19:] == Mode.BLIND).all()
    assert (trace.command_1[19:] == trace.command_1[18]).all()
