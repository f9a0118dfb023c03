"""Faults: the right channel, the right ticks, and no damage that a receiver could miss."""

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from can_rig.assessment.resolve import load
from can_rig.frames.endpoints import Receiver, Transmitter
from can_rig.plant.faults import ActuatorFault, FrameFault, SensorFault, bias, effectiveness
from can_rig.plant.simulated import SimulatedPlant
from can_rig.scenario.build import continuous_plant, network_of
from can_rig.thesis.continuous import solve

CHANNELS = ["torque", "force-difference"]
SHORT = ["duration_s=1", "fault.at_s=0.005", "fault.for_s=0.003"]  # ticks 5, 6, 7
WINDOW = range(5, 8)
NETWORK = network_of(load("thesis-step"))
COMMANDS = (NETWORK.command_1, NETWORK.command_2)


def crc8(data, data_id):
    """E2E profile 1, bit by bit."""
    crc = 0
    for byte in (data_id & 0xFF, data_id >> 8, *data[1:]):
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x11D if crc & 0x80 else 0)
    return crc


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_dead_actuator_is_dead_in_its_window_and_the_other_lives(channel):
    settings = [*SHORT, "fault.kind=actuator-dead", f"fault.channel={channel}"]
    fault = ActuatorFault(load("thesis-step", settings))
    dead = (0.0, 1.0) if channel == "torque" else (1.0, 0.0)
    for tick in range(12):
        assert fault.effectiveness(tick) == (dead if tick in WINDOW else (1.0, 1.0))


@pytest.mark.parametrize("kind", ["actuator-dead", "sensor-biased", "frames-missing", "none"])
@given(
    at=st.floats(0.0, 0.06),
    lasts=st.none() | st.floats(1e-4, 0.05),
    tick_s=st.sampled_from([0.001, 0.0004, 0.0033]),
)
def test_all_ticks_at_once_are_those_one_by_one(kind, at, lasts, tick_s):
    settings = [f"fault.at_s={at!r}", f"fault.for_s={lasts!r}"][: 1 if lasts is None else 2]
    settings += [f"tick_s={tick_s}", "duration_s=0.05", f"fault.kind={kind}"]
    scenario = load("thesis-step", settings)
    actuator, sensor = ActuatorFault(scenario), SensorFault(scenario)
    ticks = range(scenario.ticks)
    assert effectiveness(scenario).tolist() == [list(actuator.effectiveness(k)) for k in ticks]
    assert bias(scenario).tolist() == [sensor.bias(k) for k in ticks]


@pytest.mark.parametrize("channel", CHANNELS)
@given(left=st.floats(0, 1, exclude_max=True))
def test_a_partial_loss_leaves_its_share_in_its_window(channel, left):
    settings = [*SHORT, "fault.kind=actuator-dead", f"fault.channel={channel}"]
    fault = ActuatorFault(load("thesis-step", [*settings, f"fault.left={left!r}"]))
    lost = (left, 1.0) if channel == "torque" else (1.0, left)
    for tick in range(12):
        assert fault.effectiveness(tick) == (lost if tick in WINDOW else (1.0, 1.0))


def test_half_of_the_torque_moves_a_linear_car_half_as_far():
    half = ["fault.kind=actuator-dead", "fault.at_s=0", "fault.left=0.5", "duration_s=1"]
    outputs = []
    for settings, torque in ((half, 100.0), (["fault.kind=none"], 50.0)):
        plant = SimulatedPlant(load("thesis-step", settings))
        for tick in range(50):
            plant.advance(tick, torque, 0.0)
        outputs.append(plant.measure())
    assert outputs[0] == outputs[1] != 0.0


@pytest.mark.parametrize("channel", CHANNELS)
def test_the_continuous_loop_knows_a_partial_loss_too(channel):
    """By the plant's own equations: what is left of the commands is all that moves the car."""
    settings = ["fault.kind=actuator-dead", f"fault.channel={channel}", "fault.left=0.25"]
    scenario = load("thesis-step", [*settings, "fault.at_s=0", "duration_s=2"])
    run, car = solve(scenario), continuous_plant(scenario.plant)
    left = [0.25, 1.0] if channel == "torque" else [1.0, 0.25]
    steady = -car.c @ np.linalg.solve(car.a, car.b * left) @ [run.command_1[-1], run.command_2[-1]]
    assert run.measurement[-1] == pytest.approx(steady.item(), rel=1e-3)


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("kind", ["frames-missing", "frames-corrupted", "none", "actuator-dead"])
def test_frames_are_lost_on_their_channel_and_in_their_window_alone(kind, channel):
    settings = [*SHORT, f"fault.kind={kind}", f"fault.channel={channel}"]
    fault = FrameFault(load("thesis-step", settings))
    for tick in range(12):
        for index, name in enumerate(CHANNELS):
            frame = Transmitter(COMMANDS[index]).frame(1.0, tick)
            before = bytes(frame.data)
            sent = fault.on_the_wire(frame, index, tick)
            hit = kind.startswith("frames-") and tick in WINDOW and name == channel
            if hit and kind == "frames-missing":
                assert sent is None
            else:
                changed = sum(a != b for a, b in zip(before, sent.data, strict=True))
                assert changed == (1 if hit else 0)
                assert (sent.arbitration_id, sent.dlc) == (COMMANDS[index].frame_id, 8)


@pytest.mark.parametrize("kind", ["frames-missing", "frames-corrupted"])
def test_a_frame_fault_leaves_the_actuators_alone(kind):
    fault = ActuatorFault(load("thesis-step", [*SHORT, f"fault.kind={kind}"]))
    assert {fault.effectiveness(tick) for tick in range(12)} == {(1.0, 1.0)}


def test_a_biased_sensor_is_biased_while_the_fault_lasts_and_loses_nothing():
    timing = ["tick_s=0.001", "duration_s=0.02", "fault.at_s=0.005", "fault.for_s=0.01"]
    scenario = load("thesis-step", [*timing, "fault.kind=sensor-biased", "fault.bias_mps2=-0.25"])
    plant, healthy = SimulatedPlant(scenario), SimulatedPlant(scenario.healthy)
    added = []
    for tick in range(20):
        added.append(plant.measure() - healthy.measure())
        for each in (plant, healthy):
            each.advance(tick, 10.0, 100.0)
    np.testing.assert_allclose(added, [-0.25 if 5 <= tick < 15 else 0.0 for tick in range(20)])
    assert not scenario.fault.loses_a_channel


@given(st.floats(-1e6, 1e6), st.integers(0, 2**16), st.sampled_from(COMMANDS))
def test_a_crc_8_finds_every_change_of_one_byte(value, tick, codec):
    good = Transmitter(codec).frame(value, tick).data
    assert good[0] == crc8(good, codec.data_id)
    for at in range(8):
        for flip in range(1, 256):
            damaged = bytearray(good)
            damaged[at] ^= flip
            assert damaged[0] != crc8(damaged, codec.data_id)


def corrupted(seed, count=400):
    """Frames of ``count`` ticks under the fault, and what they were."""
    settings = ["duration_s=1", "fault.kind=frames-corrupted", "fault.at_s=0", f"seed={seed}"]
    fault, transmitter = FrameFault(load("thesis-step", settings)), Transmitter(COMMANDS[0])
    pairs = []
    for tick in range(count):
        frame = transmitter.frame(tick, tick)
        before = bytes(frame.data)
        pairs.append((before, bytes(fault.on_the_wire(frame, 0, tick).data)))
    return pairs


def test_damage_comes_from_the_seed_reaches_every_byte_and_every_bit_and_none_is_accepted():
    pairs = corrupted(seed=3)
    assert pairs == corrupted(seed=3)
    assert pairs != corrupted(seed=4)
    reached = 0
    receiver = Receiver(COMMANDS[0])
    for tick, (before, after) in enumerate(pairs):
        reached |= int.from_bytes(before, "big") ^ int.from_bytes(after, "big")
        message = can.Message(arbitration_id=COMMANDS[0].frame_id, is_extended_id=False, data=after)
        assert receiver.accept(message, tick) is None
    assert reached == 2**64 - 1
    assert receiver.rejected == {"wrong_crc": len(pairs)}


@pytest.mark.parametrize("kind", ["none", "actuator-dead", "frames-missing", "frames-corrupted"])
@pytest.mark.parametrize("channel", CHANNELS)
def test_only_a_fault_of_frames_concerns_the_frames_of_its_channel(kind, channel):
    fault = FrameFault(load("thesis-step", [f"fault.kind={kind}", f"fault.channel={channel}"]))
    expected = [kind.startswith("frames-") and channel == name for name in CHANNELS]
    assert [fault.concerns(at) for at in range(2)] == expected
