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
    ("name", "content", "said"),
    [
        ("short.trc", TRC, "line 4: "),
        ("short.asc", ASC, "line 3: "),
        ("a.mf4", "MDF     4.10    " + "\0" * 1000, "an MDF 4 file that is cut off or damaged"),
        ("old.mf4", "MDF     3.30" + "\0" * 88, "not an MDF 4 file"),
    ],
)
def test_one_line_for_a_damaged_log(tmp_path: Path, name: str, content: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(content, "ascii")
    done = rig("decode", path)  # a process: pytest itself keeps log records off standard error
    assert done.returncode == 2
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: {path}: {said}")
