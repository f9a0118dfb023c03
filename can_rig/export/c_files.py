"""A pair of .c and .h for each module of the target, and the constant table of a scenario in C.

Numbers that the source names become macros of C.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from can_rig.export.c_functions import CFunction, declarator, signature
from can_rig.export.c_text import (
    INDENT,
    WIDTH,
    comment,
    name,
    number,
    plain,
    with_comment,
    wrapped,
)
from can_rig.export.effects import Effects
from can_rig.export.source import Answers, CStruct, Module, Record, Sources, snake
from can_rig.export.subset import Program, Typed
from firmware_model.law.layout import Table, precision_of
from firmware_model.law.schedule import Constants
from firmware_model.law.structs import Field, Precision, Struct, fields_of

_ELSEWHERE: Final = "is a number or a function of the exported C too: must be another name"
_TITLES: Final = {"CONSTANTS": "Constants", "STATE": "State", "TABLE": "The constant table"}


class Names:
    """The named numbers of a program, each in its defining module.

    Args:
        program: the program.
        precision: of its real numbers.

    Raises:
        ExportError: a number's name or a function's name would hide another name.
    """

    def __init__(self, program: Program, precision: Precision) -> None:
        self._sources = program.sources
        self._precision: Precision = precision
        self._used: dict[tuple[str, str], set[str]] = {}  # (module, name) → using modules
        self._homes: dict[str, Module] = {}
        for typed in program.functions.values():
            user = typed.function.module
            for statement in typed.function.body:
                for node in ast.walk(statement):
                    if isinstance(node, ast.Name) and node.id not in typed.names:
                        value = user.lookup(node.id)
                        if isinstance(value, int | float):
                            home = _origin(self._sources, user, node.id)
                            self._homes[home.name] = home
                            self._used.setdefault((home.name, node.id), set()).add(user.name)
        self._check(program)

    def headers(self, user: Module) -> set[str]:
        """Modules whose names or enumerations ``user`` uses."""
        used = [(home, name) for (home, name), users in self._used.items() if user.name in users]
        homes = {home for home, _ in used}
        for home, name_ in used:
            homes |= {enum.name for enum, _ in self._enumerator(self._homes[home], name_)}
        return homes - {user.name}

    def definitions(self, home: Module, private: bool) -> list[str]:
        """Definitions of ``home`` as macros: private without users in other modules."""
        lines = []
        for found, node in home.assignments.items():
            users = self._used.get((home.name, found))
            if users is None or (users == {home.name}) != private:
                continue
            value = home.lookup(found)
            text = str(value) if isinstance(value, int) else number(value, self._precision)
            for _, enumerator in self._enumerator(home, found):
                text = enumerator
            if text == name(found):
                continue
            line = f"#define {name(found)} {text if value >= 0 else f'({text})'}"
            said = home.comments.get(node.lineno)
            lines += with_comment(line, said.text, "") if said and not said.alone else [line]
        return lines

    def _check(self, program: Program) -> None:
        """Refuse a local name or a member of a struct that means something else in C."""
        modules = self._sources.modules.values()
        macros = {f"{module.name.upper()}_H" for module in modules}
        macros |= {name(used) for _, used in self._used}
        taken = macros | set(program.functions)
        for module in modules:
            taken |= {_enumerator(n, each.name) for n, e in module.enums.items() for each in e}
            for struct in module.structs.values():
                for field in struct.fields:
                    if name(field.name) in macros:
                        at = ast.Pass(lineno=struct.line)
                        raise module.refuse(at, f"{field.name}: {_ELSEWHERE}")
        for typed in program.functions.values():
            for local, node in _locals(typed).items():
                if name(local) in taken:
                    raise typed.function.module.refuse(node, f"{local}: {_ELSEWHERE}")

    def _enumerator(self, home: Module, found: str) -> Iterator[tuple[Module, str]]:
        """The enumerator called ``found``, if any."""
        match home.assignments[found]:
            case ast.Call(
                func=ast.Name(id="int"),
                args=[ast.Attribute(value=ast.Name(id=enum), attr=member)],
            ):
                declared = home.lookup(enum)
                module = self._sources.module(declared.__module__)
                yield module, _enumerator(enum, member)


def _locals(typed: Typed) -> dict[str, ast.AST]:
    """Names declared in a C function: local names, and names for calls with several results."""
    calls = typed.calls.items()
    found: dict[str, ast.AST] = {
        each.function.name: call for call, each in calls if isinstance(each.result, Answers)
    }
    for node in ast.walk(typed.function.tree):
        local = getattr(node, "id", getattr(node, "arg", None))
        if local in typed.names:
            found.setdefault(local, node)
    return found


def _origin(sources: Sources, user: Module, found: str) -> Module:
    """The module that defines ``found`` as used in ``user``."""
    for node in user.tree.body:
        names = [alias.name for alias in getattr(node, "names", [])]
        if isinstance(node, ast.ImportFrom) and node.module and found in names:
            return _origin(sources, sources.module(node.module), found)
    return user


def _enumerator(enum: str, member: str) -> str:
    """FaultState.CLEAR as FAULT_STATE_CLEAR."""
    return f"{snake(enum).upper()}_{member}"


def _enumerations(module: Module) -> list[str]:
    """C code of every enumeration in ``module``, with comments from the docstrings."""
    lines: list[str] = []
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.name not in module.enums:
            continue
        lines += ["", *comment(ast.get_docstring(node) or node.name)]
        lines.append(f"enum {module.name}_{snake(node.name)} {{")
        for each, after in zip(node.body, [*node.body[1:], None], strict=True):
            match each:
                case ast.Assign(
                    targets=[ast.Name(id=member)], value=ast.Constant(value=int(value))
                ):
                    line = f"    {_enumerator(node.name, member)} = {value},"
                    match after:
                        case ast.Expr(value=ast.Constant(value=str(said))):
                            lines += with_comment(line, plain(said), "    ")
                        case _:
                            lines.append(line)
        lines.append("};")
    return lines


def c_files(
    program: Program, structs: list[CStruct], entries: set[str], precision: Precision
) -> dict[str, str]:
    """The files of a program, text by file name.

    Args:
        program: the program.
        structs: its memory: structs named by other programs; the functions need not use every
            struct.
        entries: C names of the functions called by other programs.
        precision: of its real numbers.

    Raises:
        ExportError: C has another meaning for a name, or another order of evaluation.
    """
    return _CFiles(program, structs, entries, precision).files()


class _CFiles:
    def __init__(
        self, program: Program, structs: list[CStruct], entries: set[str], precision: Precision
    ) -> None:
        self._program = program
        self._precision: Precision = precision
        self._effects = Effects(program)
        self._names = Names(program, precision)
        self._structs = list(self._with_members(structs))
        self._public = entries | {
            callee.function.c_name
            for typed in program.functions.values()
            for callee in typed.calls.values()
            if callee.function.module is not typed.function.module
        }

    def files(self) -> dict[str, str]:
        found = {}
        for module in self._modules():
            found[f"{module.name}.h"] = _text(self._header(module))
            if any(self._functions(module)):
                found[f"{module.name}.c"] = _text(self._source(module))
        return found

    def _modules(self) -> list[Module]:
        """Modules with C code."""
        wanted = {module.name for module in self._program.modules}
        wanted |= {struct.module for struct in self._structs}
        for module in self._program.modules:
            wanted |= self._names.headers(module)
        modules = {module.name: module for module in self._program.sources.modules.values()}
        return [each for each in modules.values() if each.name in wanted or each.enums]

    def _with_members(self, structs: list[CStruct]) -> dict[CStruct, None]:
        """Each struct once, after the structs of its members."""
        found: dict[CStruct, None] = {}
        for struct in structs:
            found |= self._with_members(self._members(struct)) | {struct: None}
        return found

    def _members(self, struct: CStruct) -> list[CStruct]:
        found = (self._program.sources.struct(field.kind) for field in struct.fields)
        return [each for each in found if each is not None]

    def _functions(self, module: Module) -> list[Typed]:
        return [
            typed for typed in self._program.functions.values() if typed.function.module is module
        ]

    def _header(self, module: Module) -> list[str]:
        guard = f"{module.name.upper()}_H"
        own = [struct for struct in self._structs if struct.module == module.name]
        exported = [t for t in self._functions(module) if t.function.c_name in self._public]
        needed = {m.module for struct in own for m in self._members(struct)} - {module.name}
        lines = comment(module.docstring)
        lines += [f"#ifndef {guard}", f"#define {guard}", "", '#include "real.h"']
        lines += [f'#include "{each}.h"' for each in sorted(needed)]
        lines += ["", *self._names.definitions(module, private=False), *_enumerations(module)]
        for struct in own:
            lines += ["", *self._struct(struct, module)]
        outside = {
            kind.struct.tag
            for typed in exported
            for kind in typed.arguments
            if isinstance(kind, Record) and kind.struct.module not in needed | {module.name}
        }
        lines += ["", *(f"struct {tag};" for tag in sorted(outside))]
        for typed in exported:
            lines += ["", *_answers(typed), *comment(typed.function.docstring)]
            lines += wrapped(f"{signature(typed, self._effects)};", "")
        return [*lines, "", "#endif"]

    def _struct(self, struct: CStruct, module: Module) -> list[str]:
        python = struct.tag.removeprefix(f"{struct.module}_").upper()
        title = [_TITLES.get(python, python.capitalize().replace("_", " "))]
        title += [line.rstrip(".:") for line in module.docstring.splitlines()[:1]]
        lines = [*comment(": ".join(title)), f"struct {struct.tag} {{"]
        for field in struct.fields:
            lines += with_comment(f"    {self._member(field)};", plain(_meaning(field)), "    ")
        return [*lines, "};"]

    def _member(self, field: Field) -> str:
        if isinstance(field.kind, type):
            struct = self._program.sources.struct(field.kind)
            assert struct is not None
            return f"struct {struct.tag} {name(field.name)}"
        sizes = "".join(f"[{size}]" for size in field.shape)
        return f"{'real' if field.kind == 'real' else 'int32_t'} {name(field.name)}{sizes}"

    def _source(self, module: Module) -> list[str]:
        functions = self._functions(module)
        needed = {callee.function.module.name for t in functions for callee in t.calls.values()}
        needed |= {
            kind.struct.module
            for typed in functions
            for kind in (*typed.types.values(), *typed.names.values())
            if isinstance(kind, Record)
        }
        needed |= self._names.headers(module)
        lines = [f'#include "{module.name}.h"', ""]
        lines += [f'#include "{each}.h"' for each in sorted(needed - {module.name})]
        lines += ["", *self._names.definitions(module, private=True)]
        for typed in functions:
            storage = ""
            lines.append("")
            if typed.function.c_name not in self._public:
                lines += [*_answers(typed), *comment(typed.function.docstring)]
                storage = "static "
            lines += wrapped(storage + signature(typed, self._effects), "")
            lines += CFunction(typed, self._effects, self._precision).body()
        return lines


def _answers(typed: Typed) -> list[str]:
    if not isinstance(typed.result, Answers):
        return []
    members = [f"    {declarator(kind, name(n), False)};" for n, kind in typed.result.items]
    title = f"What {typed.function.c_name} answers."
    return [*comment(title), f"struct {typed.result.tag} {{", *members, "};", ""]


def _meaning(field: Field) -> str:
    unit = "" if field.unit == "1" else f"[{field.unit}] "
    return f"{unit}{field.meaning}"


def _text(lines: list[str]) -> str:
    """The lines as a file, without empty ones side by side."""
    kept = [line for at, line in enumerate(lines) if line or (at and lines[at - 1])]
    return "\n".join(kept) + "\n"


def constants_files(table: Table, title: str, speeds: Constants | None = None) -> dict[str, str]:
    """``constants.h`` and ``constants.c``: the table, with exact numbers.

    Args:
        table: of ``tables.build``.
        title: the description of the table.
        speeds: of ``schedules.schedule``, where the speed of the car changes.
    """
    memories: list[tuple[str, type[Struct], Struct]] = [
        ("layout_table controller_table", Table, table)
    ]
    if speeds is not None:
        memories.append(("schedule_constants controller_schedule", Constants, speeds))
    header = [
        *comment(title), "#ifndef CONSTANTS_H", "#define CONSTANTS_H", "", '#include "layout.h"',
        *([] if speeds is None else ['#include "schedule.h"']), "",
        *(f"extern const struct {what};" for what, *_ in memories), "", "#endif",
    ]  # fmt: skip
    source = [*comment(title), '#include "constants.h"']
    for what, struct, record in memories:
        members = _members(struct, record, precision_of(table), INDENT)
        source += ["", f"const struct {what} = {{", *members, "};"]
    return {"constants.h": _text(header), "constants.c": _text(source)}


def _members(struct: type[Struct], record: Any, precision: Precision, indent: str) -> Iterator[str]:
    """Every member except zeros; C initialises missing members with zero."""
    zeros, fields = 0, fields_of(struct)
    for field in fields:
        value = record[field.name]
        if isinstance(field.kind, type):
            inside = list(_members(field.kind, value, precision, indent + INDENT))
            yield from (f"{indent}.{name(field.name)} = {{", *inside, f"{indent}}},")
        elif _is_zero(np.asarray(value)):
            zeros += 1
        else:
            yield from _initialised(field, np.asarray(value), precision, indent)
    if zeros == len(fields):  # an initialiser must not be empty
        nested = len(fields[0].shape)
        yield f"{indent}.{name(fields[0].name)} = {'{' * nested}0{'}' * nested},"


def _initialised(field: Field, value: Any, precision: Precision, indent: str) -> Iterator[str]:
    remark = f" /* {_meaning(field)} */".replace("*/ */", "*/")
    if value.ndim < 2:
        text = f".{name(field.name)} = {_initialiser(field, value, precision)},"
        if len(indent + text + remark) <= WIDTH:
            yield indent + text + remark
        else:
            yield from (indent + remark[1:], *wrapped(text, indent))
        return
    yield f"{indent}.{name(field.name)} = {{{remark}"
    for row in _without_last_zeros(value):
        yield from wrapped(f"{_initialiser(field, row, precision)},", indent + INDENT)
    yield f"{indent}}},"


def _initialiser(field: Field, value: Any, precision: Precision) -> str:
    if np.ndim(value):
        each = (_initialiser(field, one, precision) for one in _without_last_zeros(value))
        return f"{{{', '.join(each)}}}"
    return number(float(value), precision) if field.kind == "real" else str(int(value))


def _without_last_zeros(value: Any) -> Any:
    """The elements down to the last that differs from zero, but at least one."""
    last = max((at for at, one in enumerate(value) if not _is_zero(one)), default=0)
    return value[: last + 1]


def _is_zero(value: Any) -> bool:
    """Whether all elements equal C's default initialisation: -0.0 does not."""
    return not np.any(value) and not np.any(np.signbit(value))
