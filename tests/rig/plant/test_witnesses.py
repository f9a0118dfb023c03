"""Further sensors: their frames against an integration by scipy, the loops, and bad input."""

import csv
import math

import can
import cantools
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from can_rig.errors import ScenarioError
from can_rig.frames.databases import shipped_dbc
from can_rig.nodes.bus_access import StopRequest
from can_rig.results.execution import Options, execute, two_processes
from can_rig.scenario.loading import load_values
from tests.helpers import refuses

TICK_S = 0.001
CALM = {"noise": 0.0, "resolution": 0.0}
SENSORS = [
    {"measures": "lateral-acceleration", "phase_s": 0.003, "corner_hz": 0.0, **CALM},
    {"measures": "yaw-rate", "delay_s": 0.002, "corner_hz": 20.0, **CALM},
    {"measures": "steering-angle", "period_s": 0.004, **CALM},
    {"measures": "torque-echo", "period_s": 0.001, **CALM},
]
GUST = {"kind": "gust", "force_n": 500.0, "arm_m": 0.3, "at_s": 0.1, "ramp_s": 0.1}


def scenario(**more):
    values = {
        "duration_s": 0.5, "latency_ticks": 1,
        "plant": {"torque_actuator": {"lag_s": 0.005},
                  "force_difference_actuator": {"lag_s": 0.015}},
        "design": {"tau_q_s": 0.015, "alpha_q": 3, "alpha": 2, "estimator": "zoh"},
        "limits": {"torque_nm": 400.0, "force_difference_n": 4000.0}, "sensor": SENSORS, **more,
    }  # fmt: skip
    return load_values("cluster", values)


def run(chosen, out, **options):
    done = execute(chosen, out, StopRequest(), Options(report=False, **options))
    assert done.failure is None
    return out / "bus.log"


def frames(log):
    """The frames of a log by message: time, signals."""
    database = cantools.database.load_file(shipped_dbc("steer_by_wire.dbc"))
    found = {}
    for message in can.LogReader(log):
        of = database.get_message_by_frame_id(message.arbitration_id)
        signals = of.decode(message.data, decode_choices=False)
        found.setdefault(of.name, []).append((message.timestamp, signals))
    return found


@pytest.mark.parametrize("disturbance", [[], [GUST]], ids=["calm", "gust"])
def test_frames_say_what_an_integration_of_the_equations_gives(tmp_path, disturbance):
    found = frames(run(scenario(disturbance=disturbance), tmp_path / "run"))
    torque, force = (
        np.array([each[signal] for _, each in found[name]])
        for name, signal in (
            ("STEER_TORQUE_CMD", "SteerTorque"), ("FORCE_DIFF_CMD", "ForceDifference"),
        )
    )  # fmt: skip
    m, j, lf, lr, dr, js, cs = 1400.0, 2457.0, 1.02, 1.58, 1.48, 11.98, 9.0
    kf, kr, trail, v, tau = 33700.0, 56200.0, 0.05, 10.0, 1.0 / (2.0 * math.pi * 20.0)

    def push(t):
        return 500.0 * min(max(t - 0.1, 0.0) / 0.1, 1.0) if disturbance else 0.0

    def forces(x):
        yf = kf * (x[3] - x[0] - lf * x[1] / v)
        return yf, kr * (lr * x[1] / v - x[0])

    def slope(t, x, commands):
        (yf, yr), side = forces(x), push(t)
        return [
            (2 * yf + 2 * yr + side) / (m * v) - x[1],
            (2 * lf * yf - 2 * lr * yr + dr / 2 * x[5] + 0.3 * side) / j,
            (x[4] - cs * x[2] - 2 * trail * yf) / js,
            x[2],
            (commands[0] - x[4]) / 0.005,
            (commands[1] - x[5]) / 0.015,
            (x[1] - x[6]) / tau,
        ]

    states = [np.zeros(7)]
    for tick in range(499):
        commands = (torque[tick - 1], force[tick - 1]) if tick else (0.0, 0.0)
        solved = solve_ivp(
            slope, (tick * TICK_S, (tick + 1) * TICK_S), states[-1], args=(commands,),
            rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        states.append(solved.y[:, -1])

    def acceleration(tick):
        return (2 * sum(forces(states[tick])) + push(tick * TICK_S)) / m

    expected = {
        "YAW_RATE": ("YawRate", 10, 0, 2, lambda k: states[k][6], 1e-5),
        "LATERAL_ACCELERATION": ("LateralAcceleration", 10, 3, 0, acceleration, 1e-4),
        "STEERING_ANGLE": ("SteeringAngle", 4, 0, 0, lambda k: states[k][3], 1e-5),
        "STEER_TORQUE_ECHO": ("AppliedTorque", 1, 0, 0, lambda k: states[k][4], 0.1),
    }
    for name, (signal, period, phase, delay, truth, step) in expected.items():
        ticks = range(phase, 500, period)
        assert [round(time_s / TICK_S) for time_s, _ in found[name]] == list(ticks)
        for tick, (_, said) in zip(ticks, found[name], strict=True):
            assert said["Tick"] == tick and said["Valid"] == 1
            assert said["SampleTick"] == (tick - delay) % 4096
            wanted = truth(tick - delay) if tick >= delay else 0.0
            assert said[signal] == pytest.approx(wanted, abs=0.51 * step), (name, tick)
    assert max(abs(said["YawRate"]) for _, said in found["YAW_RATE"]) > 0.01


@pytest.mark.parametrize("chosen", ["healthy", "faulty"])
def test_a_run_has_the_same_frames_in_one_process_and_in_two(chosen, tmp_path):
    """Also with every fault of a sensor and of its frames, a tenth of a second each."""
    sensors = [{"measures": each["measures"]} for each in SENSORS]
    places = [{"channel": "yaw-rate"} | fault for fault, _ in (*FAULTS, *OF_FRAMES)] + LYING
    faults = [each | {"at_s": 0.1 * at, "for_s": 0.1} for at, each in enumerate(places)]
    more = {"fault": faults, "duration_s": 0.1 * len(faults)} if chosen == "faulty" else {}
    noisy = scenario(**{"sensor": sensors, "duration_s": 0.3, **more})
    one = run(noisy, tmp_path / "one").read_bytes()
    assert run(noisy, tmp_path / "two", runner=two_processes).read_bytes() == one
    assert b"0F1#" in one


def test_signals_have_a_column_for_each_sensor_behind_all_others(tmp_path):
    found = frames(run(scenario(), tmp_path / "run"))
    with (tmp_path / "run" / "signals.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    said = {
        "measured_yaw_rate_rad_per_s": ("YAW_RATE", "YawRate"),
        "measured_lateral_acceleration_mps2": ("LATERAL_ACCELERATION", "LateralAcceleration"),
        "measured_steering_angle_rad": ("STEERING_ANGLE", "SteeringAngle"),
        "torque_echo_nm": ("STEER_TORQUE_ECHO", "AppliedTorque"),
    }
    assert list(rows[0])[-len(said) :] == list(said)
    for column, (name, signal) in said.items():
        values = {tick: row[column] for tick, row in enumerate(rows) if row[column]}
        sent = {round(time_s / TICK_S): signals[signal] for time_s, signals in found[name]}
        assert values.keys() == sent.keys()
        for tick, value in values.items():
            assert float(value) == pytest.approx(sent[tick], rel=1e-8, abs=1e-12)


def test_further_sensors_change_no_other_frame(tmp_path):
    unfiltered = [{**each, "corner_hz": 0.0} for each in SENSORS]
    with_them = frames(run(scenario(sensor=unfiltered), tmp_path / "with"))
    without = frames(run(scenario(sensor=[]), tmp_path / "without"))
    for name, said in without.items():
        assert [signals for _, signals in said] == [signals for _, signals in with_them[name]]


FAULTS: list = [
    ({"kind": "sensor-biased", "offset": 0.05}, lambda y, k: y + 0.05),
    ({"kind": "sensor-drift", "drift_per_s": 0.2}, lambda y, k: y + 0.2 * (k - 200) * TICK_S),
    ({"kind": "sensor-dead", "left": 0.25}, lambda y, k: 0.25 * y),
    ({"kind": "sensor-stuck", "value": -0.1}, lambda y, k: -0.1),
    ({"kind": "sensor-scaled", "gain": -1.0}, lambda y, k: -y),
    ({"kind": "sensor-scaled", "gain": 57.3}, lambda y, k: min(57.3 * y, 5.24287)),
]


OF_FRAMES: list = [
    ({"kind": "frames-missing"}, lambda sent, k: []),
    ({"kind": "frames-repeated"}, lambda sent, k: sent[191] if k % 10 == 1 else []),
    ({"kind": "frames-late", "late_ticks": 3}, lambda sent, k: sent.get(k - 3, [])),
]
LYING = [
    {"kind": "sensor-lying", "channel": "torque-echo"},
    {"kind": "sensor-invalid", "channel": "yaw-rate"},
    {"kind": "sensor-tick-stuck", "channel": "steering-angle"},
    {"kind": "sensor-swapped", "channel": "yaw-rate", "other": "steering-angle"},
    {"kind": "frames-forged", "channel": "yaw-rate", "value": 0.5},
]
YAW = cantools.database.load_file(shipped_dbc("steer_by_wire.dbc")).get_message_by_name("YAW_RATE")


def with_fault(out, *faults, corner_hz=0.0):
    """The log of a drive with these faults, each from 0.2 s to 0.3 s."""
    sensors = [
        {"measures": "yaw-rate", "period_s": 0.01, "phase_s": 0.001, "corner_hz": corner_hz},
        {"measures": "steering-angle", "period_s": 0.001, "delay_s": 0.002},
        {"measures": "torque-echo", "period_s": 0.001},
    ]
    several = [{"at_s": 0.2, "for_s": 0.1, **each} for each in faults]
    calm = [{**each, **CALM} for each in sensors]
    return run(scenario(sensor=calm, duration_s=0.4, fault=several), out)


@pytest.fixture(scope="module")
def healthy(tmp_path_factory):
    """The log without a fault."""
    return with_fault(tmp_path_factory.mktemp("healthy") / "run")


@pytest.fixture(scope="module")
def filtered(tmp_path_factory):
    """The same with a yaw rate that a filter has smoothed."""
    return frames(with_fault(tmp_path_factory.mktemp("filtered") / "run", corner_hz=20.0))


@pytest.mark.parametrize(("fault", "expected"), FAULTS, ids=lambda each: str(each)[:24])
def test_a_fault_of_a_further_sensor_changes_its_frames_and_no_other(
    tmp_path, filtered, fault, expected
):
    fault = {"channel": "yaw-rate", **fault}
    found = frames(with_fault(tmp_path / "faulty", fault, corner_hz=20.0))
    for (time_s, said), (_, other) in zip(filtered["YAW_RATE"], found["YAW_RATE"], strict=True):
        tick = round(time_s / TICK_S)
        wanted = expected(said["YawRate"], tick) if 200 <= tick < 300 else said["YawRate"]
        assert other["YawRate"] == pytest.approx(wanted, abs=1.1e-5, rel=1e-3)
    for name in filtered.keys() - {"YAW_RATE"}:
        assert found[name] == filtered[name]


def yaw(log):
    """The frames of the yaw rate by their tick: bytes."""
    found = {}
    for message in can.LogReader(log):
        if message.arbitration_id == YAW.frame_id:
            found.setdefault(round(message.timestamp / TICK_S), []).append(bytes(message.data))
    return found


def test_an_echo_that_lies_says_the_command_while_the_motor_is_dead(tmp_path):
    dead, lying = {"kind": "actuator-dead"}, LYING[0]
    found = frames(with_fault(tmp_path / "run", {**dead, "for_s": None}, lying))
    sent = [said["SteerTorque"] for _, said in found["STEER_TORQUE_CMD"]]
    echo = [said["AppliedTorque"] for _, said in found["STEER_TORQUE_ECHO"]]
    for tick in range(200, 300):
        assert echo[tick] == pytest.approx(sent[tick - 2], abs=0.051)  # a tick of latency
    assert max(map(abs, sent[250:])) > 1.0
    assert max(map(abs, echo[350:])) < 0.1  # tells the truth again


def test_a_frame_whose_validity_is_withdrawn_carries_its_value_and_the_column_is_empty(
    tmp_path, healthy
):
    log = with_fault(tmp_path / "run", LYING[1])
    found = frames(log)["YAW_RATE"]
    assert [said["YawRate"] for _, said in found] == [
        said["YawRate"] for _, said in frames(healthy)["YAW_RATE"]
    ]
    hit = [200 <= said["Tick"] < 300 for _, said in found]
    assert [not said["Valid"] for _, said in found] == hit
    with (log.parent / "signals.csv").open(encoding="utf-8") as file:
        cells = [row["measured_yaw_rate_rad_per_s"] for row in csv.DictReader(file)]
    assert [cells[said["Tick"]] == "" for _, said in found] == hit


def test_the_tick_of_a_sample_stands_still_while_its_value_goes_on(tmp_path, healthy):
    logs = (with_fault(tmp_path / "run", LYING[2]), healthy)
    pairs = zip(*(frames(log)["STEERING_ANGLE"] for log in logs), strict=True)
    for tick, ((_, said), (_, other)) in enumerate(pairs):
        stands = 199 if 200 <= tick < 300 else tick
        assert said["SampleTick"] == (stands - 2) % 4096
        assert said["SteeringAngle"] == other["SteeringAngle"]


def test_each_of_two_swapped_sensors_says_what_the_other_reads(tmp_path, healthy):
    found, before = frames(with_fault(tmp_path / "run", LYING[3])), frames(healthy)
    angles = [said["SteeringAngle"] for _, said in before["STEERING_ANGLE"]]
    for (_, said), (_, other) in zip(found["YAW_RATE"], before["YAW_RATE"], strict=True):
        tick = said["Tick"]
        swapped = 200 <= tick < 300
        # the angle has waited two ticks for its frame, and the yaw rate none
        assert said["YawRate"] == (angles[tick + 2] if swapped else other["YawRate"])
        if swapped:
            delayed = found["STEERING_ANGLE"][tick + 2][1]["SteeringAngle"]
            assert delayed == other["YawRate"]


@pytest.mark.parametrize(("fault", "expected"), OF_FRAMES, ids=lambda each: str(each)[10:24])
def test_a_fault_of_a_sensor_s_frames_leaves_all_other_frames(tmp_path, healthy, fault, expected):
    log = with_fault(tmp_path / "run", {"channel": "yaw-rate", **fault})
    sent, found = yaw(healthy), yaw(log)
    for tick in range(400):
        whole = sent.get(tick, [])
        wanted = expected(sent, tick) if 200 <= tick < 300 else whole
        assert found.get(tick, []) == wanted, tick
    others = [each["Tick"] for each in (said for _, said in frames(log)["STEERING_ANGLE"])]
    assert others == list(range(400))


def test_a_forged_frame_precedes_the_real_one_and_is_heard_in_its_place(tmp_path, healthy):
    log = with_fault(tmp_path / "run", LYING[4])
    sent, found = yaw(healthy), yaw(log)
    for tick, whole in sent.items():
        *forged, real = found[tick]
        assert [real] == whole and len(forged) == (200 <= tick < 300)
        for each in map(YAW.decode, forged):
            assert (each["YawRate"], each["SampleTick"], each["Tick"]) == (0.5, tick, tick)
    with (log.parent / "signals.csv").open(encoding="utf-8") as file:
        cells = [row["measured_yaw_rate_rad_per_s"] for row in csv.DictReader(file)]
    assert {cells[tick] for tick in range(201, 300, 10)} == {"0.5"}
    (after,) = [s["YawRate"] for _, s in frames(healthy)["YAW_RATE"] if s["Tick"] == 301]
    assert cells[301] == f"{after:.10g}"


BAD = [
    ({"kind": "sensor-scaled", "channel": "yaw-rate"}, "fault.gain: must be set"),
    ({"kind": "sensor-lying", "channel": "yaw-rate"}, "fault.channel = 'yaw-rate': must be torque"),
    ({"kind": "sensor-invalid"}, "fault.channel = 'torque': must be yaw-rate or"),
    ({"kind": "sensor-tick-stuck", "channel": "sensor"}, "fault.channel = 'sensor': must be yaw"),
    ({"kind": "sensor-swapped", "channel": "yaw-rate"}, "fault.other: must be another"),
    ({"kind": "sensor-swapped", "channel": "yaw-rate", "other": "yaw-rate"},
     "fault.other = 'yaw-rate': must be another sensor than the channel"),
    ({"kind": "sensor-swapped", "channel": "yaw-rate", "other": "force-difference-echo"},
     "fault.other = 'force-difference-echo': must be a sensor of the scenario"),
    ({"kind": "sensor-dead", "other": "yaw-rate"}, "fault.other = 'yaw-rate': must be left out"),
    ({"kind": "sensor-dead", "channel": "force-difference-echo"}, "fault.channel = 'force-diff"),
    ({"kind": "actuator-dead", "channel": "yaw-rate"}, "'yaw-rate': must be torque or force-diff"),
    ({"kind": "frames-late", "channel": "force-difference-echo"}, "must be a sensor of the scen"),
    ({"kind": "sensor-biased", "channel": "yaw-rate"}, "fault.offset: must be set"),
    ({}, "sensor.measures: must be set"),
    ({"period_s": 0.0015}, "sensor.period_s = 0.0015: must be a whole number of ticks"),
    ({"period_s": 1e-5}, "sensor.period_s = 1e-05: must be a whole number of ticks"),
    ({"phase_s": 0.0005}, "sensor.phase_s = 0.0005: must be a whole number of ticks"),
    ({"phase_s": 0.01}, "sensor.phase_s = 0.01: must be less than the period, 0.01 s"),
    ({"delay_s": 0.0007}, "sensor.delay_s = 0.0007: must be a whole number of ticks"),
    ({"corner_hz": 1e-4}, "sensor.corner_hz = 0.0001: must be 0 (none) or at least 0.001"),
    ({"signal": "yaw"}, "sensor.signal = 'yaw': must be left out; only a class or an FMU"),
    ({"signal": "a b"}, "sensor.signal = 'a b': must be a name of letters"),
]  # fmt: skip


@pytest.mark.parametrize(("keys", "line"), BAD, ids=lambda each: str(each)[:40])
def test_bad_keys_of_a_sensor_or_of_its_fault_are_refused_in_one_line(keys, line):
    sensor = {"measures": "yaw-rate", **keys} if keys else {}
    with refuses(line):
        scenario(**({"fault": keys} if "kind" in keys else {"sensor": sensor}))


def test_a_quantity_has_one_sensor():
    with pytest.raises(ScenarioError, match=r"sensor\.1\.measures = 'yaw-rate': must be another"):
        scenario(sensor=[{"measures": "yaw-rate"}, {"measures": "yaw-rate"}])
