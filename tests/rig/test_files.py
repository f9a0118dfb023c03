"""Outputs that are there whole or not at all, and one line where they cannot be."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from can_rig.errors import LogError
from can_rig.files import atomic


def test_a_read_only_file_system_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_an_error_while_writing_leaves_what_was_there(tmp_path: Path) -> None:
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


def test_a_folder_is_never_replaced_by_a_file(tmp_path: Path) -> None:
    out = tmp_path / "a.csv"
    out.mkdir()
    (out / "mine").write_text("kept")
    with pytest.raises(LogError, match="cannot be written: Is a directory"), atomic(out, force=True) as part:
        part.write_text("new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]
    assert (out / "mine").read_text() == "kept"


def test_nor_by_a_folder(tmp_path: Path) -> None:
    out = tmp_path / "folder"
    out.mkdir()
    (out / "mine").write_text("kept")
    with pytest.raises(LogError, match="Directory not empty"), atomic(out, force=True) as part:
        part.mkdir()
    assert (out / "mine").read_text() == "kept"
