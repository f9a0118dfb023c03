"""Two nodes that were started by hand: the same scenario, or one line each that names the key."""

import math
import re
import signal
import threading
import time
from contextlib import nullcontext
from dataclasses import replace

import can
import pytest

from can_rig.buses.bus import open_bus
from can_rig.controllers.our_law import PYTHON
from can_rig.errors import BusError, ScenarioError
from can_rig.frames.codec import Transmitter
from can_rig.frames.comparison_frames import (
    ASKED,
    PRESENT,
    SENDERS,
    Comparison,
    ComparisonFrame,
    digest,
)
from can_rig.nodes import runner
from can_rig.nodes.agreement import ANSWERED_S, UNSETTLED_S, Agreement, keys_of, require_alone
from can_rig.nodes.bus_access import Timeouts
from can_rig.nodes.runner import RunOptions
from can_rig.scenario import shipped
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.clock import TurnedClock, Wire
from tests.helpers import DBC, NAMES, record, start, two_nodes
from tests.rig.nodes.running import one_line

SHORT = ["duration_s=0.3"]


def both_by_hand(bus, plant, controller, log=None, real_time=False):
    """How two nodes in this process ended."""
    chosen = RunOptions(real_time, by_hand=True, timeouts=Timeouts(20.0, 20.0), controller=PYTHON)
    with two_nodes(plant, controller, bus, log, chosen) as nodes:
        return {name: node.exception() or node.result() for name, node in nodes.items()}


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("duration_s=0.4", "duration_s"),
        ("plant.sensor.noise_mps2=0.001 limits.torque_nm=300", "plant.sensor.noise_mps2"),
        ("disturbance.kind=gust disturbance.force_n=50", "disturbance.kind"),
    ],
)
def test_both_end_and_name_the_first_key_that_differs(setting, key, tmp_path):
    one, other = load("thesis-step", SHORT), load("thesis-step", [*SHORT, *setting.split()])
    for plant, controller in ((one, other), (other, one)):
        ended = both_by_hand(f"local:{tmp_path / 'bus'}", plant, controller)
        for name, partner in (("plant", "controller"), ("controller", "plant")):
            error = ended[name]
            assert isinstance(error, ScenarioError)
            assert error.exit_status == 2
            assert str(error).startswith(f"{key} = ")
            assert f"the {partner} node" in str(error)


def test_in_real_time_too(tmp_path, monkeypatch):
    # This process must stay ordinary: no SCHED_FIFO, and no private core, for good.
    monkeypatch.setattr(runner, "preferred", lambda core: nullcontext("nothing asked for"))
    monkeypatch.setattr(runner, "undisturbed", nullcontext)
    ended = both_by_hand(
        f"local:{tmp_path / 'bus'}",
        load("ideal", SHORT),
        load("ideal", [*SHORT, "actuator.hold_s=0.02"]),
        real_time=True,
    )
    assert all(str(error).startswith("actuator.hold_s = ") for error in ended.values())


def test_the_same_scenario_runs_and_its_log_knows_nothing_of_the_comparison(tmp_path):
    scenario = load("thesis-step", SHORT)
    renamed = replace(scenario, name="another", description="of the same run")
    log = tmp_path / "by-hand.log"
    ended = both_by_hand(f"local:{tmp_path / 'bus'}", scenario, renamed, log)
    assert ended["plant"].ticks == ended["controller"].ticks == 300
    (tmp_path / "other").mkdir()
    assert log.read_bytes() == record(tmp_path / "other", *SHORT)[0].read_bytes()


def test_of_an_fmu_its_file_and_what_the_scenario_names_in_it_are_compared_not_where_it_lies():
    fmu = [f"plant.variables.{key}=u" for key in ("input_1", "input_2", "output")]
    keys = [
        dict(keys_of(load("default", [f"plant.kind=fmu:{kind}", *fmu, *more]).as_dict()))
        for kind, more in (
            ("a/car.fmu", []),
            ("/b/car.fmu", []),
            ("boat.fmu", []),
            ("car.fmu", ["plant.variables.yaw_rate_rad_per_s=r"]),
        )
    ]
    assert keys[0] == keys[1]
    differ = [{key for key in keys[0] if keys[0][key] != other[key]} for other in keys[2:]]
    assert differ == [{"plant.kind"}, {"plant.variables"}]


def test_every_two_shipped_scenarios_differ_in_a_key():
    every = {name: tuple(keys_of(load(name).as_dict())) for name in shipped()}
    assert len(set(every.values())) == len(every)


@pytest.mark.parametrize("first", ["plant", "controller"])
def test_from_the_command_line_whoever_is_there_first(first, tmp_path):
    bus = ["--bus", f"local:{tmp_path / 'bus'}", "--wait", "60"]
    words = {"plant": ["plant", "ideal", *bus], "controller": ["controller", "slow-bus", *bus]}
    second = "controller" if first == "plant" else "plant"
    nodes = {name: start(*words[name]) for name in (first, second)}
    lines = {}
    for name, process in nodes.items():
        _, errors = process.communicate(timeout=120)
        assert process.returncode == 2, errors
        lines[name] = one_line(errors)
    assert "tick_s = 0.001 is not what the controller node" in lines["plant"]
    assert "tick_s = 0.002 is not what the plant node" in lines["controller"]


# --- one end, by hand ----------------------------------------------------------------------------


class End:
    """One node's end and what its partner says on the wire."""

    def __init__(self, name="plant", *settings):
        self.clock = TurnedClock()
        self.wire = Wire(self.clock)
        self.scenario = load("thesis-step", settings)
        self.agreement = Agreement(self.scenario, name, self.wire, self.clock)
        self.agreement_name = name
        (self.other,) = {"plant", "controller"} - {name}
        self.own_frame, self.partner = ComparisonFrame(name), ComparisonFrame(self.other)

    def say(self, key, number):
        self.wire.waiting.append(self.partner.message(Comparison(key, number)))

    def said(self):
        found = [self.own_frame.read(message) for message in self.wire.sent]
        self.wire.sent.clear()
        return [said for said in found if said.key != ASKED]

    def hear_another(self, key, number=None):
        """A frame of a second node of this kind; without a number the own last frame."""
        frame = ComparisonFrame(self.agreement_name).message(Comparison(key, number or 0))
        self.wire.waiting.append(frame if number is not None else self.wire.sent[-1])


DATA = can.Message(arbitration_id=0x110, is_extended_id=False, data=bytes(8))


def test_other_frames_pass_and_those_of_the_comparison_do_not():
    end = End()
    end.agreement.announce()
    ((key, whole),) = end.said()
    assert key == 0
    end.say(0, whole)
    end.wire.waiting.append(DATA)
    assert end.agreement.recv(0.05) is DATA
    assert end.agreement.recv(0.05) is None
    assert end.clock.now_s == pytest.approx(0.05)
    assert end.said() == []


def test_once_the_scenarios_differ_nothing_else_gets_through_and_every_key_is_sent_in_order():
    end = End()
    end.say(0, 12345)
    end.wire.waiting.append(DATA)
    assert end.agreement.recv(0.05) is None
    keys = list(keys_of(end.scenario.as_dict()))
    expected = [Comparison(n, digest(*key)) for n, key in enumerate(keys, start=1)]
    assert end.said() == expected
    with pytest.raises(ScenarioError, match="the scenario is not what the controller node"):
        for _ in range(200):  # a partner that never says which key
            end.agreement.recv(0.05)
    assert end.clock.now_s == pytest.approx(0.05 + UNSETTLED_S, abs=0.06)


def test_a_late_controller_is_told_and_the_run_goes_on():
    end = End()
    end.agreement.settled = True
    end.say(0, 12345)
    for key in range(1, 20):
        end.say(key, 1)
    end.wire.waiting.append(DATA)
    assert end.agreement.recv(0.05) is DATA
    assert [key for key, _ in end.said()] == [0, 1]  # the first that differs, once


def test_a_controller_that_has_its_plant_does_not_end_because_of_another():
    end = End("controller")
    end.agreement.announce()
    ((_, whole),) = end.said()
    end.say(0, whole)
    end.say(0, 12345)
    end.say(1, 1)
    end.wire.waiting.append(DATA)
    assert end.agreement.recv(0.05) is DATA
    assert end.said() == []


@pytest.mark.parametrize("name", ["plant", "controller"])
@pytest.mark.parametrize("key", [ASKED, PRESENT])
def test_before_its_first_tick_a_node_ends_beside_another_of_its_kind(name, key):
    end = End(name)
    end.hear_another(key, 7)
    with pytest.raises(BusError, match=f"another {name} node is on this bus; a bus has one"):
        end.agreement.recv(0.05)
    assert [said.key for said in end.said()] == [PRESENT] * (key == ASKED)


def test_a_controller_that_hears_another_at_work_ends_before_it_sends_anything():
    """What the plant sends alone is an offer that waits for an answer."""
    offer = can.Message(arbitration_id=0x101, is_extended_id=False, data=bytes(8))
    asked = can.Message(
        arbitration_id=DATA.arbitration_id, is_extended_id=False, is_remote_frame=True
    )
    network = network_of(load("default", SHORT))
    command, damaged = (Transmitter(network.command_1).frame(1.0, 0) for _ in range(2))
    damaged.data[4] ^= 1
    others = (([], False), ([asked], False), ([damaged], False), ([command], True))
    for heard, refused in (([offer, *more], refused) for more, refused in others):
        end = End("controller")
        end.wire.waiting += heard
        with pytest.raises(BusError, match="another controller") if refused else nullcontext():
            end.agreement.listen((network.command_1, network.command_2, network.status))
        assert end.said() == []


def test_a_node_that_runs_answers_a_question_and_no_answer_and_goes_on():
    end = End()
    end.agreement.settled = True
    for key in (ASKED, PRESENT):
        end.hear_another(key, 7)
    end.wire.waiting.append(DATA)
    assert end.agreement.recv(0.05) is DATA
    assert [said.key for said in end.said()] == [PRESENT]


def test_a_bus_that_brings_back_what_a_node_sends_is_no_other_node():
    end = End()
    end.agreement.announce()
    end.hear_another(ASKED)
    assert end.agreement.recv(0.05) is None


def test_a_rig_on_the_bus_of_another_is_refused_and_the_first_goes_on(tmp_path):
    bus = ["--bus", f"local:{tmp_path / 'bus'}", "--set", "duration_s=20", "--set", "fault.at_s=1"]
    first = start(
        "run", "thesis-step", *bus, "--injectable", "--pace", "1", "--out", tmp_path / "1"
    )
    while first.poll() is None and not list(tmp_path.rglob("bus.log")):
        time.sleep(0.05)
    refused = start("run", "thesis-step", *bus, "--in-process", "--out", tmp_path / "2")
    _, errors = refused.communicate(timeout=120)
    assert refused.returncode == 2, errors
    assert re.search("another (plant|controller) node is on local bus", one_line(errors))
    assert first.poll() is None
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=60)
    assert not (tmp_path / "2").exists()
    assert (tmp_path / "1" / "run.json").is_file()


def test_a_busy_rig_that_answers_late_is_named_and_other_traffic_is_no_rig(tmp_path):
    bus, scenario = f"local:{tmp_path}", load("thesis-step", [])
    plant, ended, there = ComparisonFrame("plant"), threading.Event(), threading.Event()

    def busy(identifier):
        frame = can.Message(arbitration_id=identifier, is_extended_id=False, data=bytes(8))
        answer_s = math.inf
        with open_bus(bus) as own:
            while not ended.is_set():
                own.send(frame)
                there.set()
                heard = own.recv(0.01)
                if heard is not None and plant.read(heard) is not None:
                    answer_s = min(answer_s, time.monotonic() + 2 * ANSWERED_S)
                if time.monotonic() > answer_s:
                    own.send(plant.message(Comparison(PRESENT, 1)))

    for identifier, refusal in (
        (network_of(scenario).feedback.frame_id, pytest.raises(BusError, match="another")),
        (0x7FF, nullcontext()),
    ):
        ended.clear()
        there.clear()
        thread = threading.Thread(target=busy, args=(identifier,))
        thread.start()
        there.wait()
        with refusal:
            require_alone(scenario, bus)
        ended.set()
        thread.join()


def test_two_rigs_that_look_for_others_one_after_the_other_find_each_other(tmp_path):
    """The second begins when the first has asked for both kinds; both wait for an answer."""
    bus, scenario = f"local:{tmp_path}", load("thesis-step", [])
    found = []

    def look():
        try:
            require_alone(scenario, bus)
        except BusError as error:
            found.append(str(error))

    with open_bus(bus) as listener:
        threads = [threading.Thread(target=look), threading.Thread(target=look)]
        threads[0].start()
        asked = set()
        while asked != SENDERS.keys():
            heard = listener.recv(5.0)
            assert heard is not None
            asked |= {name for name in SENDERS if ComparisonFrame(name).read(heard) is not None}
        threads[1].start()
        for thread in threads:
            thread.join()
    assert len(found) == 2
    assert all("another" in text for text in found)


@pytest.mark.parametrize("key", [0, 1, 60_000])
def test_a_damaged_frame_and_an_unknown_key_say_nothing(key):
    end = End()
    end.say(key, 1)
    end.wire.waiting.append(DATA)
    if key < 100:  # not of the comparison, so of somebody else, and for the log
        damaged = end.wire.waiting[0]
        damaged.data[5] ^= 1
        assert end.agreement.recv(0.05) is damaged
    assert end.agreement.recv(0.05) is DATA
    assert end.said() == []


def test_a_partner_that_says_nothing_is_taken_as_it_is():
    end = End()
    end.agreement.announce()
    end.wire.waiting += [DATA, DATA]
    assert [end.agreement.recv(0.05) for _ in range(3)] == [DATA, DATA, None]


def test_the_frames_are_those_of_the_dbc():
    import cantools

    database = cantools.database.load_file(DBC / "agreement.dbc", strict=True)
    for name, message in (("plant", "PLANT_SCENARIO"), ("controller", "CONTROLLER_SCENARIO")):
        frame = ComparisonFrame(name)
        sent = frame.message(Comparison(7, 0xDEADBEEF))
        assert database.get_message_by_name(message).frame_id == sent.arbitration_id
        said = database.decode_message(message, sent.data)
        assert (said["Key"], said["Digest"], said["AliveCounter"]) == (7, 0xDEADBEEF, 0)
        assert frame.read(sent) == Comparison(7, 0xDEADBEEF)
        assert database.get_message_by_name(message).comment
    assert not {*NAMES} & {message.name for message in database.messages}
