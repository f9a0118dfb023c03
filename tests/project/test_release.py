"""tools/release: builds that run far from the checkout, and releases that must be refused."""

import hashlib
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from tests.project.pages import ROOT

VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="no git here")


@pytest.fixture(scope="module")
def released(tmp_path_factory):
    """The files of this checkout as a version of their own, committed to another repository."""
    folder = tmp_path_factory.mktemp("release") / "checkout"
    listed = ["git", "-c", "safe.directory=*", "ls-files", "-z", "--cached", "--others"]
    names = subprocess.run(
        [*listed, "--exclude-standard"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    for name, old, new in (  # whatever is not released yet belongs to that version
        ("CHANGELOG.md", "[Unreleased]\n", "[Unreleased]\n\n## [99.0.0] - 2099-01-01\n\n- All.\n"),
        ("pyproject.toml", f'\nversion = "{VERSION}"', '\nversion = "99.0.0"'),
    ):  # fmt: skip
        text = (folder / name).read_text("utf-8")
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1), "utf-8")
    for words in (["init", "-q"], ["add", "--all"], ["commit", "-q", "-m", "all"]):
        git(folder, *words)
    return folder


def git(folder: Path, *words: str) -> None:
    who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "safe.directory=*"]
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


def release(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "tools/release.py", "--own-packages", *words],
        cwd=folder, env={**os.environ, "GIT_CONFIG_GLOBAL": os.devnull},
        capture_output=True, text=True, check=False,
    )  # fmt: skip


def test_wheel_and_sdist_run_far_from_the_checkout(released, tmp_path):
    """The wheel holds the packages, the frames and the scenarios, and no tests."""
    done = release(released, "--out", str(tmp_path / "dist"))
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "dist").iterdir())) == 3
    (wheel,) = (tmp_path / "dist").glob("*.whl")
    for line in (tmp_path / "dist" / "SHA256SUMS").read_text().splitlines():
        found, name = line.split()
        assert hashlib.sha256((tmp_path / "dist" / name).read_bytes()).hexdigest() == found
    names = set(zipfile.ZipFile(wheel).namelist())
    shipped = "can_rig/scenario/shipped"
    for folder, package in (("dbc", "can_rig/dbc"), (shipped, shipped)):
        assert {f"{package}/{path.name}" for path in (ROOT / folder).iterdir()} <= names
    assert any(name.endswith(".dist-info/licenses/LICENSE") for name in names)
    assert {"can_rig/py.typed", "firmware_model/__init__.py"} <= names
    tops = {name.split("/")[0] for name in names}
    assert {t for t in tops if not t.endswith(".dist-info")} == {"can_rig", "firmware_model"}


@pytest.mark.parametrize(
    ("file", "old", "new", "reason"),
    [
        ("CHANGELOG.md", "[Unreleased]\n", "[Unreleased]\n\n- New.\n", "[Unreleased] has entries"),
        ("pyproject.toml", '\nversion = "', '\nversion = "9', "the first part must be '## [9"),
        ("README.md", "# ", "## ", "changes that are not committed: README.md"),
        ("", "", "", "exists; raise the version in pyproject.toml"),
    ],
)  # fmt: skip
def test_what_is_not_ready_is_refused_in_one_line(released, file, old, new, reason):
    version = (released / "pyproject.toml").read_text().partition('\nversion = "')[2].split('"')[0]
    if file:
        text = (released / file).read_text()
        (released / file).write_text(text.replace(old, new, 1))
    else:
        git(released, "tag", f"v{version}")
    try:
        done = release(released)
    finally:
        if file:
            (released / file).write_text(text)
        else:
            git(released, "tag", "-d", f"v{version}")
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert reason in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (released / "dist").exists()
