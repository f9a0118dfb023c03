"""tools/mutation: its changes, and its account of noticed and unnoticed changes."""

import ast
import importlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(autouse=True)
def as_scripts(monkeypatch):
    monkeypatch.syspath_prepend(str(TOOLS))


@pytest.mark.parametrize(
    ("line", "expected"),
    [("x = a + 1", {"x = (a - 1)", "x = a + (0)", "x = a + (2)"}), ("x = -a", {"x = (a)"}),
     ("x = a < b", {"x = (a <= b)", "x = (a >= b)"}),
     ("x = a and b", {"x = (a or b)", "x = (a)", "x = (b)"}), ("x = 2.5", {"x = (5.0)"}),
     ("x = True", {"x = (False)"}), ("x = max(a, b)", {"x = (min(a, b))"}),
     ("x = math.expm1(a)", {"x = (math.exp(a) - 1.0)"}), ("x = abs(a)", {"x = (a)"}),
     ("x = a[0]", {"x = a[(1)]"}), ("f(a)", {"pass"}), ("a.b = c", {"pass"}),
     ("raise ValueError(1 + 1)", {"pass"}),
     ("while a: break", {"while (not (a)): break", "while a: continue"}),
     ("x: int = 'text'", set()), ("return None", set()), ("zip(a, strict=True)", {"pass"})],
)  # fmt: skip
def test_what_a_line_becomes(line, expected):
    from mutation_sites import mutants

    assert {mutant.after for mutant in mutants(line)} == expected


def test_only_an_assignment_that_replaces_a_value_is_left_out():
    from mutation_sites import mutants

    source = "def f(a):\n    b = a\n    c = a\n    c = b\n    a = c\n    return a\n"
    dropped = [m.line for m in mutants(source) if m.after == "pass"]
    assert dropped == [3, 4, 5]  # line 2 defines b


def test_a_mutant_is_the_module_with_one_line_changed():
    from mutation_sites import mutants

    source = '"""µ."""\nx = "µ", 1 + a  # why\n\ny = (\n    2 *\n    a)\n'
    for mutant in mutants(source):
        before, after = source.splitlines(), mutant.source.splitlines()
        assert sum(a != b for a, b in zip(before, after, strict=False)) <= 3
        assert after[0] == before[0]
    assert ("2 * a)", "(2 / a))") in {(m.before, m.after) for m in mutants(source)}


def test_each_mutant_of_the_product_is_another_module():
    import mutation

    every = mutation.sites(mutation.modules())
    assert len(every) > 1000
    assert len({(site.module, site.mutant.source) for site in every}) == len(every)
    for site in every[::199]:
        ast.parse(site.mutant.source)  # a syntax error is no mutant


STEPS = """\
STEP = 1
SIZES = (STEP, 5)
class Kept:
    step = 1
def on(value):
    return value + STEP
"""


def test_what_a_mutant_changes_is_changed_in_a_session_that_has_imported_it(tmp_path, monkeypatch):
    """A constant wherever it has been imported to; what else is made on import is not reached."""
    from mutation import functions, swap

    path = tmp_path / "mutated_steps.py"
    path.write_text(STEPS)
    (tmp_path / "user_of_steps.py").write_text("from mutated_steps import STEP\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    steps, user = (importlib.import_module(name) for name in ("mutated_steps", "user_of_steps"))
    assert not swap(functions(), str(path), STEPS, STEPS.replace("    step = 1", "    step = 2"))
    assert swap(functions(), str(path), STEPS, STEPS.replace("value + STEP", "value - STEP"))
    assert steps.on(3) == 2
    assert swap(functions(), str(path), STEPS, STEPS.replace("STEP = 1", "STEP = (2)", 1))
    assert (steps.on(3), steps.SIZES, user.STEP) == (1, (2, 5), 2)


CODE = """\
def clip(value):
    while value > 9:
        value -= 1
    if value < 0:
        value = 0
    return value
"""
TESTS = """\
from can_rig.clip import clip

def test_below():
    assert clip(-3) == 0

def test_above():
    assert clip(12) == 9

def test_within():
    assert clip(0.5) == 0.5
"""


@pytest.fixture
def project(tmp_path):
    """A checkout of one module, its tests and the tool."""
    for name in ("can_rig", "firmware_model", "dbc", "tests/rig", "tests/firmware"):
        (tmp_path / name).mkdir(parents=True)
    shutil.copytree(TOOLS, tmp_path / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    tool = tmp_path / "tools" / "mutation.py"
    tool.write_text(tool.read_text().replace("HANGS_S: Final = 2.0", "HANGS_S: Final = 0.3"))
    (tmp_path / "can_rig" / "__init__.py").write_text("")
    (tmp_path / "can_rig" / "clip.py").write_text(CODE)
    (tmp_path / "tests" / "rig" / "test_clip.py").write_text(TESTS)
    (tmp_path / "pyproject.toml").write_text(
        '[tool.pytest.ini_options]\npythonpath = ["."]\n'
        'markers = ["vcan", "long", "compiled"]\naddopts = "--import-mode=importlib"\n'
    )
    (tmp_path / "README.md").write_text("")
    return tmp_path


def run(project: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "tools/mutation.py", *arguments],
        cwd=project,
        env={"COLUMNS": "200", "PATH": "/usr/bin:/bin"},
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )


def test_what_survives_is_told_until_a_test_notices(project):
    done = run(project)
    assert done.returncode == 1, done.stderr
    (survivor,) = [line for line in done.stdout.splitlines() if line.startswith("survived")]
    assert survivor == "survived: can_rig/clip.py:4: if value < 0:  →  if (value <= 0):"
    assert (project / "can_rig" / "clip.py").read_text() == CODE
    clip_tests = project / "tests" / "rig" / "test_clip.py"
    clip_tests.write_text(f"{TESTS}\ndef test_zero():\n    assert str(clip(-0.0)) == '-0.0'\n")
    done = run(project)
    assert done.returncode == 0, done.stderr
    assert "survived" not in done.stderr


def test_tests_that_fail_anyway_prove_nothing(project):
    (project / "tests" / "rig" / "test_clip.py").write_text("def test_no():\n    assert False\n")
    done = run(project)
    assert done.returncode == 1
    assert "error: tests/rig/test_clip.py::test_no fails on the unchanged code" in done.stderr


@pytest.mark.parametrize(
    ("code", "failing"),
    [
        ("def step():\n    return 1\n", "tests/rig/test_step.py::test_step fails"),
        ("steps = [1]\nstep = steps.pop\n", "tests/rig, imported anew, fails"),
    ],
)
def test_a_copy_that_breaks_half_way_proves_nothing(project, code, failing):
    """The first mutant's test removes a file: all that follow fail, and not for their change."""
    (project / "can_rig" / "clip.py").unlink()
    (project / "tests" / "rig" / "test_clip.py").unlink()
    (project / "can_rig" / "step.py").write_text(code)
    (project / "tests" / "rig" / "test_step.py").write_text(
        "from pathlib import Path\n\n"
        "import can_rig.step\n\n"
        "def test_step():\n"
        "    file = Path(can_rig.step.__file__).with_name('__init__.py')\n"
        "    if can_rig.step.step() != 1:\n"
        "        file.unlink(missing_ok=True)\n"
        "    assert file.exists()\n"
    )
    done = run(project)
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith(f"error: {failing} on the unchanged code")
