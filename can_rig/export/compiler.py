"""The host's C compiler."""

import ctypes
import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from can_rig.errors import ExportError, LogError
from can_rig.storage.files import atomic

FLAGS: Final = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
WARNINGS: Final = (
    "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion",
)  # fmt: skip


def host_compiler() -> list[str]:
    """The compile command: CC, or cc.

    Raises:
        ExportError: no compiler, or CC is not a command.
    """
    said = os.environ.get("CC", "")
    try:
        command = shlex.split(said) or ["cc"]
    except ValueError as error:
        raise ExportError(f"CC = {said!r}: must be a command: {error}") from None
    if shutil.which(command[0]) is None:
        raise ExportError(
            f"{command[0]}: there is no such C compiler; "
            "one must be installed (Debian: apt install gcc), or named by CC"
        )
    return command


def shared_library(sources: Mapping[str, str]) -> Path:
    """Compile the files to a library for this process.

    Args:
        sources: text by file name.

    Raises:
        ExportError: no compiler, or a compiler error; the message has the error's first line.
    """
    return built(host_compiler(), FLAGS, sources, ".so")


def loaded(library: Path) -> ctypes.CDLL:
    """A compiled library in this process.

    Raises:
        ExportError: loading fails.
    """
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise ExportError(f"{library}: cannot be loaded: {error}") from None


def placed(folder: str | Path, texts: Mapping[str, str]) -> list[str]:
    """Write files to ``folder``; returns the names of the .c files in order."""
    for name, text in texts.items():
        (Path(folder) / name).write_text(text, encoding="utf-8")
    return sorted(name for name in texts if name.endswith(".c"))


def built(
    compiler: Sequence[str], flags: Sequence[str], sources: Mapping[str, str], suffix: str
) -> Path:
    """The product of a compiler, cached.

    Args:
        compiler: the command.
        flags: compiler options.
        sources: text by file name; files with suffix .c are compiled.
        suffix: suffix of the product.

    Raises:
        ExportError: a compiler error; the message has the error's first line.
    """
    said = repr([compiler, flags, sorted(sources.items())]).encode()
    folder = _cache()
    result = folder / f"{hashlib.sha256(said).hexdigest()[:24]}{suffix}"
    if result.is_file():
        return result
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        units, made = placed(place, sources), Path(place) / result.name
        run([*compiler, *flags, "-o", made.name, *units, "-lm"], Path(place))
        if not made.is_file():
            raise ExportError(f"{compiler[0]}: must be a C compiler: it has compiled nothing")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic(result, force=True) as part:  # another process may build the same file
                shutil.copy(made, part)
        except OSError as error:
            raise ExportError(f"{folder}: cannot be written: {error.strerror}") from None
        except LogError as error:
            raise ExportError(str(error)) from None
    return result


def run(command: Sequence[str], folder: Path) -> str:
    """The output of a build tool.

    Raises:
        ExportError: the tool fails; the message has the first error line.
    """
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = (done.stderr or done.stdout).splitlines() or ["no reason given"]
        first = next((line for line in lines if "error" in line), lines[0])
        raise ExportError(f"{command[0]} ended with exit status {done.returncode}: {first}")
    return done.stdout + done.stderr


def _cache() -> Path:
    """Where compiled libraries are kept."""
    home = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(home) / "fault-tolerant-steering" / "c"
