"""Folders of results: the old one stands until the new one is whole, and foreign files stay.

A folder that replaces another of its kind is made elsewhere, and then its files are moved into the
other one by one: the folder itself and everything in it that is not of its kind are not touched. A
process that is killed while it moves files leaves them in a hidden folder, and the next command
puts them in their places.
"""

from __future__ import annotations

import errno
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from can_rig.errors import RunFolderError, one_line
from can_rig.files import WHOLE, locked, move_up, part_folder, safe_name, tidy


@dataclass(frozen=True)
class Kind:
    """What stands in a folder of results.

    Attributes:
        name: as in "not a run folder".
        marker: the file by which such a folder is recognised, plain or gzipped.
        own: the paths in a folder that are of this kind, those in a folder before itself; all
            others are foreign.
        recorded: whether anything would be lost with the folder.
    """

    name: str
    marker: str
    own: Callable[[Path], Iterable[str]]
    recorded: Callable[[Path], bool]

    def is_in(self, folder: Path) -> bool:
        """Whether ``folder`` holds the marker."""
        return any((folder / name).is_file() for name in (self.marker, f"{self.marker}.gz"))


@contextmanager
def whole_folder(path: Path, kind: Kind, *, force: bool) -> Iterator[Path]:
    """Where to write the files of a folder, which are in place once this is left without an error.

    Args:
        path: the folder.
        kind: what stands in it.
        force: replace a folder of that kind; foreign files in it stay.

    Raises:
        RunFolderError: it is not to be replaced, or cannot be written.
    """
    target = followed(path)
    try:
        with part_folder(target.parent) as place:
            made = place / target.name
            made.mkdir()
            yield made
            if not os.path.lexists(target):
                made.rename(target)
                return
            locks = [locked(target, wait=True), locked(made)]
            try:
                refuse_folder(path, kind, force)
                put_into(made, target, kind)
            finally:
                for lock in locks:
                    if lock is not None:
                        os.close(lock)
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise RunFolderError(f"{path}: cannot be written: {reason}") from None


def refuse_folder(path: Path, kind: Kind, force: bool) -> None:
    """Refuse a folder that holds something, unless that is of ``kind`` and may be replaced.

    Raises:
        RunFolderError: the reason.
    """
    target = followed(path)
    if not target.parent.is_dir():
        raise RunFolderError(f"{path}: there is no folder {target.parent}; --out makes none")
    if not os.path.lexists(target):
        return
    try:
        tidy(target)
        if names(target):
            refuse_to_replace(path, kind, force)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_to_replace(path: Path, kind: Kind, force: bool) -> None:
    """Refuse to replace a folder unasked, or one of another kind.

    Raises:
        RunFolderError: the reason.
    """
    if not force:
        raise RunFolderError(
            f"{path}: there already, and nothing is overwritten; "
            "choose another --out, or --force to replace it"
        )
    if not kind.is_in(path):
        raise RunFolderError(f"{path}: not {kind.name}, so --force does not replace it")


def default_folder(parent: str, name: str) -> Path:
    """``PARENT/NAME-DATE-TIME``, with a number where that is there already."""
    first = Path(parent) / f"{safe_name(name)}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, number = first, 1
    while os.path.lexists(folder):
        number += 1
        folder = first.with_name(f"{first.name}-{number}")
    return folder


def followed(path: Path) -> Path:
    """The folder that ``path`` means, with a name of its own.

    Raises:
        RunFolderError: it is a link to nothing.
    """
    if path.is_symlink() and not path.exists():
        raise RunFolderError(f"{path}: is a link to nothing; must be a folder, or not there")
    return path.resolve() if path.is_symlink() or path.name in {"", ".."} else path


def put_into(made: Path, target: Path, kind: Kind) -> None:
    """Move the files of ``made`` into ``target``, in place of those of its kind.

    Raises:
        OSError: they cannot be moved, or a foreign file is in the way; nothing has changed.
    """
    tidy(made)
    new, old = names(made), [*kind.own(target)]
    own = {*kind.own(made), *old}
    for name in sorted(new):
        there = target / name
        if os.path.lexists(there) and (name not in own or _is_folder(there)):
            raise FileExistsError(errno.EEXIST, f"{name} in it is not of {kind.name}")
    whole = target / f"{WHOLE}{secrets.token_hex(8)}"
    made.rename(whole)  # from here on the next command finishes, where this one is killed
    remove(target, [name for name in old if name not in new])
    move_up(whole)


def remove(folder: Path, names: Iterable[str]) -> None:
    """Take away these files of a folder, links themselves, and folders that are then empty."""
    for name in names:
        path = folder / name
        if _is_folder(path):
            with suppress(OSError):  # foreign files are in it
                path.rmdir()
        else:
            path.unlink(missing_ok=True)


def _is_folder(path: Path) -> bool:
    return path.is_dir() and not path.is_symlink()


def names(folder: Path) -> set[str]:
    """Of everything in a folder."""
    return {path.name for path in folder.iterdir()}
