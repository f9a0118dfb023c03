"""A car whose speed changes, on the bus: its frame, what the controller makes of it, its log."""

from collections.abc import Callable

import can
import numpy as np
import pytest

from can_rig.controllers.making import controller_of
from can_rig.controllers.our_law import PYTHON, OurLaw
from can_rig.controllers.protocol import Answer, InNode, Inputs
from can_rig.frames.codec import Transmitter
from can_rig.frames.operator_frames import Command, taken_message
from can_rig.logs.reading import read_log
from can_rig.nodes.lockstep import ControllerNode
from can_rig.panel.live import LiveSignals
from can_rig.plant.frameless import frameless
from can_rig.replaying.replay import OpenLoop
from can_rig.results.report.page import page
from can_rig.results.report.web_page import recording
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.driving import speeds_at_ticks
from can_rig.scenario.loading import load
from firmware_model.firmware import PYTHON_LAW
from tests.helpers import asked, decoded, on_a_bus, succeeded
from tests.rig.panel.test_live import heard

DRIVE = (
    "duration_s=0.6", "drive.ramps=[[0.0, 10.0], [0.5, 13.0]]", "reference.kind=sine",
    "fault.at_s=0.3", "budget.box=0", "budget.actuator_box=0",
)  # fmt: skip
SCENARIO = load("default", DRIVE)
NETWORK = network_of(SCENARIO)
FRAMES = 6
QUICK = ("--in-process", "--allow-unstable")  # nothing is looked at before the run


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "bus.log"
    on_a_bus(SCENARIO, path)
    return path


def test_the_speed_is_the_first_frame_of_every_tick(log):
    (frames,) = read_log(log)
    assert NETWORK.speed is not None
    identifiers = frames.arbitration_id.reshape(-1, FRAMES)
    assert (identifiers == [codec.frame_id for codec in NETWORK.on_the_bus]).all()
    assert (np.diff(identifiers[0].astype(int)) > 0).all()  # the order in which they win the bus
    values = decoded(log)["VEHICLE_SPEED"]
    np.testing.assert_allclose(values, speeds_at_ticks(SCENARIO), atol=0.5001 * NETWORK.speed.lsb)
    assert network_of(load("default")).speed is None


def test_signals_have_it_and_replay_knows_it(log):
    signals = read_signals(log, NETWORK, SCENARIO.tick_s)
    assert signals.plant["speed_mps"].tolist() == speeds_at_ticks(SCENARIO).tolist()
    loop = OpenLoop(SCENARIO, NETWORK)
    loop.run(read_log(log))
    assert not loop.account.gaps
    assert loop.comparison.same_bytes == 3 * SCENARIO.ticks
    other = OpenLoop(load("default", [*DRIVE, "design.speeds_mps=[10]"]), NETWORK)
    other.run(read_log(log))
    assert not other.comparison.identical


def test_report_and_panel_show_it(log):
    signals = read_signals(log, NETWORK, SCENARIO.tick_s)
    shown = recording(SCENARIO, NETWORK, signals)
    curve, values = shown.curves[-1]
    assert (shown.charts[-1].title, curve.unit) == ("speed", "m/s")
    assert values[-1] == pytest.approx(13.0)
    drawn = page(SCENARIO, NETWORK, signals).axes[-1]  # over the fault estimate
    assert drawn.lines[0].get_ydata().max() == pytest.approx(13.0)
    assert LiveSignals(SCENARIO, NETWORK).lamps.speed_mps is None
    live, _ = heard(SCENARIO, can.LogReader(log))
    assert live.lamps.speed_mps == pytest.approx(13.0)


def test_the_law_in_c_and_the_loop_without_a_bus_leave_the_same(log, tmp_path):
    for kind in ("c", "ecu"):  # the law, and the node in C with its receive rules
        own = tmp_path / f"{kind}.log"
        on_a_bus(SCENARIO, own, controller_of(kind, SCENARIO))
        assert own.read_bytes() == log.read_bytes()
    trace = frameless(SCENARIO)
    assert trace.fault_state[-1] == 2
    assert (
        trace.measured.tolist() == read_signals(log, NETWORK, SCENARIO.tick_s).dstar_mps2.tolist()
    )


def test_a_replay_says_which_frames_of_the_speed_are_missing(log):
    (frames,) = read_log(log)
    at = 100 * FRAMES
    keep = np.ones(len(frames), dtype=np.bool_)
    keep[[at, at + FRAMES]] = False
    loop = OpenLoop(SCENARIO, NETWORK)
    loop.run([frames[keep]])
    assert [(gap.tick, gap.message, gap.what, gap.ticks) for gap in loop.account.gaps] == [
        (100, "VEHICLE_SPEED", "missing", 2)
    ]
    assert loop.comparison.without_input == 2


Change = Callable[[can.Message], can.Message | None]


def damaged(message: can.Message) -> can.Message:
    message.data[5] ^= 1
    return message


def commands(change: Change, ticks: range) -> tuple[list[bytes], ControllerNode]:
    """What a node answers to 30 ticks while ``change`` is made to the speeds of ``ticks``."""
    sent: list[bytes] = []
    node = ControllerNode(
        SCENARIO, NETWORK, lambda message: sent.append(bytes(message.data)), PYTHON
    )
    assert NETWORK.speed is not None
    senders = [Transmitter(codec) for codec in (NETWORK.speed, NETWORK.reference, NETWORK.feedback)]
    for tick in range(30):
        values = (10.0 + 0.05 * tick, 0.5, 0.01 * tick)
        own, *others = (s.frame(v, tick) for s, v in zip(senders, values, strict=True))
        speed = change(own) if tick in ticks else own
        for message in ([speed] if speed else []) + others:
            node.take(message)
    return sent, node


def test_the_controller_is_told_every_intact_speed_the_first_too():
    heard: list[float] = []

    class Listening(OurLaw):
        def step(self, inputs: Inputs) -> Answer:
            heard.append(inputs.speed_mps)
            return super().step(inputs)

    controller = InNode(lambda scenario, network: Listening(scenario, network, PYTHON_LAW))
    node = ControllerNode(SCENARIO, NETWORK, lambda _message: None, controller)
    assert node.take(taken_message(Command("PAUSE"), 5)) is False  # answers no tick
    assert NETWORK.speed is not None
    ends = [Transmitter(codec) for codec in (NETWORK.speed, NETWORK.reference, NETWORK.feedback)]
    for tick, speed_mps in enumerate((8.0, 9.0, 10.0, 11.0)):
        values = (speed_mps, 0.0, 0.0)
        frames = [end.frame(value, tick) for end, value in zip(ends, values, strict=True)]
        frames[0].data[5] ^= tick == 2
        assert [node.take(frame) for frame in frames] == [False, False, True]
    np.testing.assert_array_equal(heard, [8.0, 9.0, np.nan, 11.0])


def test_without_a_good_frame_the_last_speed_is_held():
    whole, node = commands(lambda message: message, range(30))
    assert node.rejected()["VEHICLE_SPEED"] == {}
    missing, node = commands(lambda message: None, range(10, 20))
    assert node.rejected()["VEHICLE_SPEED"] == {"no_new_data": 10}
    wrong, node = commands(damaged, range(10, 20))
    assert node.rejected()["VEHICLE_SPEED"] == {"wrong_crc": 10}
    assert wrong == missing
    assert whole[:30] == missing[:30]
    assert whole[30:60] != missing[30:60]


def test_a_node_of_one_speed_and_a_node_of_many_differ_only_where_the_speed_does():
    """At the speed of a design the blended table is that design, to rounding.

    The whitener of a disturbance alone stays that of the slowest design.
    """
    still = ["budget.disturbance_mps2=0", "duration_s=0.3", "fault.at_s=0.1", "reference.kind=sine"]
    alone = load("default", [*still, "plant.speed_mps=13"])
    told = load("default", [*still, "drive.speed_mps=13", "design.speeds_mps=[12, 13]"])
    ours, theirs = (frameless(each) for each in (told, alone))
    np.testing.assert_allclose(ours.measurement, theirs.measurement, atol=2e-6)
    np.testing.assert_allclose(ours.command_1, theirs.command_1, atol=2e-2)


def test_what_if_repeats_a_drive(tmp_path):
    folder = tmp_path / "run"
    settings = [f"--set={each}" for each in DRIVE]
    assert asked("run", "default", *settings, *QUICK, "--out", folder).returncode == 0
    again = tmp_path / "again"
    succeeded("replay", folder, "--what-if", "--allow-unstable", "--out", again)
    assert (again / "bus.log").read_bytes() == (folder / "bus.log").read_bytes()
    assert "speed_mps" in (folder / "signals.csv").read_text().splitlines()[0]
    succeeded("decode", folder / "bus.log", "--out", tmp_path / "decoded.csv")
    assert "VehicleSpeed" in (tmp_path / "decoded.csv").read_text().splitlines()[0]


def test_a_drive_by_the_wall_clock(tmp_path):
    settings = [f"--set={each}" for each in (*DRIVE, "tick_s=0.005", "latency_ticks=2")]
    done = succeeded("run", "default", *settings, "--realtime", "--out", tmp_path / "run")
    assert "VEHICLE_SPEED" not in done.stderr
    assert len((tmp_path / "run" / "signals.csv").read_text().splitlines()) == 121
