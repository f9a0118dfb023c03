"""Outputs appear whole or not at all; a failure is a line."""

import errno
import os
import re
import secrets
import stat
import subprocess
import sys
import unicodedata
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest
from hypothesis import example, given, strategies as st

from can_rig.errors import LogError
from can_rig.storage.files import FileNames, atomic
from tests.helpers import asked, refused

CAR = str(Path(__file__).parents[3] / "docs" / "car" / "car.toml")


def test_a_read_only_file_system_is_one_line(tmp_path, monkeypatch):
    def refused(path: Path, *_: Any, **__: Any) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))

    for name in ("mkdir", "open", "unlink", "replace"):
        monkeypatch.setattr(Path, name, refused)
    out = tmp_path / "a.csv"
    with (
        pytest.raises(LogError, match=rf"^{out}: cannot be written: Read-only file system$"),
        atomic(out, force=True) as part,
        part.open("w") as file,
    ):
        file.write("never")


def test_an_error_while_writing_leaves_what_was_there(tmp_path):
    out = tmp_path / "a.csv"
    out.write_text("before")
    with (
        pytest.raises(LogError, match="cannot be written: No space left on device"),
        atomic(out, force=True) as part,
    ):
        part.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert out.read_text() == "before"


def test_a_folder_is_never_replaced_by_a_file(tmp_path):
    out = tmp_path / "a.csv"
    out.mkdir()
    (out / "mine").write_text("kept")
    with (
        pytest.raises(LogError, match="cannot be written: Is a directory"),
        atomic(out, force=True) as part,
    ):
        part.write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert (out / "mine").read_text() == "kept"


@pytest.mark.parametrize(
    "words",
    [
        ["convert", "a.csv", "{}/a.csv"],
        ["decode", "a.csv", "--out", "{}/../{}/a.csv"],
        ["replay", "a.csv", "--scenario", "default", "--gaps", "a.csv"],
        ["replay", "a.csv", "--scenario", CAR, "--out", "a.csv"],
        ["view", "a.csv", "--out", "a.csv"],
    ],
    ids=["convert", "decode", "gaps", "drive", "view"],
)
def test_force_never_replaces_the_log_that_is_read(words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = tmp_path / "a.csv"
    log.write_text(
        "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
        "1000000,00000100,false,Rx,0,1,01,\n2000000,00000100,false,Rx,0,1,02,\n"
    )
    before = log.read_bytes()
    there = [word.format(tmp_path, tmp_path.name) for word in words]
    done = asked(*there, "--force")
    assert done.returncode == 2
    assert "a.csv: is the log that is read" in done.stderr or "must be FILE.html" in done.stderr
    assert log.read_bytes() == before


@pytest.mark.parametrize("force", [False, True])
def test_links_in_the_way_are_never_followed(force, tmp_path, monkeypatch):
    """Neither those in place of the output, nor those under any name of a part of it."""
    victim, out = tmp_path / "victim", tmp_path / "b.log"
    victim.write_text("mine")
    (tmp_path / "a.log").write_text("(0.000000) can0 100#00\n")
    (tmp_path / ".part-b.log").symlink_to(victim)
    words = ["convert", tmp_path / "a.log", out, *(["--force"] if force else [])]
    assert asked(*words).returncode == 0
    out.unlink()
    for target in (victim, tmp_path / "nothing"):
        out.symlink_to(target)
        assert asked(*words).returncode == (0 if force else 2)
        assert out.is_symlink() != force
        out.unlink()
    tokens = iter(["taken", "free"])
    monkeypatch.setattr(secrets, "token_hex", lambda _: next(tokens))
    (tmp_path / ".can-rig-part-taken").symlink_to(tmp_path)
    assert asked(*words).returncode == 0
    assert victim.read_text() == "mine"
    assert not (tmp_path / "nothing").exists()


def test_a_part_lies_in_a_private_folder_whose_name_nobody_foresees(tmp_path):
    """So two commands write the same output at once, and either is whole."""
    out = tmp_path / "a.csv"
    with atomic(out, force=True) as one, atomic(out, force=True) as other:
        assert one.parent != other.parent
        assert one.name == other.name == "a.csv"  # some formats store the name
        assert stat.S_IMODE(one.parent.stat().st_mode) == 0o700
        one.write_text("one")
        other.write_text("other")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "one"}


def test_a_file_that_appears_meanwhile_stays(tmp_path):
    out = tmp_path / "a.csv"
    with pytest.raises(LogError, match="exists"), atomic(out, force=False) as part:
        part.write_text("late")
        out.write_text("mine")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "mine"}


def test_a_file_system_without_hard_links(tmp_path, monkeypatch):
    def refused(*_: Any) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    monkeypatch.setattr(Path, "hardlink_to", refused)
    for text in ("first", "second"):
        with (
            nullcontext() if text == "first" else pytest.raises(LogError, match="exists"),
            atomic(tmp_path / "a.csv", force=False) as part,
        ):
            part.write_text(text)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"a.csv": "first"}


def test_a_pipe_or_a_device_is_no_file_to_replace(tmp_path):
    (tmp_path / "a.log").write_text("(0.000000) can0 100#00\n")
    os.mkfifo(tmp_path / "b.log")
    before = (tmp_path / "b.log").stat().st_ino
    assert "OUT must name a file" in refused(
        "convert", tmp_path / "a.log", tmp_path / "b.log", "--force"
    )
    assert (tmp_path / "b.log").stat().st_ino == before


def test_what_a_killed_process_leaves_is_gone_with_the_next_output(tmp_path):
    """Parts of a live process stay, and so do foreign files of such a name."""
    program = (
        "from pathlib import Path; from can_rig.storage.files import atomic\n"
        "with atomic(Path('a.csv'), force=True) as part:\n"
        "    part.write_text('half'); print(flush=True); input()\n"
    )
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "mine").write_text("mine")
    (tmp_path / ".can-rig-part-0123456789abcdef").symlink_to(tmp_path / "kept")
    (tmp_path / ".can-rig-part-of-mine").mkdir()
    with subprocess.Popen(
        [sys.executable, "-c", program], cwd=tmp_path, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    ) as writer:  # fmt: skip
        assert writer.stdout is not None
        writer.stdout.readline()
        held = list(tmp_path.glob(".can-rig-part-*/a.csv"))
        with atomic(tmp_path / "b.csv", force=False) as part:
            part.write_text("b")
        assert held[0].read_text() == "half"
        writer.kill()
    with atomic(tmp_path / "c.csv", force=False) as part:
        part.write_text("c")
    assert {path.name for path in tmp_path.iterdir()} == {
        "b.csv", "c.csv", "kept", ".can-rig-part-0123456789abcdef", ".can-rig-part-of-mine",
    }  # fmt: skip
    assert (tmp_path / "kept" / "mine").read_text() == "mine"


@given(st.lists(st.text(), unique=True, max_size=8))
@example(["../../pwned", "..", ".", "", "/etc/passwd", "a\0b", "CON", "con.csv", "nul", "\ud800"])
@example(["Speed", "SPEED", "speed~6129de1e", "x" * 300, "x" * 301, "x" * 299 + "\u00e4" * 9])
@example(["ﬁ", "fi", "FI", "ä", "a\u0308", "trail.", "trail ", ".hidden", "a%2Fb", "a/b"])
def test_every_name_becomes_a_file_name_of_its_own(names):
    files = FileNames()
    found = [files.of(name, ".csv") for name in names]
    alike = {unicodedata.normalize("NFKC", file.casefold()).casefold() for file in found}
    assert len(alike) == len(names)
    for file in found:
        assert len(os.fsencode(file)) <= 143
        assert not re.search(r'[/\\\0<>:"|?*\x01-\x1f]', file)
        assert not file.startswith((".", " "))
        assert not re.fullmatch(r"(con|nul|prn|aux|com\d|lpt\d)(\..*)?", file, re.IGNORECASE)


def test_usual_names_stay_as_they_are():
    files = FileNames()
    for name in ("EngineData_1", "VEHICLE-SPEED", "Motor Status (2)", "Lenkwinkelübertragung"):
        assert files.of(name) == name
