"""A run with the law or the whole node in C: the same bytes on the bus as with the law in Python.

The law in this process; the node in this process, on emulated boards, and at the other end of a
serial port, which is a program behind a pseudo-terminal.
"""

import ctypes
import os
import random
import re
import shutil
import subprocess
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import can
import pytest

from can_rig.controllers import CONTROLLERS, SERIAL, ecus
from can_rig.controllers.compiled_law import CompiledLaw
from can_rig.controllers.ecus import (
    BenchEcu,
    EmulatedBoard,
    HostEcu,
    SerialLink,
    host_library,
    serial_ecu,
)
from can_rig.controllers.making import controller_of
from can_rig.controllers.our_law import PYTHON, in_node
from can_rig.controllers.protocol import WholeNode
from can_rig.errors import ExportError
from can_rig.export.application import ORDER_HEAD, application, identity
from can_rig.export.boards import BOARDS, COMPILER, EMULATOR, firmware_image
from can_rig.export.compiler import shared_library
from can_rig.export.law import number_headers
from can_rig.export.trials import random_frames
from can_rig.frames.codec import FRAME_BYTES, Transmitter
from can_rig.nodes.lockstep import ControllerNode, EcuNode
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from firmware_model.law.status import Mode
from firmware_model.law.structs import record_type
from firmware_model.law.supervision.knowledge import Saved
from tests import helpers
from tests.rig.export.shared import EMULATED, judged_alike, log_of


def refused(tmp_path: Path, *options: str) -> str:
    """The one line of a run that cannot start."""
    line = helpers.refused("run", "default", *options, "--out", tmp_path / "run")
    assert not (tmp_path / "run").exists()
    return line


# --- the law -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "precision"),
    [("chapter-2", "float64"), ("cluster", "float64"), ("default", "float64"),
     ("nonminimum-phase", "float64"), ("wltc", "float64"), ("default", "float32"),
     ("drive-cycle", "float32"), ("pendulum", "float32")],
)  # fmt: skip
def test_the_log_is_the_same(name, precision):
    tick_s = load(name, []).tick_s
    settings = [f'design.precision="{precision}"', f"duration_s={400 * tick_s}"]
    settings += ["design.speeds_mps=[8.0, 8.9, 30.0]"] if name == "drive-cycle" else []
    if load(name, []).loss.kind != "none":
        settings.append(f"fault.at_s={160 * tick_s}")
    law = controller_of("c", load(name, settings))
    python, c = (log_of(name, settings, each) for each in (PYTHON, law))
    pairs = zip(python.splitlines(), c.splitlines(), strict=True)
    assert next((pair for pair in pairs if pair[0] != pair[1]), None) is None
    assert len(python) > 50_000


def test_the_log_of_a_safe_stop_is_the_same():
    settings = [
        "reference.kind=step", "duration_s=2.2",
        "fault.0.kind=actuator-dead", "fault.0.at_s=0.5", "fault.1.kind=actuator-dead",
        "fault.1.channel=force-difference", "fault.1.at_s=0.8", "design.safe_stop_s=0.1",
    ]  # fmt: skip
    python = log_of("default", settings)
    assert log_of("default", settings, in_node(CompiledLaw("float64"))) == python
    assert log_of("default", settings[:-1]) != python


def test_the_precision_is_the_scenario_s():
    single, double = (
        log_of("default", [f'design.precision="{precision}"', "duration_s=0.2"])
        for precision in ("float32", "float64")
    )
    assert single != double


def test_two_processes_run_the_c(tmp_path):
    command = ["run", "default", "--set", "duration_s=0.2", "--controller", "c"]
    helpers.succeeded(*command, "--out", tmp_path / "run")
    found = (tmp_path / "run" / "bus.log").read_bytes()
    assert found == log_of("default", ["duration_s=0.2"])


NO_IEEE = "IEEE 754 arithmetic: compile without"
REFUSED = {
    "gcc -ffast-math": NO_IEEE,
    "true": "true: must be a C compiler: it has compiled nothing",
    'cc "': "CC = 'cc \"': must be a command: No closing quotation",
    "no-such-compiler --flag": "no-such-compiler: there is no such C compiler",
}


@pytest.mark.parametrize(("compiler", "said"), REFUSED.items(), ids=REFUSED)
def test_a_compiler_that_refuses_is_one_line(compiler, said, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", compiler)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert said in refused(tmp_path, "--controller", "c")


@pytest.mark.parametrize("flag", ["finite-math-only", "unsafe-math-optimizations",
                                  "reciprocal-math", "no-signed-zeros"])  # fmt: skip
def test_a_part_of_fast_math_is_refused(flag, monkeypatch):
    monkeypatch.setenv("CC", f"gcc -f{flag}")
    with pytest.raises(ExportError, match=NO_IEEE):
        shared_library({**number_headers("float32"), "real.c": '#include "real.h"\n'})


# --- the node ------------------------------------------------------------------------------------


def faulty(kind: str, precision: str = "float64") -> list[str]:
    return [
        "duration_s=0.5", f'fault.kind="{kind}"', "fault.at_s=0.2", "fault.for_s=0.1",
        f'design.precision="{precision}"',
    ]  # fmt: skip


def test_the_node_in_c_hears_what_the_actuators_report():
    settings = [
        "duration_s=2.5", "fault.at_s=1.2", 'design.precision="float32"',
        'fault.kind="actuator-oscillating"', 'fault.channel="force-difference"',
        "fault.amplitude=1500", "fault.frequency_rad_per_s=10",
    ]  # fmt: skip
    python = log_of("cluster", settings)
    assert python != log_of("cluster", [*settings, 'sensor=[{measures="yaw-rate"}]'])
    assert python == log_of("cluster", settings, controller_of("ecu", load("cluster", settings)))


@EMULATED
@pytest.mark.parametrize(
    ("board", "precision", "kind"),
    [("m4f", "float32", "frames-corrupted"), ("m7", "float64", "actuator-dead")],
)
def test_an_emulated_board_sends_the_same_bytes(board, precision, kind):
    settings = faulty(kind, precision)
    node = controller_of(f"arm:{board}", load("noisy", settings))
    assert log_of("noisy", settings) == log_of("noisy", settings, node)


@pytest.mark.parametrize(
    ("name", "chosen", "heard"),
    [
        ("default", [], 2),
        ("drive-cycle", ["design.speeds_mps=[8.0, 8.9, 10.0]"], 3),
        ("drive-cycle", ["design.speeds_mps=[20.0]"], 3),  # one design at all speeds
        ("cluster", [], 6),
    ],
    ids=["one speed", "blended", "one design", "further sensors"],
)
def test_any_frames_are_answered_and_judged_alike(name, chosen, heard):
    """Also after a late start."""
    scenario = load(name, ["duration_s=1", *chosen])
    library = host_library(scenario)
    for seed in range(4):
        expected, rejected = judged_alike(scenario, lambda: HostEcu(library), seed)
        assert rejected == {name: expected[name] for name in rejected}  # C hears what the law does
        assert len(rejected) == heard
        assert all(rejected.values())


@EMULATED
def test_an_emulated_board_counts_the_frames_of_the_speed():
    chosen = ["duration_s=1", "design.speeds_mps=[8.0, 8.9]", 'design.precision="float32"']
    scenario = load("drive-cycle", chosen)
    network, counts = network_of(scenario), []
    for name in ("ecu", "arm:m4f"):
        application = controller_of(name, scenario)
        assert isinstance(application, WholeNode)
        ecu = application.start()
        node = EcuNode(scenario, network, lambda message: None, ecu)
        for message in (message for tick in random_frames(network, 3) for message in tick):
            node.take(message)
        counts.append(node.rejected())
        ecu.close()
    assert counts[0] == counts[1]
    assert counts[1]["VEHICLE_SPEED"]


@pytest.mark.parametrize(("tool", "controller"), [(COMPILER, "arm:m4f"), (EMULATOR, "arm:m7")])
def test_a_missing_tool_is_one_line(tool, controller, tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: "/" if name != tool else None)
    line = refused(tmp_path, "--controller", controller)
    assert f"{tool} is not installed" in line
    assert "apt install" in line


@EMULATED
def test_an_emulator_that_ends_is_one_line(tmp_path):
    ecu = BenchEcu(EmulatedBoard(tmp_path / "no-such.elf", "m4f"))
    with pytest.raises(ExportError, match=r"qemu-system-arm has ended: .*no-such\.elf"):
        ecu.take(0x100, bytes(8))
    ecu.close()


@EMULATED
def test_single_precision_calls_no_double_arithmetic():
    """In the law and where a command is packed; 32 received bits need a product in double."""
    image = firmware_image(load("noisy", faulty("none", "float32")), "m4f")
    text = subprocess.run(
        ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(image)],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    functions = dict(re.findall(r"^[0-9a-f]+ <(\w+)>:\n((?:.+\n)*)", text, flags=re.M))
    of_law = {
        name: body
        for name, body in functions.items()
        if name.startswith(
            ("controller_", "biquad_", "mismatch_", "covariance_", "pack_", "frame_whole")
        )
    }
    assert len(of_law) > 10
    for name, body in of_law.items():
        assert not re.search(r"__aeabi_d|__aeabi_f2d|\.f64", body), name
    assert "__aeabi_dmul" in text


def test_real_time_needs_a_node_of_ours(tmp_path):
    said = refused(tmp_path, "--realtime", "--controller", "ecu")
    assert "the controller must be python or c" in said


@pytest.mark.parametrize("name", ["arm:serial:", "arm:m3", "fortran"])
def test_a_controller_that_is_none_is_refused(name, tmp_path):
    assert {each.removeprefix("arm:") for each in CONTROLLERS if ":" in each} == set(BOARDS)
    said = f"{name!r} is not one of python, c, ecu, arm:m4f, arm:m7, arm:serial:PORT."
    assert said in refused(tmp_path, "--controller", name)


# --- the node by the clock -----------------------------------------------------------------------

TICK_US = 2000
SAVED_BYTES = record_type(Saved, "float64").itemsize
DRIVER = """
#include <stddef.h>
#include "ecu.h"
static void (*sender)(uint32_t, const uint8_t *);
void set_sender(void (*called)(uint32_t, const uint8_t *)) { sender = called; }
void ecu_send(const struct ecu *ecu, uint32_t id, uint8_t length, const uint8_t *data)
{ sender(id, data); }
size_t ecu_size(void) { return sizeof(struct ecu); }
uint32_t ecu_alive(const struct ecu *ecu) { return ecu->alive; }
uint32_t ecu_stalls(const struct ecu *ecu) { return ecu->stalls; }
"""
Sender = ctypes.CFUNCTYPE(None, ctypes.c_uint32, ctypes.POINTER(ctypes.c_uint8))


class NodeInC:
    """The exported application with a CAN driver of Python."""

    def __init__(self) -> None:
        self.scenario = load("default", ["duration_s=1", f"tick_s={TICK_US / 1e6}"])
        self.network = network_of(self.scenario)
        files = application(self.scenario) | {"driver.c": DRIVER}
        self.library = ctypes.CDLL(str(shared_library(files)))
        for asked in (self.library.ecu_is_overdue, self.library.ecu_on_frame):
            asked.restype = ctypes.c_bool
        self.sent: list[tuple[int, bytes]] = []
        self._sender = Sender(lambda frame, data: self.sent.append((frame, bytes(data[:8]))))
        self.library.set_sender(self._sender)
        self.ecu = ctypes.create_string_buffer(self.library.ecu_size())
        self.library.ecu_init(self.ecu)

    def take(self, message: can.Message, now_us: int) -> None:
        data, now = bytes(message.data), ctypes.c_uint32(now_us)
        if self.library.ecu_on_frame(self.ecu, message.arbitration_id, len(data), data, now):
            self.library.ecu_on_tick(self.ecu)

    def is_overdue(self, now_us: int) -> bool:
        return bool(self.library.ecu_is_overdue(self.ecu, ctypes.c_uint32(now_us)))


@pytest.mark.parametrize("ppm", [-800, 800])
def test_a_clock_that_drifts_misses_no_frame(ppm):
    """Against the sender's clock the node's clock is off by four ticks at the end."""
    node = NodeInC()
    ends = Transmitter(node.network.reference), Transmitter(node.network.feedback)
    for tick in range(5000):
        at_us = tick * TICK_US + ppm * tick * TICK_US // 1_000_000
        assert not node.is_overdue(at_us)
        for end in ends:
            node.take(end.frame(0.0, tick), at_us)
    assert len(node.sent) == 3 * 5000
    assert (node.library.ecu_alive(node.ecu), node.library.ecu_stalls(node.ecu)) == (5000, 0)


@pytest.mark.parametrize("seed", range(2))
def test_a_feedback_that_does_not_come_is_missed(seed):
    """The application with a CAN driver of Python: half a tick late is missed, as in Python."""
    choose, node = random.Random(seed), NodeInC()
    scenario, network, take, overdue = node.scenario, node.network, node.take, node.is_overdue
    expected: list[tuple[int, bytes]] = []
    python = ControllerNode(
        scenario, network, lambda m: expected.append((m.arbitration_id, bytes(m.data))), PYTHON
    )
    reference, feedback = Transmitter(network.reference), Transmitter(network.feedback)
    start_us = 2**32 - 50 * TICK_US  # the clock wraps
    assert not overdue(start_us)
    missed = 0
    for tick in range(120):
        at_us = start_us + tick * TICK_US
        wanted, measured = (
            each.frame(choose.uniform(-2, 2), tick) for each in (reference, feedback)
        )
        python.take(wanted)
        take(wanted, at_us)
        if tick and choose.random() < 0.3:
            assert not overdue(at_us + TICK_US // 2 - 200)
            assert overdue(at_us + TICK_US // 2 + 200)
            node.library.ecu_on_tick(node.ecu)
            python.miss()
            missed += 1
        else:
            python.take(measured)
            take(measured, at_us + choose.randrange(-100, 100))
        assert not overdue(at_us + TICK_US // 2 + 200)
        assert node.sent == expected
    assert missed > 20
    assert len(expected) == 3 * 120


def test_a_node_that_stood_still_sends_no_burst():
    """The node makes up for few ticks; after a longer standstill it begins with the next frames."""
    node = NodeInC()
    library, ecu, sent, network = node.library, node.ecu, node.sent, node.network

    def tick(number: int, now_us: int) -> None:
        for end in ends:
            node.take(end.frame(0.01 * (number % 50), number), now_us)

    for late_us, made_up in (
        (TICK_US // 2 - 1, 0), (TICK_US // 2, 1), (15 * TICK_US + TICK_US // 2, 16),
        (16 * TICK_US, 16), (16 * TICK_US + 1, 0), (2_000_000, 0), (2**31 + TICK_US, 0),
        (2**32 - 2 * TICK_US - 1, 0),
    ):  # fmt: skip
        library.ecu_init(ecu)
        sent.clear()
        ends = [Transmitter(network.reference), Transmitter(network.feedback)]
        for number in range(200):
            tick(number, number * TICK_US)
        now_us = 200 * TICK_US + late_us
        known, kept = (ctypes.create_string_buffer(SAVED_BYTES) for _ in range(2))
        library.ecu_save(ecu, known)
        while node.is_overdue(now_us):
            library.ecu_on_tick(ecu)
        stalled = late_us > 16 * TICK_US
        assert (len(sent) // 3 - 200, library.ecu_stalls(ecu)) == (made_up, stalled)
        library.ecu_save(ecu, kept)
        assert any(known.raw[16:]) and (kept.raw == known.raw or not stalled)
        first = now_us // TICK_US + 1
        for number in range(first, first + 30):
            tick(number, number * TICK_US)
        assert len(sent) == 3 * library.ecu_alive(ecu)
        ticks = [int.from_bytes(data[2:4], "little") for _, data in sent[-3:]]
        assert ticks == [(first + 29) % 65536] * 3 or not stalled


def test_an_old_reference_does_not_come_back_when_the_number_of_its_tick_does():
    """A tick has 16 bits, and the reference has been missing since; in Python likewise."""
    node, answers = NodeInC(), []
    status = node.network.status
    python = ControllerNode(node.scenario, node.network, answers.append, PYTHON)
    reference, feedback = Transmitter(node.network.reference), Transmitter(node.network.feedback)
    for number in range(10):
        for frame in (reference.frame(0.5, number), feedback.frame(0.001 * number, number)):
            python.take(frame)
            node.take(frame, 0)
    for _ in range(10, 2**16 + 9):
        python.miss()
        node.library.ecu_on_tick(node.ecu)
    last = feedback.frame(0.0, 9)
    python.take(last)
    node.take(last, 0)
    assert [status.decode(answer).mode for answer in (answers[-1].data, node.sent[-1][1])] == [
        Mode.SAFE_STOP, Mode.SAFE_STOP,
    ]  # fmt: skip
    assert len(answers) == len(node.sent) == 3 * (2**16 + 10)


# --- the node at a serial port -------------------------------------------------------------------


@contextmanager
def board(*command: str | Path) -> Iterator[str]:
    """A port with a program at its other end."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    running = subprocess.Popen([*map(str, command)], stdin=ours, stdout=ours)
    try:
        yield os.ttyname(theirs)
    finally:
        running.kill()
        running.wait()
        os.close(ours)
        os.close(theirs)


def test_a_board_at_a_port_sends_the_same_bytes(built):
    settings = faulty("frames-corrupted")
    python = log_of("noisy", settings)
    with board(built("float64") / "bench") as port:
        node = controller_of(f"{SERIAL}{port}", load("noisy", settings))
        for _ in range(2):  # and again
            assert python == log_of("noisy", settings, node)


@pytest.mark.parametrize("cut_short", [b"F", b"F\x01\x02", b"C", b"R" + bytes(10), b"xyz"])
def test_what_was_cut_short_is_forgotten(built, cut_short, monkeypatch):
    monkeypatch.setattr(ecus, "QUIET_S", 0.5)  # the board is a program on a busy machine
    with board(built("float64") / "bench") as port:
        link = SerialLink(port)
        link.write(cut_short)
        link.close()
        ecu = serial_ecu(port, identity(application(load("noisy", []))), "noisy")
        assert ecu.take(0x7FF, b"12345678") == []
        assert ecu.counts() == [0] * 20
        ecu.close()


def test_another_controller_is_refused(built):
    with (
        board(built("float64") / "bench") as port,
        pytest.raises(ExportError, match="another controller answers"),
    ):
        serial_ecu(port, identity(application(load("default", []))), "default")


def test_a_board_that_is_silent_is_one_line(monkeypatch):
    monkeypatch.setattr(ecus, "SILENCE_S", 0.05)
    with board("sleep", "60") as port, pytest.raises(ExportError, match=f"{port}: 0 of 8 bytes"):
        serial_ecu(port, bytes(8), "default")


def test_an_answer_that_is_none_is_one_line():
    asked_for = (
        f"head -c {ORDER_HEAD + FRAME_BYTES + 1} > /dev/null"  # what clears the line, and an order
    )
    with board("sh", "-c", f"{asked_for}; printf '%s' xxxxxxxxxxxxx; sleep 60") as port:
        ecu = BenchEcu(SerialLink(port))
        with pytest.raises(ExportError, match="sent 120 frames"):
            ecu.take(0x100, bytes(8))


def test_a_port_that_is_none_is_one_line(tmp_path):
    line = refused(tmp_path, "--in-process", "--controller", f"{SERIAL}{tmp_path}/none")
    assert f"{tmp_path}/none: cannot be opened as a serial port" in line


FIRST, SECOND = (
    f"    content.value = now.command_{n};\n"
    f"    answer(ecu, {n}, &frame_command_{n}, &ecu->command_{n}, &content);\n"
    for n in (1, 2)
)


@pytest.mark.parametrize(
    ("flow", "counted"),
    [(FIRST + SECOND, 5), (SECOND, 0), (SECOND + FIRST, 0), (FIRST + SECOND + SECOND, 0)],
    ids=["whole", "left out", "swapped", "repeated"],
)
def test_only_a_tick_with_all_its_stages_in_order_is_alive(flow, counted):
    node = application(load("default", ["duration_s=1"]))
    assert FIRST + SECOND in node["ecu.c"]
    node |= {"driver.c": DRIVER, "ecu.c": node["ecu.c"].replace(FIRST + SECOND, flow)}
    library = ctypes.CDLL(str(shared_library(node)))
    sender = Sender(lambda *_: None)
    library.set_sender(sender)
    ecu = ctypes.create_string_buffer(library.ecu_size())
    library.ecu_init(ecu)
    for _ in range(5):
        library.ecu_on_tick(ecu)
    assert library.ecu_alive(ecu) == counted
