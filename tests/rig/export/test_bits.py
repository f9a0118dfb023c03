"""The law in C against the law in Python: the same bits after every tick, whatever the memory."""

from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from can_rig.export.compiler import FLAGS, shared_library
from can_rig.export.controllers import CompiledLaw
from can_rig.export.law import law_files
from can_rig.export.trials import different, in_python, random_table, random_trials, states_of
from firmware_model.firmware import Law
from firmware_model.target.layout import state_type, table_type
from firmware_model.target.structs import Precision

PRECISIONS: tuple[Precision, ...] = ("float64", "float32")
MEMORIES, TICKS = 150, 12


def compiled(compiler: str, level: str, precision: Precision) -> CompiledLaw:
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    before = os.environ.get("CC")
    os.environ["CC"] = compiler
    try:
        flags = [level if flag == "-O2" else flag for flag in FLAGS]
        return CompiledLaw(precision, shared_library(law_files(precision), flags))
    finally:
        os.environ.pop("CC")
        if before is not None:
            os.environ["CC"] = before


def differing(law: Law, precision: Precision, seed: int, memories: int = MEMORIES) -> int:
    """Of so many random memories and their ticks, the states that differ from Python's."""
    trials = random_trials(precision, seed, memories, TICKS)
    return different(in_python(trials), b"".join(states_of(law, trials)), trials)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("level", ["-O0", "-O1", "-O2", "-O3"])
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_every_bit_of_the_state_is_the_same(
    compiler: str, level: str, precision: Precision
) -> None:
    law = compiled(compiler, level, precision)
    memories = MEMORIES if level == "-O2" else MEMORIES // 3  # -O2: what the export's Makefile has
    assert differing(law, precision, int(level[-1]), memories) == 0


@pytest.mark.parametrize("precision", PRECISIONS)
def test_another_law_has_other_bits(precision: Precision) -> None:
    files = dict(law_files(precision))
    files["biquad.c"] = files["biquad.c"].replace("[i][1] * u -", "[i][1] * u +")
    assert files != law_files(precision)
    assert differing(CompiledLaw(precision, shared_library(files)), precision, 0, 5) > 20


@pytest.mark.parametrize("precision", PRECISIONS)
def test_structs_lie_where_numpy_has_them(tmp_path: Path, precision: Precision) -> None:
    """C says the offset of every field, as assertions that a compiler checks."""
    lines = ["#include <stddef.h>", '#include "layout.h"']

    def check(struct: str, dtype: np.dtype[np.void], path: str = "", base: int = 0) -> None:
        assert dtype.fields is not None
        for name, (kind, offset, *_) in dtype.fields.items():
            place = f"{path}{name}"
            lines.append(
                f"typedef char at_{len(lines)}"
                f"[offsetof(struct {struct}, {place}) == {base + offset} ? 1 : -1];"
            )
            if kind.names:
                check(struct, kind, f"{place}.", base + offset)

    for struct, dtype in (("layout_table", table_type), ("layout_state", state_type)):
        check(struct, dtype(precision))
        size = dtype(precision).itemsize
        lines.append(f"typedef char size_{struct}[sizeof(struct {struct}) == {size} ? 1 : -1];")
    assert len(lines) > 150
    shared_library({**law_files(precision), "offsets.c": "\n".join(lines) + "\n"})


def test_inputs_that_are_missing_are_held() -> None:
    tables = random_table(np.random.default_rng(5), "float64")
    law = CompiledLaw("float64")
    states = law.init(tables[0])
    *_, mode, _, _ = law.step_of(tables, states)(math.nan, 0.0)
    assert mode == 2
