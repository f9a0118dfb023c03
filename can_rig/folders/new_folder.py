"""A folder of results that grows over time; recorded results are never lost.

A new folder is made in its final place. A replacement grows beside the old folder, as
``NAME.unfinished``; the old folder stands until the new folder is complete. Both are locked.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from can_rig.errors import RunFolderError, one_line
from can_rig.files import locked, tidy
from can_rig.folders.replacing import Kind, followed, names, put_into, refuse_to_replace, remove


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
        if not self.making.is_dir():
            raise RunFolderError(f"{self.making}: is a file; must be a folder, or not there")
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
