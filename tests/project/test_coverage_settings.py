"""What the branch coverage of firmware_model counts: every line of it, and less than all fails.

The coverage run itself takes minutes; whether anything is left out of it shows at once.
"""

import ast
import re
from pathlib import Path

import coverage
import pytest

ROOT = Path(__file__).parents[2]
MODULES = sorted((ROOT / "firmware_model").rglob("*.py"))


@pytest.fixture
def settings(monkeypatch):
    """As coverage itself reads them, wherever they are written."""
    monkeypatch.chdir(ROOT)
    return coverage.Coverage(data_file=None)  # a file on disk belongs to parallel tests too


def test_the_whole_package_counts_with_its_branches_and_must_be_covered(settings):
    assert settings.get_option("run:branch") is True
    assert settings.get_option("run:source") == ["firmware_model"]
    assert settings.get_option("report:fail_under") == 100
    for left_out in ("run:omit", "run:include", "report:omit", "report:include"):
        assert not settings.get_option(left_out), left_out


def only_for_mypy(path):
    """The lines below ``if TYPE_CHECKING``."""
    blocks = [each for each in ast.walk(ast.parse(path.read_text())) if isinstance(each, ast.If)]
    chosen = [each for each in blocks if ast.unparse(each.test) == "TYPE_CHECKING"]
    return {line for each in chosen for line in range(each.lineno, each.end_lineno + 1)}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_line_and_no_branch_is_excluded(path, settings):
    """But for what only mypy reads."""
    _, _, excluded, _, _ = settings.analysis2(str(path))
    lines = path.read_text().splitlines()
    for line in (lines[number - 1].strip() for number in set(excluded) - only_for_mypy(path)):
        assert re.match(r"$|@overload$|def .*: \.\.\.$", line), line
    for pattern in settings.get_option("report:partial_branches"):
        assert not re.search(pattern, path.read_text())


def test_no_test_of_the_firmware_is_left_out_of_one_of_its_two_runs():
    """Interpreted and compiled it passes the same tests, but for those marked compiled."""
    for path in (ROOT / "tests" / "firmware").rglob("test_*.py"):
        assert "skipif" not in path.read_text(), path
