"""A folder of decoded messages, whose files have the names of messages that anybody has chosen."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from tests.helpers import asked, record

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
def test_no_name_of_a_message_leads_out_of_the_folder(
    written: Callable[[tuple[str, ...]], str], tmp_path: Path
) -> None:
    dbc, inner = tmp_path / f"a.{written.__name__}", tmp_path / "deep" / "er"
    dbc.write_text(written(HOSTILE), "utf-8")
    lines = (f"({at}.000000) can0 {0x100 + at:X}#{at:02X}\n" for at in range(len(HOSTILE)))
    (tmp_path / "a.log").write_text("".join(lines), "ascii")
    inner.mkdir(parents=True)
    (tmp_path / "pwned.csv").write_text("mine")
    out = inner / "out"
    done = asked("decode", tmp_path / "a.log", "--dbc", dbc, "--out", out)
    assert done.returncode == 0, done.stderr
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
    again = asked("decode", tmp_path / "a.log", "--dbc", dbc, "--out", out, "--force",
                "--message", "Speed")  # fmt: skip
    assert again.returncode == 0, again.stderr
    assert {path.name for path in out.iterdir()} == {"Speed.csv", "_decoded.json"}


def test_an_index_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    drive = record(tmp_path, "duration_s=0.02")[0]
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "mine.csv").write_text("mine")
    index = {"files": {"../mine.csv": "a", str(tmp_path / "mine.csv"): "b", "..": "c", "": "d"}}
    (out / "_decoded.json").write_text(json.dumps(index))
    assert asked("decode", drive, "--out", out, "--force").returncode == 0
    assert (tmp_path / "mine.csv").read_text() == "mine"
