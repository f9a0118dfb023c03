"""Writes requirements.lock: every package of every extra, with the hashes of its files.

The Pythons are those that pyproject.toml classifies the project under, the machines are Linux on
x86-64 and aarch64. A line before each package names the extras that need it, or says ``base``:
every installation needs the base, which includes the build tools. ``tools/setup`` picks by these
words.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
BASE = "base"
HEAD = "# Written by tools/lock; the line before each package says which extras need it.\n"
WHEEL = re.compile(
    r"-(py3|py2\.py3|cp3\d+)-(none|abi3|cp3\d+)-(any|.*linux\S*_(x86_64|aarch64))\.whl$"
)
"""What CPython installs on those machines: neither PyPy, nor Python without its lock."""


def locked(uv: Path, folder: Path, renewed: list[str]) -> Iterator[tuple[list[str], str]]:
    """Lock in ``folder``; yield each package's needs and its lines from ``uv export``.

    ``renewed`` are the packages that may get another version; without any, all may.
    """
    text = (ROOT / "pyproject.toml").read_text("utf-8")
    project = tomllib.loads(text)
    newest = max(map(int, re.findall(r'"Programming Language :: Python :: 3\.(\d+)"', text)))
    text = text.replace('requires-python = ">=3.11"', f'requires-python = ">=3.11,<3.{newest + 1}"')
    build = [*project["build-system"]["requires"], "editables"]  # asked for as hatchling runs
    pins = [line.split(" \\")[0] for line in LOCK.read_text("utf-8").splitlines() if "==" in line]
    kept = [pin for pin in pins if renewed and pin.split("==")[0] not in renewed]
    groups = f"[dependency-groups]\nbuild = {build}\n[tool.uv]\nconstraint-dependencies = {kept}\n"
    (folder / "pyproject.toml").write_text(f"{text}\n{groups}", "utf-8")
    for name in ("README.md", "LICENSE"):
        (folder / name).write_bytes((ROOT / name).read_bytes())

    def run(*words: str) -> str:
        command = [str(uv), *words, "--quiet", "--project", str(folder), "--python", sys.executable]
        done = subprocess.run(command, check=False, stdout=subprocess.PIPE, text=True)
        if done.returncode:  # uv has said why
            raise SystemExit(2)
        return str(done.stdout)

    def packages(*choice: str) -> list[str]:
        form = ("--no-emit-project", "--no-annotate", "--no-header", "--no-dev", "--frozen")
        return re.split(r"\n(?! )", run("export", *form, *choice).strip())

    run("lock")
    extras = {extra: ("--extra", extra) for extra in project["project"]["optional-dependencies"]}
    needs = {
        word: {package.split()[0] for package in packages(*choice)}
        for word, choice in {BASE: ("--group", "build"), **extras}.items()
    }
    for package in packages("--group", "build", "--all-extras"):
        who = [word for word, names in needs.items() if package.split()[0] in names]
        yield who[:1] if who[0] == BASE else sorted(who), package


def other_files(folder: Path) -> set[str]:
    """Return the hashes of files for other machines."""
    packages = tomllib.loads((folder / "uv.lock").read_text("utf-8"))["package"]
    found: set[str] = set()
    for package in packages:
        files = [*package.get("wheels", []), *[package["sdist"] for _ in "1" if "sdist" in package]]
        others = {each["hash"] for each in files if not WHEEL.search(each["url"])}
        found |= others if len(others) < len(files) else set()
    return found


def main() -> None:
    """Lock with the uv of the environment in the first argument; the others are names to renew."""
    own, *renewed = sys.argv[1:]
    folder = Path(own) / "project"
    folder.mkdir()
    needed = list(locked(Path(own) / "bin" / "uv", folder, renewed))
    unwanted = other_files(folder)
    parts = [HEAD]
    for who, package in needed:
        first, *hashes = package.replace(" \\", "").splitlines()
        kept = [line for line in hashes if line.strip().removeprefix("--hash=") not in unwanted]
        parts.append(f"# {' '.join(who)}\n" + " \\\n".join([first, *kept]) + "\n")
    LOCK.write_text("".join(parts), "utf-8")


if __name__ == "__main__":
    main()
