"""A release: version and changelog checked, wheel and sdist built, installed and tried, checksums.

The files are in ``dist/`` afterwards; nothing is tagged, pushed or uploaded.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import site
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from pathlib import Path
from typing import Final

CHECKOUT: Final = Path(__file__).parents[1]
ASK: Final = (
    "import can_rig; from importlib.metadata import version; "
    "print(version('fault-tolerant-steering'), can_rig.__file__)"
)
TRIAL: Final = ("run", "thesis-step", "--in-process", "--allow-unstable")


def fail(reason: str) -> None:
    """End with one line."""
    sys.exit(f"error: {reason}")


def run(*command: str | Path, cwd: Path = CHECKOUT, env: dict[str, str] | None = None) -> str:
    """The output of a command; the release ends where the command fails."""
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env=env, capture_output=True, text=True, check=False
    )
    if done.returncode:
        fail(f"{' '.join(map(str, command[:4]))} …: {(done.stderr or done.stdout).strip()[-600:]}")
    return done.stdout


def check_sources() -> str:
    """The version; the tree is clean, and the changelog has a dated part for the version."""
    version = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    changelog = (CHECKOUT / "CHANGELOG.md").read_text("utf-8")
    unreleased, _, rest = changelog.partition("## [Unreleased]\n")[2].partition("\n## [")
    if unreleased.strip():
        fail("CHANGELOG.md: [Unreleased] has entries; they belong to the version released")
    heading = re.match(r"(\S+)\] - \d{4}-\d\d-\d\d\n", rest)
    if heading is None or heading[1] != version:
        fail(f"CHANGELOG.md: the first part must be '## [{version}] - YYYY-MM-DD'")
    if not re.search(r"^- ", rest.partition("\n## [")[0], re.MULTILINE):
        fail(f"CHANGELOG.md: [{version}] has no entries")
    if changes := run("git", "status", "--porcelain"):
        fail(f"the working tree has changes that are not committed: {changes.split()[1]}")
    if run("git", "tag", "--list", f"v{version}"):
        fail(f"tag v{version} exists; raise the version in pyproject.toml")
    return str(version)


def build(version: str, dist: Path) -> list[Path]:
    """The sdist, and the wheel made from the sdist."""
    shutil.rmtree(dist, ignore_errors=True)
    epoch = run("git", "log", "-1", "--format=%ct").strip()  # the same bytes from the same commit
    command = (sys.executable, "-m", "build", "--no-isolation", "--outdir", dist)
    run(*command, env={**os.environ, "SOURCE_DATE_EPOCH": epoch})
    files = sorted(dist.iterdir())
    stem = f"fault_tolerant_steering-{version}"
    if [file.name for file in files] != [f"{stem}-py3-none-any.whl", f"{stem}.tar.gz"]:
        fail(f"built {', '.join(file.name for file in files)} instead of wheel and sdist")
    with tarfile.open(files[1]) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    if missing := {*run("git", "ls-files").split("\n"), ""} - inside - {""}:
        fail(f"the sdist lacks {min(missing)}")
    return files


def tried(package: Path, version: str, own_packages: bool) -> None:
    """Install a file into an empty environment far from the checkout, and run a scenario there."""
    with tempfile.TemporaryDirectory(prefix="release-") as name:
        folder = Path(name)
        run(sys.executable, "-m", "venv", "--without-pip", folder / "venv")
        python = folder / "venv" / "bin" / "python"
        pip = (
            *(sys.executable, "-m", "pip", "--python", python),
            *("install", "--quiet", "--disable-pip-version-check"),
        )
        if own_packages:  # a line in a .pth file adds a folder and not the .pth files in the folder
            (packages,) = (folder / "venv" / "lib").glob("python3*/site-packages")
            (packages / "own.pth").write_text("\n".join(site.getsitepackages()), "utf-8")
            run(*pip, "--no-deps", "--no-index", "--no-build-isolation", package, cwd=folder)
        else:
            locked = re.findall(
                r"^# [\w ]*\bbase\b[\w ]*\n((?:[^#\n].*\n)+)",
                (CHECKOUT / "requirements.lock").read_text("utf-8"),
                re.MULTILINE,
            )
            (folder / "requirements").write_text("".join(locked), "utf-8")
            run(*pip, "--no-deps", "--require-hashes", "--requirement", folder / "requirements")
            run(*pip, "--no-deps", package, cwd=folder)
        environment = {"PATH": os.environ["PATH"], "HOME": name, "NUMBA_DISABLE_JIT": "1"}
        command = (folder / "venv" / "bin" / "can-rig", *TRIAL, "--set", "duration_s=0.05")
        run(*command, "--out", "run", cwd=folder, env=environment)
        summary = json.loads((folder / "run" / "run.json").read_text("utf-8"))
        found, where = run(python, "-c", ASK, cwd=folder, env=environment).split()
        if summary["outcome"] != "complete" or not where.startswith(name) or found != version:
            fail(f"{package.name}: {found} from {where} ran to the outcome {summary['outcome']}")


def main() -> None:
    """Make the files of a release, or end with the reason why not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--own-packages", action="store_true",
        help="try with the dependencies in .venv: no network",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, default=CHECKOUT / "dist", metavar="FOLDER")
    asked = parser.parse_args()
    version = check_sources()
    files = build(version, asked.out)
    for file in files:
        tried(file, version, asked.own_packages)
    sums = "".join(f"{hashlib.sha256(f.read_bytes()).hexdigest()}  {f.name}\n" for f in files)
    (asked.out / "SHA256SUMS").write_text(sums, "utf-8")
    print(sums, end="")
    print(f"next: git tag -s v{version} -m v{version}; see docs/releasing.md")


if __name__ == "__main__":
    main()
