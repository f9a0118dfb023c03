"""What every command does with few letters, a full disk, few open files and an odd Ctrl-C."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

LOG = Path(__file__).parents[2] / "drives" / "ideal.log.gz"
SHORT = ("thesis-step", "--set", "duration_s=0.01", "--allow-unstable")


def rig(*words: object, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "can_rig", *map(str, words)]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.run(command, check=False, text=True, timeout=300, **options)


@pytest.mark.parametrize("words", [("check", "thesis-step"), ("check", "--json")], ids=" ".join)
def test_a_terminal_without_some_letters_shows_the_others(words):
    plain = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    done = rig(*words, env=os.environ | plain)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.isascii()


def test_a_value_that_such_a_terminal_does_not_know_is_refused():
    plain = {"PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "LC_ALL": "C"}
    done = rig("check", "--set", "design.tau_s=ü", env=os.environ | plain)
    assert done.returncode == 2
    assert done.stderr.startswith("error: --set 'design.tau_s=")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words", [("--version",), ("scenarios",), ("check", "thesis-step", "--json")], ids=" ".join
)
def test_a_full_disk_at_standard_output_is_one_line(words):
    with Path("/dev/full").open("w") as full:
        done = rig(*words, stdout=full)
    assert done.returncode == 2
    assert done.stderr == ("error: standard output cannot be written: No space left on device\n")


def test_names_of_any_bytes_are_taken_or_refused_in_a_line(tmp_path):
    (tmp_path / "s3:d").mkdir()
    assert rig("decode", LOG, "--out", "s3:d/x.parquet", cwd=tmp_path).returncode == 0
    other = tmp_path / os.fsdecode(b"d\xf6.toml")
    other.write_text("")
    for words in (("decode", LOG, "--out", other.with_suffix("")), ("check", other)):
        done = rig(*words, cwd=tmp_path)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "UTF-8" in done.stderr


@pytest.mark.parametrize(
    ("files", "words"), [(6, ("run", *SHORT)), (12, ("campaign", "losses", "--runs", "2"))]
)
def test_too_few_open_files_are_one_line_and_no_traceback(files, words, tmp_path):
    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

    done = rig(*words, "--out", tmp_path / "out", preexec_fn=limited, cwd=tmp_path)
    assert "Traceback" not in done.stderr
    assert "[Errno" not in done.stderr
    assert done.returncode in {0, 2, 3}
    if done.returncode:
        assert done.stderr.splitlines()[-1].startswith("error: ")
        assert words[0] == "campaign" or not (tmp_path / "out").exists()


def test_json_is_alone_on_standard_output(tmp_path):
    (tmp_path / "talks.py").write_text(
        "import os\n\ndef step(inputs):\n    print('by Python')\n"
        "    os.write(1, b'by C\\n')\n    return inputs.reference, 0.0\n"
    )
    kind = ("--set", "controller.kind=talks:step", "--allow-unstable", "--set", "fault.kind=none")
    done = rig("run", "--set", "duration_s=0.01", *kind, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["ticks"] == 10
    assert "by Python" in done.stderr and "by C" in done.stderr


SWALLOWED = """
import signal, time
from can_rig.cli.startup import end_at_once, raise_again

class Interrupted:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

signal.signal(signal.SIGINT, signal.default_int_handler)
end_at_once()
raise_again()
interrupted = Interrupted()
try:
    del interrupted
    time.sleep(600)
except KeyboardInterrupt:
    print("stopped")
"""


FAILS_BY_CTRL_C = (
    SWALLOWED.partition("try:")[0]
    + """
import click
from can_rig.cli.main import Commands

class One(Commands):
    def get_command(self, ctx, name):
        return click.Command(name, callback=fail)

def fail():
    global interrupted
    del interrupted
    raise RuntimeError("no compiled object yet")

One().main(["check"])
"""
)


def test_what_fails_by_a_ctrl_c_in_a_callback_is_no_traceback():
    """Numba raises another error where Python drops the Ctrl-C in a callback of LLVM."""
    command = [sys.executable, "-c", FAILS_BY_CTRL_C]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")
    usual = FAILS_BY_CTRL_C.replace("interrupted = Interrupted()", "interrupted = None")
    done = subprocess.run([*command[:2], usual], check=False, capture_output=True, timeout=60)
    assert done.returncode == 1 and b"no compiled object yet" in done.stderr


def test_ctrl_c_in_a_destructor_is_neither_lost_nor_a_traceback():
    """Python would print the exception, and go on."""
    command = [sys.executable, "-c", SWALLOWED]
    done = subprocess.run(command, check=False, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "stopped\n", "")


@pytest.mark.parametrize("words", [("check", "thesis-step"), ("check", "--json")], ids=" ".join)
def test_a_reader_that_has_ended_is_no_answer(words):
    """Exit status 1 of ``check | head -1`` says that the loop is not stable."""
    read, written = os.pipe()
    os.close(read)
    done = rig(*words, stdout=written)
    os.close(written)
    assert (done.returncode, done.stderr) == (141, "")


def test_a_log_comes_from_standard_input(tmp_path):
    """As ``candump -L can0 | can-rig decode -`` has it: a pipe, whose name has no suffix."""
    text = "(1.0) can0 001#07\n(1.1) can0 001#\n"
    dbc = tmp_path / "a.dbc"
    dbc.write_text('BO_ 1 A: 1 X\n SG_ V : 0|8@1+ (1,0) [0|0] "" X\n')
    done = rig("decode", "-", "--dbc", dbc, "--out", tmp_path / "a.csv", input=text)
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "a.csv").read_text() == '"time_s","message","A.V"\n1,"A",7\n'


@pytest.mark.parametrize(
    "words", [("decode", LOG), ("run", *SHORT), ("figures",)], ids=lambda words: words[0]
)
def test_no_folder_is_named_as_standard_output(words, tmp_path):
    done = rig(*words, "--out", "-", cwd=tmp_path)
    assert (done.returncode, done.stdout, [*tmp_path.iterdir()]) == (2, "", [])
    assert done.stderr.startswith("error: -: ") and "must" in done.stderr
