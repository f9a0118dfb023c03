"""The C compiler of this machine."""

from __future__ import annotations

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
from can_rig.files import atomic

FLAGS: Final = ("-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
WARNINGS: Final = (
    "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wdouble-promotion",
)  # fmt: skip


def host_compiler() -> list[str]:
    """The command that compiles: what CC says, or cc.

    Raises:
        ExportError: there is none, or CC is no command.
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


def shared_library(sources: Mapping[str, str], flags: Sequence[str] = FLAGS) -> Path:
    """The files compiled to a library that this process can load.

    Args:
        sources: text by file name.
        flags: what the compiler gets.

    Raises:
        ExportError: there is no compiler, or it refuses; its first line says why.
    """
    return built(host_compiler(), flags, sources, ".so")


def built(
    compiler: Sequence[str], flags: Sequence[str], sources: Mapping[str, str], suffix: str
) -> Path:
    """What a compiler makes of the files, kept for the next time.

    Args:
        compiler: the command.
        flags: what it gets.
        sources: text by file name; what ends in .c is compiled.
        suffix: of the file that it makes.

    Raises:
        ExportError: it refuses; its first line says why.
    """
    said = repr([compiler, flags, sorted(sources.items())]).encode()
    folder = _cache()
    result = folder / f"{hashlib.sha256(said).hexdigest()[:24]}{suffix}"
    if result.is_file():
        return result
    with tempfile.TemporaryDirectory(prefix="can-rig-") as place:
        for name, text in sources.items():
            (Path(place) / name).write_text(text, encoding="utf-8")
        made = Path(place) / result.name
        units = [name for name in sources if name.endswith(".c")]
        run([*compiler, *flags, "-o", made.name, *units, "-lm"], Path(place))
        if not made.is_file():
            raise ExportError(f"{compiler[0]}: must be a C compiler: it has compiled nothing")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with atomic(result, force=True) as part:  # another process may be making the same one
                shutil.copy(made, part)
        except OSError as error:
            raise ExportError(f"{folder}: cannot be written: {error.strerror}") from None
        except LogError as error:
            raise ExportError(str(error)) from None
    return result


def run(command: Sequence[str], folder: Path) -> str:
    """What a tool says that compiles.

    Raises:
        ExportError: it fails; with the first line that names an error.
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
