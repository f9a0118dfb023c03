"""The constant table of a scenario as one ``const`` struct of C."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from can_rig.export.writing.c_text import INDENT, WIDTH, comment, name, number, wrapped
from firmware_model.target.layout import TABLE, precision_of
from firmware_model.target.schedule import CONSTANTS
from firmware_model.target.structs import Field, Precision, Record, Struct


def constants_source(table: Record, title: str, speeds: Record | None = None) -> str:
    """``constants.c``: the table, with exact numbers.

    Args:
        table: of ``tables.build``.
        title: the description of the table.
        speeds: of ``schedules.schedule``, where the speed of the car changes.
    """
    lines = [
        *comment(title), '#include "constants.h"', "",
        "const struct layout_table controller_table = {",
        *_members(TABLE, table, precision_of(table), INDENT),
        "};",
    ]  # fmt: skip
    if speeds is not None:
        members = _members(CONSTANTS, speeds, precision_of(table), INDENT)
        lines += ["", "const struct schedule_constants controller_schedule = {", *members, "};"]
    return "\n".join(lines) + "\n"


def constants_header(title: str, speeds: Record | None = None) -> str:
    """``constants.h``, which declares the table."""
    more = [] if speeds is None else ["extern const struct schedule_constants controller_schedule;"]
    lines = [
        *comment(title), "#ifndef CONSTANTS_H", "#define CONSTANTS_H", "", '#include "layout.h"',
        *([] if speeds is None else ['#include "schedule.h"']),
        "", "extern const struct layout_table controller_table;", *more,
        "", "#endif",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _members(struct: Struct, record: Any, precision: Precision, indent: str) -> Iterator[str]:
    """Every member except zeros; C initialises missing members with zero."""
    zeros = []
    for field in struct:
        value = record[field.name]
        if isinstance(field.kind, tuple):
            inside = list(_members(field.kind, value, precision, indent + INDENT))
            yield from (f"{indent}.{name(field.name)} = {{", *inside, f"{indent}}},")
        elif _is_zero(np.asarray(value)):
            zeros.append(field)
        else:
            yield from _member(field, np.asarray(value), precision, indent)
    if len(zeros) == len(struct):  # an initialiser must not be empty
        nested = len(struct[0].shape)
        yield f"{indent}.{name(struct[0].name)} = {'{' * nested}0{'}' * nested},"


def _member(field: Field, value: Any, precision: Precision, indent: str) -> Iterator[str]:
    unit = "" if field.unit == "1" else f"[{field.unit}] "
    remark = f" /* {unit}{field.meaning} */".replace("*/ */", "*/")
    if value.ndim < 2:
        text = f".{name(field.name)} = {_initialiser(field, value, precision)},"
        if len(indent + text + remark) <= WIDTH:
            yield indent + text + remark
        else:
            yield from (indent + remark[1:], *wrapped(text, indent))
        return
    yield f"{indent}.{name(field.name)} = {{{remark}"
    last = max(at for at, row in enumerate(value) if not _is_zero(row))
    for row in value[: last + 1]:
        yield from wrapped(f"{_initialiser(field, row, precision)},", indent + INDENT)
    yield f"{indent}}},"


def _initialiser(field: Field, value: Any, precision: Precision) -> str:
    if np.ndim(value):
        last = max((at for at, one in enumerate(value) if not _is_zero(one)), default=0)
        return (
            f"{{{', '.join(_initialiser(field, each, precision) for each in value[: last + 1])}}}"
        )
    return number(float(value), precision) if field.kind == "real" else str(int(value))


def _is_zero(value: Any) -> bool:
    """Whether all elements equal C's default initialisation: -0.0 does not."""
    return not np.any(value) and not np.any(np.signbit(value))
