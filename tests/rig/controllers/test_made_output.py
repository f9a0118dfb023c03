"""A car without a sensor of D*: the controller makes D* of yaw rate and lateral acceleration."""

from pathlib import Path

import can
import cantools
import numpy as np
import pytest

from can_rig.controllers.making import controller_of
from can_rig.plant.frameless import frameless
from can_rig.results.isolation import with_verdict
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from tests.helpers import DBC, on_a_bus, on_no_bus, refuses

MADE = (
    "plant.sensor.is_made=true", "plant.sensor.corner_hz=50", "design.alpha=4", "design.alpha_q=5",
)  # fmt: skip
ALONE = ["design.supervision=none", "design.compensation=always"]
SHORT = ("duration_s=6", "fault.at_s=3")


def made(*settings: str) -> Scenario:
    return load("chassis-cluster", [*MADE, *SHORT, *settings])


def logged(folder: Path, scenario: Scenario, controller: str) -> Path:
    """A run's log; ``none`` is the rig's own law without a bus."""
    log = folder / f"{controller}.log"
    if controller == "none":
        on_no_bus(scenario, log)
    else:
        law = controller_of(controller, scenario)
        on_a_bus(scenario, log, law)
    return log


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_every_loop_has_the_same_bytes(tmp_path, precision):
    scenario = made(f"design.precision={precision}")
    logs = [logged(tmp_path, scenario, each) for each in ("none", "python", "c", "ecu")]
    first, *others = (log.read_bytes() for log in logs)
    assert all(other == first for other in others)
    network = network_of(scenario)
    seen = read_signals(logs[0], network, scenario.tick_s)
    trace = frameless(scenario)
    np.testing.assert_array_equal(seen.torque_nm[:-1], trace.command_1[:-1])
    assert 2 in seen.fault_state  # CONFIRMED
    assert np.isnan(seen.dstar_mps2).all()


def test_no_loop_has_a_sensor_of_the_output_in_a_healthy_run_either(tmp_path):
    scenario = made("fault={kind='none'}")
    network = network_of(scenario)
    log, other = (logged(tmp_path, scenario, each) for each in ("none", "python"))
    assert log.read_bytes() == other.read_bytes()
    seen = read_signals(log, network, scenario.tick_s)
    trace = frameless(scenario)
    np.testing.assert_array_equal(seen.torque_nm, trace.command_1)
    assert np.isnan(trace.measured).all()


def test_what_the_pictures_show_is_what_the_frames_of_both_sensors_make(tmp_path):
    scenario, database = made(), cantools.database.load_file(DBC / "steer_by_wire.dbc")
    log, network = logged(tmp_path, scenario, "none"), network_of(scenario)
    shown = with_verdict(scenario, network, read_signals(log, network, scenario.tick_s)).dstar_mps2
    said: dict[str, list[float]] = {"YAW_RATE": [], "LATERAL_ACCELERATION": []}
    for message in can.LogReader(log):
        frame = database.get_message_by_frame_id(message.arbitration_id)
        if frame.name in said:
            values = frame.decode(bytes(message.data))
            (signal,) = (each for each in frame.signals if each.unit in {"rad/s", "m/s^2"})
            said[frame.name].append(float(values[signal.name]))
    turning, lateral = (np.array(said[name]) for name in said)
    weight, speed = scenario.plant.lateral_weight, scenario.plant.speed_mps
    np.testing.assert_allclose(shown, weight * lateral + (1 - weight) * speed * turning, atol=1e-12)
    assert np.abs(shown).max() > 0.5


def test_a_wrong_sensor_is_a_wrong_output():
    """Both sensors of one car: a bias of either sensor and a lost actuator look alike."""
    fault = "fault={kind='sensor-biased', channel='yaw-rate', at_s=2, offset=0.05}"
    scenario = made(fault)
    trace = frameless(scenario)
    off = (1 - scenario.plant.lateral_weight) * scenario.plant.speed_mps * 0.05
    settled = slice(-50, None)
    error = trace.measurement[settled].mean() - trace.reference[settled].mean()
    assert error == pytest.approx(-off, abs=0.02)


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("chassis-can", [], "plant.sensor.is_made: must be false without the sensors 'yaw-rate'"),
        ("chapter-2", [], "plant.sensor.is_made: must be false without the sensors 'yaw-rate' and"),
        ("chassis-cluster", ["sensor.0.period_s=0.02"], "or both sensors have period_s = 0.01, a"),
        ("chassis-cluster", ["sensor.1.delay_s=0.01"], "a tick, and the same delay_s"),
        ("chassis-cluster", ["sensor.1.corner_hz=20"], "or both sensors have the same corner_hz"),
        ("chassis-cluster", ["plant.sensor.corner_hz=20"], "sensor.corner_hz: must be 50, as"),
        ("chassis-cluster", ["plant.sensor.dead_time_s=0.1"], "sensor.dead_time_s: must be 0"),
        ("chassis-cluster", ALONE, "for design.supervision = 'none'"),
        ("chassis-cluster", ["model.sensor.is_made=false"], "sensor.is_made: must be left to"),
        ("chassis-cluster", ["fault.kind=sensor-dead"], "fault: must be of 'yaw-rate' or"),
    ],
)  # fmt: skip
def test_what_cannot_be_made_is_refused(name, settings, said):
    with refuses(said):
        load(name, [*MADE, *settings])
