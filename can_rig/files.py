"""Output files that exist whole or not at all, and replace nothing unasked."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from can_rig.errors import LogError, one_line

PICTURES = {".png", ".svg", ".pdf"}
"""Suffixes of pictures; matplotlib knows the format by it."""


def refuse_existing(path: Path, force: bool, option: str, *, new_folder: bool = False) -> None:
    """Refuse an output that exists, unless it may be replaced; or whose folder does not.

    Args:
        path: the output.
        force: replace it.
        option: the one that named it.
        new_folder: the option named the folder of the output, which is made where it is missing.

    Raises:
        LogError: the reason.
    """
    if path.exists() and not force:
        raise LogError(f"{path}: exists; choose another {option}, or --force to replace it")
    folder = path.parent.parent if new_folder else path.parent
    if not folder.is_dir():
        raise LogError(f"{path}: there is no folder {folder}; {option} makes none")


def refuse_picture(path: Path, force: bool) -> None:
    """Refuse a picture of --out that cannot be one, or exists.

    Raises:
        LogError: the reason.
    """
    if path.suffix.lower() not in PICTURES:
        raise LogError(f"{path}: a picture must be FILE.png, FILE.svg or FILE.pdf")
    refuse_existing(path, force, "--out")


@contextmanager
def atomic(path: Path) -> Iterator[Path]:
    """Where to write what becomes ``path`` once the context is left without an error.

    A file replaces one that is there; a folder that holds something is never replaced.

    Raises:
        LogError: the operating system does not let it be written.
    """
    part = path.with_name(f".part-{path.name}")
    try:
        path.parent.mkdir(exist_ok=True)
        yield part
        part.replace(path)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise LogError(f"{path}: cannot be written: {reason}") from None
    finally:
        with suppress(OSError):  # a read-only file system refuses this too; the reason is known
            _remove(part)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
