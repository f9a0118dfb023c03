"""Both DBCs load strictly in two libraries, and what they say is the contract of the bus."""

import logging
import warnings
from decimal import Decimal
from itertools import combinations, product

import canmatrix.formats
import cantools
import pytest

from can_rig.frames.codec import ROLES, SPEED
from can_rig.frames.databases import attribute
from can_rig.frames.network import load_network
from can_rig.scenario.sensor_settings import MEASURED
from tests.helpers import DBC

FILES = ("steer_by_wire.dbc", "plant_by_numbers.dbc")
FURTHER = tuple(each.replace("-", "_") for each in MEASURED)

both = pytest.mark.parametrize("name", FILES)


@pytest.fixture(autouse=True)
def no_warnings(caplog):
    with warnings.catch_warnings(), caplog.at_level(logging.WARNING):
        warnings.simplefilter("error")
        yield
    assert not caplog.records


def load(name):
    return cantools.database.load_file(DBC / name, strict=True)


def load_matrix(name):
    (matrix,) = canmatrix.formats.loadp(str(DBC / name)).values()
    return matrix


@both
def test_both_libraries_read_the_same_frames(name):
    frames = {frame.arbitration_id.id: frame for frame in load_matrix(name).frames}
    messages = {message.frame_id: message for message in load(name).messages}
    assert frames.keys() == messages.keys()
    for frame_id, message in messages.items():
        frame = frames[frame_id]
        assert frame.name == message.name
        assert frame.size == message.length == 8
        assert frame.transmitters == message.senders
        assert frame.attributes["RigRole"] == attribute(message, "RigRole")
        assert frame.attributes["E2EDataId"] == str(attribute(message, "E2EDataId"))
        for ours, theirs in zip(message.signals, frame.signals, strict=True):
            assert (ours.name, ours.start, ours.length, ours.is_signed, ours.unit or "") == (
                theirs.name,
                theirs.get_startbit(bit_numbering=1),
                theirs.size,
                theirs.is_signed,
                theirs.unit,
            )
            assert theirs.is_little_endian


@both
def test_layout(name):
    for message in load(name).messages:
        assert not message.is_extended_frame
        assert message.length == 8
        *header, value = [(signal.name, signal.start, signal.length) for signal in message.signals]
        status = [("Mode", 12, 2), ("FaultState", 14, 2)]
        status_frame = attribute(message, "RigRole") == "status"
        further = attribute(message, "RigRole") in FURTHER
        assert header == [
            ("Checksum", 0, 8),
            ("AliveCounter", 8, 4),
            *(status if status_frame else []),
            *([("Valid", 12, 1)] if further else []),
            ("Tick", 16, 16),
            *([("SampleTick", 32, 12)] if further else []),
            *([("Verdict", 32, 4)] if status_frame else []),
        ]
        assert value[1:] == ((36, 28) if status_frame else (44, 20) if further else (32, 32))


@both
def test_ranges_are_symmetric_and_exactly_on_the_grid(name):
    for frame in load_matrix(name).frames:
        value = frame.signals[-1]
        assert isinstance(value.max, Decimal)
        end = 2 ** (value.size - 1)
        assert value.max == value.factor * (end - 1)
        assert value.min == -value.max
        assert value.values == {-end: "NOT_AVAILABLE"}


@both
def test_everything_is_explained_and_set(name):
    database = load(name)
    assert {node.name for node in database.nodes} == {"PLANT", "CONTROLLER"}
    for thing in [*database.nodes, *database.messages]:
        assert thing.comment
    for message in database.messages:
        assert len(message.senders) == 1
        assert message.receivers == {"PLANT", "CONTROLLER"} - set(message.senders)
        assert message.cycle_time == (10 if attribute(message, "RigRole") in FURTHER else 1)
        assert message.send_type == "Cyclic"
        assert all(signal.comment for signal in message.signals)


@both
def test_identifiers_follow_the_order_of_a_tick(name):
    messages = sorted(load(name).messages, key=lambda message: message.frame_id)
    speed = (SPEED,) if name == FILES[0] else ()
    roles = tuple(attribute(message, "RigRole") for message in messages)
    assert roles == (*speed, *FURTHER, *ROLES)
    own = ["PLANT"] * (2 + len(speed) + len(FURTHER))
    assert [message.senders[0] for message in messages] == own + ["CONTROLLER"] * 3


def test_no_identifier_is_used_twice_in_both_networks():
    codecs = [
        codec
        for name, sensors in ((FILES[0], FURTHER), (FILES[1], FURTHER[3:]))
        for codec in load_network(DBC / name, name == FILES[0], sensors).on_the_bus
    ]
    assert len({codec.frame_id for codec in codecs}) == len({c.data_id for c in codecs}) == 18


def test_the_lsb_arithmetic_of_the_readme():
    network = load_network(DBC / FILES[0])
    assert network.feedback.lsb == network.reference.lsb == 1e-8
    assert network.status.lsb == 2e-7
    assert network.command_1.lsb == network.command_2.lsb == 1e-3
    assert network.feedback.maximum > 2 * 9.81
    assert network.command_1.maximum > 4 * 5e5
    gain_nm_per_mps2 = 2.5e5
    assert network.feedback.lsb * gain_nm_per_mps2 == pytest.approx(2.5e-3)
    chapter_2 = load_network(DBC / FILES[1])
    assert chapter_2.feedback.lsb * 100 == pytest.approx(chapter_2.command_2.lsb)


def test_the_table_of_identifiers_in_the_readme():
    text = (DBC / "README.md").read_text(encoding="utf-8")
    for name, codec in product(FILES, ROLES):
        facts = getattr(load_network(DBC / name), codec)
        assert f"0x{facts.frame_id:X} `{facts.name}`" in text


def test_frames_differ_in_the_crc_of_their_data_id():
    from can_rig.frames.codec import Checker, CheckStatus, Transmitter

    codecs = [codec for name in FILES for codec in load_network(DBC / name)]
    for sender, receiver in combinations(codecs, 2):
        message = Transmitter(sender).frame(1.0, 2)
        assert Checker(receiver.data_id).check(message.data) is CheckStatus.WRONG_CRC
