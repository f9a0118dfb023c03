"""Folders of results: the old folder stands until the new folder is complete; foreign files stay.

A replacement is made elsewhere; then its files move into the old folder one by one. The old folder
itself and all foreign files in the folder remain untouched. A process killed while moving files
leaves the rest in a hidden folder; the next command puts the rest in place.
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
    """The contents of a kind of result folder.

    Attributes:
        name: as in "not a run folder".
        marker: the file that identifies such a folder, plain or gzipped.
        own: the paths of this kind in a folder, contents before their folder; all other paths are
            foreign.
        recorded: whether the folder holds results that must survive.
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
    """A path for writing a folder's files; after leaving without an error, the files are in place.

    Args:
        path: the folder.
        kind: what stands in it.
        force: replace a folder of that kind; foreign files in it stay.

    Raises:
        RunFolderError: a folder that must not be replaced, or a failure to write.
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
    """Refuse a non-empty folder, unless the folder is of ``kind`` and replaceable.

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
    """Refuse replacing without ``force``, and replacing another kind of folder.

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
    """``PARENT/NAME-DATE-TIME``, followed by a number if the folder exists."""
    first = Path(parent) / f"{safe_name(name)}-{time.strftime('%Y%m%d-%H%M%S')}"
    folder, number = first, 1
    while os.path.lexists(folder):
        number += 1
        folder = first.with_name(f"{first.name}-{number}")
    return folder


def followed(path: Path) -> Path:
    """The folder behind ``path``, with links resolved and a real name.

    Raises:
        RunFolderError: it is a link to nothing.
    """
    if path.is_symlink() and not path.exists():
        raise RunFolderError(f"{path}: is a link to nothing; must be a folder, or not there")
    return path.resolve() if path.is_symlink() or path.name in {"", ".."} else path


def put_into(made: Path, target: Path, kind: Kind) -> None:
    """Move the files of ``made`` into ``target``, in place of the files of its kind.

    Raises:
        OSError: failed moves, or a foreign file in the way; the target is unchanged.
    """
    tidy(made)
    new, old = names(made), [*kind.own(target)]
    own = {*kind.own(made), *old}
    for name in sorted(new):
        there = target / name
        if os.path.lexists(there) and (name not in own or _is_folder(there)):
            raise FileExistsError(errno.EEXIST, f"{name} in it is not of {kind.name}")
    whole = target / f"{WHOLE}{secrets.token_hex(8)}"
    made.rename(whole)  # killed after this line, the next command completes the move
    remove(target, [name for name in old if name not in new])
    move_up(whole)


def remove(folder: Path, names: Iterable[str]) -> None:
    """Remove these files of a folder, links themselves, and emptied folders."""
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
