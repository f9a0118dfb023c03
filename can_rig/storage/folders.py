"""Folders of results: complete or absent; the old folder stands until the new one is complete.

Foreign files in a folder stay.
"""

from __future__ import annotations

import errno
import os
import secrets
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from can_rig.errors import RunFolderError, one_line
from can_rig.storage.files import WHOLE, locked, move_up, no_folder, part_folder, safe_name, tidy


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
        raise RunFolderError(f"{path}: {no_folder(target.parent)}; --out makes none")
    if not os.path.lexists(target):
        return
    refuse_file(target)
    try:
        tidy(target)
        if names(target):
            refuse_to_replace(path, kind, force)
    except OSError as error:
        raise RunFolderError(f"{path}: cannot be read: {error.strerror}") from None


def refuse_file(path: Path) -> None:
    """Refuse a file where a folder must be.

    Raises:
        RunFolderError: the file.
    """
    if path.exists() and not path.is_dir():
        raise RunFolderError(f"{path}: is a file; must be a folder, or not there")


def refuse_to_replace(path: Path, kind: Kind, force: bool) -> None:
    """Refuse replacing without ``force``, and replacing another kind of folder.

    Raises:
        RunFolderError: the reason.
    """
    if not force:
        way_out = ", or --force to replace it" if kind.is_in(path) else ""
        raise RunFolderError(
            f"{path}: there already, and nothing is overwritten; choose another --out{way_out}"
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
        RunFolderError: it is a link to nothing, or ``-``, standard output elsewhere.
    """
    if path == Path("-"):
        raise RunFolderError("-: must be the name of a folder; none is written to standard output")
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


class NewFolder:
    """A growing folder of results; no other process writes into the folder meanwhile.

    Attributes:
        path: the final place of the folder, as the user named the place.
        making: the present place of the folder.
    """

    def __init__(self, path: Path, target: Path, making: Path, kind: Kind) -> None:
        self.path = path
        self.making = making
        self._target = target
        self._kind = kind
        self._held = ExitStack()
        self._is_new = False

    @classmethod
    def create(cls, path: Path, kind: Kind, force: bool) -> NewFolder:
        """Make the folder, and its parents.

        Raises:
            RunFolderError: the folder exists and ``force`` is not given; the folder is of another
                kind; another process writes the folder; the folder cannot be made.
        """
        target = followed(path)
        made = cls(path, target, target, kind)
        with made._refusals():
            for parent in target.parents:
                refuse_file(parent)
            target.parent.mkdir(parents=True, exist_ok=True)
            if not made._took_place():
                refuse_to_replace(path, kind, force)
                made._make_beside(target)
        return made

    @classmethod
    def resume(cls, path: Path, kind: Kind) -> NewFolder:
        """Continue the unfinished folder for ``path``.

        Raises:
            RunFolderError: a missing folder, or another process writing the folder.
        """
        target = followed(path)
        made = cls(path, target, target.with_name(f"{target.name}.unfinished"), kind)
        if not kind.is_in(made.making):
            made.making = target
        if not kind.is_in(made.making):
            raise RunFolderError(f"{path}: not {kind.name}; --resume needs its --out")
        made._hold(made.making)
        tidy(made.making)
        return made

    @classmethod
    def files_of(cls, folder: Path, name: str, kind: Kind) -> NewFolder:
        """New files for ``folder``, made in the folder ``NAME.unfinished`` within.

        Raises:
            RunFolderError: files that an earlier command failed to finish, or a failure to create.
        """
        made = cls(folder / name, folder, folder, kind)
        with made._refusals():
            made._make_beside(made.path)
        return made

    def _make_beside(self, path: Path) -> None:
        self.making = path.with_name(f"{path.name}.unfinished")
        if not self._took_place():
            raise RunFolderError(
                f"{self.making}: holds what an earlier command recorded and could not finish; "
                "move it away, or choose another name"
            )

    @contextmanager
    def _refusals(self) -> Iterator[None]:
        """Says why the folder cannot be made; then other processes may."""
        try:
            yield
        except BaseException as error:
            self.close()
            if isinstance(error, OSError):
                reason = error.strerror or one_line(error)
                raise RunFolderError(f"{self.making}: cannot be made: {reason}") from None
            raise

    def _took_place(self) -> bool:
        """Whether the folder ``making`` is new, or became empty."""
        tidy(self.making.parent)
        if not os.path.lexists(self.making):
            self.making.mkdir()
            self._is_new = True
            self._hold(self.making)
            return True
        refuse_file(self.making)
        self._hold(self.making)
        tidy(self.making)
        own = [*self._kind.own(self.making)]
        if names(self.making) - {*own} or self._kind.recorded(self.making):
            return False
        remove(self.making, own)  # a killed command had recorded nothing yet
        return True

    def _hold(self, folder: Path) -> None:
        try:
            lock = locked(folder)
        except BlockingIOError:
            raise RunFolderError(
                f"{folder}: another command is writing into it; wait for it, or choose another "
                "--out"
            ) from None
        if lock is not None:
            self._held.callback(os.close, lock)

    def close(self) -> None:
        """Let other processes write into it."""
        self._held.close()

    def __enter__(self) -> NewFolder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def give_up(self) -> None:
        """Remove the new folder, unless the folder holds recorded results."""
        with suppress(OSError):
            tidy(self.making)
            remove(self.making, self._kind.own(self.making))
            if self._is_new or self.making != self._target:
                self.making.rmdir()
        self.close()

    def publish(self) -> None:
        """Put the complete folder in its place, and remove the replaced folder.

        Raises:
            RunFolderError: it cannot be; both are still there.
        """
        try:
            if self.making != self._target:
                put_into(self.making, self._target, self._kind)
        except OSError as error:
            reason = error.strerror or one_line(error)
            raise RunFolderError(
                f"{self.path}: cannot be replaced: {reason}; what is new is in {self.making}"
            ) from None
        finally:
            self.close()
        self.making = self._target
