"""Lines of a test as a module of the target: in C, or refused with file, line and remedy."""

import importlib.util
import re
import sys
import textwrap
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, reject, settings, strategies as st

from can_rig.errors import ExportError
from can_rig.export.c_files import Checked, c_files
from can_rig.export.compiler import run
from can_rig.export.law import number_headers
from can_rig.export.source import REAL, Record, Sources
from can_rig.export.subset import Program

HEADER = """
import math
from math import pi
import numpy as np
from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from typing import Annotated
from firmware_model.law.structs import FloatArray, Records, Struct

OTHER = 0.1
MANY, HUGE = 7, 2**32
NOTHING = math.nan
ANNOTATED: int = 3
class Row(Struct):
    k: Annotated[int, "1", "an integer", (0, 2)]
    v: Annotated[float, "1", "a number"]

class State(Struct):
    a: Annotated[float, "1", "a number"]
    n: Annotated[int, "1", "an integer"]
    of_table: Annotated[int, "1", "an integer of a table", (0, 4)]
    begun: Annotated[int, "1", "an integer that begins with zero", (1, 4)]
    list: Annotated[FloatArray, "1", "an array", (4,)]
    grid: Annotated[FloatArray, "1", "a matrix", (4, 2)]
    rows: Annotated[Records[Row], "1", "structs", (3,)]

@firmware
def clear(rows: Records[Row]) -> None:
    for i in range(3):
        row = rows[i]
        row.v = 0.0

@firmware
def lift(row: Row) -> float:
    row.v += real(1.0, row.v)
    return row.v

@firmware
def count(state: State) -> float:
    state.a += real(1.0, state.a)
    answer: float = state.a
    return answer

@firmware
def change(state: State) -> None:
    state.n = 2 if state.a > 0.0 else 0

@firmware
def choose(state: State, n: int) -> int:
    return n if state.a > 0.0 else 0

@firmware
def bump(state: State) -> int:
    state.n = (state.n + 1) % 2
    return state.n

@firmware
def through(state: State) -> float:
    part = state.list
    part[0] += real(1.0, state.a)
    return part[0]

@firmware
def again(x: float) -> float:
    return x

renamed = again

@firmware
def again(x: float) -> float:
    return -x

@firmware
def pair(x: float) -> tuple[float, float]:
    y = x
    return x, y

"""
COMPILED = "from firmware_model.compiled import firmware\n"


@pytest.fixture
def translate(tmp_path):
    """Translates a function from its text, into a folder."""
    return lambda text: translated(text, tmp_path)


def translated(text: str, folder: Path) -> Path:
    """``folder``, with the C of a function ``f(state: State, x: float)``."""
    path = folder / "lines.py"
    path.write_text(HEADER + textwrap.dedent(text), encoding="utf-8")
    spec = importlib.util.spec_from_file_location("lines", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["lines"] = module
    try:
        spec.loader.exec_module(module)
        sources = Sources()
        source = sources.module("lines")
        program = Program(sources)
        struct = source.structs[module.State]
        program.add(source.functions["f"], [Record(struct), REAL])
        files = c_files(Checked(program, {"lines_f"}), [struct], "float64")
    finally:
        del sys.modules["lines"]
    for name, written in (files | number_headers("float64")).items():
        (folder / name).write_text(written, encoding="utf-8")
    return folder


def compile_in(folder: Path) -> None:
    """Let the C compiler look at what ``translated`` wrote."""
    for standard in ("c99", "gnu17"):
        run(["cc", f"-std={standard}", "-pedantic-errors", "-fsyntax-only", "lines.c"], folder)


REFUSED = {
    "y = 2.0 * x": "2.0 has no precision: must be real(2.0, x)",
    "y = OTHER * x": "OTHER has no precision: must be real(OTHER, x)",
    "y = 1.0": "y gets a literal without a precision: must be real(..., x)",
    "y = x * state.n": "a real number and an integer: must be real(n, x)",
    "y = state.n / state.n": "state.n is an integer: must be a real number",
    "y = x % x": "x is a real number: must be an integer",
    "y = x ** x": "x ** x: must be +, -, *, / or %",
    "state.n = x": "state.n gets a real number: must be an integer",
    "state.a = state.n": "state.a gets an integer: must be a real number",
    "y = x\n    y = state.n": "y is a real number before and an integer here",
    "if x > 0.1:\n        pass": "0.1 has no precision",
    "if x:\n        pass": "x is a real number: must be a truth value or an integer",
    "if 0.0 < x < 1.0:\n        pass": "must be two comparisons",
    "while x > 0.0:\n        pass": "while x > 0.0: must be an assignment, a call, if, for",
    "for y in state.list:\n        pass": "must be for i in range(stop), range(start, stop) or",
    "for i in range(4):\n        i = 2": "i counts a loop: must not be assigned",
    "for i in range(state.n):\n        state.n = 2": "range(state.n): must be a name, a number",
    "y = math.exp(x)": "math.exp(x): must be a function of the target",
    "y = np.sin(x)": "np.sin(x): must be a function of the target",
    "y = np.float64(x)": "np.float64(x): must be a function of the target",
    "y = [x]": "[x]: the subset has no such thing",
    "y = (lambda z: z)(x)": "must be a function of the target",
    "y = state.rows.a": "state.rows.a: an array of 3 structs lines_row has no such field",
    "state.rows[3].v = x": "state.rows[3]: index 3 must be from 0 to 2",
    "state.rows[:] = x": "state.rows[:] is an array of 3 structs lines_row: must have an index",
    "state.rows[0] = x": "state.rows[0] gets a real number: must be the struct lines_row",
    "for i in range(4):\n        state.rows[i].v = x": "state.rows[i]: index 3 is possible",
    "y = state.list[state.rows[state.of_table].k]": "state.rows[state.of_table]: index 4 is",
    "state.rows[1].k = 3": "can be beyond its declared range: must be from 0 to 2",
    "for i in range(3):\n        if state.rows[i].k < 2:\n            k = state.rows[2 - i].k\n"
    "            state.rows[k + 1].v = x": "index 3 is possible",
    "y = state.rows[0].v + lift(state.rows[0])": "lift(state.rows[0]) changes something",
    "y = state.b": "the struct lines_state has no such field",
    "y = unknown": "unknown: must be a name of this function, or a number of the module",
    "y = state.grid[1]": "state.grid[1]: must have an index for each of (4, 2)",
    "y = state.list[x]": "x is a real number: must be an integer",
    "y = state.list[1:state.n]": "its ends must be integers of the source",
    "state.list = x": "must be an array of shape (4,)",
    "y = x + count(state) * state.a": "count(state) changes something",
    "y = state.a + count(state)": "count(state) changes something",
    "state.a += count(state)": "count(state) changes something",
    "y = pair(state.a)[0]": "pair(state.a) is 2 values: must be an array",
    "y, z, w = pair(x)": "pair(x) is 2 values: must be 3 values",
    "y = count(state, x)": "count(state, x): must have 1 arguments by position",
    "y = count(state=state)": "must have 1 arguments by position",
    "y = pair(1.0)": "1.0 has no precision: must be real(1.0, x)",
    "y = pair(state.n)": "x is an integer: its annotation must say so",
    "state.a, state.list[0] = state.list[0], state.a": "may be what was just assigned",
    "y, z = z, y": "z: must be a name of this function",
    "f(state, x)": "f calls itself: must be a loop",
    "y = x if x > 0.0 else state.n": "both answers must be alike",
    "y = max(x, 1)": "all must be real, or all integers",
    "y = min(x)": "must be a function of the target",
    "state.n %= 3": "must be x = x % n",
    "global y": "must be an assignment, a call, if",
    "y = 'text'": "must be a number",
    "y = x is x": "must be <, <=, >, >=, == or !=",
    "y = ~state.n": "must be -x or not x",
    "del x": "must be an assignment, a call, if",
    "y = state.list[-1]": "state.list[-1]: index -1 must be from 0 to 3",
    "y = state.list[4]": "state.list[4]: index 4 must be from 0 to 3",
    "state.list[MANY] = x": "state.list[MANY]: index 7 must be from 0 to 3",
    "y = state.grid[3, 2]": "state.grid[3, 2]: index 2 must be from 0 to 1",
    "for i in range(4):\n        pass\n    state.n = i": "i ends with its loop",
    "for i in range(4):\n        pass\n    i = 2": "i counts a loop: must not be assigned",
    "i = 2\n    for i in range(4):\n        pass": "i has another use: must be a name that only",
    "for i in range(4):\n        for i in range(2):\n            pass": "i has another use",
    "if x > 0.0:\n        y = x\n    state.a = y": "y: must be assigned on every way",
    "if x > 0.0:\n        y = x\n    else:\n        z = x\n    y += x": "y: must be assigned",
    "for i in range(4):\n        y = x\n    state.a = y": "y: must be assigned on every way",
    "for i in range(4):\n        if x > 0.0:\n            break\n        y = x\n    y = y + x":
        "y: must be assigned on every way",
    "state.n = MANY\n    MANY = 2": "MANY: must be assigned on every way that leads here",
    "return\n    state.a = x": "is never reached: must not be there",
    "state.n = 2147483648": "2147483648: must be an integer from -2**31 to 2**31 - 1",
    "state.n = -2147483649": "-2147483649: must be an integer from -2**31 to 2**31 - 1",
    "state.n = HUGE": "HUGE: must be an integer from -2**31 to 2**31 - 1",
    "state.n = state.n % 0": "state.n % 0: must not divide by 0",
    "for i in range(9):\n        state.list[i] = x":
        "state.list[i]: index 8 is possible: must be from 0 to 3",
    "for i in range(4):\n        state.list[i - 1] = x":
        "state.list[i - 1]: index -1 is possible: must be from 0 to 3",
    "n = state.n\n    for i in range(n):\n        state.list[i - 1] = x": "i - 1 can be any number",
    "n = state.n\n    for i in range(n):\n        state.list[i] = x": "any index seems possible",
    "for i in range(3, -2, -1):\n        state.list[i] = x": "index -1 is possible",
    "for i in range(4):\n        for j in range(i, 3):\n            y = state.grid[i, j]":
        "state.grid[i, j]: index 2 is possible: must be from 0 to 1",
    "k = 6\n    y = state.list[k]": "state.list[k]: index 6 is possible",
    "k = 6\n    state.list[k] = x": "state.list[k]: index 6 is possible",
    "k = 3\n    if x > 0.0:\n        k = 4\n    y = state.list[k]": "index 4 is possible",
    "k = 3\n    for _ in range(9):\n        k += 1\n    y = state.list[k]": "k += 1 can be any",
    "k = 3\n    for _ in range(9):\n        if x > 0.0:\n            k = 4\n            break\n"
    "    y = state.list[k]": "index 4 is possible",
    "k = 2 if x > 0.0 else -2\n    y = state.list[k]": "index -2 is possible",
    "y = state.list[state.n % 5]": "index 4 is possible",
    "y = state.list[state.n % state.of_table]": "must not divide by 0, which is possible",
    "y = state.list[min(state.n, 3)]": "any index seems possible",
    "y = state.list[max(-1, state.n % 3) - 1]": "index -1 is possible",
    "for i in range(4):\n        y = state.list[2 * i]": "index 6 is possible",
    "k = 100000\n    state.n = k * k": "k * k can be 10000000000: must be from -2**31 to",
    "y = real(state.of_table * 1000000000, x)": "can be 4000000000: must be from -2**31 to",
    "y = real(-state.n, x)": "-state.n can be any number: must be from -2**31 to 2**31 - 1",
    "y = state.list[state.of_table]": "index 4 is possible: must be from 0 to 3",
    "y = state.list[state.n - 1]": "state.n - 1 can be any number: must be from -2**31 to",
    "if state.of_table > 0:\n        y = state.list[state.of_table]": "index 4 is possible",
    "if state.of_table < 4 or x > 0.0:\n        y = state.list[state.of_table]": "index 4 is",
    "if state.of_table < 4 and x > 0.0:\n        y = x\n    else:\n"
    "        y = state.list[state.of_table]": "index 4 is possible",
    "if state.n > 0:\n        change(state)\n        y = state.list[state.n - 1]": "index -1 is",
    "if state.of_table <= 4:\n        y = state.list[state.of_table]": "index 4 is possible",
    "for i in range(-1, 4):\n        y = state.list[min(i * i, 3)]": "index -3 is possible",
    "y = state.list[state.of_table % -3]": "state.of_table % -3 can be any number",
    "state.of_table = 5": "can be beyond its declared range: must be from 0 to 4",
    "y = state.list[int(x)]": "int(x): any number seems possible: must be compared with limits",
    "if not x < 0.0 and not x > 3.0:\n        y = state.list[int(x)]": "any number seems possible",
    "if x >= 0.0 and x < 5.0:\n        y = state.list[int(x)]": "index 5 is possible",
    "y = state.list[choose(state, 2)] + state.list[choose(state, 4)]": "index 4 is possible",
    "k = 0\n    k = m = k + 1": "k + 1: must be a name or a literal to go to several places",
    "state.list[:] = state.list[0] + x": "must be a name or a literal to go to several places",
    "state.list[:] = count(state)": "must be a name or a literal to go to several places",
    "y = state.grid[bump(state), state.n % 2]": "bump(state) changes something",
    "state.grid[bump(state), state.n % 2] += x": "bump(state) changes something",
    "y = through(state) + state.list[0]": "through(state) changes something",
    "y, y = pair(x)": "y, y = pair(x): must be different names",
    "y = real(NOTHING, x)\n    if y < 0.0:\n        pass\n    state.list[MANY - 1] = x":
        "index 6 is possible",
    "y = real(1e-50, x)\n    state.n = int(y / y)": "int(y / y): any number seems possible",
    "state.a = state.list[8 % state.begun]": "must not divide by 0, which is possible",
    "state.list[state.begun - 1] = x": "index -1 is possible",
    "state.n = ANNOTATED": "ANNOTATED: must have an assignment in a module: ANNOTATED = 3",
    "y = real(pi, x)": "pi: must have an assignment in a module: pi = 3.14159",
    "y = renamed(x)": "renamed(x): must be a function of the target",
    "größe = x": "größe: must be a name in ASCII, as C has them",
}  # fmt: skip


@pytest.mark.parametrize("line", REFUSED)
def test_what_is_outside_is_refused(translate, line):
    text = f'@firmware\ndef f(state: State, x: float) -> None:\n    """Text."""\n    {line}\n'
    with pytest.raises(ExportError, match=re.escape(REFUSED[line])) as refused:
        translate(text)
    first = HEADER.count("\n") + 4
    where = re.match(r".*lines\.py:(\d+): ", str(refused.value))
    assert where is not None
    inside = range(first, first + line.count("\n") + 1)
    elsewhere = "annotation" in str(refused.value) or "calls itself" in str(refused.value)
    assert int(where[1]) in inside or elsewhere
    assert "\n" not in str(refused.value)


NOT_A_FIELD = r"lines\.Other\.wrong: must be Annotated\["
OF_ITSELF = r"lines\.Other\.wrong: must not contain Other, which contains it"


@pytest.mark.parametrize(
    ("declaration", "line", "said"),
    [("float", 4, NOT_A_FIELD), ('Annotated[complex, "1", "a"]', 4, NOT_A_FIELD),
     ('Annotated[float, "1", "a", (0, 4)]', 4, NOT_A_FIELD),
     ('Annotated[int, "1", "a", (4, 0)]', 4, NOT_A_FIELD),
     ('Annotated[FloatArray, "1", "a", (0,)]', 4, NOT_A_FIELD),
     ('Annotated[Records[Row], "1", "a", (0,)]', 4, NOT_A_FIELD),
     ('Annotated[Records[Row], "1", "a", (3, 2)]', 4, NOT_A_FIELD),
     ('Annotated[Records[float], "1", "a", (3,)]', 4, NOT_A_FIELD),
     ('Annotated[Records["Other"], "1", "a", (3,)]', 4, OF_ITSELF),
     ('Annotated["Other", "1", "a"]', 4, OF_ITSELF),
     ('Annotated["Unknown", "1", "a"]', 2, r"name 'Unknown' is not defined")],
)  # fmt: skip
def test_a_field_that_is_declared_wrongly_is_refused(translate, declaration, line, said):
    text = f"""
        class Other(Struct):
            right: Annotated[float, "1", "a number"]
            wrong: {declaration}

        @firmware
        def f(state: State, x: float) -> None:
            pass
        """
    where = rf"lines\.py:{HEADER.count(chr(10)) + line}: {said}"
    with pytest.raises(ExportError, match=where):
        translate(text)


@pytest.mark.parametrize(
    ("signature", "body", "what"),
    [
        ("f(state: State, x: float = 1.0)", "pass", "must have parameters by position only"),
        ("f(state: State, x: int)", "pass", "x is a real number: its annotation must say so"),
        ("f(state: State, x)", "pass", "x is a real number: its annotation must say so"),
        ("f(state: State, x: float)", "if x > 0.0:\n        return x", "must end with a return"),
        ("f(state: State, x: float)", "return x, state.a", "must return different names"),
        ("f(state: State, x: float)", "return x, x", "must return different names"),
        ("f(state: State, x: float)", "return x, MANY", "must return different names"),
        ("f(state: State, x: float)", "if x > 0.0:\n        return x\n    return state.n",
         "returns an integer: must be a real number as before"),
    ],
)  # fmt: skip
def test_signatures_that_c_has_not_are_refused(translate, signature, body, what):
    with pytest.raises(ExportError, match=re.escape(what)):
        translate(f"@firmware\ndef {signature}:\n    {body}\n")


@pytest.mark.parametrize(
    "line",
    [
        "y = real(2.0, x) * x", "state.list[:] = 0.0", "state.grid[1:, :] = x",
        "y = count(state) + x", "y, _ = pair(x)", "state.a = state.list[0] = x",
        "y = -x if not x > 0.0 else abs(x)", "state.n = (state.n + 1) % 4",
        "for i in range(4):\n        state.list[i] = real(i, x)",
        "if x > 0.0:\n        y = x\n    else:\n        y = -x\n    state.a = y",
        "if x > 0.0:\n        y = x\n    else:\n        return\n    state.a = y",
        "for i in range(4):\n        if i > 1:\n            break\n        y = x\n        x = y",
        "for i in range(4):\n        pass\n    for i in range(2):\n        state.list[i] = x",
        "state.n = -2147483648", "y = state.list[3]",
        "for i in range(1, 4):\n        state.list[i - 1] = x",
        "n = state.of_table\n    for i in range(n):\n        state.list[i] = x",
        "n = state.of_table - 1\n    for i in range(n, -1, -1):\n        state.list[i] = x",
        "k = 0\n    for _ in range(3):\n        k = (k + 1) % 4\n        state.list[k] = x",
        "state.n = min(state.n + 1, 3)\n    y = state.list[state.n]",
        "k = 0\n    k += 3\n    state.list[k] = x", "y = state.list[max(0, min(state.n, 3))]",
        "for i in range(2):\n        for j in range(2):\n            state.list[2 * i + j] = x",
        "change(state)\n    y = state.list[state.n + 1]",
        "if state.of_table > 0:\n        y = state.list[state.of_table - 1]",
        "if state.of_table:\n        y = state.list[state.n % state.of_table]",
        "if not (x >= 0.0 and x < 4.0):\n        return\n    y = state.list[min(int(x), 3)]",
        "y = state.list[choose(state, 2)] + state.list[choose(state, 3)]",
        "for i in range(2 if x > 0.0 else 3):\n        state.list[i] = x",
        "clear(state.rows)\n    y = lift(state.rows[1])",
        "for i in range(3):\n        row = state.rows[i]\n        row.v = state.list[row.k]",
        "row = state.rows[1]\n    row.k = 2\n    y = state.rows[row.k].v",
        "y = state.list[1:][0]", "_ = x", "_ = count(state)", "s = state\n    s = s\n    s.a = x",
        "low = state.of_table < 4 and state.list[state.of_table] > x",
    ],
)  # fmt: skip
def test_what_is_inside_is_not(translate, line):
    compile_in(translate(f"@firmware\ndef f(state: State, x: float) -> None:\n    {line}\n"))


class CheckedArray(list[Any]):
    """An array as C has it, without an element before the first."""

    def __getitem__(self, at: Any) -> Any:
        assert 0 <= at < len(self)
        return super().__getitem__(at)

    def __setitem__(self, at: Any, value: Any) -> None:
        assert 0 <= at < len(self)
        super().__setitem__(at, value)


INTEGERS = st.recursive(
    st.sampled_from(
        [
            "k",
            "m",
            "state.n",
            "state.of_table",
            "state.rows[0].k",
            "state.rows[m].k",
            "0",
            "1",
            "2",
            "3",
            "int(x)",
        ]
    ),
    lambda of: st.one_of(
        st.tuples(of, st.sampled_from(["+", "-", "*", "%"]), of).map(
            lambda each: f"({each[0]} {each[1]} {each[2]})"
        ),
        st.tuples(st.sampled_from(["min", "max"]), of, of).map(
            lambda each: f"{each[0]}({each[1]}, {each[2]})"
        ),
        st.tuples(of, of).map(lambda each: f"({each[0]} if x > 1.0 else {each[1]})"),
    ),
    max_leaves=4,
)
ORDERS = st.sampled_from(["<", "<=", ">", ">=", "==", "!="])
TESTS = st.recursive(
    st.one_of(
        st.tuples(INTEGERS, ORDERS, INTEGERS).map(" ".join),
        st.tuples(st.just("x"), ORDERS, st.sampled_from(["0.0", "3.0"])).map(" ".join),
        st.just("changes(state)"),
    ),
    lambda of: st.one_of(
        st.tuples(of, st.sampled_from([" and ", " or "]), of).map(
            lambda each: f"({''.join(each)})"
        ),
        of.map(lambda each: f"(not {each})"),
    ),
    max_leaves=3,
)


def indented(body: list[str]) -> list[str]:
    return [f"    {line}" for line in body]


BODIES = st.recursive(
    st.one_of(
        st.tuples(st.sampled_from(["k", "m", "state.n"]), INTEGERS).map(
            lambda each: [f"{each[0]} = {each[1]}"]
        ),
        INTEGERS.map(lambda at: [f"state.list[{at}] = x"]),
        st.tuples(INTEGERS, INTEGERS).map(lambda each: [f"state.rows[{each[0]}].k = {each[1]}"]),
        st.just(["change(state)"]),
    ),
    lambda of: st.one_of(
        st.tuples(of, of).map(lambda each: [*each[0], *each[1]]),
        st.tuples(TESTS, of, of).map(
            lambda each: [f"if {each[0]}:", *indented(each[1]), "else:", *indented(each[2])]
        ),
        st.tuples(st.sampled_from(["_", "i"]), st.integers(0, 4), of).map(
            lambda each: [f"for {each[0]} in range({each[1]}):", *indented(each[2])]
        ),
    ),
    max_leaves=6,
)


@settings(max_examples=75, deadline=None)
@given(BODIES, st.lists(st.tuples(st.integers(0, 4), st.floats()), min_size=4, max_size=4))
def test_what_is_translated_never_leaves_its_array(body, runs):
    """Whatever is accepted runs in Python, call after call, with every index in its array."""
    lines = ["    k = 0", "    m = state.n", *indented(body)]
    text = (
        "@firmware\ndef changes(state: State) -> bool:\n    change(state)\n    return state.n > 1\n"
        "@firmware\ndef f(state: State, x: float) -> None:\n" + "\n".join(lines) + "\n"
    )
    with TemporaryDirectory() as folder:
        try:
            translated(text, Path(folder))
        except ExportError:
            reject()
    names: dict[str, Any] = {}
    exec("def firmware(f):\n    return f\n" + (HEADER + text).replace(COMPILED, ""), names)
    rows = CheckedArray(SimpleNamespace(k=0, v=0.0) for _ in range(3))
    state = SimpleNamespace(a=0.0, n=0, list=CheckedArray([0.0] * 4), rows=rows)
    for of_table, x in runs:
        state.of_table, state.a = of_table, x
        names["f"](state, x)


def test_no_docstring_is_no_comment(translate):
    folder = translate("@firmware\ndef f(state: State, x: float) -> None:\n    pass\n")
    assert (folder / "lines.h").read_text(encoding="utf-8").startswith("#ifndef LINES_H\n")
    assert "/* State */\nstruct lines_state {" in (folder / "lines.h").read_text(encoding="utf-8")
    compile_in(translate('@firmware\ndef f(state: State, x: float) -> None:\n    """Text."""\n'))


# --- names that C has already --------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["sqrt", "fabs", "rint", "real", "real_min", "int_max", "float_", "NAN", "INFINITY", "memset",
     "int32_t", "bool", "DBL_MAX", "INT32_MAX", "_Bool", "asm", "i", "pair_2", "linux"],
)  # fmt: skip
def test_names_that_c_has_are_others_there(translate, name):
    text = f"""
        @firmware
        def double({name}: float) -> tuple[float, float]:
            float = {name}
            return float, {name}

        @firmware
        def f(state: State, x: float) -> None:
            float, {name} = double(x)
            state.a = min(np.sqrt(np.ceil({name})), abs(np.rint({name})))
            state.n = max(state.n, 3) % 2
            {name}, _ = pair({name} if math.isfinite({name}) else x)
            state.list[:] = np.copysign({name}, float)
            for _ in range(MANY):
                state.list[:] = {name}
        """
    compile_in(translate(text))


@pytest.mark.parametrize("name", ["MANY", "lines_g", "LINES_H", "SHADE_DARK"])
@pytest.mark.parametrize("where", ["parameter", "local"])
def test_names_of_the_exported_c_are_refused(translate, name, where):
    parameter, local = (name, "y") if where == "parameter" else ("y", name)
    text = f"""
        from enum import IntEnum

        class Shade(IntEnum):
            DARK = 1

        @firmware
        def g({parameter}: float) -> float:
            {local} = -{parameter}
            return {local}

        @firmware
        def f(state: State, x: float) -> None:
            state.a = g(x) * real(MANY, x)
        """
    line = 8 if where == "parameter" else 9
    what = f":{HEADER.count(chr(10)) + line}: {name}: is a number or a function of the exported C"
    with pytest.raises(ExportError, match=what):
        translate(text)


def test_members_that_a_number_would_replace_are_refused(translate):
    text = """
        a = 2

        @firmware
        def f(state: State, x: float) -> None:
            state.list[a] = x
        """
    line = HEADER[: HEADER.index("class State")].count("\n") + 1
    with pytest.raises(ExportError, match=rf"lines\.py:{line}: a: is a number or a function"):
        translate(text)


def test_a_name_for_several_answers_must_not_hide_a_function(translate):
    text = """
        @firmware
        def g(x: float) -> float:
            return x

        @firmware
        def lines_g(x: float) -> tuple[float, float]:
            y = g(x)
            return x, y

        @firmware
        def f(state: State, x: float) -> None:
            y, z = lines_g(x)
        """
    with pytest.raises(ExportError, match="lines_g: is a number or a function of the exported C"):
        translate(text)


def test_a_number_may_have_a_name_of_the_library(translate):
    text = """
        DBL_MAX = 2.0

        @firmware
        def f(state: State, x: float) -> None:
            state.a = real(DBL_MAX, x)
        """
    assert "#define DBL_MAX_ 2.0\n" in (translate(text) / "lines.c").read_text(encoding="utf-8")
    compile_in(translate(text))
