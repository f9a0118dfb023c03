"""Of a damaged log only our own line is printed, and nothing that a library has to say about it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers import rig

TRC = """\
;$FILEVERSION=1.1
;$STARTTIME=43474.7110516666
;
     1)      1059.9  Rx         0300  7  00 00
"""
ASC = """\
date Fri Jul 10 06:17:32 2015
base hex  timestamps absolute
   0.000000 1  44              Rx   d 5 2A
"""


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("short.trc", TRC, 4),
        ("short.asc", ASC, 3),
        ("hex.trc", TRC.replace("7  00 00", "1  0G"), 4),
    ],
)
def test_one_line_for_a_bad_line(tmp_path: Path, name: str, content: str, line: int) -> None:
    path = tmp_path / name
    path.write_text(content, "ascii")
    done = rig("decode", path)  # a process: pytest itself keeps log records off standard error
    assert done.returncode == 2
    assert done.stdout == ""
    (said,) = done.stderr.splitlines()
    assert said.startswith(f"error: {path}: line {line}: ")


def test_one_line_for_a_cut_off_mdf_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    path.write_bytes(b"MDF     4.10    " + bytes(1000))
    done = rig("decode", path)
    assert done.returncode == 2
    (said,) = done.stderr.splitlines()
    assert said.startswith(f"error: {path}: an MDF 4 file that is cut off or damaged")
