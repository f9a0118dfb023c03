"""Signals of any layout: the sent bytes are those of cantools."""

import math
from collections.abc import Callable
from pathlib import Path

import cantools
import pytest
from cantools.database.can import Database
from hypothesis import example, given, settings, strategies as st

from can_rig.errors import DbcError, ScenarioError
from can_rig.frames.codec import CheckStatus, Receiver, Transmitter
from can_rig.frames.foreign_frames import Roles, map_network
from can_rig.frames.network import Network
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import record, refuses
from tests.rig.own_frames.arxml import as_arxml, name_of
from tests.rig.own_frames.scenarios import FD_SIGNALS, MOTOROLA, SIGNALS, database, options

VALUES = st.floats(allow_nan=False, allow_infinity=True)


def network(folder: Path, text: str, **roles: object) -> Network:
    path = folder / "own.dbc"
    path.write_text(text)
    return map_network(path, Roles(FD_SIGNALS, **roles))  # type: ignore[arg-type]


@st.composite
def layouts(draw: st.DrawFn) -> tuple[str, float, int, bool]:
    """A value above bit 32 of 8 bytes: its line in a DBC, size of a step, bits, signed or not."""
    bits = draw(st.integers(2, 32))
    signed, factor = draw(st.booleans()), draw(st.sampled_from([1.0, 0.5, 0.001, 3.0, -0.35]))
    lowest = -(2 ** (bits - 1)) if signed else 0
    offset = draw(st.integers(2 - 2**bits - lowest, -1 - lowest))  # both signs can be sent
    start = draw(st.integers(32, 64 - bits))
    motorola = draw(st.booleans())
    if motorola:  # its most significant bit, so many bits before the end of the frame
        at = draw(st.integers(0, 32 - bits))
        start = 8 * (4 + at // 8) + 7 - at % 8
    order, sign = ("0" if motorola else "1"), ("-" if signed else "+")
    line = f"{start}|{bits}@{order}{sign} ({factor:g},{offset * factor:.17g}) [0|0]"
    return line, abs(factor), bits, signed


@settings(max_examples=60)
@example(("32|25@1- (0.001,16777.203000000001) [0|0]", 0.001, 25, True), [1.0])
@given(layout=layouts(), values=st.lists(VALUES, min_size=1, max_size=5))
def test_cantools_reads_what_is_sent(tmp_path_factory, layout, values):
    line, factor, bits, _ = layout
    text = database(line, 8)
    codec = network(tmp_path_factory.mktemp("n"), text, tick="Count").command_1
    theirs = cantools.database.load_string(text, "dbc")
    transmitter, receiver = Transmitter(codec), Receiver(codec)
    for tick, value in enumerate((*values, 0.0, math.nan), 65534):
        frame = transmitter.frame(value, tick)
        said = theirs.decode_message(frame.arbitration_id, frame.data)
        record = receiver.accept(frame, tick)
        assert record is not None and said["Count"] == tick & 0xFFFF == record.tick
        if math.isnan(value):
            assert math.isnan(record.value)
            assert not codec.minimum <= said["Value"] <= codec.maximum
            continue
        cancelled = math.ulp(2**bits * factor)  # of raw value and offset, each as large
        within = 1e-9 * factor + 2 * cancelled
        assert said["Value"] == pytest.approx(record.value, abs=within, rel=1e-12)
        nearest = min(max(value, codec.minimum), codec.maximum)
        rounding = 2 * math.ulp(nearest)
        assert abs(record.value - nearest) <= factor / 2 * (1 + 1e-9) + rounding
        assert record.value == codec.quantise(value)


@pytest.mark.parametrize(("bits", "types"), [(32, "1"), (64, "2")])
def test_floats_have_their_own_not_a_number(tmp_path, bits, types):
    text = database(f"{64}|{bits}@1- (1,0) [0|0]", 16, types=types, fd=True)
    codec = network(tmp_path, text, tick="Count").feedback
    theirs = cantools.database.load_string(text, "dbc")
    assert (codec.lsb, codec.fd, codec.layout.length) == (0.0, True, 16)
    for value in (0.1, -1e30, math.inf, math.nan):
        frame = Transmitter(codec).frame(value, 7)
        assert frame.is_fd and len(frame.data) == 16
        record = Receiver(codec).accept(frame, 7)
        assert record is not None
        said = theirs.decode_message(frame.arbitration_id, frame.data)["Value"]
        assert record.value == said or (math.isnan(value) and math.isnan(record.value))
        if abs(value) <= codec.maximum:
            assert record.value == pytest.approx(value, rel=2.0 ** (-24 if bits == 32 else -53))


def test_a_frame_takes_the_next_length_of_can_fd(tmp_path):
    text = database("64|16@1- (0.01,0) [0|0]", 10, fd=True, first_id=0x98FF0000)
    codec = network(tmp_path, text, tick="Count").status
    frame = Transmitter(codec).frame(1.0, 5, mode=1, fault_state=2)
    assert len(frame.data) == 12 and frame.is_extended_id and frame.is_fd
    record = Receiver(codec).accept(frame, 5)
    assert record is not None and record == (1.0, 5, 1, 2, 0)
    frame.is_extended_id = False
    assert Receiver(codec).accept(frame, 5) is None


def test_protection_of_any_length_finds_what_is_damaged(tmp_path):
    ids = {"reference": 1, "feedback": 2, "command_1": 3, "command_2": 4, "status": 5}
    text = database("64|16@1- (0.01,0) [0|0]", 12, fd=True)
    protected = network(tmp_path, text, tick="Count", data_ids=ids)
    assert protected.unprotected == ()
    codec = protected.command_2
    frame = Transmitter(codec).frame(1.0, 5)
    for byte in range(12):
        frame.data[byte] ^= 0x10
        receiver = Receiver(codec)
        assert receiver.accept(frame) is None
        assert receiver.checker.counts[CheckStatus.WRONG_CRC] == 1
        frame.data[byte] ^= 0x10
    assert Receiver(codec).accept(frame) is not None
    bare = network(tmp_path, text, tick="Count")
    assert bare.unprotected == ("M1", "M2", "M3", "M4", "M5")
    frame.data[9] ^= 0x10
    assert Receiver(bare.command_2).accept(frame, 5) is not None
    frame.data.append(0)
    assert Receiver(bare.command_2).rejected == {}


BAD = {
    "one sign": ("32|16@1+ (0.01,0) [0|0]", {}, "signals.reference) carries 0..655.35: must"),
    "offset": ("32|16@1- (0.01,0.005) [0|0]", {}, "signals.reference): offset 0.005: must be"),
    "factor": ("32|16@1- (0,0) [0|0]", {}, "signals.reference): factor 0: must not be 0"),
    "overlap": ("8|16@1- (1,0) [0|0]", {"tick": "Count"}, "cannot be used: The signals Count and"),
    "tick": ("32|16@1- (1,0) [0|0]", {"tick": "Cnt"}, "network.tick = 'Cnt'"),
    "tick is the value": (
        "32|16@1- (1,0) [0|0]", {"tick": "Value"},
        "network.signals.reference and network.tick are both M1.Value",
    ),
    "tick of 15 bits": (
        '32|16@1- (1,0) [0|0] "" A\n SG_ Short : 48|15@1+ (1,0) [0|0]', {"tick": "Short"},
        "Short (network.tick): must be an unsigned integer of at least 16",
    ),
    "tick with a sign": (
        '32|16@1- (1,0) [0|0] "" A\n SG_ Signed : 48|16@1- (1,0) [0|0]', {"tick": "Signed"},
        "Signed (network.tick): must be an unsigned integer of at least 16",
    ),
    "room": (
        "4|4@1- (1,0) [0|0]", {"data_ids": {"command_1": 7}},
        "Value (network.signals.command_1) lies in byte 0 or the low half of byte 1: must leave",
    ),
    "alike": (
        "32|16@1- (1,0) [0|0]", {"data_ids": {"command_1": 7, "command_2": 7}}, "give the same CRC",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("value", "roles", "line"), BAD.values(), ids=BAD)
def test_a_signal_that_cannot_do_is_one_line(tmp_path, value, roles, line):
    with refuses(line, DbcError):
        network(tmp_path, database(value, 8), **roles)


def test_what_is_wrong_elsewhere_in_a_database_is_no_matter(tmp_path):
    """Overlapping signals, and an extended identifier without its mark."""
    other = 'BO_ 217056298 Other: 8 B\n SG_ A : 0|9@1+ (1,0) [0|0] "" A\n'
    other += ' SG_ B : 8|9@1+ (1,0) [0|0] "" A\n'
    text = database("32|16@1- (1,0) [0|0]", 8)
    with_it = [codec.encode(1.0, 5) for codec in network(tmp_path, text + other).by_role]
    assert with_it == [codec.encode(1.0, 5) for codec in network(tmp_path, text).by_role]


def test_the_other_signals_of_a_message_have_their_initial_values():
    theirs = cantools.database.load_file(MOTOROLA)
    codec = map_network(MOTOROLA, Roles(SIGNALS, "Count")).feedback
    said = theirs.decode_message(codec.frame_id, codec.encode(1.5, 4))
    assert said == {"DStarMeas": 1.5, "Valid": 0, "Count": 4}


@pytest.mark.parametrize("bits", [0, 3, 4, 8])
def test_a_status_frame_of_one_s_own_says_the_verdict_where_it_has_room(tmp_path, bits):
    text = database("64|16@1- (0.01,0) [0|0]", 12, fd=True)
    last = ' SG_ Fault : 14|2@1+ (1,0) [0|3] "" A\n'
    if bits:
        text = text.replace(last, f'{last} SG_ Whose : 40|{bits}@1+ (1,0) [0|0] "" A\n')
    signals = {**FD_SIGNALS, **({"verdict": "M5.Whose"} if bits else {})}
    path = tmp_path / "own.dbc"
    path.write_text(text)
    if bits == 3:
        with pytest.raises(DbcError, match=r"signals.verdict\): must be an integer of at least 4"):
            map_network(path, Roles(signals, "Count"))
        return
    codec = map_network(path, Roles(signals, "Count")).status
    assert bool(codec.verdicts) == bool(bits)
    record = codec.decode(codec.encode(1.0, 5, 1, 2, 8))
    assert record == (1.0, 5, 1, 2, 8 if bits else 0)
    assert codec.decode(codec.encode(1.0, 5, 1, 2, 99)).verdict == (13 if bits else 0)


SHORT = ["duration_s=0.12", "fault.at_s=0.05"]
WRITERS: dict[str, tuple[Callable[[Database], str], str]] = {
    "kcd": (lambda database: str(database.as_kcd_string()), "utf-8"),
    "sym": (lambda database: str(database.as_sym_string()), "cp1252"),
    "arxml": (as_arxml, "utf-8"),
}
TICKS = {
    "reference": "VMC_Request", "feedback": "ESP_Motion", "command_1": "EPS_Command",
    "command_2": "DRV_Command", "status": "EPS_Status",
}  # fmt: skip


def arxml_options(path: Path) -> list[str]:
    """In ARXML a name is there once, so each message counts the ticks by another."""
    pairs = {role: name.split(".") for role, name in SIGNALS.items()}
    names = {role: f"{m}.{name_of(m, signal)}" for role, (m, signal) in pairs.items()}
    ticks = [f"network.ticks.{role}={name_of(m, 'Count')}" for role, m in TICKS.items()]
    return [*options(path, names, tick=""), *ticks]


@pytest.fixture(scope="module")
def dbc_log(tmp_path_factory):
    words = [*SHORT, *options(MOTOROLA, SIGNALS)]
    return record(tmp_path_factory.mktemp("dbc"), *words, name="default")[0].read_bytes()


@pytest.mark.parametrize("kind", WRITERS)
def test_the_log_is_that_of_the_dbc(kind, dbc_log, tmp_path):
    write, encoding = WRITERS[kind]
    path = tmp_path / f"own.{kind}"
    path.write_text(write(cantools.database.load_file(MOTOROLA)), encoding=encoding)
    words = arxml_options(path) if kind == "arxml" else options(path, SIGNALS)
    (tmp_path / "logs").mkdir()
    log, summary, scenario = record(tmp_path / "logs", *SHORT, *words, name="default")
    assert summary.ticks == scenario.ticks == 120
    assert log.read_bytes() == dbc_log


TICK_KEYS = {
    "network.ticks.feedback=": "network.ticks.feedback: must be set beside the other ticks",
    "network.tick=Count": "network.ticks: must not be set beside network.tick",
    "network.ticks.status=Count_of_EPS_Statis": "network.ticks.status = 'Count_of_EPS_Statis': ",
    "network.ticks.mode=Count": "network.ticks.mode: unknown key",
    "network.ticks.status=Estimate_of_EPS_Status": "and network.ticks.status are both",
}


@pytest.mark.parametrize(("setting", "line"), TICK_KEYS.items(), ids=TICK_KEYS)
def test_a_bad_tick_is_one_line(setting, line, tmp_path):
    path = tmp_path / "own.arxml"
    path.write_text(as_arxml(cantools.database.load_file(MOTOROLA)))
    with refuses(line, (ScenarioError, DbcError)):
        network_of(load("default", [*arxml_options(path), setting]))


def test_ticks_need_the_signals():
    with pytest.raises(ScenarioError, match=r"network\.signals: must be set beside network\.tick"):
        load("default", [f"network.dbc={MOTOROLA}", *(f"network.ticks.{key}=C" for key in TICKS)])
