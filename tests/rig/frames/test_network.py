"""The frames of the rig in a DBC: found by their roles, or refused with the reason."""

import math

import cantools
import pytest

from can_rig.errors import DbcError, RigError
from can_rig.frames.network import load_network
from firmware_model.law.status import FaultState, Mode, Verdict
from tests.helpers import DBC, refuses

STEER_BY_WIRE = DBC / "steer_by_wire.dbc"


def test_the_value_tables_are_the_firmware_s():
    status = load_network(STEER_BY_WIRE).status
    assert status.modes == {int(mode): mode.name for mode in Mode}
    assert status.fault_states == {int(state): state.name for state in FaultState}
    verdicts = {int(verdict): verdict.name for verdict in Verdict}
    assert status.verdicts == verdicts | {14: "NO_DECISION", 15: "NOT_AVAILABLE"}


def test_a_status_frame_without_a_verdict_has_all_bits_for_the_estimate(tmp_path):
    verdict = ' SG_ Verdict : 32|4@1+ (1,0) [0|15] ""  PLANT\n'
    text = STEER_BY_WIRE.read_text().replace(verdict, "").replace("36|28@1-", "32|32@1-")
    lines = (line for line in text.splitlines() if " 288 Verdict" not in line)
    path = tmp_path / "without.dbc"
    path.write_text(
        "\n".join(lines).replace("FaultEstimate -134217728", "FaultEstimate -2147483648")
    )
    status = load_network(path).status
    assert status.verdicts == {}
    data = status.encode(-1.5, 7, 1, 2, 8)
    assert status.decode(data) == (-1.5, 7, 1, 2, 0)
    message = cantools.database.load_file(path).get_message_by_name(status.name)
    assert message.decode(data)["FaultEstimate"] == -1.5


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Verdict : 32|4@1+", "Verdict : 32|3@1+", "signal Verdict is unsigned Intel, 3 bits"),
        ('8 "BOTH_LOST" ', "", "signal Verdict must have a value table of 0 to 13"),
        ("36|28@1- (2E", "36|27@1- (2E", "it must be signed Intel, 28 bits at bit 36"),
    ],
)
def test_a_verdict_that_is_not_at_its_place_is_refused(tmp_path, old, new, said):
    path = tmp_path / "other.dbc"
    path.write_text(STEER_BY_WIRE.read_text().replace(old, new))
    with pytest.raises(DbcError, match=said):
        load_network(path)


def test_layout_variant_with_swapped_status_words(tmp_path):
    text = STEER_BY_WIRE.read_text().replace("Mode : 12|2", "Mode : 14|2")
    text = text.replace("FaultState : 14|2", "FaultState : 12|2")
    path = tmp_path / "swapped.dbc"
    path.write_text(text)
    status = load_network(path).status
    message = cantools.database.load_file(path).get_message_by_name(status.name)
    decoded = message.decode(status.encode(0.0, 0, 1, 2), decode_choices=False)
    assert (decoded["Mode"], decoded["FaultState"]) == (1, 2)


def test_a_narrower_range_saturates_there_and_what_lies_beyond_is_not_a_value(tmp_path):
    path = tmp_path / "narrow.dbc"
    wide = '[-2147483.647|2147483.647] "N.m"'
    path.write_text(STEER_BY_WIRE.read_text().replace(wide, '[-100|50.5] "N.m"'))
    codec = load_network(path).command_1
    assert (codec.quantise(-1e9), codec.quantise(1e9)) == (-100.0, 50.5)
    assert math.isnan(codec.decode(bytes(4) + (50_501).to_bytes(4, "little")).value)


ROLE_FEEDBACK = 'BA_ "RigRole" BO_ 257 2;'
DSTAR_PLACE = "DStar : 32|32@1- (1E-008,0)"
DSTAR = f"{DSTAR_PLACE} [-21.47483647|21.47483647]"
EXTRA = 'SG_ Extra : 12|4@1+ (1,0) [0|15] ""  CONTROLLER'

BAD = {
    "role missing": (ROLE_FEEDBACK, "", "no message has RigRole feedback"),
    "role none": (ROLE_FEEDBACK, 'BA_ "RigRole" BO_ 257 0;', "no message has RigRole feedback"),
    "role twice": (ROLE_FEEDBACK, 'BA_ "RigRole" BO_ 257 1;', "both have RigRole reference"),
    "data id missing": ('BA_ "E2EDataId" BO_ 257 23313;', "", "E2EDataId is None; it must be 1"),
    "data id zero": ("BO_ 257 23313;", "BO_ 257 0;", "E2EDataId is 0; it must be 1..65535"),
    "data id twice": ("BO_ 257 23313;", "BO_ 257 23312;", "give the same CRC"),
    "data id collides": ("BO_ 257 23313;", "BO_ 257 123;", "give the same CRC"),
    "length": ("257 DSTAR_FEEDBACK: 8", "257 DSTAR_FEEDBACK: 9", "it must be a classic one of 8"),
    "extended": ("257", "2147483905", "an extended frame of 8 bytes"),
    "checksum place": ("Checksum : 0|8@1+", "Checksum : 0|7@1+", "signal Checksum is unsigned"),
    "checksum name": ("Checksum : 0|8@1+", "Crc : 0|8@1+", "no signal Checksum"),
    "counter sign": ("AliveCounter : 8|4@1+", "AliveCounter : 8|4@1-", "AliveCounter is signed"),
    "tick scaled": ('Tick : 16|16@1+ (1,0)', "Tick : 16|16@1+ (2,0)", "signal Tick is unsigned"),
    "value place": (DSTAR, DSTAR.replace("32|32", "32|31"), "it must be signed Intel, 32 bits"),
    "value unsigned": (DSTAR, DSTAR.replace("1-", "1+", 1), "DStar is unsigned"),
    "value Motorola": (DSTAR, DSTAR.replace("32|32@1", "39|32@0"), "DStar is signed Motorola"),
    "value offset": (DSTAR, DSTAR.replace(",0)", ",1)"), "offset 1"),
    "value factor": (DSTAR, DSTAR.replace("(1E", "(-1E"), "factor above 0"),
    "range empty": (DSTAR, f"{DSTAR_PLACE} [0|0]", "it must include 0"),
    "range without 0": (DSTAR, f"{DSTAR_PLACE} [1|5]", "has range 1..5; it must include 0"),
    "range too wide": (DSTAR, DSTAR.replace("-21.47483647", "-21.47483648"), "at most 2147483647"),
    "range off the grid": (DSTAR, DSTAR.replace("|21.47483647", "|0.000000015"), "multiples of"),
    "second value": (f"SG_ {DSTAR}", f"{EXTRA}\n SG_ {DSTAR}", "in addition to the header"),
    "no mode": ("Mode ", "Moode ", "no signal Mode"),
    "mode place": ("SG_ Mode : 12|2", "SG_ Mode : 12|1", "signal Mode is unsigned"),
    "mode words": ('0 "STANDBY" 1 "RUN" 2 "BLIND"', '0 "STANDBY"', "Mode must have a value table"),
    "overlap": ("FaultState : 14|2", "FaultState : 12|2", "overlapping"),
    "no sender": ("DSTAR_FEEDBACK: 8 PLANT", "DSTAR_FEEDBACK: 8 Vector__XXX", "0 senders"),
    "not a DBC": ("BU_:", "BU", "cannot be loaded as DBC"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "reason"), BAD.values(), ids=BAD.keys())
def test_bad_dbc_is_refused_with_its_reason(old, new, reason, tmp_path):
    text = STEER_BY_WIRE.read_text()
    assert old in text
    path = tmp_path / "bad.dbc"
    path.write_text(text.replace(old, new))
    with refuses(reason, DbcError) as caught:
        load_network(path)
    assert str(caught.value).startswith(str(path))
    assert isinstance(caught.value, RigError)


def test_missing_file_is_refused_by_name(tmp_path):
    with pytest.raises(DbcError, match=r"none\.dbc: cannot be read: No such file"):
        load_network(tmp_path / "none.dbc")
