"""One filter as C: the lines of the exported law, and every bit of ``Filter``."""

import ctypes
import platform
import re
import shutil
import subprocess

import numpy as np
import pytest

from can_rig.export.compiler import WARNINGS, shared_library
from can_rig.export.law import law_files
from can_rig.export.trials import reals
from firmware_model import Filter, discretise
from firmware_model.errors import ParameterError
from firmware_model.law.structs import Precision
from tests.firmware.discretisation.random_filters import random_filter
from tests.rig.export.shared import PRECISIONS, run

INTEGRATOR = discretise(([1.0, 2.0], [1.0, 3.0, 0.0]), 1e-3)
CONSTANT = discretise(([2.0], [1.0]), 1e-3)


def random_filters(precision: Precision) -> list[Filter]:
    """Random ones of any order, an integrator and a constant."""
    rng, found = np.random.default_rng(11), [INTEGRATOR, CONSTANT]
    while len(found) < 12:
        g, tick_s = random_filter(rng)
        found.append(discretise(g, tick_s, precision="float64"))
    kept = []
    for each in found:
        try:
            kept.append(each.in_precision(precision))
        except ParameterError:  # too slow for its tick in single precision
            continue
    return kept


def in_one_library(filters: list[Filter]) -> ctypes.CDLL:
    files: dict[str, str] = {}
    for n, each in enumerate(filters):
        files |= each.to_c(f"filter_{n}")
    return ctypes.CDLL(str(shared_library(files)))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_every_answer_and_every_state_is_the_same(precision):
    filters, random = random_filters(precision), np.random.default_rng(1)
    library = in_one_library(filters)
    real = ctypes.c_float if precision == "float32" else ctypes.c_double
    assert len(filters) >= 8
    for n, made in enumerate(filters):
        step, reset = (getattr(library, f"filter_{n}_{name}") for name in ("step", "reset"))
        for function in (step, reset):
            function.argtypes, function.restype = [ctypes.c_void_p, real], real
        state = np.zeros((len(made.sections.coefficients), 2), precision)
        for round_ in range(6):
            value = float(reals(random, (), precision)) if round_ else 0.0
            answers = [(reset(state.ctypes.data, value), made.reset(value))]
            u = reals(random, (50,), precision)
            answers += zip((step(state.ctypes.data, float(x)) for x in u), made.run(u), strict=True)
            one, other = np.array(answers, precision).T
            assert np.array_equal(one, other, equal_nan=True)
            assert np.array_equal(np.signbit(one[one == 0]), np.signbit(other[other == 0]))


@pytest.mark.parametrize("precision", PRECISIONS)
def test_the_loops_are_those_of_the_exported_law(precision):
    def loops(text: str) -> list[str]:
        return re.findall(r"    for \(.*?\n    }\n", text, flags=re.S)

    law = law_files(precision)["biquad.c"].replace("cascade->n", "FILTER_SECTIONS")
    own = re.sub(r"\b(float|double)\b", "real", CONSTANT.in_precision(precision).to_c()["filter.c"])
    assert len(loops(own)) == 2
    assert set(loops(own)) < set(loops(law))  # the law has biquad_output too


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_no_compiler_warns(compiler, precision, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    prewarped = discretise(([1.0], [1.0, 30.0, 900.0]), 2e-3, prewarp_rad_per_s=30.0)
    for name, text in prewarped.in_precision(precision).to_c("low_pass").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        assert max(map(len, text.splitlines())) <= 120
    command = [compiler, "-std=c99", "-Werror", *WARNINGS, "-c", "low_pass.c"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)


@pytest.mark.skipif(
    platform.machine() != "x86_64" or shutil.which("gcc") is None, reason="no gcc for x86-64"
)
def test_gcc_fuses_nothing_as_it_comes(tmp_path):
    """Outside -std=c99 gcc fuses where a processor can, unless the file forbids that."""
    for name, text in INTEGRATOR.to_c().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    code = run("gcc", "-O2", "-mfma", "-S", "filter.c", "-o", "-", cwd=tmp_path)
    assert "vmulsd" in code
    assert not re.search("vfn?m", code)
