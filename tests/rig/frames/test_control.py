"""The frames with which a run is touched, against cantools and autosar-e2e alone."""

from typing import get_args

import cantools
import pytest
from e2e.p01 import e2e_p01_check
from hypothesis import given, strategies as st

from can_rig.frames import operator_frames
from can_rig.plant.faults.injection import injected
from can_rig.scenario.disturbance_settings import DisturbanceKind, DisturbanceSettings
from can_rig.scenario.fault_settings import NUMBER, FaultKind
from tests.helpers import DBC

OF_FAULTS = ("actuator-", "sensor-", "frames-")
PUSHES = {  # with a number of 0.5
    "gust": {"force_n": 0.5, "arm_m": 0.3},
    "turbulence": {"intensity_n": 0.5, "arm_m": 0.3, "length_m": 50.0},
    "bank": {"bank_percent": 0.5},
    "friction": {"front": 0.5, "rear": 0.5},
    "steering-kick": {"torque_nm": 0.5},
    "push": {"size": 0.5},
}
DATABASE = cantools.database.load_file(DBC / "control.dbc", strict=True)


@given(
    kind=st.sampled_from(operator_frames.kinds()),
    place=st.sampled_from(operator_frames.places()),
    value=st.none() | st.integers(-8_388_607, 8_388_607).map(lambda raw: raw / 1000),
    tenths=st.integers(0, 255),
    sequence=st.integers(0, operator_frames.SEQUENCES - 1),
)
def test_a_command_is_what_the_dbc_says(kind, place, value, tenths, sequence):
    if not kind.startswith(OF_FAULTS):
        place = "world"
    elif place == "world":
        place = "torque"
    asked = operator_frames.Command("INJECT", kind, place, value, tenths / 10 or None)
    message = operator_frames.command_message(asked, sequence)
    frame = DATABASE.get_message_by_name("RIG_CONTROL")
    said = frame.decode(bytes(message.data))
    assert (message.arbitration_id, len(message.data)) == (frame.frame_id, frame.length)
    where = "torque" if place == "world" else place  # the first word of the table
    assert (str(said["Kind"]), str(said["Place"]), said["Sequence"]) == (kind, where, sequence)
    assert said["Value"] == pytest.approx(value or 0.0, abs=5e-4)
    assert e2e_p01_check(message.data, frame.dbc.attributes["E2EDataId"].value)
    read = operator_frames.read_command(message, sequence)
    assert read is not None
    assert read[:3] == asked[:3]
    assert read.value == (None if value is None else pytest.approx(value, abs=5e-4))
    assert read.duration_s == (pytest.approx(tenths / 10) if tenths else None)
    assert operator_frames.read_command(message, (sequence + 1) % operator_frames.SEQUENCES) is None


@given(st.integers(0, 63))
def test_one_changed_bit_is_noticed(bit):
    message = operator_frames.command_message(operator_frames.Command("CLEAR"), 4)
    message.data[bit // 8] ^= 1 << bit % 8
    assert operator_frames.read_command(message, 4) is None


def test_what_is_taken_is_said_in_the_same_signals():
    asked = operator_frames.Command("INJECT", "frames-forged", "sensor", -0.25, 0.5)
    message = operator_frames.taken_message(asked, 7)
    asking, taken = (DATABASE.get_message_by_name(f"RIG_{name}") for name in ("CONTROL", "TAKEN"))
    places = [
        {(s.name, s.start, s.length, s.is_signed, s.scale, str(s.choices)) for s in each.signals}
        for each in (asking, taken)
    ]
    assert places[0] == places[1]
    assert message.arbitration_id == taken.frame_id
    assert e2e_p01_check(message.data, taken.dbc.attributes["E2EDataId"].value)
    assert operator_frames.read_taken(message) == (7, asked)
    assert operator_frames.read_command(message, 7) is None  # nobody is commanded by it


def test_every_kind_of_the_dbc_can_be_injected():
    others = {"none", "controller-restarted"}
    faults = [kind for kind in operator_frames.kinds() if kind.startswith(OF_FAULTS)]
    pushes = [kind for kind in operator_frames.kinds() if kind not in faults]
    assert {*others, *faults} == set(get_args(FaultKind))
    assert {"none", *pushes} == set(get_args(DisturbanceKind))
    for kind, sizes in PUSHES.items():
        command = operator_frames.Command("INJECT", kind, "world", 0.5, 2.0)
        assert injected(command, 3, 1_000_000) == DisturbanceSettings(kind, 0.003, 2.0, **sizes)
        assert injected(command._replace(value=None), 3, 1_000_000) is None
    assert [*PUSHES] == pushes
    for kind in faults:
        place = "torque-echo" if kind.startswith("sensor-") else "torque"
        value = 3.0 if kind == "sensor-swapped" else 0.5
        fault = injected(operator_frames.Command("INJECT", kind, place, value), 3, 1_000_000)
        key = "offset" if kind == "sensor-biased" else NUMBER.get(kind, "")
        assert fault is not None or key == "late_ticks"
        if fault is not None:
            assert (fault.kind, fault.at_s, getattr(fault, key, 0.5)) == (kind, 0.003, 0.5)
    for kind, place, value in (
        ("actuator-dead", "sensor", None),
        ("actuator-drift", "torque", None),
        ("actuator-dead", "yaw-rate", None),
        ("sensor-invalid", "sensor", None),
        ("sensor-lying", "yaw-rate", None),
        ("sensor-swapped", "yaw-rate", None),
        ("sensor-swapped", "yaw-rate", 3.0),  # with itself
        ("sensor-swapped", "yaw-rate", 0.0),  # with an actuator
    ):
        command = operator_frames.Command("INJECT", kind, place, value)
        assert injected(command, 3, 1_000_000) is None


@pytest.mark.parametrize("place", [operator_frames.ALL, *operator_frames.places()])
def test_one_place_is_cleared_or_all_of_them(place):
    message = operator_frames.command_message(operator_frames.Command("CLEAR", place=place), 9)
    said = DATABASE.decode_message("RIG_CONTROL", bytes(message.data))
    action = {operator_frames.ALL: "CLEAR_ALL", "world": "CLEAR_WORLD"}.get(place, "CLEAR")
    assert str(said["Action"]) == action
    assert operator_frames.read_command(message, 9) == operator_frames.Command("CLEAR", place=place)


def test_a_state_is_what_the_dbc_says():
    state = operator_frames.State(True, True, 7, 200, 70_000, 1000.0)
    message = operator_frames.state_message(state, 16)
    said = DATABASE.decode_message("RIG_STATE", bytes(message.data))
    assert (said["AliveCounter"], said["Refused"], said["Pace"]) == (1, 65535, 655.35)
    assert operator_frames.read_state(message) == operator_frames.State(
        True, True, 7, 200, 65535, 655.35
    )
