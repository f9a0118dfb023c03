"""A pair of .c and .h for each module of the target: structs, prototypes, functions."""

from __future__ import annotations

from collections.abc import Iterator

from can_rig.export.translation.effects import Effects
from can_rig.export.translation.program import Program, Typed
from can_rig.export.translation.source import Module
from can_rig.export.translation.types import Answers, CStruct, Record
from can_rig.export.writing.c_functions import CFunction, declarator, signature
from can_rig.export.writing.c_text import comment, name, plain, with_comment, wrapped
from can_rig.export.writing.names import Names, enumerations
from firmware_model.target.structs import Field, Precision


class CFiles:
    """The files of a program.

    Args:
        program: the program.
        structs: its memory: structs named by other programs; the functions need not use every
            struct.
        entries: C names of the functions called by other programs.
        precision: of its real numbers.
    """

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
        """Text by file name."""
        found = {}
        for module in self._modules():
            found[f"{module.name}.h"] = _text(self._header(module))
            if any(self._functions(module)):
                found[f"{module.name}.c"] = _text(self._source(module))
        return found

    def _modules(self) -> list[Module]:
        """Modules with C code."""
        by_name = {module.name: module for module in self._program.sources.modules.values()}
        wanted = {module.name for module in self._program.modules}
        wanted |= {struct.module for struct in self._structs}
        for module in self._program.modules:
            wanted |= self._names.headers(module)
        wanted |= {name for name, module in by_name.items() if module.enums}
        return [module for name, module in by_name.items() if name in wanted]

    def _with_members(self, structs: list[CStruct]) -> Iterator[CStruct]:
        """Each struct once, after the structs of its members."""
        seen: set[CStruct] = set()

        def visit(struct: CStruct) -> Iterator[CStruct]:
            for member in self._members(struct):
                yield from visit(member)
            if struct not in seen:
                seen.add(struct)
                yield struct

        for struct in structs:
            yield from visit(struct)

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
        public = self._names.public(module)
        lines += ["", *public] if public else []
        lines += enumerations(module)
        for struct in own:
            lines += ["", *self._struct(struct, module)]
        outside = {
            kind.struct.tag
            for typed in exported
            for kind in typed.arguments
            if isinstance(kind, Record) and kind.struct.module not in needed | {module.name}
        }
        lines += [""] * bool(outside) + [f"struct {tag};" for tag in sorted(outside)]
        for typed in exported:
            lines += ["", *self._answers(typed), *comment(typed.function.docstring)]
            lines += wrapped(f"{signature(typed, self._effects)};", "")
        return [*lines, "", "#endif"]

    def _struct(self, struct: CStruct, module: Module) -> list[str]:
        what = {"CONSTANTS": "Constants", "STATE": "State", "TABLE": "The constant table"}
        python = struct.tag.removeprefix(f"{struct.module}_").upper()
        title = [what.get(python, python.capitalize().replace("_", " "))]
        title += [line.rstrip(".:") for line in module.docstring.splitlines()[:1]]
        lines = comment(": ".join(title))
        lines.append(f"struct {struct.tag} {{")
        for field in struct.fields:
            lines += with_comment(f"    {self._member(field)};", _meaning(field), "    ")
        return [*lines, "};"]

    def _member(self, field: Field) -> str:
        if isinstance(field.kind, tuple):
            struct = self._program.sources.struct(field.kind)
            assert struct is not None
            return f"struct {struct.tag} {name(field.name)}"
        sizes = "".join(f"[{size}]" for size in field.shape)
        return f"{'real' if field.kind == 'real' else 'int32_t'} {name(field.name)}{sizes}"

    @staticmethod
    def _answers(typed: Typed) -> list[str]:
        if not isinstance(typed.result, Answers):
            return []
        members = [f"    {declarator(kind, name(n), False)};" for n, kind in typed.result.items]
        title = f"What {typed.function.c_name} answers."
        return [*comment(title), f"struct {typed.result.tag} {{", *members, "};", ""]

    def _source(self, module: Module) -> list[str]:
        functions = self._functions(module)
        needed = {callee.function.module.name for t in functions for callee in t.calls.values()}
        needed |= {
            kind.struct.module
            for typed in functions
            for kind in (*typed.expressions.values(), *typed.names.values())
            if isinstance(kind, Record)
        }
        needed |= self._names.headers(module)
        lines = [f'#include "{module.name}.h"', ""]
        lines += [f'#include "{each}.h"' for each in sorted(needed - {module.name})]
        private = self._names.private(module)
        lines += ["", *private] if private else []
        for typed in functions:
            lines += ["", *self._function(typed)]
        return lines

    def _function(self, typed: Typed) -> list[str]:
        lines, storage = [], ""
        if typed.function.c_name not in self._public:
            lines, storage = [*self._answers(typed), *comment(typed.function.docstring)], "static "
        body = CFunction(typed, self._effects, self._precision).body()
        return [*lines, *wrapped(storage + signature(typed, self._effects), ""), *body]


def _meaning(field: Field) -> str:
    unit = "" if field.unit == "1" else f"[{field.unit}] "
    return plain(f"{unit}{field.meaning}")


def _text(lines: list[str]) -> str:
    """The lines as a file, without empty ones side by side."""
    kept = [line for at, line in enumerate(lines) if line or (at and lines[at - 1])]
    return "\n".join(kept) + "\n"
