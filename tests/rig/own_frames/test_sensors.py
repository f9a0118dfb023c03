"""Further sensors on the user's frames: in the database's units, by cantools."""

import math
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from can_rig.errors import DbcError, ScenarioError
from can_rig.logs.columns import ON_THE_BUS
from can_rig.nodes.bus_access import StopRequest
from can_rig.results.counterfactual import signals_without_log
from can_rig.results.execution import Options, execute, two_processes
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load_values
from can_rig.scenario.sensor_settings import ECHOES
from can_rig.scenario.settings import Scenario
from tests.rig.own_frames.scenarios import CALM, ESP12, MOTOROLA, SIGNALS

OF_A_CAR = f"""{ESP12}
BO_ 1311 ESP13: 4 VMC
 SG_ LAT_ACCEL : 7|16@0- (0.001,0) [-2|2] "g" EPS

BO_ 1313 ECHO12: 4 VMC
 SG_ Torque : 7|16@0- (0.1,0) [-3000|3000] "Nm" EPS
 SG_ Force : 23|16@0- (1,0) [-30000|30000] "N" EPS

BO_ 1312 SAS11: 5 VMC
 SG_ Angle : 16|16@1- (0.1,0) [-3000|3000] "deg" EPS
 SG_ Word : 32|8@1- (1,0) [-100|100] "furlong" EPS
"""
SENSORS = [
    {"measures": "yaw-rate", "period_s": 0.02, **CALM},
    {"measures": "lateral-acceleration", "phase_s": 0.005, **CALM},
    {"measures": "steering-angle", "delay_s": 0.003, **CALM},
]
ROLES: dict[str, Any] = {
    "yaw_rate": "ESP12.YAW_RATE",
    "lateral_acceleration": "ESP13.LAT_ACCEL",
    "steering_angle": {"signal": "SAS11.Angle", "factor": -0.0625},  # 16 at the wheel, mirrored
}
SENT = {  # message, signal, steps from the rig's unit, period and delay in ticks
    "yaw-rate": ("ESP12", "YAW_RATE", 180.0 / math.pi, 0.01),
    "lateral-acceleration": ("ESP13", "LAT_ACCEL", 1.0 / 9.80665, 0.001),
    "steering-angle": ("SAS11", "Angle", -16.0 * 180.0 / math.pi, 0.1),
}


@pytest.fixture(scope="module")
def dbc(tmp_path_factory):
    path = tmp_path_factory.mktemp("dbc") / "car.dbc"
    path.write_text(MOTOROLA.read_text("utf-8").replace("BO_ 1304", f"{OF_A_CAR}\nBO_ 1304"))
    return path


def scenario(dbc: Path | None, roles: dict[str, Any], **more: Any) -> Scenario:
    own = {}
    if dbc is not None:
        signals = {**SIGNALS, **roles}
        own = {"network": {"dbc": str(dbc), "tick": "Count", "signals": signals}}
    values = {
        "duration_s": 0.4, "latency_ticks": 1, "sensor": SENSORS, "fault": {"kind": "none"},
        "limits": {"torque_nm": 400.0, "force_difference_n": 4000.0}, **own, **more,
    }  # fmt: skip
    return load_values("sensed", values)


def ran(chosen: Scenario, out: Path, **options: Any) -> Path:
    done = execute(chosen, out, StopRequest(), Options(report=False, **options))
    assert done.failure is None
    return out / "bus.log"


def test_sensors_are_sent_in_the_units_of_the_database_and_heard_in_the_rig_s(dbc, tmp_path):
    chosen, database = scenario(dbc, ROLES), cantools.database.load_file(dbc)
    log = ran(chosen, tmp_path / "one")
    other = ran(chosen, tmp_path / "two", runner=two_processes)
    assert other.read_bytes() == log.read_bytes()
    fine = ran(scenario(None, {}), tmp_path / "fine")  # frames of the rig, nearly without steps
    exact, heard = (
        read_signals(path, network_of(of), of.tick_s).sensors
        for path, of in ((fine, scenario(None, {})), (log, chosen))
    )
    frames = list(can.LogReader(log))
    for number, (measures, (message, signal, factor, step)) in enumerate(SENT.items()):
        column = {0: "measured_yaw_rate_rad_per_s", 1: "measured_lateral_acceleration_mps2"}.get(
            number, "measured_steering_angle_rad"
        )
        frame_id = database.get_message_by_name(message).frame_id
        said = [
            (round(each.timestamp / chosen.tick_s), database.decode_message(message, each.data))
            for each in frames
            if each.arbitration_id == frame_id
        ]
        period, phase, _ = chosen.sensors[number].timing(chosen.tick_s)
        assert chosen.sensors[number].measures == measures
        assert [tick for tick, _ in said] == list(range(phase, chosen.ticks, period))
        for tick, signals in said:
            truth = exact[column][tick]
            # the commands are rounded on other grids, so D* differs by less than a step
            assert signals[signal] == pytest.approx(factor * truth, abs=1.5 * step)
            assert heard[column][tick] == pytest.approx(signals[signal] / factor, abs=1e-9)
    assert max(abs(signals["Angle"]) for _, signals in said) > 2.0


def test_two_sensors_of_one_message_share_its_frames_and_their_faults(dbc, tmp_path):
    sensors = [{**each, "period_s": 0.02, "phase_s": 0.0} for each in SENSORS[:2]]
    forged = {"kind": "frames-forged", "channel": "yaw-rate", "value": 0.3, "at_s": 0.3}
    missing = {"kind": "frames-missing", "channel": "yaw-rate", "at_s": 0.2, "for_s": 0.1}
    roles = {"yaw_rate": "ESP12.YAW_RATE", "lateral_acceleration": "ESP12.LAT_ACCEL"}
    chosen = scenario(dbc, roles, sensor=sensors, fault=[missing, forged])
    log, database = ran(chosen, tmp_path / "one"), cantools.database.load_file(dbc)
    assert ran(chosen, tmp_path / "two", runner=two_processes).read_bytes() == log.read_bytes()
    alone = ran(scenario(None, {}, sensor=sensors), tmp_path / "alone")
    exact = read_signals(alone, network_of(scenario(None, {}, sensor=sensors)), 0.001).sensors
    heard = read_signals(log, network_of(chosen), chosen.tick_s).sensors
    frames = [each for each in can.LogReader(log) if each.arbitration_id == 1310]
    ticks = [round(each.timestamp / chosen.tick_s) for each in frames]
    assert ticks == [
        *range(0, 200, 20),
        *(at for tick in range(300, 400, 20) for at in (tick,) * 2),
    ]
    for tick, message in zip(ticks[:10], frames[:10], strict=True):
        said = database.decode_message(message.arbitration_id, message.data)
        yaw, felt = (column[tick] for column in exact.values())
        assert said["YAW_RATE"] == pytest.approx(math.degrees(yaw), abs=0.015)
        assert said["LAT_ACCEL"] == pytest.approx(felt, abs=0.015)
        assert heard["measured_yaw_rate_rad_per_s"][tick] == pytest.approx(yaw, abs=0.0003)
        assert heard["measured_lateral_acceleration_mps2"][tick] == pytest.approx(felt, abs=0.015)
    yaws = heard["measured_yaw_rate_rad_per_s"]
    assert yaws[380] != pytest.approx(0.3, abs=0.01)  # unprotected: the last frame counts
    said = database.decode_message(1310, frames[10].data)
    assert said["YAW_RATE"] == pytest.approx(math.degrees(0.3), abs=0.006)


def test_a_loop_without_frames_hears_them_too(dbc, tmp_path):
    """Neither validity nor the tick of the sample is in a frame; both echoes are in one."""
    sensors = [{"measures": each, "period_s": 0.02, "delay_s": 0.02} for each in ECHOES]
    roles = {"torque_echo": "ECHO12.Torque", "force_difference_echo": "ECHO12.Force"}
    faults = [
        {"kind": "actuator-dead", "channel": "torque", "at_s": 0.1},
        {"kind": "sensor-invalid", "channel": "torque-echo", "at_s": 0.2},
    ]
    more = {
        "design": {"tau_q_s": 0.015, "alpha_q": 3, "compensation": "on-confirmation"},
        "reference": {"kind": "sine", "frequency_rad_per_s": 20.0},
    }
    chosen = scenario(dbc, roles, sensor=sensors, fault=faults, **more)
    heard = read_signals(ran(chosen, tmp_path / "run"), network_of(chosen), chosen.tick_s)
    without = signals_without_log(chosen)
    for column in ON_THE_BUS:
        np.testing.assert_array_equal(getattr(heard, column), getattr(without, column), column)


def test_a_sensor_without_validity_sends_not_available(dbc, tmp_path):
    fault = {"kind": "sensor-invalid", "channel": "yaw-rate", "at_s": 0.2, "for_s": 0.1}
    chosen = scenario(dbc, ROLES, fault=fault)
    log = ran(chosen, tmp_path / "run")
    found = read_signals(log, network_of(chosen), chosen.tick_s).sensors
    yaw = found["measured_yaw_rate_rad_per_s"][::20]
    assert [math.isnan(value) for value in yaw] == [10 <= at < 15 for at in range(20)]


def test_a_protected_sensor_s_corrupted_frames_are_not_heard(dbc, tmp_path):
    fault = {"kind": "frames-corrupted", "channel": "steering-angle", "at_s": 0.2, "for_s": 0.1}
    network = {"dbc": str(dbc), "tick": "Count", "signals": {**SIGNALS, **ROLES}}
    chosen = scenario(None, {}, fault=fault, network={**network, "data_ids": {"steering_angle": 7}})
    log = ran(chosen, tmp_path / "run")
    found = read_signals(log, network_of(chosen), chosen.tick_s).sensors
    angle = found["measured_steering_angle_rad"][::10]
    assert [math.isnan(value) for value in angle] == [20 <= at < 30 for at in range(40)]


@pytest.mark.parametrize(
    ("roles", "line"),
    [
        ({"yaw_rate": ""}, "network.signals.yaw_rate: must be set for the sensor 'yaw-rate'"),
        ({"yaw_rate": "ESP12.YAW"}, "message ESP12 has no signal YAW; it has Count, LAT_ACCEL"),
        ({"yaw_rate": "ESP12.Count"}, "network.signals.yaw_rate: has no unit; must be a table"),
        ({"steering_angle": "SAS11.Word"}, "has unit 'furlong'; must be a table with unit = one"),
        ({"yaw_rate": "ESP13.LAT_ACCEL"}, "network.signals.yaw_rate: has unit 'g'; must be"),
        ({"steering_angle": {"signal": "ESP12.YAW_RATE", "unit": "deg"}},
         "network.signals.yaw_rate are both ESP12.YAW_RATE: each must have a signal"),
        ({"lateral_acceleration": "ESP12.LAT_ACCEL"},
         "sensor 'lateral-acceleration': must have the period_s and phase_s of 'yaw-rate'"),
        ({"yaw_rate": {"signal": "ESP_Motion.DStarMeas", "unit": "rad/s"}},
         "feedback and yaw_rate both have identifier"),
        ({"yaw_rate": {"signal": "ESP12.YAW_RATE", "sign": "ESP12.Count"}},
         "network.signals.yaw_rate: must be one signal, with unit and factor at most"),
        ({"yaw_rate": ["ESP12.YAW_RATE", "SAS11.Angle"]}, "network.signals.yaw_rate: must be one"),
        ({"yaw_rate": {"signal": "ESP12.YAW_RATE", "factor": 0}}, "factor = 0: must not be 0"),
    ],
    ids=lambda each: str(each)[:40],
)  # fmt: skip
def test_bad_roles_are_refused_in_one_line(dbc, roles, line):
    with pytest.raises((ScenarioError, DbcError)) as refused:
        network_of(scenario(dbc, {**ROLES, **roles}))
    assert line in str(refused.value) and "\n" not in str(refused.value)
