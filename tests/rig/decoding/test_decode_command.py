"""``can-rig decode``: files that other programs read as cantools decodes, and every count."""

import csv
import gzip
import json

import asammdf
import can
import cantools
import numpy as np
import pandas as pd
import pytest

from can_rig.decoding.decode import decode_log
from can_rig.frames.databases import shipped_dbc
from can_rig.results.run_folder import LOG
from tests.helpers import NAMES, asked, decoded, record, refused, succeeded

FEATURES = """VERSION ""
BU_: ECU
BO_ 2147484160 MIXED: 8 ECU
 SG_ Page M : 0|4@1+ (1,0) [0|0] "" ECU
 SG_ Door m0 : 8|2@1+ (1,0) [0|0] "" ECU
 SG_ Level m1 : 8|16@1- (0.1,-5) [0|0] "mm" ECU
 SG_ Odometer : 47|24@0+ (0.001,0) [0|0] "km" ECU
BO_ 768 PLAIN: 2 ECU
 SG_ Speed : 0|16@1+ (0.01,0) [0|0] "km/h" ECU
VAL_ 2147484160 Door 0 "shut, locked" 1 "open" ;
"""


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    log, _, _ = record(tmp_path_factory.mktemp("drive"), "duration_s=0.3", bus="virtual:decode")
    return log


@pytest.fixture
def foreign(tmp_path):
    """A DBC and a log that have nothing to do with the rig."""
    (tmp_path / "car.dbc").write_text(FEATURES, "ascii")
    random = np.random.default_rng(5)
    lines = []
    for at in range(60):
        mixed = bytes([at % 2, at % 3, *random.bytes(6)]).hex().upper()
        lines.append(f"({1.7e9 + at * 0.01:.6f}) can{at % 2} 00000200#{mixed}\n")
        lines.append(f"({1.7e9 + at * 0.01:.6f}) can0 300#{random.bytes(2).hex()}\n")
    lines += ["(1700000001.000000) can0 00000200#0500000000000000\n"]  # no such page
    lines += ["(1700000001.000001) can0 300#11\n", "(1700000001.000002) can0 300#112233\n"]
    lines += ["(1700000001.000003) can0 300#R2\n", "(1700000001.000004) can0 20000080#\n"]
    lines += ["(1700000001.000005) can0 7FF#\n", "(1700000001.000006) can0 00000300#0000\n"]
    (tmp_path / "car.log").write_text("".join(lines), "ascii")
    return tmp_path / "car.dbc", tmp_path / "car.log"


def test_a_run_as_a_table(drive, tmp_path):
    succeeded("decode", drive, "--out", tmp_path / "a.csv", "--out", tmp_path / "a.parquet")
    expected = decoded(drive)
    stamps = [round(message.timestamp * 1e9) for message in can.LogReader(drive)]
    table = pd.read_csv(tmp_path / "a.csv")
    assert table["message"].tolist() == list(NAMES) * 300
    assert (table["time_s"] * 1e9).round().tolist() == stamps
    for at, (name, signal) in enumerate(zip(NAMES, ("DStarReference", "DStar"), strict=False)):
        column = table.loc[table["message"] == name, f"{name}.{signal}"]
        assert (column.to_numpy() == expected[name]).all()
        assert table.loc[table["message"] != name, f"{name}.{signal}"].isna().all()
        own = pd.read_parquet(tmp_path / f"a.parquet/{name}.parquet")
        assert own[signal].tolist() == list(expected[name])
        assert (own["time_s"] * 1e9).round().tolist() == stamps[at :: len(NAMES)]


def test_anybodys_log_through_anybodys_dbc(foreign, tmp_path):
    dbc, log = foreign
    done = succeeded("decode", log, "--dbc", dbc, "--out", tmp_path / "a.csv", "--names", "--json")
    summary = json.loads(done.stdout)
    assert summary["messages"]["MIXED"] == {
        **dict.fromkeys(summary["messages"]["MIXED"], 0),
        "frames": 61,
        "decoded": 60,
        "unknown_multiplexer": 1,
    }
    assert summary["messages"]["PLAIN"] == {
        **dict.fromkeys(summary["messages"]["PLAIN"], 0),
        "frames": 63,
        "decoded": 61,
        "too_short": 1,
        "remote": 1,
        "longer": 1,
    }
    assert summary["unknown"] == {"7FF": 1, "00000300": 1}
    assert (summary["frames"], summary["error_frames"]) == (127, 1)
    database = cantools.database.load_file(dbc)
    with (tmp_path / "a.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    good = [m for m in can.LogReader(log) if m.timestamp < 1.7e9 + 1]
    assert len(rows) == len(good) + 1
    for row, message in zip(rows, good, strict=False):
        assert row["time_s"] == f"{message.timestamp:.6f}000"
        name = "MIXED" if message.is_extended_id else "PLAIN"
        values = database.get_message_by_name(name).decode(message.data)
        given = {key: text for key, text in row.items() if "." in key and text}
        assert row["message"] == name
        assert given.keys() == {f"{name}.{signal}" for signal in values}
        for signal, value in values.items():
            text = given[f"{name}.{signal}"]
            assert text == str(value) or float(text) == value


def test_a_folder_has_a_file_for_each_message(foreign, tmp_path):
    dbc, log = foreign
    out = tmp_path / "decoded"
    assert asked("decode", log, "--dbc", dbc, "--out", out, "--relative").returncode == 0
    assert {path.name for path in out.iterdir()} == {"MIXED.csv", "PLAIN.csv", "_decoded.json"}
    table = pd.read_csv(out / "MIXED.csv")
    assert list(table.columns) == ["time_s", "Page", "Door", "Level", "Odometer"]
    assert table["time_s"].tolist() == pytest.approx([at * 0.01 for at in range(60)], abs=1e-9)
    assert table["Level"].isna().tolist() == [True, False] * 30


def test_mdf_opens_in_asammdf(foreign, tmp_path):
    dbc, log = foreign
    columns = decode_log(log, dbc)
    assert asked("decode", log, "--dbc", dbc, "--out", tmp_path / "a.mf4").returncode == 0
    with asammdf.MDF(tmp_path / "a.mf4") as file:
        assert [group.channel_group.acq_name for group in file.groups] == ["MIXED", "PLAIN"]
        assert file.header.abs_time == 1_700_000_000 * 10**9
        speed, level = file.get("Speed"), file.get("Level")
        assert (speed.unit, level.unit) == ("km/h", "mm")
        assert speed.samples.tolist() == columns["PLAIN"].signals["Speed"].tolist()
        assert (
            level.samples.tolist() == np.ma.compressed(columns["MIXED"].signals["Level"]).tolist()
        )
        assert speed.timestamps[:60] == pytest.approx(np.arange(60) * 0.01, abs=1e-9)
        assert "1 open" in file.get("Door").comment


def test_the_same_as_asammdf_extracts(drive, tmp_path):
    """From bus logging written by the rig: log → MF4 → asammdf's own decoder, and ours."""
    run = tmp_path / "run"
    arguments = ("--set", "duration_s=0.2", "--out", run, "--log", tmp_path / "bus.mf4")
    assert asked("run", "thesis-step", *arguments, "--in-process").returncode == 0
    ours = decode_log(tmp_path / "bus.mf4", shipped_dbc("steer_by_wire.dbc"))
    files = {"CAN": [(shipped_dbc("steer_by_wire.dbc"), 0)]}
    with asammdf.MDF(tmp_path / "bus.mf4") as file, file.extract_bus_logging(files) as extracted:
        for message, signal in [("DSTAR_FEEDBACK", "DStar"), ("FORCE_DIFF_CMD", "ForceDifference")]:
            theirs = extracted.get(signal)
            assert len(theirs.samples) == 200
            assert np.allclose(ours[message].signals[signal], theirs.samples, rtol=1e-15, atol=0)
            assert np.allclose(ours[message].time_s, theirs.timestamps, rtol=0, atol=1e-9)


def test_a_run_writes_its_log_in_other_formats(tmp_path):
    names = ["a.blf", "a.asc", "a.mf4", "a.trc", "a.log.gz"]
    logs = [option for name in (*names, names[0]) for option in ("--log", tmp_path / name)]
    arguments = ("run", "thesis-step", "--set", "duration_s=0.05", "--in-process", *logs)
    assert asked(*arguments, "--out", tmp_path / "run").returncode == 0
    expected = decoded(tmp_path / "run" / LOG)
    for name in names:
        log = decode_log(tmp_path / name, shipped_dbc("steer_by_wire.dbc"))
        sent = {name: (c.frames, c.decoded) for name, c in log.counts.items() if c.frames}
        assert list(sent.values()) == [(50, 50)] * 5  # no speed and no further sensor
        assert log["DSTAR_FEEDBACK"].signals["DStar"].tolist() == list(expected["DSTAR_FEEDBACK"])
    assert "a.blf: exists" in refused(*arguments, "--out", tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_counts_of_a_damaged_run(drive, tmp_path):
    lines = drive.read_text("ascii").splitlines(keepends=True)
    feedback = [at for at, line in enumerate(lines) if " 101#" in line]
    lines[feedback[3]] = (
        lines[feedback[3]][:-4] + ("0" if lines[feedback[3]][-4] != "0" else "1") + " T\n"
    )
    lines[feedback[10]] = ""
    lines[feedback[20]] *= 2
    (tmp_path / "a.log").write_text("".join(lines), "ascii")
    summary = json.loads(asked("decode", tmp_path / "a.log", "--json").stdout)
    assert summary["messages"]["DSTAR_FEEDBACK"] == {
        **dict.fromkeys(summary["messages"]["DSTAR_FEEDBACK"], 0),
        "frames": 300,
        "decoded": 298,
        "wrong_crc": 1,
        "repeated": 1,
        "gaps": 2,
        "lost": 2,
    }
    shown = asked("decode", tmp_path / "a.log").stdout
    assert "wrong crc" in shown
    assert "too short" not in shown


def test_outputs_are_whole_and_never_replaced_unasked(drive, tmp_path):
    out = tmp_path / "a.csv"
    out.write_text("mine")
    assert "exists" in refused("decode", drive, "--out", out)
    assert out.read_text() == "mine"
    bad = tmp_path / "bad.log"
    bad.write_text(drive.read_text("ascii") + "no frame\n", "ascii")
    failed = asked("decode", bad, "--out", out, "--force")
    assert (failed.returncode, out.read_text()) == (2, "mine")
    assert "line 1501: not a frame" in failed.stderr
    assert asked("decode", drive, "--out", out, "--force").returncode == 0
    assert len(pd.read_csv(out)) == 1500
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv", "bad.log"]
    mine = tmp_path / "folder"
    mine.mkdir()
    (mine / "thesis.txt").write_text("mine")
    kept = asked("decode", drive, "--out", mine, "--force")
    assert (kept.returncode, (mine / "thesis.txt").read_text()) == (2, "mine")


def test_a_missing_end_is_said_and_the_rest_decoded(drive, tmp_path):
    (tmp_path / "a.log").write_bytes(drive.read_bytes()[:-9])
    done = succeeded("decode", tmp_path / "a.log")
    assert "note:" in done.stderr
    assert "line 1500: the file ends within this line" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nothing.log"], "nothing.log: there is no such file"),
        (["{log}", "--dbc", "no.dbc"], "no.dbc: cannot be read"),
        (["{log}", "--message", "DSTAR"], "no message DSTAR in the database; it has DSTAR_"),
        (["{log}", "--signal", "dstar"], "no signal dstar in the database; it has DStar"),
        (["{log}", "--message", "dstar"], "no message dstar in the database; it has DSTAR_"),
        (["{log}", "--out", "a.xlsx"],
         "a.xlsx: cannot be written as .xlsx; it must be .csv, .parquet"),
        (["{log}", "--out", "/proc/a.csv"], "/proc/a.csv: cannot be written")],
)  # fmt: skip
def test_bad_input_is_one_line(drive, arguments, reason):
    assert refused("decode", *(argument.format(log=drive) for argument in arguments)).startswith(
        f"error: {reason}"
    )


@pytest.mark.parametrize("name", ["a.blf", "a.csv", "a.log.gz"])
def test_a_node_records_candump_lines_only(name, tmp_path):
    assert f"{name}: must be FILE.log, a node records candump lines" in refused(
        "plant", "thesis-step", "--log", tmp_path / name, "--wait", "0.01"
    )
    assert not (tmp_path / name).exists()


def test_a_node_replaces_no_log_unasked(tmp_path):
    log = tmp_path / "drive.log"
    log.write_text("a drive\n")
    command = ("plant", "thesis-step", "--log", log, "--bus", f"local:{tmp_path / 'b'}")
    assert f"{log}: exists; choose another --log, or --force to replace it" in refused(
        *command, "--wait", "0.01"
    )
    assert log.read_text() == "a drive\n"
    assert asked(*command, "--wait", "0.01", "--force").returncode == 3
    assert log.read_text() == "a drive\n"  # no record could replace the log


def test_an_empty_log_gives_an_empty_table(tmp_path):
    (tmp_path / "a.asc").write_text("date Mon Jan 1 00:00:00 2024\nbase hex timestamps absolute\n")
    outputs = [option for name in ("a.csv", "a.mf4", "b") for option in ("--out", tmp_path / name)]
    assert asked("decode", tmp_path / "a.asc", *outputs).returncode == 0
    assert len(pd.read_csv(tmp_path / "a.csv")) == 0
    assert (tmp_path / "b").is_dir()


@pytest.mark.parametrize("name", ["a.log", "a.log.gz"])
def test_an_empty_file_is_no_log(name, tmp_path):
    """Without a frame no line shows the candump format."""
    (tmp_path / name).write_bytes(gzip.compress(b"") if name.endswith(".gz") else b"")
    assert refused("decode", tmp_path / name, "--out", tmp_path / "a.csv").startswith(
        f"error: {tmp_path / name}: has no frame in it"
    )
    assert not (tmp_path / "a.csv").exists()


def test_a_silent_part_gives_an_empty_table_and_a_part_beyond_the_end_is_refused(tmp_path):
    """The log itself is a log, as its other parts show."""
    (tmp_path / "a.log").write_text("(1.000000) can0 123#00\n(3.500000) can0 123#00\n")
    said = refused("decode", tmp_path / "a.log", "--from", "5", "--out", tmp_path / "a.csv")
    assert said.endswith("a.log: has no frame after --from, the last is at 2.5 s")
    assert not (tmp_path / "a.csv").exists()
    silent = ("decode", tmp_path / "a.log", "--from", "1", "--to", "2")
    done = asked(*silent, "--out", tmp_path / "a.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert len(pd.read_csv(tmp_path / "a.csv")) == 0


def test_unknown_identifiers_are_told_from_their_counts(tmp_path):
    (tmp_path / "a.log").write_text("(1.000000) can0 123#00\n(2.000000) can0 123#01\n")
    done = asked("decode", tmp_path / "a.log")
    assert "frames not in the database: 2 (identifier 0x123: 2)" in done.stdout


@pytest.mark.parametrize("command", ["decode", "stats"])
def test_a_strangers_log_is_not_called_a_damaged_one_of_the_rig(command, tmp_path, drive):
    """Frames of another car, by an identifier that the rig has too."""
    log, dbc = tmp_path / "a.log", tmp_path / "car.dbc"
    log.write_text("(1.000000) can0 100#0011223344556677\n(2.000000) can0 100#1122334455667788\n")
    dbc.write_text('BO_ 256 SPEED: 8 A\n SG_ V : 0|16@1+ (1,0) [0|0] "" A\n')
    said = "note: no frame of DSTAR_REFERENCE is intact, by the rig's own database; --dbc names"
    assert said in asked(command, log).stderr
    assert asked(command, log, "--dbc", dbc).stderr == ""
    assert asked(command, drive).stderr == ""


HOSTILE = ("../../pwned", "..", "/tmp/x", "a b/c", "Speed", "SPEED", "CON", "x" * 300)
"""Names of messages that KCD and SYM hold."""


def kcd(names: tuple[str, ...]) -> str:
    messages = "".join(
        f'<Message id="0x{0x100 + at:x}" name="{name}" length="1">'
        '<Signal name="Value" offset="0" length="8"/></Message>'
        for at, name in enumerate(names)
    )
    return (
        '<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document name="x"/>'
        f'<Bus name="Bus">{messages}</Bus></NetworkDefinition>'
    )


def sym(names: tuple[str, ...]) -> str:
    messages = "".join(
        f'["{name}"]\nID={0x100 + at:X}h\nLen=1\nVar=Value unsigned 0,8\n\n'
        for at, name in enumerate(names)
    )
    return (
        f'FormatVersion=6.0 // Do not edit this line!\nTitle="x"\n\n{{SENDRECEIVE}}\n\n{messages}'
    )


@pytest.mark.parametrize("written", [kcd, sym])
def test_no_name_of_a_message_leads_out_of_the_folder(written, tmp_path):
    dbc, inner = tmp_path / f"a.{written.__name__}", tmp_path / "deep" / "er"
    dbc.write_text(written(HOSTILE), "utf-8")
    lines = (f"({at}.000000) can0 {0x100 + at:X}#{at:02X}\n" for at in range(len(HOSTILE)))
    (tmp_path / "a.log").write_text("".join(lines), "ascii")
    inner.mkdir(parents=True)
    (tmp_path / "pwned.csv").write_text("mine")
    out = inner / "out"
    succeeded("decode", tmp_path / "a.log", "--dbc", dbc, "--out", out)
    assert (tmp_path / "pwned.csv").read_text() == "mine"
    assert {path.name for path in inner.rglob("*") if path.is_file()} == {
        path.name for path in out.iterdir()
    }
    files = json.loads((out / "_decoded.json").read_text())["files"]
    assert sorted(files.values()) == sorted(HOSTILE)
    assert {path.name for path in out.iterdir()} == {*files, "_decoded.json"}
    assert len({file.lower() for file in files}) == len(HOSTILE)
    for file, name in files.items():
        assert pd.read_csv(out / file)["Value"].tolist() == [HOSTILE.index(name)]
    succeeded("decode", tmp_path / "a.log", "--dbc", dbc, "--out", out, "--force",
                "--message", "Speed")  # fmt: skip
    assert {path.name for path in out.iterdir()} == {"Speed.csv", "_decoded.json"}


def test_an_index_names_no_file_outside_its_folder(tmp_path):
    drive = record(tmp_path, "duration_s=0.02")[0]
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "mine.csv").write_text("mine")
    index = {"files": {"../mine.csv": "a", str(tmp_path / "mine.csv"): "b", "..": "c", "": "d"}}
    (out / "_decoded.json").write_text(json.dumps(index))
    assert asked("decode", drive, "--out", out, "--force").returncode == 0
    assert (tmp_path / "mine.csv").read_text() == "mine"
