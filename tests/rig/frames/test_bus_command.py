"""``can-rig bus``, the timing of any DBC, and a scenario that takes its latency from the bus."""

import json
from dataclasses import replace
from fractions import Fraction

import pytest

from can_rig.errors import DbcError
from can_rig.frames.bus_timing import PeriodicFrame, dbc_timing, latency_ticks, response_times
from can_rig.frames.frame_length import FrameError, worst_case_bits
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_values
from tests.helpers import asked, refuses, succeeded

FOREIGN = """VERSION ""
BS_:
BU_: A B
BO_ 291 FAST: 7 A
 SG_ Speed : 0|8@1+ (1,0) [0|255] ""  B
BO_ 2566844926 LONG_IDENTIFIER: 8 A
 SG_ Speed : 0|8@1+ (1,0) [0|255] ""  B
BO_ 292 FLEXIBLE: 20 B
 SG_ Speed : 0|8@1+ (1,0) [0|255] ""  A
 SG_ Overlap : 4|8@1+ (1,0) [0|255] ""  A
BO_ 293 ON_EVENT: 8 B
 SG_ Speed : 0|8@1+ (1,0) [0|255] ""  A
BO_ 2147484000 TRANSPORT: 40 B
 SG_ Speed : 0|8@1+ (1,0) [0|255] ""  A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","r2","J1939PG","r4","r5","r6","r7","r8","r9","r10","r11","r12","r13","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "GenMsgCycleTime" BO_ 291 10;
BA_ "GenMsgCycleTime" BO_ 2566844926 20;
BA_ "GenMsgCycleTime" BO_ 292 50;
BA_ "GenMsgCycleTime" BO_ 2147484000 100;
BA_ "VFrameFormat" BO_ 292 14;
"""  # noqa: E501


@pytest.fixture
def foreign(tmp_path):
    path = tmp_path / "foreign.dbc"
    path.write_text(FOREIGN)
    return path


def test_any_dbc_by_its_cycle_times(foreign):
    timing = dbc_timing(foreign, 500_000, 2_000_000)
    bits = {
        "FAST": worst_case_bits(7),
        "FLEXIBLE": worst_case_bits(20, fd=True, brs=True),
        "LONG_IDENTIFIER": worst_case_bits(8, extended=True),
    }
    alone = response_times(
        [
            PeriodicFrame("FAST", 291, bits["FAST"], 0.01),
            PeriodicFrame("FLEXIBLE", 292, bits["FLEXIBLE"], 0.05),
            PeriodicFrame("LONG", 0x18FEF1FE, bits["LONG_IDENTIFIER"], 0.02, extended=True),
        ],
        500_000,
        2_000_000,
    )
    assert [f.name for f in timing.frames] == ["FAST", "FLEXIBLE", "LONG_IDENTIFIER"]
    assert [f.response_s for f in timing.frames] == [r.response_s for r in alone]
    assert [f.bits for f in timing.frames] == [bits[f.name].on_the_bus for f in timing.frames]
    assert [f.deadline_s for f in timing.frames] == [Fraction(n, 1000) for n in (10, 50, 20)]
    assert timing.left_out == [
        "ON_EVENT (no cycle time)",
        "TRANSPORT (40 bytes do not fit in a frame)",
    ]
    assert timing.latency_ticks is None
    slow = dbc_timing(foreign, 500_000)  # without a data bit rate no frame switches
    assert slow.utilisation > timing.utilisation
    with pytest.raises(FrameError):
        dbc_timing(foreign, 500_000, 250_000)


def test_no_deadline_is_met_where_no_message_has_a_cycle_time(foreign):
    text = foreign.read_text().replace('BA_ "GenMsgCycleTime"', "//")
    foreign.write_text("\n".join(line for line in text.splitlines() if not line.startswith("//")))
    assert asked("bus", "--dbc", foreign).returncode == 2
    with pytest.raises(
        DbcError,
        match=r"foreign.dbc: no message to look at: FAST \(no cycle time\), .*GenMsgCycleTime",
    ):
        dbc_timing(foreign, 500_000)


def test_a_dbc_with_the_usual_slips_is_mended(foreign):
    """An extended identifier without its highest bit, and words of a signal that is missing."""
    text = foreign.read_text()
    whole = dbc_timing(foreign, 500_000)
    assert str(0x98FEF1FE) in text
    text = text.replace(str(0x98FEF1FE), str(0x18FEF1FE)) + '\nVAL_ 291 Missing 0 "off" ;\n'
    foreign.write_text(text)
    assert dbc_timing(foreign, 500_000) == whole


def test_a_file_that_is_no_dbc_is_one_line(tmp_path):
    (tmp_path / "x.dbc").write_text("not a DBC")
    for path, reason in (("x.dbc", "not a DBC"), ("missing.dbc", "cannot be read"), (".", "read")):
        with refuses(reason, DbcError):
            dbc_timing(tmp_path / path, 500_000)


def test_a_scenario_takes_its_latency_from_the_bus():
    setting = ["latency_ticks=from-bus"]
    assert load("thesis-step").latency_ticks == 0
    assert load("thesis-step", setting).latency_ticks == 1
    assert load("chapter-2", setting).latency_ticks == 1
    assert load("thesis-step", [*setting, "bus.compute_s=0.0004"]).latency_ticks == 2
    assert load("thesis-step", [*setting, "bus.bitrate=500000", "tick_s=0.002"]).latency_ticks == 1
    scenario = load("thesis-step", [*setting, "bus.compute_s=0.0004"])
    assert latency_ticks(network_of(scenario), 1_000_000, 0.001, 0.0004) == scenario.latency_ticks
    assert load_values("x", scenario.as_dict()) == replace(scenario, name="x")


def test_the_command_prints_the_table_and_says_by_its_status_whether_it_fits():
    fits = asked("bus")
    assert (fits.returncode, fits.stderr) == (0, "")
    for text in ("STEER_TORQUE_CMD", "0x110", "135.0", "875.0", "67.5%", "latency_ticks = 1"):
        assert text in fits.stdout
    full = asked("bus", "--bitrate", 500_000, "--set", "latency_ticks=from-bus")
    assert full.returncode == 1
    assert "135.0%" in full.stdout
    assert "∞" in full.stdout
    assert "not schedulable: STEER_TORQUE_CMD" in full.stdout
    assert "…" not in fits.stdout + full.stdout  # no number cut off at 80 columns


def test_the_command_speaks_json_and_reads_any_dbc(foreign):
    one = json.loads(asked("bus", "thesis-step", "--json").stdout)
    assert (one["latency_ticks"], one["utilisation"], one["schedulable"]) == (1, 0.675, True)
    assert [frame["arrival_s"] for frame in one["frames"]][-1] == 0.000875
    other = succeeded("bus", "--dbc", foreign, "--bitrate", 500_000, "--data-bitrate", 2_000_000)
    assert "0x18FEF1FE" in other.stdout
    assert "left out: ON_EVENT (no cycle time), TRANSPORT" in other.stdout
    full = json.loads(asked("bus", "--json", "--bitrate", "400000").stdout)
    assert full["latency_ticks"] is None
    assert full["frames"][-1]["response_s"] is None


@pytest.mark.parametrize(
    "arguments", [["--dbc", "missing.dbc"], ["--bitrate", "0"], ["nowhere"], ["--set", "bus.x=1"]]
)
def test_bad_input_of_the_command_is_one_line_and_status_2(arguments):
    bad = asked("bus", *arguments)
    assert bad.returncode == 2
    assert bad.stdout == ""
