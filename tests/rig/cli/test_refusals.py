"""Options that name missing things: a line, exit status 2, no output file."""

import os
import re

import pytest

from tests.helpers import asked, refused

FRAMES = "(0.000000) can0 101#0011223344556677\n(0.001000) vcan1 100#0011223344556677\n"


@pytest.fixture(autouse=True)
def log(tmp_path):
    """A log of two buses, in the working directory."""
    path = tmp_path / "a.log"
    path.write_text(FRAMES)
    return path


@pytest.mark.parametrize(
    "words",
    [
        ("run", "thesis-step", "--in-process", "--log", "no/such/x.blf"),
        ("decode", "a.log", "--out", "no/such/x.csv"),
        ("decode", "a.log", "--out", "no/such/folder"),
        ("replay", "a.log", "--scenario", "default", "--gaps", "no/such/x.csv"),
        ("plot", "a.log", "DStar", "--out", "no/such/x.png"),
        ("tune", "--out", "no/such/x"),
        ("figures", "--out", "no/such/x"),
        ("export", "nothing", "--out", "no/such/x"),
    ],
)  # fmt: skip
def test_the_folder_of_an_output_must_exist(words, tmp_path):
    line = refused(*words)
    assert line.startswith(f"error: {words[-1]}")
    assert ": there is no folder no/such; --" in line
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


def test_a_picture_in_place_of_a_folder_is_refused(tmp_path):
    for command, file in (("tune", "tuning.png"), ("figures", "fig-2.2.png")):
        said = f"error: x.png: --out must name a folder, for {file}"
        assert refused(command, "--out", "x.png") == said
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("decode", "a.log", "--out", "/dev/full"), "/dev/full: is a file; must be a folder"),
        (("decode", "a.log", "--out", "a.log/x.csv"), "a.log/x.csv: a.log is a file; --out makes"),
        (("export", "--out", "/dev/full"), "/dev/full: is a file; must be a folder"),
        (("run", "thesis-step", "--out", "a.log/x/y"), "a.log: is a file; must be a folder"),
    ],
    ids=range(4),
)
def test_a_file_in_place_of_a_folder_is_named(words, said, tmp_path):
    assert refused(*words).startswith(f"error: {said}")
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


def test_a_name_with_a_line_break_and_an_escape_is_refused_on_one_line():
    assert refused("check", "a\nb\x1b[31m.toml").startswith(
        "error: scenario a\\nb\\x1b[31m.toml: no such scenario"
    )


def test_a_name_that_is_not_utf_8_is_named_and_not_the_page_or_table_with_the_name(tmp_path):
    for words in (("view", "--out", "x.html"), ("convert", "ÿ.trc")):
        command, *rest = (os.fsdecode(word.encode("latin-1")) for word in words)
        path = os.fsdecode(b"a \xff.log")
        (tmp_path / path).write_text(FRAMES.replace("vcan1", "can0"))
        line = refused(command, path, *rest)
        assert re.fullmatch(r"error: [^<;]{,300}\\udcff\.\w{3}: must be a name in UTF-8", line)


def test_a_new_folder_of_decoded_messages_is_made(tmp_path):
    assert asked("decode", "a.log", "--out", "new").returncode == 0
    assert (tmp_path / "new").is_dir()


@pytest.mark.parametrize(
    "words",
    [("run", "--bus", ""), ("run", "--in-process", "--bus", " "), ("plant", "--bus", ""),
     ("controller", "--bus", ""), ("replay", "a.log", "--bus", "")],
)  # fmt: skip
def test_a_bus_has_a_name(words, tmp_path):
    assert "must name a bus, such as local or socketcan:vcan0" in refused(*words)
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]


@pytest.mark.parametrize("out", [(), ("--out", "x.csv"), ("--out", "x")])
def test_a_bus_that_is_not_in_the_log_is_refused(out, tmp_path):
    done = asked("decode", "a.log", "--channel", "can7", *out)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "error: a.log: no frame on bus can7; the log has can0, vcan1\n"
    assert [path.name for path in tmp_path.iterdir()] == ["a.log"]
    assert asked("decode", "a.log", "--channel", "can0").returncode == 0


def test_a_fault_after_the_end_is_mentioned_in_one_line():
    late = ("--set", "duration_s=0.05", "--set", "fault.at_s=0.05")
    line = "note: the fault (actuator-dead at 0.05 s) never occurs: the run ends at 0.05 s"
    for words in (("run", "--in-process", "thesis-step"), ("check", "thesis-step")):
        assert asked(*words, *late).stdout.splitlines().count(line) == 1
    in_time = ("--set", "duration_s=0.05", "--set", "fault.at_s=0.049")
    assert "never occurs" not in asked("run", "--in-process", "thesis-step", *in_time).stdout
    no_fault = (*late, "--set", "fault.kind=none")
    assert "never occurs" not in asked("run", "--in-process", "thesis-step", *no_fault).stdout


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--verbos",), "error: No such option '--verbos'."),
        (("chek",), "error: No such command 'chek'"),
        (("bus", "--bitrate", "0"), "error: Invalid value for '--bitrate': 0 is not in the range"),
        (("export", "--out", "x", "--runs", "3"), "error: --runs: must come with --evidence and"),
        (("export", "default"), "error: Missing option '--out'. (see "),
        (("inject", "torque", "gone"), "error: torque gone: must be one of dead, stuck, "),
        (("inject", "sensor"), "error: sensor: must be one of biased, dead, "),
        (("inject", "yaw-rate", "swapped"), "error: --with: must name the other sensor of a swap"),
        (("inject", "yaw-rate", "lying"), "error: yaw-rate lying: must be one of biased, dead, "),
        (("inject", "yaw-rate", "biased"), "error: sensor-biased: its value is offset; "),
        (("inject", "pause", "3"), "error: pause 3: nothing must follow"),
        (("inject", "reference", "nan"), "error: value nan: must be -8388.607 to 8388.607"),
        (("inject", "pace", "-1"), "error: pace -1: must be above 0, or 0 for as fast"),
        (("inject", "reference", "-0.3", "--bus", "local:x"), "error: bus local:x: silent; no "),
    ],
)  # fmt: skip
def test_a_wrong_option_is_one_line(words, line):
    assert refused(*words).startswith(line)
