"""``tools/vcan_guest``: a command runs in the guest as outside, beside vcan0."""

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

GUEST = Path(__file__).parents[2] / "tools" / "vcan_guest"


def test_environment_folder_output_and_exit_status_are_those_of_a_plain_call(guest, tmp_path):
    folder = tmp_path / "a b'c"
    folder.mkdir()
    script = """
        echo "$PWD|$MINE|$1|$(ls /sys/class/net | xargs)"; echo to stderr >&2; echo kept > file
        candump -n 1 -T 5000 vcan1 & sleep 0.1; cansend vcan1 123#11; wait; cangw -L; exit 7
    """
    awkward = "x\n$HOME \"'\\é"
    process = guest("bash", "-c", script, "name", awkward, cwd=folder, env={"MINE": awkward})
    out, err = process.communicate(timeout=60)
    assert process.returncode == 7
    head, _, tail = out.partition("|lo ")
    assert head == f"{folder}|{awkward}|{awkward}"
    names, *lines = tail.splitlines()
    assert {"vcan0", "vcan1"} <= set(names.split())
    assert lines[0].split() == ["vcan1", "123", "[1]", "11"]
    assert err.splitlines()[0] == "to stderr"
    assert (folder / "file").read_text() == "kept\n"


def test_all_output_arrives(guest):
    out, _ = guest("seq", 200_000).communicate(timeout=60)
    assert out == "".join(f"{number}\n" for number in range(1, 200_001))


def test_a_time_limit(guest):
    process = guest("--timeout", 4, "sleep", 100)
    assert process.communicate(timeout=60) == ("", "error: stopped after 4 s\n")
    assert process.returncode == 124


def test_ctrl_c_reaches_the_command_and_its_status_counts(guest):
    process = guest("bash", "-c", "trap 'echo stopped; exit 9' INT; echo go; sleep 50 & wait")
    assert process.stdout.readline() == "go\n"
    os.kill(process.pid, signal.SIGINT)
    assert process.communicate(timeout=60)[0] == "stopped\n"
    assert process.returncode == 9


def test_the_second_ctrl_c_ends_a_command_that_does_not_listen(guest):
    process = guest("bash", "-c", "trap '' INT; echo go; sleep 50")
    assert process.stdout.readline() == "go\n"
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.5)
    process.communicate(timeout=60)
    assert process.returncode == 130


@pytest.mark.parametrize(
    ("arguments", "options", "expected"),
    [
        ((), {}, "usage: tools/vcan_guest"),
        (("--foo", "true"), {}, "error: unknown option --foo; the only one is --timeout SECONDS"),
        (("true",), {"cwd": "/proc"}, "error: the guest has a /dev, /proc, /run and /sys of its"),
    ],
    ids=["nothing", "option", "folder"],
)
def test_what_cannot_start_says_so_in_its_first_line(arguments, options, expected, guest):
    process = guest(*arguments, **options)
    _, err = process.communicate(timeout=60)
    assert err.startswith(expected)
    assert process.returncode == 125


def test_a_missing_package_comes_with_its_recipe(tmp_path):
    for name in ("bash", "env"):
        (tmp_path / name).symlink_to(shutil.which(name))
    script = tmp_path / "vcan_guest"  # as on a machine without /sbin
    script.write_text(GUEST.read_text().replace("PATH=$PATH:/usr/sbin:/sbin\n", ""))
    done = subprocess.run(
        [shutil.which("bash"), script, "true"], env={"PATH": str(tmp_path)}, check=False,
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 125
    assert done.stderr == (
        "error: no linux.uml here: apt-get install user-mode-linux kmod iproute2 can-utils\n"
    )
