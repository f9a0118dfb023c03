"""The exported FMUs: in FMPy, in the rig bit for bit, and built again from their own sources."""

import math
import runpy
import struct
import zipfile
from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import can
import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import FMU3Slave
from fmpy.simulation import instantiate_fmu
from fmpy.validation import validate_fmu

import can_rig
from can_rig.errors import ExportError, LogError, RigError
from can_rig.export.controller_fmu import controller_model, node_model
from can_rig.export.fmu import write_fmus
from can_rig.frames.frame_columns import quantised
from can_rig.plant.car_fmu import car_model, write_inputs
from can_rig.plant.frameless import frameless
from can_rig.results.run_folder import LOG
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Firmware
from tests.helpers import refused, succeeded
from tests.rig.export.shared import STRICT, run
from tests.rig.own_frames.scenarios import FD_SIGNALS, database, options

SHORT: dict[str, object] = {"duration_s": 0.6, "fault.at_s": 0.3}
CASES: dict[str, tuple[str, dict[str, object]]] = {
    "double": ("default", SHORT),
    "single": ("default", {**SHORT, "design.precision": "float32"}),
    "drive": ("drive-cycle", SHORT),
    "pendulum": ("pendulum", SHORT),
    "sensors": ("cluster", {"duration_s": 1.2, "fault.at_s": 0.5}),
}
LONGER: dict[str, object] = {"duration_s": 1.5, "fault.at_s": 0.5}
LOOPS: dict[str, tuple[str, dict[str, object]]] = {
    "at once": ("default", LONGER), "every 10 ms": ("cluster", LONGER),
    "single precision": ("cluster", {**LONGER, "design.precision": "float32"}),
    "tick of 10 ms": ("chassis-cluster", {"duration_s": 6.0, "fault.at_s": 3.0}),
    "an oscillator": ("pendulum", SHORT),
    "dead times, limits, a late and a biased sensor": (
        "cluster",
        {**LONGER, "plant.torque_actuator.dead_time_s": 0.0025,
         "plant.torque_actuator.rate_nm_per_s": 2000.0,
         "plant.force_difference_actuator.dead_time_s": 0.002, "plant.sensor.dead_time_s": 0.0013,
         "plant.sensor.resolution_mps2": 0.001, "sensor.0.delay_s": 0.003,
         "fault.kind": "sensor-biased", "fault.channel": "sensor", "fault.bias_mps2": 0.2}),
}  # fmt: skip
MEASUREMENT, COMMANDS = 2, [3, 4]
EXAMPLE = runpy.run_path("docs/examples/fmu_loop.py")


def written(scenario: Scenario, folder: Path) -> None:
    """Both FMUs of both versions, and the inputs."""
    car = car_model(scenario)
    assert car is not None
    for model in (controller_model(scenario), car):
        for path in write_fmus(model, folder, force=False):
            assert validate_fmu(str(path)) == []
    name = scenario.name.replace("-", "_")
    assert write_inputs(scenario, folder / f"inputs_{name}.csv", force=False) == []


def with_floats(folder: Path) -> Scenario:
    """`default` with frames of CAN FD, identifiers of 29 bits and floats of 32."""
    path = folder / "own.dbc"
    text = database("48|32@1- (1,0) [0|0]", 16, first_id=0x80001300, types="1", fd=True)
    path.write_text(text, encoding="utf-8")
    short = [f"{key}={value}" for key, value in SHORT.items()]
    return load("default", [*options(path, FD_SIGNALS), *short])


@pytest.mark.parametrize("case", [*LOOPS, "floats"])
def test_both_in_a_loop_are_the_rig_bit_for_bit(case, tmp_path):
    ours = with_floats(tmp_path) if case == "floats" else can_rig.load_scenario(*LOOPS[case])
    written(ours, tmp_path)
    network = network_of(ours)
    trace = frameless(ours)
    for version in ("fmi2", "fmi3"):
        ticks = list(EXAMPLE["loop"](tmp_path, ours.name, version))
        found = {name: np.array([tick[name] for tick in ticks]) for name in ticks[0]}
        for channel in ("command_1", "command_2"):
            found[channel] = quantised(getattr(network, channel), found[channel])
        found["measured"] = found["measurement"]
        found["measurement"] = found["output"]
        for name in (
            "measured", "measurement", "command_1", "command_2", "fault_estimate", "fault_state",
            "verdict",
        ):  # fmt: skip
            np.testing.assert_array_equal(found[name], getattr(trace, name), err_msg=name)
    assert np.ptp(trace.command_2) > 0.0


def controlled_by(path: Path) -> dict[str, dict[str, object]]:
    """Changes of a scenario that let the controller be an FMU."""
    model = fmpy.read_model_description(str(path))
    variables = {each.name: each.name for each in model.modelVariables if each.name != "time"}
    return {"controller": {"kind": f"fmu:{path}", "variables": variables}}


@pytest.mark.parametrize("case", CASES)
def test_the_rig_runs_the_controller_bit_for_bit(case, tmp_path):
    ours = can_rig.load_scenario(*CASES[case])
    _, path = write_fmus(controller_model(ours), tmp_path, force=False)
    fmu = controlled_by(path)
    runs = [can_rig.run(ours), can_rig.run(ours, fmu, allow_unstable=True)]
    logs = [(each.folder / LOG).read_bytes() for each in runs]
    assert logs[0] == logs[1]
    assert (runs[1].table.columns["mode"] == 1).any()


@pytest.mark.parametrize("version", [0, 1])
def test_the_rig_drives_both_bit_for_bit(version, tmp_path):
    """The lags are the FMU's; latency, faults and noise are the rig's."""
    ours = can_rig.load_scenario("default", SHORT)
    car = car_model(ours)
    assert car is not None
    (controller, _), (path, _) = (
        write_fmus(model, tmp_path, force=False)[:: 1 - 2 * version]
        for model in (controller_model(ours), car)
    )
    plant: dict[str, object] = {
        "kind": f"fmu:{path}", "torque_actuator.lag_s": 0.0, "force_difference_actuator.lag_s": 0.0,
        "variables": {"input_1": "command_1", "input_2": "command_2", "output": "output",
                      "slip_rad": "side_slip_rad"},
        "parameters": {"latency_ticks": 0},
    }  # fmt: skip
    both = {"plant": plant, **controlled_by(controller)}
    runs = [can_rig.run(ours), can_rig.run(ours, both, allow_unstable=True)]
    logs = [(each.folder / LOG).read_bytes() for each in runs]
    assert logs[0] == logs[1]
    np.testing.assert_array_equal(
        runs[1].table.columns["slip_rad"], runs[0].table.columns["side_slip_rad"]
    )
    plant["parameters"] = {"latency_ticks": 2}
    with pytest.raises(RigError, match="the FMU says: latency_ticks must be 0 to 1"):
        can_rig.run(ours, both, allow_unstable=True)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    ours = can_rig.load_scenario("cluster", LONGER)
    written(ours, folder)
    write_fmus(node_model(ours), folder, force=False)
    return folder


def test_what_a_sensor_says_moves_the_decision(cluster):
    """Without the echoes the loss is found later: the inputs are used."""
    part = EXAMPLE["Part"]
    first = {"reference": 0.0}
    deaf, hears = (part(cluster / "fmi3" / "controller_cluster.fmu", first) for _ in range(2))
    found = []
    for tick in islice(EXAMPLE["loop"](cluster, "cluster"), 700):
        inputs = {name: value for name, value in tick.items() if "age" not in name}
        found.append([each.step(now, 0.001) for each, now in ((hears, tick), (deaf, inputs))])
        assert found[-1][0] == {name: tick[name] for name in found[-1][0]}
    assert any(heard != not_heard for heard, not_heard in found)


def test_a_sample_comes_on_time_and_once(cluster):
    """Every 10 ms from the phase of the scenario on, in steps of one tick and of five."""
    ages = {1: [], 5: []}  # type: dict[int, list[float]]
    for ticks, found in ages.items():
        car = EXAMPLE["Part"](cluster / "fmi2" / "car_cluster.fmu", {})
        for _ in range(40 // ticks):
            found.append(car.outputs["torque_echo_nm_age_ticks"])
            car.step({}, 0.001 * ticks)
    assert [at for at, age in enumerate(ages[1]) if age == 0.0] == [6, 16, 26, 36]
    assert set(ages[1]) == {-1.0, 0.0}
    assert ages[5] == [-1.0, -1.0, 4.0, -1.0, 4.0, -1.0, 4.0, -1.0]
    car = EXAMPLE["Part"](cluster / "fmi2" / "car_cluster.fmu", {})
    nothing = {f"{name}_error": float("nan") for name in ("measurement", "torque_echo_nm")}
    said = [car.step(nothing, 0.001) for _ in range(10)]
    assert all(np.isnan(each["measurement"]) for each in said)
    assert {each["torque_echo_nm_age_ticks"] for each in said} == {-1.0}


def test_a_car_without_commands_holds_them_and_then_lets_go(tmp_path):
    ours = can_rig.load_scenario("default", {"actuator.hold_s": 0.003})
    written(ours, tmp_path)
    held, silent = (EXAMPLE["Part"](tmp_path / "fmi3" / "car_default.fmu", {}) for _ in range(2))
    given = {"command_1": 10.0, "command_2": 0.0}
    none = {"command_1": float("nan"), "command_2": float("nan")}
    zero = {"command_1": 0.0, "command_2": 0.0}
    for part, inputs in ((held, [given] * 4 + [zero]), (silent, [given] + [none] * 4)):
        for each in inputs:
            part.step(each, 0.001)
    assert held.outputs == silent.outputs
    assert held.outputs["output"] != 0.0
    most = network_of(ours).command_1.maximum
    for part, command in ((held, most), (silent, 1e6 * most)):
        for _ in range(3):
            part.step({"command_1": command, "command_2": 0.0}, 0.001)
    assert held.outputs == silent.outputs  # a frame saturates


class OnTheBus:
    """The node's FMU, and an importer without any bus simulation."""

    def __init__(self, path: Path, folder: Path) -> None:
        model = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), str(folder))
        self.said: list[bytes] = []
        self.fmu = FMU3Slave(
            guid=model.instantiationToken,
            unzipDirectory=str(folder),
            modelIdentifier=model.coSimulation.modelIdentifier,
        )
        self.start(events=True)
        self.rx_data, self.rx_clock, self.tx_data, self.tx_clock = (
            next(each.valueReference for each in model.modelVariables if each.name == name)
            for name in ("rx_data", "rx_clock", "tx_data", "tx_clock")
        )
        self.time_s = 0.0

    def start(self, events: bool) -> None:
        """Up to the first event."""
        self.fmu.instantiate(
            eventModeUsed=events, logMessage=lambda *message: self.said.append(message[-1])
        )
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def event(self, received: bytes = b"") -> bytes:
        """What the node sends in an event that brings these operations."""
        if received:
            self.fmu.setClock([self.rx_clock], [True])
            self.fmu.setBinary([self.rx_data], [received])
        sent, again = b"", True
        while again:
            if self.fmu.getClock([self.tx_clock])[0]:
                sent += self.fmu.getBinary([self.tx_data])[0]
            again = self.fmu.updateDiscreteStates()[0]
        self.fmu.enterStepMode()
        return sent

    def step(self, step_s: float) -> bool:
        """Whether the node needs an event at the end of the step; enters the event."""
        needs_event: bool = self.fmu.doStep(self.time_s, step_s)[0]
        self.time_s += step_s
        self.fmu.enterEventMode()
        return needs_event


def transmit(frame: can.Message) -> bytes:
    """The operation of FMI-LS-BUS 1.0 that sends a frame."""
    if frame.is_fd:
        flags = frame.is_extended_id, frame.bitrate_switch, frame.error_state_indicator
        n = len(frame.data)
        head = struct.pack("<IIIBBBH", 0x11, 17 + n, frame.arbitration_id, *flags, n)
    else:
        head = struct.pack("<IIIBBH", 0x10, 16 + len(frame.data), frame.arbitration_id,
                           frame.is_extended_id, 0, len(frame.data))  # fmt: skip
    return head + bytes(frame.data)


@pytest.mark.parametrize("name", ["cluster", "drive-cycle", "floats"])
def test_the_node_on_a_bus_sends_the_frames_of_the_rig(name, tmp_path):
    ours = with_floats(tmp_path) if name == "floats" else can_rig.load_scenario(name, LONGER)
    (path,) = write_fmus(node_model(ours), tmp_path, force=False)
    assert validate_fmu(str(path)) == []
    node = OnTheBus(path, tmp_path / "unpacked")
    network = network_of(ours)
    own = {
        each.frame_id & 0x1FFFFFFF
        for each in (network.command_1, network.command_2, network.status)
    }
    ticks: list[tuple[list[bytes], list[bytes]]] = []
    ran = can_rig.run(ours)  # keeps its folder
    for frame in can.CanutilsLogReader(ran.folder / LOG):
        answers = frame.arbitration_id in own
        if not answers and (not ticks or ticks[-1][1]):
            ticks.append(([], []))
        ticks[-1][answers].append(transmit(frame))
    assert len(ticks) == ours.ticks
    remote = [operation[:13] + b"\x01" + operation[14:] for operation in ticks[0][0]]
    assert node.event() == struct.pack("<IIBI", 0x40, 13, 1, ours.bus.bitrate)
    if name != "floats":  # CAN FD has no remote frames
        node.step(ours.tick_s)
        assert node.event(b"".join(remote)) == b""
    for received, sent in ticks:
        assert not node.step(ours.tick_s)
        assert node.event(b"".join(received)) == b"".join(sent)
    assert node.step(1.6 * ours.tick_s)  # no feedback: the node answers by itself
    assert len(node.event()) == len(b"".join(ticks[0][1]))


def test_the_node_answers_an_operation_that_it_does_not_understand(cluster, tmp_path):
    node = OnTheBus(cluster / "fmi3" / "node_cluster.fmu", tmp_path)
    node.event()
    confirm = struct.pack("<III", 0x20, 12, 0x100)
    remote = struct.pack("<IIIBBH", 0x10, 16, 0x100, 0, 1, 0)
    for wrong in (
        struct.pack("<II", 0x77, 8), struct.pack("<IIIBBH", 0x10, 16, 0x100, 0, 0, 8),
        struct.pack("<II", 0x10, 7), struct.pack("<II", 0x10, 400), struct.pack("<II", 0x20, 12),
        struct.pack("<IIIBBH300x", 0x10, 316, 0x100, 0, 0, 300), b"\x10",
    ):  # fmt: skip
        node.step(0.001)
        answer = struct.pack("<IIH", 0x01, 10 + len(wrong), len(wrong)) + wrong
        assert node.event(confirm + remote + wrong) == answer
    node.step(0.001)
    node.fmu.setBinary([node.rx_data], [wrong])
    assert node.event() == b""  # without its clock nothing is received
    node.step(0.001)
    node.fmu.setClock([node.rx_clock], [True])
    with pytest.raises(FMICallException):
        node.fmu.setBinary([node.rx_data], [bytes(4097)])
    with pytest.raises(FMICallException):
        node.fmu.setClock([node.tx_clock], [True])
    assert node.said == [
        b"a binary to set must be rx_data, of at most 4096 bytes",
        b"a clock to set must be rx_clock",
    ]
    with pytest.raises(Exception, match="instantiate"):
        node.start(events=False)
    assert node.said[2:] == [b"eventModeUsed must be true: frames come and go in events"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    _, path = write_fmus(controller_model(can_rig.load_scenario("default")), folder, force=False)
    return path


def instance_of(path: Path, folder: Path) -> Any:
    model = fmpy.read_model_description(str(path))
    fmpy.extract(str(path), str(folder))
    return instantiate_fmu(str(folder), model, "CoSimulation")


def started(fmu: Any) -> Any:
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    return fmu


def test_a_step_of_several_ticks_holds_the_inputs(exported, tmp_path):
    scenario = can_rig.load_scenario("default")
    one, many = (started(instance_of(exported, tmp_path / name)) for name in ("one", "many"))
    firmware = Firmware(controller_table(scenario, network_of(scenario)))
    firmware.reset(0.0)
    for at, (reference, measured) in enumerate(np.random.default_rng(1).standard_normal((50, 2))):
        for fmu in (one, many):
            fmu.setFloat64([1, MEASUREMENT], [reference, measured])
        for tick in range(3):
            one.doStep(0.003 * at + 0.001 * tick, 0.001)
            said = firmware.step(reference, measured)
        many.doStep(0.003 * at, 0.003)
        assert one.getFloat64(COMMANDS) == many.getFloat64(COMMANDS) == [*said[:2]]
    for step_s in (0.0004, -0.001, 0.0, 1e16, math.inf, math.nan):
        with pytest.raises(FMICallException):
            one.doStep(0.15, step_s)
    one.reset()
    assert one.getFloat64(COMMANDS) == [0.0, 0.0]
    for fmu in (one, many):
        fmu.terminate()
        fmu.freeInstance()


@pytest.mark.parametrize(
    "file", ["fmi2/controller_cluster.fmu", "fmi3/car_cluster.fmu", "fmi3/node_cluster.fmu"]
)
def test_calls_out_of_order_are_refused(file, cluster, tmp_path):
    model = fmpy.read_model_description(str(cluster / file))
    fmpy.extract(str(cluster / file), str(tmp_path))
    said: list[bytes] = []
    fmu: Any = instantiate_fmu(
        str(tmp_path), model, "CoSimulation", logger=lambda *message: said.append(message[-1]),
        event_mode_used="node" in file,
    )  # fmt: skip

    def begin(**times: float) -> None:
        if "fmi2" in file:
            fmu.setupExperiment(**times)
            fmu.enterInitializationMode()
        else:
            fmu.enterInitializationMode(**times)

    def refused(said_why: bytes, call: Callable[..., object], *arguments: float) -> None:
        with pytest.raises(FMICallException):
            call(*arguments)
        assert said_why in said.pop()
        assert not said

    before, start = b"between initialisation and end", b"a start time must be a number"
    refused(before, fmu.doStep, 5.0, 0.001)
    refused(start, lambda: begin(startTime=math.nan))
    begin(startTime=5.0, stopTime=5.003)
    refused(before, fmu.doStep, 5.0, 0.001)
    fmu.exitInitializationMode()
    refused(b"must end once", fmu.exitInitializationMode)
    refused(start, lambda: begin(startTime=0.0))
    for point_s in (5.001, 4.999, math.nan, math.inf):
        refused(b"where the one before has ended", fmu.doStep, point_s, 0.001)
    fmu.doStep(5.0, 0.001)
    refused(b"where the one before has ended", fmu.doStep, 5.0, 0.001)
    refused(b"by the stop time", fmu.doStep, 5.001, 0.003)
    for step_s in (0.0, -0.001, math.nan):
        refused(b"a communication step must be", fmu.doStep, 5.001, step_s)
    fmu.doStep(5.001 + 1e-9, 0.002)  # what rounding makes of the point
    fmu.terminate()
    refused(before, fmu.doStep, 5.003, 0.001)
    fmu.reset()
    begin()
    fmu.exitInitializationMode()
    fmu.doStep(0.0, 0.01)  # no stop time any more


@pytest.mark.parametrize(
    "file", ["fmi3/car_cluster.fmu", "fmi2/controller_cluster.fmu", "fmi3/node_cluster.fmu"]
)
def test_the_sources_within_build_without_a_warning(file, cluster, tmp_path):
    fmpy.extract(str(cluster / file), str(tmp_path))
    name = "buildDescription.xml" if "fmi3" in file else "../modelDescription.xml"
    build = Xml.parse(tmp_path / "sources" / name).getroot()
    units = [each.get("name") for tag in ("SourceFile", "File") for each in build.iter(tag)]
    flags = [*STRICT, "-fPIC", "-shared", "-ffp-contract=off", "-lm", "-o", tmp_path / "again.so"]
    run("cc", *(tmp_path / "sources" / str(unit) for unit in units), *flags)
    assert {"fmu.c", "fmi3.c"} <= set(units)
    assert ("fmi2.c" in units) == ("node" not in file)


def test_the_same_controller_is_the_same_file(exported, tmp_path):
    again = controller_model(can_rig.load_scenario("default"))
    _, path = write_fmus(again, tmp_path / "new" / "folder", force=False)
    assert path.read_bytes() == exported.read_bytes()
    with zipfile.ZipFile(path) as fmu:
        text = fmu.read("modelDescription.xml").decode()
    assert 'unit="N m"' in text


def test_it_is_refused_in_one_line(exported, tmp_path):
    model = controller_model(can_rig.load_scenario("default"))
    folder = exported.parents[1]
    with pytest.raises(LogError, match="exists; choose another"):
        write_fmus(model, folder, force=False)
    with pytest.raises(ExportError, match="cannot be made"):
        write_fmus(model, exported / "below", force=False)
    assert "--fmu and --evidence do not go together" in refused(
        "export", "default", "--fmu", "--evidence", "--out", folder
    )
    done = succeeded("export", "drive-cycle", "--fmu", "--out", tmp_path)
    assert "no FMU of the car: plant must be linear" in done.stdout
    done = succeeded(
        "export", "default", "--fmu", "--out", tmp_path, "--set", "fault.kind=actuator-stuck"
    )
    assert "inputs_default.csv: has no input for actuator-stuck" in done.stderr
    assert len(list(tmp_path.glob("*/*.fmu"))) == 8
    for path in tmp_path.glob("fmi3/c*.fmu"):
        part = EXAMPLE["Part"](path, {})
        for each in part.model.modelVariables:
            if each.start is not None:
                (value,) = getattr(part.fmu, f"get{each.type}")([each.valueReference])
                assert value == float(each.start), each.name
