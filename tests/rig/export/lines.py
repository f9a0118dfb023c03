"""Lines of a test as a module of the target, translated to C."""

from __future__ import annotations

import importlib.util
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

from can_rig.export.c_files import c_files
from can_rig.export.compiler import run
from can_rig.export.law import real_header
from can_rig.export.source import REAL, Record, Sources
from can_rig.export.subset import Program

HEADER = """
import math
import numpy as np
from firmware_model.compiled import firmware
from firmware_model.target.precision import real
from firmware_model.target.structs import Field, Record

OTHER = 0.1
MANY, HUGE = 7, 2**32
STATE = (
    Field("a", "1", "a number"),
    Field("n", "1", "an integer", "int32"),
    Field("list", "1", "an array", shape=(4,)),
    Field("grid", "1", "a matrix", shape=(4, 2)),
)

@firmware
def count(state: Record) -> float:
    state.a += real(1.0, state.a)
    answer: float = state.a
    return answer

@firmware
def pair(x: float) -> tuple[float, float]:
    y = x
    return x, y

"""
Translate = Callable[[str], Path]


def translated(text: str, folder: Path) -> Path:
    """``folder``, with the C of a function ``f(state: Record, x: float)``."""
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
        struct = source.structs[id(module.STATE)]
        program.add(source.functions["f"], [Record(struct), REAL])
        files = c_files(program, [struct], {"lines_f"}, "float64")
    finally:
        del sys.modules["lines"]
    for name, written in (files | {"real.h": real_header("float64")}).items():
        (folder / name).write_text(written, encoding="utf-8")
    return folder


def compile_in(folder: Path) -> None:
    """Let the C compiler look at what ``translated`` wrote."""
    run(["cc", "-std=c99", "-pedantic-errors", "-fsyntax-only", "lines.c"], folder)
