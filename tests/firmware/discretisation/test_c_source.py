"""A filter's C files as text; `tests/rig/export` compares their results."""

import re

import numpy as np
import pytest

from firmware_model import discretise
from firmware_model.errors import ParameterError

LEAD = discretise(([1.0, 5.0], [1.0, 500.0]), 1e-3)
THIRD = discretise(([2.0], [1.0, 3.0, 4.0, 5.0]), 1e-3, "zoh")


@pytest.mark.parametrize("precision", ["float64", "float32"])
@pytest.mark.parametrize("made", [LEAD, THIRD])
def test_every_coefficient_is_exact(made, precision):
    stored = made.in_precision(precision)
    header, source = stored.to_c("lead").values()
    suffix = "f" if precision == "float32" else ""
    rows = re.findall(r"^    \{(.*)\},$", source, flags=re.M)
    literals = [[each.removesuffix(suffix) for each in row.split(", ")] for row in rows]
    assert np.array_equal(np.array(literals, precision), stored.sections.coefficients)
    assert f"#define LEAD_SECTIONS {len(rows)}\n" in header
    assert "$" not in header + source


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_real_numbers_have_one_type(precision):
    texts = LEAD.in_precision(precision).to_c().values()
    code = re.sub(r"/\*.*?\*/", "", "".join(texts), flags=re.S)
    assert ("double" in code) == (precision == "float64") == ("float " not in code)
    assert bool(re.search(r"\d\.\d+(?![\df.e])", code)) == (precision == "float64")


def test_files_have_the_name_and_say_what_they_are():
    files = LEAD.to_c("lead")
    assert sorted(files) == ["lead.c", "lead.h"]
    assert "Filter of order 1, tustin, tick 0.001 s, float64: DC gain 0.01" in files["lead.h"]
    assert "double lead_step(struct lead *state, double u);" in files["lead.h"]


@pytest.mark.parametrize("name", ["", "2nd", "low-pass", "a b", "é", "a\n"])
def test_a_name_that_is_none_in_c_is_refused(name):
    with pytest.raises(ParameterError, match="must be a name in C"):
        LEAD.to_c(name)


TAKEN = {
    "a keyword of C,": "int float while bool asm",
    "a keyword of C++": "class new this template or xor",
    "a name of the C library": "NULL EOF errno assert NAN INFINITY DBL_MAX INT32_MAX int32_t div_t "
    "math stdint signal",  # NAME.h would stand before the library's header
    "a macro of some compilers": "linux unix",
}


@pytest.mark.parametrize("whose", TAKEN)
def test_a_name_that_is_taken_is_refused(whose):
    for name in TAKEN[whose].split():
        with pytest.raises(ParameterError, match=re.escape(f"name = '{name}': is {whose}")):
            LEAD.to_c(name)
    assert LEAD.to_c(f"{name}_")
