"""The whole controller node in C, on this machine and on emulated ones: the same bytes."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from can_rig.assessment.resolve import load
from can_rig.cli.main import main
from can_rig.errors import ExportError
from can_rig.export import CONTROLLERS
from can_rig.export.controllers import PYTHON, Application, controller_of
from can_rig.export.ecus import (
    BOARDS,
    COMPILER,
    EMULATOR,
    BenchEcu,
    EmulatedBoard,
    HostEcu,
    firmware_image,
    host_library,
)
from can_rig.export.programs import random_frames
from can_rig.nodes.lockstep import ControllerNode, EcuNode
from can_rig.scenario.build import network_of
from tests.rig.export.test_controller_c import log_of

EMULATED = pytest.mark.skipif(
    shutil.which(COMPILER) is None or shutil.which(EMULATOR) is None,
    reason=f"{COMPILER} or {EMULATOR} is not installed",
)
FAULTS = ("none", "actuator-dead", "frames-missing", "frames-corrupted")


def settings(fault: str, precision: str = "float64") -> list[str]:
    return [
        "duration_s=1.2", f'fault.kind="{fault}"', "fault.at_s=0.5", "fault.for_s=0.3",
        f'design.precision="{precision}"',
    ]  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_the_node_in_c_sends_the_same_bytes(fault: str, tmp_path: Path) -> None:
    chosen = settings(fault)
    node = controller_of("ecu", load("default", chosen))
    python = log_of("default", chosen, PYTHON, tmp_path / "python")
    assert python == log_of("default", chosen, node, tmp_path / "ecu")


@EMULATED
@pytest.mark.parametrize(
    ("board", "precision", "fault"),
    [
        ("m4f", "float32", "frames-corrupted"),
        ("m4f", "float64", "actuator-dead"),
        ("m7", "float64", "frames-missing"),
        ("m7", "float32", "actuator-dead"),
    ],
)
def test_an_emulated_board_sends_the_same_bytes(
    board: str, precision: str, fault: str, tmp_path: Path
) -> None:
    chosen = settings(fault, precision)
    node = controller_of(f"arm:{board}", load("noisy", chosen))
    python = log_of("noisy", chosen, PYTHON, tmp_path / "python")
    assert python == log_of("noisy", chosen, node, tmp_path / board)


@pytest.mark.parametrize(
    ("name", "chosen", "heard"),
    [
        ("default", [], 2),
        ("drive-cycle", ["design.speeds_mps=[8.0, 8.9, 10.0]"], 3),
        ("drive-cycle", ["design.speeds_mps=[20.0]"], 3),  # one design at all speeds
    ],
    ids=["one speed", "blended", "one design"],
)
def test_any_frames_are_answered_and_judged_alike(name: str, chosen: list[str], heard: int) -> None:
    """Wrong ticks, wrong lengths, repeated, damaged and missing frames, and a late start."""
    scenario = load(name, ["duration_s=1", *chosen])
    network = network_of(scenario)
    library = host_library(scenario)
    for seed in range(20):
        inputs = [message for tick in random_frames(network, seed) for message in tick]
        sent: list[list[tuple[int, bytes]]] = [[], []]
        nodes = (
            ControllerNode(scenario, network, lambda m, s=sent[0]: s.append(
                (m.arbitration_id, bytes(m.data)))),
            EcuNode(scenario, network, lambda m, s=sent[1]: s.append(
                (m.arbitration_id, bytes(m.data))), HostEcu(library)),
        )  # fmt: skip
        for message in inputs:
            one, other = (node.take(message) for node in nodes)
            assert one == other
        assert sent[0] == sent[1]
        assert len(sent[0]) > 0
        rejected = nodes[1].rejected()
        assert rejected == nodes[0].rejected()
        assert len(rejected) == heard
        assert all(rejected.values())


@EMULATED
def test_an_emulated_board_counts_the_frames_of_the_speed() -> None:
    chosen = ["duration_s=1", "design.speeds_mps=[8.0, 8.9]", 'design.precision="float32"']
    scenario = load("drive-cycle", chosen)
    network, counts = network_of(scenario), []
    for name in ("ecu", "arm:m4f"):
        application = controller_of(name, scenario)
        assert isinstance(application, Application)
        node = EcuNode(scenario, network, lambda message: None, application.start())
        for message in (message for tick in random_frames(network, 3) for message in tick):
            node.take(message)
        counts.append(node.rejected())
        node.close()
    assert counts[0] == counts[1]
    assert counts[1]["VEHICLE_SPEED"]


@pytest.mark.parametrize(("tool", "controller"), [(COMPILER, "arm:m4f"), (EMULATOR, "arm:m7")])
def test_a_missing_tool_is_one_line(
    tool: str, controller: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = shutil.which
    monkeypatch.setattr(shutil, "which", lambda name: "/" if name != tool else None)
    command = ["run", "default", "--controller", controller, "--out", str(tmp_path / "run")]
    done = CliRunner().invoke(main, command)
    monkeypatch.setattr(shutil, "which", found)
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert f"{tool} is not installed" in line
    assert "apt install" in line


@EMULATED
def test_an_emulator_that_ends_is_one_line(tmp_path: Path) -> None:
    ecu = BenchEcu(EmulatedBoard(tmp_path / "no-such.elf", "m4f"))
    with pytest.raises(ExportError, match=r"qemu-system-arm has ended: .*no-such\.elf"):
        ecu.take(0x100, bytes(8))
    ecu.close()


@pytest.mark.skipif(shutil.which(COMPILER) is None, reason=f"{COMPILER} is not installed")
def test_single_precision_calls_no_double_arithmetic() -> None:
    """In the law: the frames' own conversion is double, as their resolution needs it."""
    image = firmware_image(load("noisy", settings("none", "float32")), "m4f")
    text = subprocess.run(
        ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(image)],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    functions = dict(re.findall(r"^[0-9a-f]+ <(\w+)>:\n((?:.+\n)*)", text, flags=re.M))
    of_law = {
        name: body
        for name, body in functions.items()
        if name.startswith(("controller_", "biquad_", "mismatch_", "decision_", "covariance_"))
    }
    assert len(of_law) > 10
    for name, body in of_law.items():
        assert "__aeabi_d" not in body, name
        assert "__aeabi_f2d" not in body, name
        assert ".f64" not in body, name
    assert "__aeabi_ddiv" in functions["frame_pack"] or "__aeabi_ddiv" in text


def test_real_time_needs_a_node_of_ours(tmp_path: Path) -> None:
    command = ["run", "default", "--realtime", "--controller", "ecu"]
    done = CliRunner().invoke(main, [*command, "--out", str(tmp_path / "run")])
    assert done.exit_code == 2
    assert "the controller must be python or c" in done.stderr


def test_the_boards_are_those_of_the_option() -> None:
    assert {name.removeprefix("arm:") for name in CONTROLLERS if ":" in name} == set(BOARDS)
