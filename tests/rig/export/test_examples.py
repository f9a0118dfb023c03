"""The examples of ``docs/examples/c``: each answers recorded ticks as the law in Python does.

On emulated boards, and on this computer as a user of CMake and of a Zephyr module builds them.
"""

import math
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from can_rig.export.application import application, exported, write
from can_rig.export.boards import emulated, image_of
from can_rig.export.compiler import built
from can_rig.export.law import support
from can_rig.scenario.build import network_of
from can_rig.scenario.controls import controls
from can_rig.scenario.loading import load
from firmware_model.firmware import Firmware
from tests.rig.export.shared import EMULATED, STRICT, log_of, run
from tests.rig.own_frames.scenarios import FD_SIGNALS, database, options

EXAMPLES = Path(__file__).parents[3] / "docs" / "examples" / "c"
SETTINGS = [
    "duration_s=0.2", "fault.kind=frames-missing", "fault.channel=sensor", "fault.at_s=0.1",
    'design.precision="float32"',
]  # fmt: skip
SCENARIO = load("default", SETTINGS)
SOURCES = {
    "super_loop": ("super_loop.c", "driver.c", "driver.h"),
    "tasks": ("tasks.c", "driver.c", "driver.h"),
    "steering": ("steering.c", "rte_main.c", "Rte_Steering.h"),
}
FRAME, FD_FRAME = "<IIB8s3x", "<IIB16s3x"
BOARD = {"super_loop": "m4f", "tasks": "m7", "steering": "m4f"}


def frames(missing_s: float = 0.1) -> tuple[bytes, list[tuple[int, bytes]]]:
    """What the node receives, as ``struct driver_frame``, and what the law in Python sends.

    The feedback is missing for ``missing_s`` from 0.1 s on.
    """
    received, sent = b"", []
    network = network_of(SCENARIO)
    sends = {codec.frame_id for codec in (network.command_1, network.command_2, network.status)}
    settings = [*SETTINGS, f"fault.for_s={missing_s}"]
    for line in log_of("default", settings).decode().splitlines():
        at, _, frame, _ = line.split()
        number, data = (each for each in frame.split("#"))
        frame_id, payload = int(number, 16), bytes.fromhex(data)
        if frame_id in sends:
            sent.append((frame_id, payload))
        elif not payload.endswith(b"\x00\x00\x00\x80"):  # a value, which needs a frame
            at_us = round(float(at.strip("()")) * 1e6)
            received += struct.pack(FRAME, at_us, frame_id, 8, payload)
    assert len(sent) == 3 * 200
    assert len(received) == struct.calcsize(FRAME) * (400 - round(1e3 * missing_s))
    return received, sent


def signals() -> tuple[bytes, bytes]:
    """Reference and measurement of each tick, and the answers of the law in Python."""
    inputs = np.array([[math.sin(k / 30), 0.9 * math.sin(k / 30 - 0.1)] for k in range(300)])
    inputs[100, 0] = inputs[150:160, 1] = math.nan
    firmware = Firmware(controls(SCENARIO, network_of(SCENARIO)).table)
    firmware.begin()
    answers = (firmware.step(*each) for each in inputs.tolist())
    return inputs.tobytes(), b"".join(struct.pack("<3f3i", *each) for each in answers)


def check(example: str, answered: bytes) -> None:
    """Compare what an example has written with the law in Python."""
    if example == "steering":
        assert answered == signals()[1]
    else:
        assert sent_frames(answered) == frames()[1]


def sent_frames(answered: bytes) -> list[tuple[int, bytes]]:
    """Identifier and data of each ``struct driver_frame``."""
    return [(frame[1], frame[3]) for frame in struct.iter_unpack(FRAME, answered)]


def inputs_of(example: str) -> bytes:
    """The file that an example reads."""
    return signals()[0] if example == "steering" else frames()[0]


@EMULATED
@pytest.mark.parametrize("example", SOURCES)
def test_on_a_board_it_answers_as_in_python(example):
    main, *others = SOURCES[example]
    files = {name: (EXAMPLES / name).read_text(encoding="utf-8") for name in (main, *others)}
    image = image_of(application(SCENARIO) | files, None, BOARD[example])
    answered = emulated(
        image, BOARD[example], {"received": inputs_of(example)}, "sent",
        "-icount", "shift=6,sleep=off",
    )  # fmt: skip
    check(example, answered)


def program(example: str, node: dict[str, str], *flags: str) -> Path:
    """An example as a program of this computer."""
    files = {name: (EXAMPLES / name).read_text(encoding="utf-8") for name in SOURCES[example]}
    files["host_files.c"] = (EXAMPLES / "host_files.c").read_text(encoding="utf-8")
    files["host.h"] = support("host.h")
    return built(["cc"], (*STRICT, *flags), node | files, ".out")


def test_a_loop_as_slow_as_the_tick_survives_a_missing_feedback(tmp_path):
    """The frames of the next tick are there before the clock is read."""
    received, sent = frames(missing_s=0.001)
    (tmp_path / "received").write_bytes(received)
    run(program("super_loop", application(SCENARIO), "-DDRIVER_STEP_US=1000u"), cwd=tmp_path)
    assert sent_frames((tmp_path / "sent").read_bytes()) == sent


def test_an_example_carries_identifiers_of_29_bits_and_frames_of_can_fd(tmp_path):
    path, flags = tmp_path / "own.dbc", 0xC0000000
    text = database("48|32@1- (1,0) [0|0]", 16, first_id=0x80001300, types="1", fd=True)
    path.write_text(text, encoding="utf-8")
    scenario = load("default", [*options(path, FD_SIGNALS), "duration_s=0.1"])
    network = network_of(scenario)
    inputs = b"".join(
        struct.pack(FD_FRAME, 0, codec.frame_id | flags, 16, bytes(codec.encode(0.0, tick=7)))
        for codec in (network.reference, network.feedback)
    )
    (tmp_path / "received").write_bytes(inputs)
    run(program("super_loop", application(scenario)), cwd=tmp_path)
    answered = struct.iter_unpack(FD_FRAME, (tmp_path / "sent").read_bytes())
    sent = [network.command_1, network.command_2, network.status]
    assert [frame[1:3] for frame in answered][:3] == [(each.frame_id | flags, 16) for each in sent]


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """An export that ``cmake --install`` has put into a folder of its own."""
    if shutil.which("cmake") is None:
        pytest.skip("cmake is not installed")
    place = tmp_path_factory.mktemp("cmake")
    write(exported(SCENARIO), place / "controller", force=False)
    run("cmake", "-S", place / "controller", "-B", place / "build")
    run("cmake", "--build", place / "build", "--target", "firmware", "example", "self_test")
    assert "100% tests passed" in run("ctest", "--test-dir", place / "build")
    run("cmake", "--install", place / "build", "--prefix", place / "opt")
    return place


def test_find_package_finds_an_installed_export(installed, tmp_path):
    """The installed package needs no file of the folder of the export."""
    (installed / "controller").rename(installed / "moved")
    run("cmake", "-S", EXAMPLES, "-B", tmp_path, f"-DCMAKE_PREFIX_PATH={installed / 'opt'}",
        f"-DCMAKE_C_FLAGS={' '.join(STRICT)}")  # fmt: skip
    (installed / "moved").rename(installed / "controller")
    run("cmake", "--build", tmp_path)
    for example in ("super_loop", "steering"):
        (tmp_path / "received").write_bytes(inputs_of(example))
        run(tmp_path / example, cwd=tmp_path)
        check(example, (tmp_path / "sent").read_bytes())


ZEPHYR = """\
cmake_minimum_required(VERSION 3.13)
project(application C)
set(CONFIG_FIRMWARE y)
macro(zephyr_library_named name)
  add_library(${name} STATIC)
  set(library ${name})
endmacro()
macro(zephyr_library_sources)
  target_sources(${library} PRIVATE ${ARGN})
endmacro()
macro(zephyr_include_directories)
  include_directories(${ARGN})
endmacro()
add_subdirectory(MODULE/zephyr module)
"""
"""A build system with the three functions of Zephyr's that the module calls, as documented."""


def test_the_zephyr_module_has_all_sources_and_no_program(installed, tmp_path):
    controller = installed / "controller"
    shutil.copytree(EXAMPLES / "zephyr", controller / "zephyr", dirs_exist_ok=True)
    said = (controller / "zephyr" / "module.yml").read_text(encoding="utf-8")
    places = dict(line.split(": ") for line in said.splitlines() if line.startswith("  "))
    assert (controller / places["  cmake"] / "CMakeLists.txt").is_file()
    assert (controller / places["  kconfig"]).is_file()
    (tmp_path / "CMakeLists.txt").write_text(ZEPHYR.replace("MODULE", str(controller)))
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build")
    run("cmake", "--build", tmp_path / "build")
    objects = run("ar", "t", tmp_path / "build" / "module" / "libfirmware.a").splitlines()
    expected = run("ar", "t", installed / "build" / "libfirmware.a").splitlines()
    assert sorted(objects) == sorted(expected)
