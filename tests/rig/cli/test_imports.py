"""What a light command does without, and what --help says before a command is imported."""

import json
import subprocess
import sys

import click
import pytest

from can_rig.cli.main import COMMANDS, main
from tests.helpers import asked, refused

MEASURE = """
import json, sys
sys.argv = ["can-rig", *json.loads(sys.argv[1])]
from can_rig.__main__ import main
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
    print(json.dumps(sorted(sys.modules)), file=sys.stderr)
"""
TABLES = {"asammdf", "pandas", "pyarrow"}
PICTURES = {"matplotlib", "control"}
SOLVERS = {"scipy.signal", "scipy.optimize"}
LAW = {"firmware_model.law.controller", "firmware_model.discretisation.tables"}
"""What a plant node does without, so that a second plant on a bus is named at once."""
NUMBERS = {"numpy", "scipy", "numba", "pydantic", "can", "cantools"}


def imported_by(*arguments: str) -> set[str]:
    command = [sys.executable, "-c", MEASURE, json.dumps(arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    return set(json.loads(done.stderr.splitlines()[-1]))


@pytest.mark.parametrize(
    ("arguments", "without"),
    [(["--help"], TABLES | PICTURES | SOLVERS | NUMBERS | {"rich"}),
     (["scenarios"], TABLES | PICTURES | SOLVERS | NUMBERS),
     (["check", "thesis-step"], TABLES | PICTURES | SOLVERS | {"yaml", "numpy.f2py.f2py2e"}),
     (["bus"], TABLES | PICTURES | SOLVERS), (["run", "--help"], TABLES | PICTURES | SOLVERS),
     (["plant", "--help"], TABLES | PICTURES | SOLVERS | LAW)],
)  # fmt: skip
def test_a_light_command_imports_nothing_heavy(arguments, without):
    imported = imported_by(*arguments)
    assert "can_rig.cli.main" in imported
    assert not without & imported


HIDDEN = """
import sys
from can_rig.cli.startup import leave_out
leave_out()
import can
assert "pandas" not in sys.modules
import asammdf
import numba
assert "coverage" not in sys.modules
import coverage
import cantools, numpy, yaml
assert cantools.tester.Tester.__init__
numpy.testing.assert_allclose(1.0, 1.0)
assert numpy.f2py.get_include()
from matplotlib.lines import Line2D
line = Line2D([0, 1], [0, 1])
line.set(color="red", linewidth=3)
assert line.get_linewidth() == 3 and not Line2D.set.__doc__
"""


def test_the_command_line_imports_libraries_without_others_which_are_there_all_the_same():
    subprocess.run([sys.executable, "-c", HIDDEN], check=True, timeout=300)


LIBRARIES = """
import can, can_rig.drawing.style
assert can.io.mf4.asammdf is not None
from matplotlib.lines import Line2D
assert "color" in Line2D.set.__doc__
"""


def test_a_program_that_imports_can_rig_keeps_libraries_as_they_are():
    subprocess.run([sys.executable, "-c", LIBRARIES], check=True, timeout=300)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_line_in_the_list_begins_like_the_command_s_own_help(name):
    command = main.get_command(click.Context(main), name)
    assert command is not None
    assert command.name == name
    line = COMMANDS[name][1]
    assert line.endswith(".")
    assert len(line) <= 68  # one line of a terminal of 80
    assert line.split()[0] == (command.help or "").split()[0]
    assert line in asked("--help").stdout


def test_an_unknown_command_gets_a_suggestion_or_none_but_no_traceback():
    assert "No such command 'chekc'" in refused("chekc")


COLLECTED = """
import atexit, gc, sys
atexit.register(lambda: print(gc.isenabled(), gc.get_freeze_count() > 10_000))
from can_rig.cli import check

def seen(*_):
    print(gc.isenabled(), gc.get_freeze_count() > 10_000)
    gc.unfreeze()
    raise SystemExit(0)

check.load = seen
sys.argv = ["can-rig", "check"]
from can_rig.__main__ import main
main()
"""


def test_garbage_is_looked_for_while_a_command_runs_but_not_in_what_it_imported():
    """Nor when it has ended: the first of the functions that run at the end is the last but one."""
    command = [sys.executable, "-c", COLLECTED]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.splitlines() == ["True True", "True True"]
