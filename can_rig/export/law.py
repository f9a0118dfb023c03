"""The control law as files of C: the functions that its entry points need."""

import re
import sys
from collections.abc import Collection, Mapping
from functools import cache
from importlib.resources import files
from typing import Final

from can_rig.export.c_files import Checked, c_files
from can_rig.export.source import INT, REAL, Record, Sources, Type
from can_rig.export.subset import Program
from firmware_model.law import controller, layout, schedule
from firmware_model.law.structs import Precision
from firmware_model.law.supervision import further_sensors, knowledge

ENTRIES: Final = ("start_up", "step", "reset")
"""Entry points called by a node: each function takes table and state, then real numbers."""

HEAR: Final = "hear"
"""Entry point called before a step for each sample of a further sensor; see ``further_sensors``."""

SAVE: Final = "save"
"""Entry point called by a node that saves its state; see ``knowledge``."""

CHANGE_SPEED: Final = "change_speed"
"""Entry point called before a step if the speed of the car changes; see ``schedule``."""

BLENDS: Final = "blends"
HEARS: Final = "hears"
NODE: Final = "node"
SINGLE: Final = "single"
SENSORS: Final = "sensors"
"""Parts of handwritten files: for designs blended by the speed, for a node that hears a speed, for
a whole node, for single precision, for a node that hears further sensors."""


def support(name: str, parts: Collection[str] = (), **values: str) -> str:
    """A handwritten file; other braces than those of ``values``, frequent in C, stay.

    Args:
        name: the name of the file.
        parts: lines between ``//: if PART``, ``//: else`` and ``//: end`` depend on them.
        values: texts in the place of ``{name}``.
    """
    text = (files("can_rig.export") / "support" / name).read_text(encoding="utf-8")
    kept, holds = [], [True]
    for line in text.splitlines(keepends=True):
        match line.split() if line.startswith("//:") else []:
            case [_, "if", part]:
                holds.append(part in parts)
            case [_, "else"]:
                holds[-1] = not holds[-1]
            case [_, "end"]:
                holds.pop()
            case _ if all(holds):
                kept.append(line)
    return re.sub(r"\{(\w+)\}", lambda found: values.get(found[1], found[0]), "".join(kept))


def parts_of(texts: Mapping[str, str]) -> set[str]:
    """Parts of handwritten files that go with the files of a law or of a whole node."""
    marks = {
        BLENDS: ("schedule.c", ""), NODE: ("ecu.c", ""),
        HEARS: ("frames.h", "frame_speed"), SENSORS: ("ecu.h", "ECU_SENSORS"),
    }  # fmt: skip
    return {part for part, (name, mark) in marks.items() if mark in texts.get(name, ())}


def numbers_of(precision: Precision) -> dict[str, str]:
    """Texts of handwritten files that depend on the precision of real numbers."""
    if precision == "float32":
        return {
            "words": "single", "real": "float", "fabs": "fabsf", "MAX": "FLT_MAX", "zero": "0.0f",
            "bits": "uint32_t", "infinite": "0xFF", "mantissa": "23",
        }  # fmt: skip
    return {
        "words": "double", "real": "double", "fabs": "fabs", "MAX": "DBL_MAX", "zero": "0.0",
        "bits": "uint64_t", "infinite": "0x7FF", "mantissa": "52",
    }  # fmt: skip


def number_headers(precision: Precision) -> dict[str, str]:
    """The headers about real numbers, text by file name."""
    headers = ("real.h", "rounding.h")
    return {name: support(name, **numbers_of(precision)) for name in headers}


def _target_sources() -> Sources:
    """The modules of `firmware_model.law`, read."""
    room = layout.__name__.rpartition(".")[0]
    return _read(tuple(name for name in sorted(sys.modules) if name.startswith(f"{room}.")))


@cache
def _read(modules: tuple[str, ...]) -> Sources:
    sources = Sources()
    for name in modules:
        sources.module(name)
    return sources


def check_declarations() -> None:
    """Check the structs of the law, before a table is built of them.

    Raises:
        ExportError: a field is declared wrongly.
    """
    for module in _target_sources().modules.values():
        _ = module.structs


def law_modules() -> dict[str, str]:
    """The full name of each module of the law, by its file's name in C."""
    found = _target_sources().modules.values()
    return {module.name: module.namespace.__name__ for module in found}


def _records(sources: Sources, *memory: object) -> list[Record]:
    """The types of structs of the target."""
    found = (sources.struct(each) for each in memory)
    return [Record(struct) for struct in found if struct is not None]


@cache
def law_program() -> Program:
    """The typed program of the control law.

    Raises:
        ExportError: something is outside the subset.
    """
    program = Program(_target_sources())
    functions = program.sources.module(controller.__name__).functions
    memory: list[Type] = [*_records(program.sources, layout.Table, layout.State)]
    for name in ENTRIES:
        inputs = len(functions[name].parameters) - len(memory)
        program.add(functions[name], [*memory, *(REAL,) * inputs])
    hear = program.sources.module(further_sensors.__name__).functions[HEAR]
    program.add(hear, [*memory, REAL, REAL, REAL])
    save = program.sources.module(knowledge.__name__).functions[SAVE]
    program.add(save, [*_records(program.sources, layout.Supervision), INT])
    return program


@cache
def speed_program() -> Program:
    """The typed program that blends tables by the speed of the car.

    A separate program, because the program writes the table; for the law the table is constant.

    Raises:
        ExportError: something is outside the subset.
    """
    program = Program(_target_sources())
    structs = (schedule.Constants, schedule.State, layout.Table, layout.State)
    function = program.sources.module(schedule.__name__).functions[CHANGE_SPEED]
    program.add(function, [*_records(program.sources, *structs), REAL])
    return program


@cache
def law_files(precision: Precision, blends: bool = False) -> dict[str, str]:
    """Text by file name.

    Args:
        precision: of real numbers.
        blends: adds the code that blends designs by the speed of the car.

    Raises:
        ExportError: something is outside the subset.
    """
    checked = _checked(blends)
    memory = (schedule.Constants, schedule.State) if blends else (layout.Table, layout.State)
    structs = [each.struct for each in _records(checked.program.sources, *memory)]
    found = c_files(checked, structs, precision)
    if blends:
        return law_files(precision) | {name: found[name] for name in ("schedule.h", "schedule.c")}
    return found | number_headers(precision)


@cache  # for both precisions
def _checked(blends: bool) -> Checked:
    if blends:
        return Checked(speed_program(), {f"schedule_{CHANGE_SPEED}"})
    entries = {f"controller_{name}" for name in ENTRIES}
    return Checked(law_program(), entries | {f"further_sensors_{HEAR}", f"knowledge_{SAVE}"})
