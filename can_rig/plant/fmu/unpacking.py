"""An FMU unpacked within bounds: it is a ZIP archive, which may claim and hold anything.

What is counted is what comes out, not what the archive's headers claim.
"""

from __future__ import annotations

import zipfile
from pathlib import Path, PurePosixPath
from typing import Final

DESCRIPTION: Final = "modelDescription.xml"
MEBIBYTE: Final = 1 << 20
LARGEST: Final = 512 * MEBIBYTE
"""Of all files together."""
LARGEST_DESCRIPTION: Final = 64 * MEBIBYTE
LARGEST_RATIO: Final = 100
"""Of all files together to the archive, once they are larger than a description may be."""
MOST_FILES: Final = 10_000


class UnpackingError(Exception):
    """An archive beyond the bounds, or with a path that leads out of its folder."""


def unpack(path: Path, folder: Path) -> None:
    """The files of the archive ``path`` below ``folder``, which exists.

    Raises:
        UnpackingError: see there; some files may have been written.
        OSError, zipfile.BadZipFile: as of ``zipfile``.
    """
    bound = min(LARGEST, max(LARGEST_DESCRIPTION, LARGEST_RATIO * path.stat().st_size))
    with zipfile.ZipFile(path) as archive:
        if len(archive.infolist()) > MOST_FILES:
            raise UnpackingError(f"it holds more than {MOST_FILES} files")
        left = bound
        for member in archive.infolist():
            target = folder / _inside(member.filename)
            if member.is_dir():
                target.mkdir(parents=True, exist_ok=True)
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            with archive.open(member) as source, target.open("wb") as file:
                while chunk := source.read(MEBIBYTE):
                    left -= len(chunk)
                    if left < 0:
                        raise UnpackingError(
                            f"it unpacks to more than {bound // MEBIBYTE} MiB; at most "
                            f"{LARGEST_RATIO} times its own size and {LARGEST // MEBIBYTE} MiB "
                            "are unpacked"
                        )
                    file.write(chunk)


def refuse_large_description(path: Path) -> None:
    """Before a parser reads it.

    Raises:
        UnpackingError: it is larger than ``LARGEST_DESCRIPTION``.
        KeyError: there is none.
        OSError, zipfile.BadZipFile: as of ``zipfile``.
    """
    read = 0
    with zipfile.ZipFile(path) as archive, archive.open(DESCRIPTION) as source:
        while chunk := source.read(MEBIBYTE):
            read += len(chunk)
            if read > LARGEST_DESCRIPTION:
                raise UnpackingError(
                    f"{DESCRIPTION} is larger than {LARGEST_DESCRIPTION // MEBIBYTE} MiB"
                )


def _inside(name: str) -> PurePosixPath:
    """A path of the archive that stays in the folder it is unpacked to."""
    path = PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name:
        raise UnpackingError(f"it holds the path {name!r}, which must stay in the FMU's folder")
    return path
