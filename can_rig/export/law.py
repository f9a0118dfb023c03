"""The control law as files of C: the functions that its entry points need."""

from __future__ import annotations

import re
import sys
from functools import cache
from importlib.resources import files
from typing import Final

from can_rig.export.translation.program import Program
from can_rig.export.translation.source import Sources
from can_rig.export.translation.types import REAL, Record, Type
from can_rig.export.writing.c_files import CFiles
from firmware_model.target import controller, layout, schedule
from firmware_model.target.structs import Precision, Struct

ENTRIES: Final = ("start_up", "step", "reset")
"""Entry points called by a node: each function takes table and state, then real numbers."""

CHANGE_SPEED: Final = "change_speed"
"""Entry point called before a step if the speed of the car changes; see ``schedule``."""


def support(name: str) -> str:
    """The text of a handwritten file, with placeholders ``{word}``."""
    return (files("can_rig.export") / "support" / name).read_text(encoding="utf-8")


def real_header(precision: Precision) -> str:
    """``real.h``: the definition of a real number."""
    single = precision == "float32"
    return filled(
        support("real.h"),
        words="single" if single else "double",
        real="float" if single else "double",
        fabs="fabsf" if single else "fabs",
        MAX="FLT_MAX" if single else "DBL_MAX",
    )


def filled(text: str, **values: str) -> str:
    """``text`` with ``{name}`` replaced; other braces, frequent in C, stay."""
    return re.sub(r"\{(\w+)\}", lambda found: values.get(found[1], found[0]), text)


def target_sources() -> Sources:
    """The modules of `firmware_model.target`, read."""
    sources = Sources()
    room = layout.__name__.rpartition(".")[0]
    for name in sorted(sys.modules):
        if name.startswith(f"{room}."):
            sources.module(name)
    return sources


def record(sources: Sources, struct: Struct) -> Record:
    """The type of a struct of the target."""
    found = sources.struct(struct)
    assert found is not None
    return Record(found)


def law_program() -> Program:
    """The typed program of the control law.

    Raises:
        ExportError: something is outside the subset.
    """
    sources = target_sources()
    program = Program(sources)
    functions = sources.module(controller.__name__).functions
    memory: list[Type] = [record(sources, layout.TABLE), record(sources, layout.STATE)]
    for name in ENTRIES:
        inputs = len(functions[name].parameters) - len(memory)
        program.add(functions[name], [*memory, *(REAL,) * inputs])
    return program


def speed_program() -> Program:
    """The typed program that blends tables by the speed of the car.

    A separate program, because the program writes the table; for the law the table is constant.

    Raises:
        ExportError: something is outside the subset.
    """
    sources = target_sources()
    program = Program(sources)
    structs = (schedule.CONSTANTS, schedule.STATE, layout.TABLE, layout.STATE)
    function = sources.module(schedule.__name__).functions[CHANGE_SPEED]
    program.add(function, [*(record(sources, each) for each in structs), REAL])
    return program


@cache
def speed_files(precision: Precision) -> dict[str, str]:
    """Text by file name of what blends designs by the speed of the car.

    Raises:
        ExportError: something is outside the subset.
    """
    program = speed_program()
    structs = [
        record(program.sources, each).struct for each in (schedule.CONSTANTS, schedule.STATE)
    ]
    written = CFiles(program, structs, {f"schedule_{CHANGE_SPEED}"}, precision).files()
    return {name: written[name] for name in ("schedule.h", "schedule.c")}


@cache
def law_files(precision: Precision, blends: bool = False) -> dict[str, str]:
    """Text by file name.

    Args:
        precision: of real numbers.
        blends: adds the code that blends designs by the speed of the car.

    Raises:
        ExportError: something is outside the subset.
    """
    program = law_program()
    structs = [record(program.sources, each).struct for each in (layout.TABLE, layout.STATE)]
    entries = {f"controller_{name}" for name in ENTRIES}
    translated = CFiles(program, structs, entries, precision).files()
    blending = speed_files(precision) if blends else {}
    return {**translated, "real.h": real_header(precision), **blending}
