"""A run that is touched while it goes on, against the same faults in the scenario."""

import random
from pathlib import Path

import can
import numpy as np
import pytest

from can_rig.controllers.making import controller_of
from can_rig.frames import operator_frames
from can_rig.frames.codec import Transmitter
from can_rig.frames.operator_frames import Command, command_message, taken_message
from can_rig.logs.reading import read_log
from can_rig.nodes.bus_access import DEFAULT_TIMEOUTS, StopRequest, Watchdog
from can_rig.nodes.ends import PlantEnd
from can_rig.nodes.interaction import Interaction
from can_rig.nodes.operating import Touch, done, touches
from can_rig.nodes.run_control import FollowedFaults, RunControl
from can_rig.plant.faults.frame_faults import FrameFaults
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.clock import TurnedClock, Wire
from tests.helpers import on_a_bus

SETTINGS = ("duration_s=0.3", "fault.kind=none")
FRAMES = 5  # of a tick


def touched(
    folder: Path,
    *commands: tuple[int, Command],
    controller="python",
    name="ideal",
    settings=SETTINGS,
):
    """A run to which ``commands`` came after so many frames of the network, and its scenario."""
    scenario = load(name, settings)
    told = tuple(
        Touch(after, 0, command_message(command, number))
        for number, (after, command) in enumerate(commands)
    )
    log = folder / f"{len(list(folder.glob('*.log')))}.log"
    chosen, interaction = controller_of(controller, scenario), Interaction(True, told=told)
    return log, scenario, on_a_bus(scenario, log, chosen, interaction=interaction)


def frames(log: Path) -> list[str]:
    """What the nodes sent, in its order."""
    told = f"{operator_frames.identifiers().control:03X}#"
    said = [line.partition(" ")[2] for line in log.read_text().splitlines()]
    return [frame for frame in said if told not in frame]


def columns(path: Path) -> dict[str, list[str]]:
    """A file of plant signals, column by column; a run that is touched has the world's too."""
    names, *rows = (line.split(",") for line in path.read_text().splitlines())
    return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


DEAD = Command("INJECT", "actuator-dead", "torque", None, 0.1)


@pytest.mark.parametrize(
    ("kind", "place", "value", "for_s", "key"),
    [("actuator-dead", "torque", None, 0.1, ""),
     ("sensor-biased", "sensor", 0.07, None, "bias_mps2"),
     ("actuator-late", "force-difference", 3.0, None, "late_ticks"),
     ("sensor-stuck", "sensor", None, None, ""), ("frames-missing", "torque", None, 0.1, ""),
     ("frames-corrupted", "force-difference", None, 0.1, ""),
     ("frames-repeated", "torque", None, 0.1, ""), ("frames-repeated", "sensor", None, 0.1, ""),
     ("frames-late", "torque", 3.0, 0.1, "late_ticks"),
     ("frames-forged", "torque", 2.5, 0.1, "value"),
     ("frames-forged", "sensor", 0.25, 0.1, "value")],
)  # fmt: skip
def test_an_injected_fault_is_that_of_a_scenario_from_the_next_tick_on(
    tmp_path, kind, place, value, for_s, key
):
    # Within tick 100: after its reference, feedback and first command.
    command = Command("INJECT", kind, place, value, for_s)
    log, scenario, _ = touched(tmp_path, (100 * FRAMES + 3, command))
    keys = [f"kind={kind}", *([f"for_s={for_s}"] if for_s else [])]
    keys += [f"{key}={value:g}"] if key else []
    keys += [] if kind.startswith("sensor") else [f"channel={place}"]
    same = load("ideal", [*SETTINGS, "fault.at_s=0.101", *(f"fault.{each}" for each in keys)])
    other = tmp_path / "scheduled.log"
    on_a_bus(same, other)
    assert frames(log) == frames(other)
    ours, scheduled = columns(tmp_path / "0.plant.csv"), columns(tmp_path / "scheduled.plant.csv")
    assert {name: ours[name] for name in scheduled} == scheduled
    assert (
        done(scenario, touches(read_log(log), network_of(scenario))).scenario.faults == same.faults
    )


@pytest.mark.parametrize(
    ("name", "kind", "value", "keys"),
    [("ideal", "gust", 300.0, "force_n=300, arm_m=0.3"), ("ideal", "bank", -5.0, "bank_percent=-5"),
     ("ideal", "friction", 0.5, "front=0.5, rear=0.5"),
     ("nonlinear-car", "steering-kick", 20.0, "torque_nm=20"),
     ("two-masses", "push", 0.4, "size=0.4")],
)  # fmt: skip
def test_the_world_pushes_from_the_next_tick_on_until_it_is_cleared(
    tmp_path, name, kind, value, keys
):
    """As a disturbance of the scenario, but for the rounding of a calm plant's equations."""
    more = ["plant.e=[0, 0, 1, 0]"] if name == "two-masses" else []
    calm = load(name, [*more, "fault.kind=none"])
    settings = [*more, "fault.kind=none", f"duration_s={500 * calm.tick_s!r}"]
    push = Command("INJECT", kind, "world", value)
    commands = [(100 * FRAMES + 3, push), (450 * FRAMES + 3, Command("CLEAR", place="world"))]
    log, scenario, summary = touched(tmp_path, *commands, name=name, settings=settings)
    assert "RIG_CONTROL" not in summary.rejected_frames
    begin_s, end_s = 101 * calm.tick_ns / 1e9, 451 * calm.tick_ns / 1e9
    its = f"kind='{kind}', {keys}, at_s={begin_s!r}, ramp_s=0.3, for_s={end_s - begin_s + 0.3!r}"
    same = load(name, [*settings, f"disturbance={{{its}}}"])
    injected = done(scenario, touches(read_log(log), network_of(scenario))).scenario
    assert injected.disturbances == same.disturbances
    other = tmp_path / "scheduled.log"
    on_a_bus(same, other)
    ours, scheduled = columns(tmp_path / "0.plant.csv"), columns(tmp_path / "scheduled.plant.csv")
    assert ours.keys() == scheduled.keys()
    for column, values in scheduled.items():
        found, right = np.array(ours[column], float), np.array(values, float)
        assert np.abs(found - right).max() <= 1e-6 * max(np.abs(right).max(), 1e-3), column
    assert frames(touched(tmp_path, name=name, settings=settings)[0]) != frames(log)


@pytest.mark.parametrize(
    ("name", "pushes"),
    [
        ("ideal", [("push", 1.0), ("gust", None)]),
        ("two-masses", [("gust", 1.0), ("push", 1.0)]),  # without plant.e
    ],
)
def test_what_cannot_push_this_plant_is_refused(tmp_path, name, pushes):
    settings = ["fault.kind=none", f"duration_s={150 * load(name).tick_s!r}"]
    commands = [(503, Command("INJECT", kind, "world", value)) for kind, value in pushes]
    log, _, summary = touched(tmp_path, *commands, name=name, settings=settings)
    assert summary.rejected_frames["RIG_CONTROL"] == {"refused": 2}
    assert frames(log) == frames(touched(tmp_path, name=name, settings=settings)[0])


def test_what_is_cleared_is_over_from_the_next_tick_on(tmp_path):
    log, scenario, _ = touched(
        tmp_path,
        (500, DEAD._replace(duration_s=None)),
        (650, Command("CLEAR", place="sensor")),
        (700, Command("CLEAR", place="torque")),
    )
    (fault,) = done(scenario, touches(read_log(log), network_of(scenario))).scenario.faults
    # After 500 frames tick 99 is over; tick 100 has not begun, and is the first.
    assert (fault.at_s, fault.for_s) == (0.1, pytest.approx(0.04))


def test_a_node_in_c_fails_as_one_in_python_does(tmp_path):
    commands = [
        (333, Command("INJECT", "frames-forged", "torque", 2.5, 0.1)),
        (444, Command("INJECT", "frames-repeated", "torque")),
        (777, Command("CLEAR", place="torque")),
    ]
    log, _, _ = touched(tmp_path, *commands)
    other, _, _ = touched(tmp_path, *commands, controller="ecu")
    assert log.read_bytes() == other.read_bytes()
    assert frames(log) != frames(touched(tmp_path)[0])


def test_the_controller_follows_the_next_command_alone():
    scenario = load("ideal", SETTINGS)
    network = network_of(scenario)
    faults, sender = FrameFaults(scenario, network), Transmitter(network.command_1)
    followed = FollowedFaults(scenario, faults)
    missing, clear = Command("INJECT", "frames-missing", "torque"), Command("CLEAR")
    damaged = taken_message(missing, 8)
    damaged.data[6] ^= 1
    steps = [  # what comes, whether it is for the node, whether frames go on afterwards
        (command_message(missing, 6), False, True),
        (taken_message(Command("PAUSE"), 6), True, True),
        (taken_message(missing, 7), True, False),
        (taken_message(clear, 7), True, False),
        (taken_message(clear, 6), True, False),
        (taken_message(clear, 8), True, True),
        (damaged, True, True),
        (taken_message(missing, 7), True, True),
    ]
    for tick, (message, its, goes_on) in enumerate(steps):
        assert followed.take(message, tick) == its
        assert bool(faults.on_the_wire(sender.frame(1.0, tick), 0, tick)) == goes_on, tick


def test_the_log_of_a_touched_run_gives_the_same_log_again(tmp_path):
    commands = [
        (333, DEAD), (333, Command("PAUSE")), (333, Command("STEP", value=2.0)),
        (343, Command("PACE", value=0.5)),
        (702, Command("INJECT", "actuator-stuck", "force-difference", 1e9)),
        (1002, Command("CLEAR")), (1004, Command("INJECT", "sensor-late", "sensor", 5000.0)),
    ]  # fmt: skip
    log, scenario, summary = touched(tmp_path, *commands)
    assert summary.rejected_frames["RIG_CONTROL"] == {"refused": 1}  # no such late sensor
    told = tuple(touches(read_log(log), network_of(scenario)))
    assert [touch.after for touch in told] == [after for after, _ in commands]
    again = tmp_path / "again.log"
    on_a_bus(scenario, again, interaction=Interaction(injectable=True, told=told))
    assert again.read_bytes() == log.read_bytes()


def a_control(interaction: Interaction, bus: Wire) -> tuple[RunControl, PlantEnd, Watchdog]:
    scenario = load("ideal", SETTINGS)
    end = PlantEnd(scenario, network_of(scenario), bus.send, None, None, interaction.injectable)
    watchdog = Watchdog(bus, "controller", DEFAULT_TIMEOUTS, StopRequest(), clock=bus.clock)
    return RunControl(interaction, scenario, end, bus.send, bus.clock), end, watchdog


def test_ten_thousand_wrong_or_repeated_commands_change_nothing():
    run, end, watchdog = a_control(Interaction(injectable=True), Wire(TurnedClock()))
    good = [command_message(DEAD._replace(duration_s=None), 0), command_message(DEAD, 1)]
    for message in good:
        run.take(message)
    run.begin(0, watchdog, run.take)
    before = end.plant._faults._faults._dead
    assert len(before) == 2
    draw = random.Random(7)
    frame_id = operator_frames.identifiers().control
    for at in range(10_000):
        if at % 2:
            message = good[draw.randrange(2)]
        else:
            data = bytearray(draw.randbytes(draw.choice((8, 8, 8, 7))))
            message = can.Message(arbitration_id=frame_id, is_extended_id=False, data=data)
        run.take(message)
    run.begin(1, watchdog, run.take)
    assert end.plant._faults._faults._dead is before
    assert run.refused == 10_000


def test_a_node_that_is_not_injectable_counts_and_refuses(tmp_path):
    for interaction in (Interaction(), Interaction(pace=1e6)):
        bus = Wire(TurnedClock())
        run, end, watchdog = a_control(interaction, bus)
        run.take(command_message(DEAD, 0))
        run.begin(0, watchdog, run.take)
        assert (run.refused, bus.sent, end.plant._faults.at(200).left) == (1, [], (1.0, 1.0))


def test_a_paused_node_goes_on_by_steps_and_says_how_it_stands():
    told = [Command("PAUSE"), Command("MOVE_REFERENCE", value=0.25), Command("STEP", value=2.0)]
    messages = [command_message(command, at) for at, command in enumerate(told)]
    bus = Wire(TurnedClock(10**9), *messages)
    run, end, watchdog = a_control(Interaction(injectable=True), bus)
    run.begin(5, watchdog, run.take)
    run.begin(6, watchdog, run.take)
    state = operator_frames.read_state(bus.sent[-1])
    assert state is not None
    assert (state.injectable, state.paused, state.next_sequence, state.refused) == (
        True,
        True,
        3,
        0,
    )
    assert end.reference_offset == 0.25
    bus.waiting = [command_message(Command("PACE", value=0.0), 3)]
    run.begin(7, watchdog, run.take)  # would wait for ever without it


@pytest.mark.parametrize(
    ("begun_s", "next_s"),
    [
        (0.102, 0.102),  # late by 0.1 s: caught up with, so the next tick need not wait
        (0.103, 0.104),  # by more: the pace begins anew
    ],
)
def test_the_pace_after_a_late_tick(begun_s, next_s):
    clock = TurnedClock()
    run, _, watchdog = a_control(Interaction(pace=1.0), Wire(clock))
    run.begin(0, watchdog, run.take)
    assert clock.now_s == 0.001
    clock.pass_s(begun_s - 0.001)
    run.begin(1, watchdog, run.take)  # was due at 0.002 s
    run.begin(2, watchdog, run.take)
    assert clock.now_s == pytest.approx(next_s, abs=1e-12)
