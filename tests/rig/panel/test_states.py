"""The panel says the state of the run, and offers the orders that have an effect in this state."""

import asyncio
import json
import re
import time
from dataclasses import replace
from unittest.mock import AsyncMock, Mock

import can
import pytest

from can_rig.buses.bus import open_bus
from can_rig.drawing.bench import text
from can_rig.frames import operator_frames
from can_rig.panel.live import HOLD
from can_rig.panel.session import Session
from can_rig.panel.setup import setup
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from tests.helpers import load, record
from tests.rig.panel.test_live import heard

PALETTES = re.findall(r":root \{(.*?)\}", text("bench.css"), re.DOTALL)
LIGHT, DARK = (dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6})", each)) for each in PALETTES)


def said_by_the_plant_node(paused: bool) -> can.Message:
    state = operator_frames.State(True, paused, 0, 0, 0, 1.0)
    return operator_frames.state_message(state, 0)


class Bus:
    """Frames of two nodes on a bus that a panel watches."""

    def __init__(self, scenario: Scenario, log: object, **more: object) -> None:
        self.frames = list(can.LogReader(log))
        self.session = Session("virtual:states", scenario, "ideal", **more)
        self.nodes = open_bus("virtual:states")
        self.network = network_of(scenario)

    def send(self, *frames: can.Message) -> None:
        for frame in frames:
            self.nodes.send(frame)

    def state(self, name: str) -> object:
        """The state after at most ten seconds, which must be ``name``."""
        end_s = time.monotonic() + 10.0
        while time.monotonic() < end_s:
            self.session.live.update()
            if self.session.state().name == name:
                break
            time.sleep(0.02)
        assert self.session.state().name == name
        return self.session.state()


@pytest.fixture
def bus(tmp_path):
    made = []

    def make(**more):
        log, _, scenario = record(tmp_path, "duration_s=0.05", name="ideal")
        made.append(Bus(scenario, log, **more))
        return made[-1]

    yield make
    for each in made:
        each.session.close()
        each.nodes.shutdown()


def start(rig: Bus, monkeypatch: pytest.MonkeyPatch) -> Mock:
    """Let the panel start a run; returns the process of the run, which does nothing."""
    process = Mock(returncode=None, wait=AsyncMock())
    monkeypatch.setattr(asyncio, "create_subprocess_exec", AsyncMock(return_value=process))
    asyncio.run(rig.session.start())
    return process


def test_before_the_first_frame_a_panel_says_what_to_do(bus):
    ready = bus().state("ready")
    assert ready.orders == ("start", "choose")
    assert "Press Start" in ready.says
    waiting = bus(starts=False).state("waiting")
    assert waiting.orders == ()
    assert "virtual:states" in waiting.says


def test_running_and_paused_offer_different_orders(bus):
    rig = bus(starts=False)
    rig.send(said_by_the_plant_node(paused=False), *rig.frames)
    running = rig.state("running").orders
    rig.send(said_by_the_plant_node(paused=True))
    paused = rig.state("paused").orders
    assert "pause" in running
    assert "step" not in running
    assert "step" in paused
    assert "pause" not in paused
    assert {"inject", "clear", "reference", "pace"} <= set(running) & set(paused)
    assert rig.state("ended").orders == ()  # the plant node no longer says that it pauses


@pytest.mark.parametrize(
    ("injectable", "sends", "why"),
    [(True, False, "--allow-control"), (False, True, "--injectable")],
)
def test_without_control_a_run_offers_no_orders_and_says_why(bus, injectable, sends, why):
    rig = bus(starts=False, sends=sends)
    rig.send(*([said_by_the_plant_node(paused=False)] if injectable else []), *rig.frames)
    running = rig.state("running")
    assert running.orders == ()
    assert why in running.says


@pytest.mark.parametrize(("last", "state"), [("feedback", "silent"), ("status", "ended")])
def test_the_last_frame_tells_a_killed_controller_from_the_end_of_a_run(bus, last, state):
    rig = bus(starts=False)
    frame_id = getattr(rig.network, last).frame_id
    end = max(at for at, frame in enumerate(rig.frames) if frame.arbitration_id == frame_id)
    rig.send(*rig.frames[: end + 1])
    says = rig.state(state).says
    assert ("The controller node is silent" in says) == (state == "silent")


def test_a_second_run_of_foreign_nodes_is_shown_from_its_first_tick(bus):
    rig = bus(starts=False)
    rig.send(*rig.frames)
    rig.state("ended")
    assert not rig.session.begins_again
    rig.send(*rig.frames)
    end_s = time.monotonic() + 10.0
    while not rig.session.begins_again and time.monotonic() < end_s:
        time.sleep(0.01)
    rig.session.renew()
    rows = [row for _ in range(2 * HOLD) for row in rig.session.live.update().tolist()]
    assert rows[0][0] == 0.0
    assert rig.state("running").orders == ()


def test_a_bus_that_fails_is_down_until_the_next_frame(bus):
    rig = bus(starts=False)
    rig.session.live.frames.on_error(can.CanOperationError("Network is down"))
    assert "Network is down" in rig.state("bus-down").says
    rig.send(*rig.frames)
    rig.state("running")


@pytest.mark.parametrize(
    ("duration_s", "stopped", "state"),
    [(20.0, False, "silent"), (20.0, True, "finishing"), (0.05, False, "finishing")],
)
def test_a_run_of_the_panel_that_falls_silent_early_was_not_ended_as_planned(
    bus, monkeypatch, duration_s, stopped, state
):
    rig = bus()
    rig.session.scenario = replace(rig.session.scenario, duration_s=duration_s)
    start(rig, monkeypatch)
    rig.send(*rig.frames)
    if stopped:
        asyncio.run(rig.session.stop())
    assert ("killed" in rig.state(state).says) == (state == "silent")


def test_a_run_that_the_panel_stops_is_finishing_whichever_node_was_heard_last(bus, monkeypatch):
    rig = bus()
    start(rig, monkeypatch)
    rig.send(*rig.frames, *(f for f in rig.frames[:2] if f.arbitration_id < 0x110))
    asyncio.run(rig.session.stop())
    assert "is being written" in rig.state("finishing").says


@pytest.mark.parametrize(
    ("status", "out", "err", "state", "says", "saves"),
    [
        (0, json.dumps({"folder": "runs/x"}), "", "ended", "runs/x", True),
        (130, json.dumps({"folder": "runs/x"}), "", "ended", "was stopped", True),
        (-15, "", "", "ended", "was stopped", False),
        (130, "", "stopped before the first tick", "ended", "no folder is left", False),
        (3, "", "error: the controller node is silent", "failed", "node is silent", False),
    ],
)  # fmt: skip
def test_the_end_of_a_run_of_the_panel_has_a_reason(
    bus, monkeypatch, status, out, err, state, says, saves
):
    rig = bus()
    process = start(rig, monkeypatch)

    async def communicate():
        process.returncode = status
        return out.encode(), err.encode()

    process.communicate = communicate
    assert rig.state("starting").orders == ("stop",)
    asyncio.run(rig.session.ended())
    after = rig.state(state)
    assert says in after.says
    assert ("save" in after.orders) == saves
    assert "start" in after.orders


def counts(scenario: Scenario, frames: list[can.Message]) -> tuple[int, int, float]:
    """Ticks without commands, ticks not heard, and bus load, as a panel counts them."""
    live, _ = heard(scenario, frames)
    return live.lamps.unanswered_ticks, live.lamps.unheard_ticks, live.lamps.bus_load


def test_a_tick_that_the_panel_missed_is_no_tick_without_commands(tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.05", name="ideal")
    frames, network = list(can.LogReader(log)), network_of(scenario)
    whole = counts(scenario, frames)
    assert whole[:2] == (0, 0)
    torque = [f for f in frames if f.arbitration_id == network.command_1.frame_id]
    dropped = [f for f in frames if f not in torque[10:14]]
    assert counts(scenario, dropped)[:2] == (4, 0)
    ticks = len(frames) // 50
    lagging = frames[: 10 * ticks + 3] + frames[20 * ticks - 1 :]
    assert counts(scenario, lagging)[:2] == (0, 9)  # the tenth was heard in part


def test_the_load_is_the_load_of_the_scenario_without_the_frames_of_the_panel(tmp_path):
    log, _, scenario = record(tmp_path, "duration_s=0.05", name="ideal")
    frames = list(can.LogReader(log))
    watched = []
    for frame in frames:
        applied = operator_frames.applied_message(1.0, 2.0)
        applied.timestamp = frame.timestamp
        watched += [frame, applied]
    assert counts(scenario, watched)[2] == counts(scenario, frames)[2]


@pytest.mark.parametrize("name", ["pendulum", "two-masses"])
def test_controls_have_the_names_and_units_of_the_plant(name):
    plant = load(name).plant
    made = setup(load(name), network_of(load(name)), 20.0)
    signals = plant.input_1, plant.input_2, plant.output
    for place, signal in zip(made["places"], signals, strict=True):
        assert signal.name in place["words"]
        units = {kind["value"] for kind in place["kinds"] if kind["kind"].endswith("-stuck")}
        assert units == {f"value {signal.unit}"}
    assert [each["words"] for each in made["quick"][:2]] == [f"{s.name} lost" for s in signals[:2]]
    assert made["output"]["unit"] == plant.output.unit
    assert made["moved_by"] == 2.0 * load(name).reference.amplitude_mps2
    assert not re.search("motor|m/s²|steering", json.dumps(made, ensure_ascii=False))


def test_the_further_sensors_of_a_scenario_can_fail_too_and_only_they():
    made = setup(load("cluster"), network_of(load("cluster")), 20.0)
    faults = {each["place"]: each["kinds"] for each in made["places"]}
    assert set(faults) == set(operator_frames.places())
    swaps = [each for each in faults["yaw-rate"] if each["kind"] == "sensor-swapped"]
    assert {operator_frames.places()[each["number"]] for each in swaps} == {
        "lateral-acceleration", "steering-angle", "torque-echo", "force-difference-echo"
    }  # fmt: skip
    biased = next(each for each in faults["yaw-rate"] if each["kind"] == "sensor-biased")
    assert biased["value"] == "offset rad/s"
    liars = {place for place, its in faults.items() if "sensor-lying" in str(its)}
    assert liars == {"torque-echo", "force-difference-echo"}
    without = setup(load("default"), network_of(load("default")), 20.0)
    assert [each["place"] for each in without["places"]] == [
        *operator_frames.places()[:3], "world"
    ]  # fmt: skip


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour, after WCAG 2.2."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: str, other: str) -> float:
    light, dark = sorted([luminance(one), luminance(other)], reverse=True)
    return (light + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("palette", [LIGHT, DARK], ids=["light", "dark"])
def test_text_curves_and_lamps_stand_out_in_both_palettes(palette):
    assert set(LIGHT) == set(DARK)
    for text_colour in ("ink", "soft", "good", "warn"):
        for ground in ("paper", "card"):
            assert contrast(palette[text_colour], palette[ground]) >= 4.5
    curves = ["blue", "orange", "green", "pale", "pale-blue", "violet", "gold", "pink", "grey"]
    for curve in curves:
        for ground in ("paper", "suspect", "confirmed"):
            assert contrast(palette[curve], palette[ground]) >= 3.0, (curve, ground)
