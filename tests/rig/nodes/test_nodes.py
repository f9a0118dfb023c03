"""Both nodes in one process: faults that end where arithmetic says."""

import numpy as np
import pytest

from can_rig.buses.bus import open_bus
from can_rig.controllers.our_law import PYTHON
from can_rig.frames.codec import Transmitter
from can_rig.nodes.bus_access import StopRequest, Timeouts, Watchdog
from can_rig.nodes.lockstep import ControllerNode, PlantNode
from can_rig.nodes.recording import Recorder
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import NAMES, decoded, record
from tests.rig.nodes.world import LSB, dstar_under

SHORT = ["duration_s=0.3"]
FAULT_TICK = 100


@pytest.mark.parametrize(("noise", "logs"), [("0", 1), ("0.01", 2)])
def test_another_seed_is_another_log_where_something_is_random(noise, logs, tmp_path):
    changes = [*SHORT, f"plant.sensor.noise_mps2={noise}"]
    assert len({record(tmp_path, *changes, f"seed={s}")[0].read_bytes() for s in (1, 2)}) == logs


def in_turns(scenario, ticks, recorder=None, earlier=()):
    """Both nodes on a bus with ``earlier`` frames; of each message, the rejected frames."""
    network = network_of(scenario)
    with open_bus("virtual:turns") as plant_bus, open_bus("virtual:turns") as controller_bus:
        with open_bus("virtual:turns") as intruder:
            for message in earlier:
                intruder.send(message)
        plant = PlantNode(scenario, network, plant_bus.send, recorder)
        controller = ControllerNode(scenario, network, controller_bus.send, PYTHON)
        to_plant = Watchdog(plant_bus, "controller", Timeouts(1, 1), StopRequest())
        to_controller = Watchdog(controller_bus, "plant", Timeouts(1, 1), StopRequest())
        for tick in ticks:
            plant.offer(tick)
            controller.serve(to_controller)
            plant.collect(tick, to_plant)
    return plant.rejected() | controller.rejected()


def test_the_tick_counts_on_where_its_sixteen_bits_wrap():
    """The nodes take up a run just before 65536 and go on past it."""
    scenario = load("thesis-step", ["duration_s=65.6"])
    assert not any(in_turns(scenario, range(65_530, 65_545)).values())


# --- what a frame of someone else does ---------------------------------------------------------


@pytest.mark.parametrize("forged", ["reference", "feedback", "both"])
def test_intact_frames_of_another_tick_before_the_run_are_not_its_beginning(forged, tmp_path):
    """One made-up frame in 256 has the right CRC; the controller has to wait for two that agree."""
    scenario, log = load("thesis-step", ["duration_s=0.05"]), tmp_path / "bus.log"
    network = network_of(scenario)
    frames = {
        "reference": Transmitter(network.reference).frame(1.0, 999),
        "feedback": Transmitter(network.feedback).frame(1.0, 555),
    }
    sent = [message for name, message in frames.items() if forged in {name, "both"}]
    with Recorder(log) as recorder:
        in_turns(scenario, range(scenario.ticks), recorder, sent)
    quiet = record(tmp_path, "duration_s=0.05")[0]
    forgeries = {f"{m.arbitration_id:03X}#{m.data.hex().upper()}" for m in frames.values()}
    seen = [line.split()[2:] for line in log.read_text().splitlines()]
    wanted = [line.split()[2:] for line in quiet.read_text().splitlines()]
    assert [each for each in seen if each[0] not in forgeries] == wanted


# --- faults, end to end ------------------------------------------------------------------------


def missing_as_nan(log, channel, lost):
    """Put the lost ticks back into a log without them, so that rows are ticks."""
    values = decoded(log)
    name = NAMES[2 + channel]
    for tick in lost:
        values[name] = np.insert(values[name], tick, np.nan)
    return values


@pytest.mark.parametrize(
    ("kind", "channel", "hold", "count"),
    [("missing", 0, 7, 200), ("corrupted", 1, 7, 200), ("missing", 0, 5, 1), ("missing", 0, 5, 14),
     ("missing", 0, 5, 30), ("corrupted", 0, 5, 13), ("corrupted", 0, 5, 14)],
)  # fmt: skip
def test_the_plant_holds_a_lost_channel_drops_it_to_zero_and_takes_it_again(
    kind, channel, hold, count, tmp_path
):
    """Again at once, but for 14 lost frames: the counter of 15 steps stands where it stood."""
    log, summary, _ = record(
        tmp_path, *SHORT, f"fault.kind=frames-{kind}", "fault.at_s=0.1",
        f"fault.for_s={count / 1000}", f"actuator.hold_s={hold / 1000}",
        f"fault.channel={('torque', 'force-difference')[channel]}",
        "reference.kind=sine", "reference.frequency_rad_per_s=20",  # so that what is held matters
    )  # fmt: skip
    gone = range(FAULT_TICK, FAULT_TICK + count)
    values = missing_as_nan(log, channel, gone if kind == "missing" else [])
    repeated = count % 15 == 14

    def misfit(hold_ticks):
        u = np.stack([values[NAMES[2]], values[NAMES[3]]], axis=1)
        u[FAULT_TICK : FAULT_TICK + count + repeated, channel] = 0.0
        u[FAULT_TICK:, channel][: min(hold_ticks, count)] = u[FAULT_TICK - 1, channel]
        return np.abs(dstar_under(u) - values[NAMES[1]]).max()

    assert misfit(hold) < LSB
    if count > hold:
        assert misfit(hold - 1) > 100 * LSB  # a tick more or less shows
        assert misfit(hold + 1) > 100 * LSB
    counts = summary.rejected_frames[NAMES[2 + channel]]
    assert counts["no_new_data" if kind == "missing" else "wrong_crc"] == count
    assert counts.get("repeated", 0) == repeated
    assert not summary.rejected_frames[NAMES[3 - channel]]


@pytest.mark.parametrize("channel", [0, 1])
def test_a_dead_actuator_is_zero_from_its_tick_on_while_its_frames_go_on(channel, tmp_path):
    name = ("torque", "force-difference")[channel]
    log, *_ = record(tmp_path, *SHORT, "fault.at_s=0.1", f"fault.channel={name}")
    values = decoded(log)
    u = np.stack([values[NAMES[2]], values[NAMES[3]]], axis=1)
    assert len(u) == 300
    assert np.abs(dstar_under(u)[: FAULT_TICK + 1] - values[NAMES[1]][: FAULT_TICK + 1]).max() < LSB
    u[FAULT_TICK:, channel] = 0.0
    assert np.abs(dstar_under(u) - values[NAMES[1]]).max() < LSB


@pytest.mark.parametrize(
    ("kind", "channel"),
    [("actuator-dead", "torque"), ("frames-missing", "torque"),
     ("frames-corrupted", "force-difference")],
)  # fmt: skip
def test_the_error_is_below_a_millionth_before_and_long_after_every_loss(kind, channel, tmp_path):
    settings = ["fault.at_s=1", "duration_s=4", f"fault.kind={kind}", f"fault.channel={channel}"]
    values = decoded(record(tmp_path, *settings)[0])
    error = np.abs(values[NAMES[0]] - values[NAMES[1]])
    assert error[500:1000].max() < 1e-6
    assert error[-500:].max() < 1e-6
    if channel == "torque":  # it was there to be compensated
        assert error[1000:].max() > 1e-5
        assert np.abs(values[NAMES[4]][1000:]).max() > 0.3


def test_without_the_compensator_the_same_fault_is_not_overcome(tmp_path):
    settings = ["fault.at_s=1", "duration_s=4"]
    values = decoded(record(tmp_path, *settings, name="no-compensation")[0])
    assert np.abs(values[NAMES[0]] - values[NAMES[1]])[-500:].min() > 0.1


@pytest.mark.parametrize(("name", "latency"), [("ideal", 0), ("lane-change", 1), ("highway", 3)])
def test_the_fault_estimate_over_the_bus_is_at_most_one_step_of_dstar(tmp_path, name, latency):
    """F1 sees the commands as their frames carry them, so only the rounding of D* is left."""
    settings = ["fault.kind=none", "duration_s=2.5", f"latency_ticks={latency}"]
    slow = ["design.tau_q_s=0.01", "reference.amplitude_mps2=0.7"]
    values = decoded(record(tmp_path, *settings, *slow, name=name)[0])
    assert np.abs(values["DSTAR_FEEDBACK"]).max() > 0.5
    assert np.abs(values["CONTROLLER_STATUS"]).max() <= LSB * (1 + 1e-9)
