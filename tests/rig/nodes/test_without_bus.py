"""A run without a bus leaves what both nodes leave on one, byte for byte."""

import json
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from can_rig.controllers.making import PEER
from can_rig.controllers.our_law import PYTHON
from can_rig.errors import RigError
from can_rig.frames.codec import COUNTERS, Transmitter
from can_rig.frames.frame_columns import payloads, quantised
from can_rig.nodes.bus_access import StopRequest
from can_rig.plant import in_windows
from can_rig.results.execution import NO_BUS, Options, execute
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_values
from can_rig.scenario.sensor_settings import MEASURED
from can_rig.scenario.settings import Scenario
from firmware_model.law.status import Verdict
from tests.helpers import on_a_bus, on_no_bus
from tests.rig.plant.failing import FAILING
from tests.rig.replay.recorded import DRIVES, log_of, scenario_of

VALUES = (
    "reference_mps2", "dstar_mps2", "torque_nm", "force_difference_n", "fault_estimate_mps2"
)  # fmt: skip
NETWORK = network_of(load("default"))
SHORT = ["duration_s=0.35", "fault.at_s=0.2"]
QUICK = ("chapter-2", "cluster", "default", "drive-cycle", "noisy", "pendulum", "wltc")
SLOW = ("chassis-can-coarse", "chassis-cluster")
NONLINEAR = "plant.kind=can_rig.plant.nonlinear_car:NonlinearCar"
CASES = [
    *((name, SHORT) for name in QUICK),
    *((name, ["duration_s=3", "fault.at_s=1.5"]) for name in SLOW),
    ("chassis-cluster", ["duration_s=2", "controller.kind=tests.rig.nodes.hearing:Hearing"]),
    ("chassis-cluster", ["duration_s=1", NONLINEAR, "fault.at_s=0.2", "fault.for_s=0.2"]),
    ("drive-cycle", [*SHORT, "drive.ramps=[[0, 1.5], [0.05, 1.9], [0.2, 3]]", "limits.blind_s=0.05",
                     "drive.speed_rate_max_mps2=9"]),
    ("default", [*SHORT, "fault.kind=frames-missing", "fault.for_s=0.015"]),
    ("default", [*SHORT, "fault.kind=frames-corrupted", "fault.channel=force-difference"]),
    ("noisy", [*SHORT, "fault.kind=frames-corrupted", "fault.for_s=0.06", "actuator.hold_s=0.005"]),
    ("default", [*SHORT, "fault.kind=sensor-biased", "fault.for_s=0.1", "seed=7"]),
    ("thesis-step", [*SHORT, "reference.amplitude_mps2=21", "fault.kind=none"]),
    ("default", [*SHORT, NONLINEAR]),
    ("default", [*SHORT, "design.precision=float32"]),
    ("chassis-can", ["duration_s=3", "fault.at_s=1.5", "design.precision=float32"]),
    ("default", [*SHORT, "plant.torque_actuator.dead_time_s=0.0015", "latency_ticks=2",
                 "plant.torque_actuator.limit_nm=50", "plant.sensor.dead_time_s=0.0012"]),
    ("default", [*SHORT, "plant.kind=tests.rig.plant.linear:LinearPlant", "fault.left=0.5",
                 "plant.torque_actuator.dead_time_s=0.0015", "plant.torque_actuator.lag_s=0",
                 "plant.force_difference_actuator.dead_time_s=0.0025", "tick_s=0.0007"]),
    ("thesis-step", ["tick_s=0.0004", "duration_s=2e-3", "fault.kind=none"]),
    ("ideal", ["duration_s=0.001", "fault.kind=none"]),
]  # fmt: skip
TIMES = ("bus", "wall_s", "ticks_per_s", "real_time_factor")


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(in_windows, "BLOCK_TICKS", 97)
    monkeypatch.setattr(in_windows, "WINDOW_TICKS", 2 * 97)


def folders(scenario: Scenario, where: Path) -> Iterator[dict[str, Any]]:
    """Every file of a run without a bus, and of one on a bus."""
    for name, bus in (("without", None), ("with", "virtual:compared")):
        done = execute(scenario, where / name, StopRequest(), Options(bus=bus, report=False))
        assert done is not None
        assert (done.outcome.bus == NO_BUS) == (bus is None)
        files: dict[str, Any] = {file.name: file.read_bytes() for file in done.folder.iterdir()}
        summary = json.loads(files.pop("run.json"))
        yield {**files, **{key: value for key, value in summary.items() if key not in TIMES}}


@pytest.mark.parametrize(
    ("name", "changes"), CASES, ids=[f"{name} {' '.join(s)}" for name, s in CASES]
)
def test_the_folder_is_that_of_both_nodes(name, changes, tmp_path):
    without, on_a_bus = folders(load(name, changes), tmp_path)
    assert without.keys() == on_a_bus.keys()
    assert {key for key in without if without[key] != on_a_bus[key]} == set()


@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    sensors=st.lists(
        st.fixed_dictionaries({
            "measures": st.sampled_from(MEASURED),
            "period_s": st.sampled_from([0.001, 0.003, 0.01]),
            "delay_s": st.sampled_from([0.0, 0.002, 0.05]),
            "corner_hz": st.sampled_from([0.0, 30.0]),
            "noise": st.sampled_from([0.0, 0.1]),
        }),
        min_size=1, max_size=5, unique_by=lambda each: str(each["measures"]),
    ),
    more=st.sampled_from([
        {}, {"drive": {"ramps": [[0.0, 10.0], [0.15, 10.5]]}},
        {"disturbance": [{"kind": "gust", "force_n": 300.0, "at_s": 0.05, "for_s": 0.05}]},
        {"fault": {"kind": "controller-restarted", "at_s": 0.04, "for_s": 0.02}},
        {"fault": {"kind": "actuator-late", "at_s": 0.04, "late_ticks": 7}},
        {"controller": {"kind": "tests.rig.nodes.hearing:Hearing"}},
    ]),
)  # fmt: skip
def test_any_sensors_send_the_frames_of_both_nodes(sensors, more):
    scenario = load_values("sensed", {"duration_s": 0.15, "sensor": sensors, **more})
    controller = PEER if "controller" in more else PYTHON
    with TemporaryDirectory() as where:
        logs = [Path(where, name) for name in ("a.log", "b.log")]
        ours, theirs = on_no_bus(scenario, logs[0]), on_a_bus(scenario, logs[1], controller)
        for suffix in (".log", ".plant.csv"):
            one, other = (log.with_suffix(suffix).read_bytes() for log in logs)
            assert one == other
            assert one.count(b"\n") > 150
    assert ours.rejected_frames == theirs.rejected_frames


@pytest.mark.parametrize("name", DRIVES)
def test_the_log_is_the_recorded_drive(name, tmp_path):
    """But for a few steps of a signal: linear algebra rounds otherwise on another processor."""
    log, scenario = tmp_path / "bus.log", scenario_of(name)
    on_no_bus(scenario, log)
    network = network_of(scenario)
    ours, recorded = (read_signals(path, network, scenario.tick_s) for path in (log, log_of(name)))
    for column, lsb in (
        *zip(VALUES, (frame.lsb for frame in network), strict=True),
        *((code, 0.0) for code in ("mode", "fault_state", "verdict")),
    ):
        one, other = getattr(ours, column), getattr(recorded, column)
        np.testing.assert_allclose(one, other, rtol=0.0, atol=10 * lsb, err_msg=column)


def test_a_plant_that_fails_leaves_what_was_sent_by_then(tmp_path):
    scenario = load("default", [FAILING, "plant.parameters.calls=150", "duration_s=0.3"])
    logs, reasons = [tmp_path / "a.log", tmp_path / "b.log"], []
    for run, log in zip((on_no_bus, on_a_bus), logs, strict=True):
        with pytest.raises(RigError, match="stuck") as reason:
            run(scenario, log)
        reasons.append(str(reason.value))
    assert reasons[0] == reasons[1]
    for suffix in (".log", ".plant.csv"):
        ours, theirs = (log.with_suffix(suffix).read_bytes() for log in logs)
        assert ours == theirs
        assert ours.count(b"\n") > 50


@given(
    codec=st.sampled_from(list(NETWORK)),
    first=st.sampled_from([0, 1, 65530]),  # the tick on the wire has 16 bits
    values=st.lists(st.floats(), min_size=1, max_size=40),
    mode=st.integers(0, 3),
    state=st.integers(0, 3),
    verdict=st.sampled_from(Verdict),
)
def test_payloads_are_those_of_a_transmitter(codec, first, values, mode, state, verdict):
    sender = Transmitter(codec)
    for tick in range(first % COUNTERS):
        sender.frame(0.0, tick)
    words = (mode, state, int(verdict))
    frames = [bytes(sender.frame(v, first + k, *words).data) for k, v in enumerate(values)]
    bits = [np.full(len(values), word) for word in words] if codec.modes else []
    assert [bytes(row) for row in payloads(codec, np.array(values), first, *bits)] == frames
    expected = [codec.quantise(value) for value in values]
    np.testing.assert_array_equal(quantised(codec, np.array(values)), expected)
