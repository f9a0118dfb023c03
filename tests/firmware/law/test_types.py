"""A declared record is a type: what does not fit is an error before anything runs."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import pytest

from firmware_model.law.core import biquad
from firmware_model.law.structs import FloatArray, Struct, fields_of

ROOT = Path(__file__).parents[3]
LINES = """\
from firmware_model.law.core.biquad import advance
from firmware_model.law.layout import State, Table
def f(table: Table, state: State) -> None:
    state.fault_state = state.mode
    state.command_1 = advance(table.tracking.filter, state.tracking.filter, state.reference)
    state.fault_stat = 1
    state.command_1 = state.estimator.chanel_1.accumulators[0, 0]
    advance(table.tracking.filter, table.tracking.filter, 1.0)
    advance(table.tracking, state.tracking.filter, 1.0)
    state.fault_state = 0.5
"""
WRONG = {
    6: '"State" has no attribute "fault_stat"',
    7: 'has no attribute "chanel_1"',
    8: 'incompatible type "Constants"; expected "State"',
    9: 'expected "firmware_model.law.core.biquad.Constants"',
    10: 'expression has type "float", variable has type "int"',
}


@pytest.fixture(scope="module")
def errors(tmp_path_factory):
    """What mypy says with the settings of the project, by line."""
    path = tmp_path_factory.mktemp("typed") / "typed_lines.py"
    path.write_text(LINES, encoding="utf-8")
    # As a process of its own: mypy raises the limit of recursion for all that follows.
    command = [sys.executable, "-m", "mypy", "--config-file", ROOT / "pyproject.toml", path]
    said = subprocess.run(command, check=False, capture_output=True, text=True).stdout
    found = re.findall(r"typed_lines\.py:(\d+): error: (.*)$", said, re.MULTILINE)
    assert found, said
    return {int(line): text for line, text in found}


@pytest.mark.compiled  # mypy says the same of interpreted lines
@pytest.mark.parametrize("line", WRONG, ids=lambda line: LINES.splitlines()[line - 1].strip())
def test_a_wrong_line_is_a_type_error(errors, line):
    assert WRONG[line] in errors[line]


@pytest.mark.compiled
def test_right_lines_are_none(errors):
    assert errors.keys() == WRONG.keys()


class Bare(Struct):
    a: float


class Unshaped(Struct):
    a: Annotated[FloatArray, "y", "an array"]


class Text(Struct):
    a: Annotated[str, "1", "a text"]


class Shaped(Struct):
    a: Annotated[biquad.State, "y", "several structs", (2,)]


@pytest.mark.parametrize("struct", [Bare, Unshaped, Text, Shaped])
def test_a_field_that_no_target_has_is_refused(struct):
    with pytest.raises(TypeError, match=rf"test_types\.{struct.__name__}\.a: must be Annotated"):
        fields_of(struct)
