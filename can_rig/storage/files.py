"""Output files: complete or absent, never over existing files unasked, and under safe names.

The writer works in a private folder beside the file's place, safe from guesses and planted links,
and renames the complete file. The folder is locked; a missing lock identifies the remains of a
killed process, which the next output beside removes. `folders` does the same for folders.
"""

import fcntl
import hashlib
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from can_rig.errors import LogError, one_line

PICTURES = {".png", ".svg", ".pdf"}
"""Suffixes of pictures; matplotlib knows the format by it."""

PART: Final = ".can-rig-part-"
"""Prefix of a private folder's name; its contents are incomplete."""

WHOLE: Final = ".can-rig-whole-"
"""Prefix of a folder's name; its files are complete and about to move into the parent folder."""

_LEFT_OVER: Final = re.compile(f"({re.escape(PART)}|{re.escape(WHOLE)})[0-9a-f]{{16}}")

_RESERVED: Final = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices."""

_NAME_BYTES: Final = 120
"""Of a safe name without its suffix; file systems take 255, some of them 143."""


def refuse_existing(path: Path, force: bool, option: str, *, new_folder: bool = False) -> None:
    """Refuse an existing output file unless replaceable, and a missing folder.

    Args:
        path: the output.
        force: replace it.
        option: the one that named it.
        new_folder: the option named the output's folder; a missing folder is then created.

    Raises:
        LogError: the reason.
    """
    if new_folder and (path.parent.suffix.lower() in PICTURES or path.parent == Path("-")):
        raise LogError(f"{path.parent}: {option} must name a folder, for {path.name}")
    if path.is_dir():
        raise LogError(f"{path}: is a folder; {option} must name a file")
    if path.exists() and not path.is_file():
        raise LogError(f"{path}: is a device or a pipe; {option} must name a file")
    if os.path.lexists(path) and not force:
        raise LogError(f"{path}: exists; choose another {option}, or --force to replace it")
    folder = path.parent.parent if new_folder else path.parent
    if not folder.is_dir():
        raise LogError(f"{path}: {no_folder(folder)}; {option} makes none")


def refuse_itself(source: Path, *outputs: Path) -> None:
    """Refuse to replace the log that is read, also with ``--force``.

    Raises:
        LogError: an output that is the log.
    """
    for path in outputs:
        if path.exists() and not path.is_symlink() and path.samefile(source):
            raise LogError(f"{path}: is the log that is read; the output must be another file")


def no_folder(folder: Path) -> str:
    """What is wrong with a path that must be a folder."""
    return f"{folder} is a file" if folder.exists() else f"there is no folder {folder}"


def refuse_picture(path: Path, force: bool) -> None:
    """Refuse an impossible picture format in --out, and an existing picture.

    Raises:
        LogError: the reason.
    """
    if path.suffix.lower() not in PICTURES:
        raise LogError(f"{path}: a picture must be FILE.png, FILE.svg or FILE.pdf")
    refuse_existing(path, force, "--out")


@contextmanager
def atomic(path: Path, *, force: bool) -> Iterator[Path]:
    """Where to write what becomes the file ``path`` once the context is left without an error.

    Args:
        path: the file; a link in its place is replaced, and never followed.
        force: replace an existing file; without ``force``, a file that appears meanwhile stays too.

    Raises:
        LogError: a failing write, or an existing file.
    """
    try:
        path.parent.mkdir(exist_ok=True)
        with part_folder(path.parent) as folder:
            part = folder / path.name
            yield part
            if force:
                part.replace(path)
            else:
                _put_in_place(part, path)
    except FileExistsError:
        raise LogError(f"{path}: exists; choose another name, or --force to replace it") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror or one_line(error)}") from None


def _put_in_place(part: Path, path: Path) -> None:
    """Rename a file where nothing is.

    Raises:
        FileExistsError: something is there.
    """
    try:
        path.hardlink_to(part)
    except FileExistsError:
        raise
    except OSError:  # a file system without hard links
        os.close(os.open(path, os.O_CREAT | os.O_EXCL))
        part.replace(path)


@contextmanager
def part_folder(beside: Path) -> Iterator[Path]:
    """A private folder in the folder ``beside``, gone when the context is left.

    Raises:
        OSError: it cannot be made.
    """
    tidy(beside)
    while True:
        folder = beside / f"{PART}{secrets.token_hex(8)}"
        try:
            folder.mkdir(mode=0o700)
        except FileExistsError:
            continue
        with suppress(BlockingIOError, FileNotFoundError):  # just tidied away by another process
            lock = locked(folder)
            break
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def locked(folder: Path, *, wait: bool = False) -> int | None:
    """Lock a folder until the descriptor is closed, here and in every forked process.

    Args:
        folder: the folder.
        wait: until no other process holds it.

    Returns:
        The descriptor; None on a file system without locks.

    Raises:
        BlockingIOError: another process holds it.
        OSError: the folder is missing, or is a link.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        if not os.path.samestat(os.fstat(descriptor), folder.lstat()):
            raise FileNotFoundError(folder)
    except OSError as error:
        os.close(descriptor)
        if isinstance(error, BlockingIOError | FileNotFoundError):
            raise
        return None
    return descriptor


def tidy(folder: Path) -> None:
    """Remove the parts of killed processes from a folder; complete the results that were whole.

    Parts that a process holds stay. On a file system without locks every part stays.
    """
    with suppress(OSError):
        left = [
            each
            for each in os.scandir(folder)
            if _LEFT_OVER.fullmatch(each.name) and each.is_dir(follow_symlinks=False)
        ]
        for each in left:
            with suppress(OSError):
                lock = locked(Path(each))
                if lock is None:
                    continue
                try:
                    if each.name.startswith(WHOLE):
                        move_up(Path(each))
                    elif each.stat().st_uid == os.getuid():
                        shutil.rmtree(each, ignore_errors=True)
                finally:
                    os.close(lock)


def move_up(whole: Path) -> None:
    """Move the files of a folder to their places in the parent folder.

    Raises:
        OSError: a file cannot be renamed.
    """
    for path in sorted(whole.iterdir()):
        path.replace(whole.parent / path.name)
    whole.rmdir()


class FileNames:
    """Safe file names for names from a file; every two names differ on every file system.

    Letters, digits and ``-_. ()+,=@`` stay as they are; everything else is written as %XX, as in an
    address, and so are a first or last dot or space and the first letter of a name that Windows
    reserves. A long name is cut. A part of the hash distinguishes shortened names, and names that
    differ only in case.
    """

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def of(self, name: str, suffix: str = "") -> str:
        """The file name for ``name``, different from every earlier file name."""
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
        stem = safe_name(name)
        for digits in (0, *range(8, len(digest), 8)):
            found = (f"{stem}~{digest[:digits]}" if digits else stem) + suffix
            folded = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", found).casefold())
            if folded not in self._taken:
                break
        self._taken.add(folded)
        return found


def safe_name(name: str) -> str:
    """``name`` as a file name that stays in its folder; see ``FileNames``."""
    name = unicodedata.normalize("NFC", name)
    first = len(name) - len(name.lstrip(". "))
    end = len(name.rstrip(". "))
    safe = "".join(
        char if (char.isalnum() or char in "-_. ()+,=@") and first <= at < end else _escaped(char)
        for at, char in enumerate(name)
    )
    if _RESERVED.fullmatch(safe):
        safe = _escaped(safe[0]) + safe[1:]
    encoded = safe.encode()
    if len(encoded) > _NAME_BYTES:
        digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()
        safe = f"{encoded[:_NAME_BYTES].decode('utf-8', 'ignore').rstrip('. ')}~{digest[:8]}"
    return safe or "%"


def _escaped(char: str) -> str:
    return "".join(f"%{byte:02X}" for byte in char.encode("utf-8", "surrogatepass"))
