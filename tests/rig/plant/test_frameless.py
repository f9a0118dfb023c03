"""The loop without frames is the run on a bus, to the last bit of every signal."""

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.plant.faults.delivery import delivery
from can_rig.plant.frameless import frameless
from can_rig.plant.sensor import SensorNoise, noise
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from firmware_model.target.status import Mode
from tests.helpers import record

LAG = """
class Lag:
    def __init__(self, settings): self.reset()
    def reset(self): self.dstar_mps2 = 0.0
    def advance(self, dt_s, torque_nm, force_difference_n):
        target_mps2 = 0.02 * torque_nm + 3e-4 * force_difference_n
        self.dstar_mps2 += (target_mps2 - self.dstar_mps2) * min(1.0, dt_s / 0.1)
        return self.dstar_mps2
"""
NONLINEAR = "can_rig.plant.nonlinear_car:NonlinearCar"
SINE = ["reference.kind=sine", "reference.frequency_rad_per_s=20"]
FAULTS = [
    [],
    ["fault.kind=actuator-dead", "fault.left=0.3"],
    ["fault.kind=actuator-dead", "fault.channel=force-difference", "fault.for_s=0.05"],
    ["fault.kind=frames-missing", "fault.for_s=0.014", "actuator.hold_s=0.004"],  # the counter's 15
    ["fault.kind=frames-missing", "fault.channel=force-difference", "actuator.hold_s=0"],
    ["fault.kind=frames-corrupted", "fault.for_s=0.03", "actuator.hold_s=0.005"],
    ["fault.kind=sensor-biased", "fault.bias_mps2=0.05"],
]


def compared(tmp_path, name, *settings):
    """Both ways of running a scenario; where they differ in what the bus carried."""
    settings = ["duration_s=0.25", "fault.kind=none", "fault.at_s=0.1", *settings]
    log, _, scenario = record(tmp_path, *settings, name=name)
    network = network_of(scenario)
    signals, trace = read_signals(log, network, scenario.tick_s), frameless(scenario, network)
    assert len(signals) == scenario.ticks == len(trace.measured)
    estimate = [network.status.quantise(d) for d in trace.fault_estimate.tolist()]
    pairs = {
        "reference": (signals.reference_mps2, trace.reference),
        "D*": (signals.dstar_mps2, trace.measured),
        "torque": (signals.torque_nm, trace.command_1),
        "force": (signals.force_difference_n, trace.command_2),
        "estimate": (signals.fault_estimate_mps2, estimate),
        "mode": (signals.mode, trace.mode),
        "fault state": (signals.fault_state, trace.fault_state),
    }
    arrives = delivery(scenario, network).used
    for at, command in enumerate(("torque", "force")):
        there = np.isfinite(pairs[command][0])
        assert there[arrives[:, at]].all()  # every one that acted is in the log
        pairs[command] = tuple(np.asarray(side)[there] for side in pairs[command])
    for bus, loop in pairs.values():
        np.testing.assert_array_equal(bus, loop)
    return trace


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: " ".join(fault) or "none")
@pytest.mark.parametrize("kind", ["steer-by-wire", NONLINEAR])
def test_every_kind_of_fault(kind, fault, tmp_path):
    trace = compared(tmp_path, "thesis-step", f"plant.kind={kind}", *SINE, *fault)
    assert np.abs(trace.measured).max() > 0.1


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("default", ["fault.kind=actuator-dead"]),
        ("noisy", ["fault.kind=actuator-dead", "seed=3"]),
        ("noisy", ["fault.kind=sensor-biased", "fault.for_s=0.05"]),
        ("slow-bus", ["fault.kind=frames-missing", "fault.for_s=0.06"]),
        ("partial-loss", ["fault.kind=actuator-dead"]),
        ("lane-change", ["latency_ticks=3", "fault.kind=frames-corrupted", "fault.for_s=0.02"]),
        ("chapter-2", ["fault.kind=actuator-dead"]),
        ("default", ["fault.kind=frames-missing", "fault.for_s=0.06", "actuator.hold_s=0.043"]),
        ("thesis-step", ["reference.amplitude_mps2=21"]),  # D* reaches the end of its frame
        ("thesis-step", ["limits.torque_nm=30", "limits.torque_rate_nm_per_s=900"]),
    ],
)
def test_every_kind_of_scenario(name, settings, tmp_path):
    compared(tmp_path, name, *settings)


def test_noise_is_drawn_in_units_of_its_rms():
    quiet, loud = (load("noisy", [f"plant.sensor.noise_mps2={rms}"]) for rms in (0.5, 1.0))
    np.testing.assert_array_equal(noise(loud), 2.0 * noise(quiet))
    assert abs(np.std(noise(loud)) - 1.0) < 0.1
    silent = load("noisy", ["plant.sensor.noise_mps2=0"])
    assert not noise(silent).any()
    assert noise(silent).shape == noise(loud).shape == (loud.ticks,)


@pytest.mark.parametrize("corner_hz", [None, 40.0])
def test_noise_of_a_run_is_drawn_as_tick_by_tick(corner_hz):
    filtered = [] if corner_hz is None else [f"plant.sensor.corner_hz={corner_hz}"]
    scenario = load("noisy", ["duration_s=0.3", "seed=5", "design.tau_q_s=0.02", *filtered])
    drawn = SensorNoise(scenario)
    assert noise(scenario).tolist() == [drawn.next() for _ in range(scenario.ticks)]


def test_both_commands_of_every_tick_arrive_or_not():
    scenario = load("thesis-step", ["fault.kind=frames-missing", "fault.channel=force-difference"])
    arrives = delivery(scenario, network_of(scenario)).used
    assert arrives.shape == (scenario.ticks, 2)
    assert arrives[:, 0].all()
    assert not arrives[:, 1].all()


def test_a_class_of_one_s_own(tmp_path):
    (tmp_path / "lagging_car.py").write_text(LAG)
    trace = compared(tmp_path, "default", "plant.kind=lagging_car:Lag", "fault.kind=actuator-dead")
    assert np.abs(trace.measured).max() > 0.01


def test_a_plant_that_fails_is_held_from_then_on(tmp_path):
    (tmp_path / "brief_car.py").write_text(
        LAG.replace("Lag", "Brief")
        .replace("self.dstar_mps2 = 0.0", "self.dstar_mps2 = 0.0; self.n = 0")
        .replace(
            "        return", "        self.n += 1\n        assert self.n != 31\n        return"
        )
    )
    scenario = load("thesis-step", ["duration_s=0.1", "plant.kind=brief_car:Brief"])
    trace = frameless(scenario, network_of(scenario))
    assert np.isfinite(trace.measured[:31]).all()
    assert np.isnan(trace.measured[31:]).all()
    assert (trace.mode[31:] == Mode.HOLD).all()
    assert (trace.command_1[31:] == trace.command_1[30]).all()


@pytest.mark.parametrize("kind", ["steer-by-wire", "tests.rig.plant.linear:LinearPlant"])
def test_it_is_the_run_on_the_bus_behind_lags_limits_and_a_real_sensor(kind, tmp_path):
    settings = [
        f"plant.kind={kind}", "duration_s=0.6", "fault.at_s=0.3", "latency_ticks=2",
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
