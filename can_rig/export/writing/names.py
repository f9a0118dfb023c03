"""Numbers that the source names, as macros of C, and enumerations."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from typing import Final

from can_rig.export.translation.program import Program, Typed
from can_rig.export.translation.source import Module, Sources
from can_rig.export.translation.types import Answers
from can_rig.export.writing.c_text import comment, number, plain, with_comment
from can_rig.export.writing.c_text import name as c_name
from firmware_model.target.structs import Precision

_ELSEWHERE: Final = "is a number or a function of the exported C too: must be another name"


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
                            home = origin(self._sources, user, node.id)
                            self._homes[home.name] = home
                            self._used.setdefault((home.name, node.id), set()).add(user.name)
        self._check(program)

    def headers(self, user: Module) -> set[str]:
        """Modules whose names or enumerations ``user`` uses."""
        used = [(home, name) for (home, name), users in self._used.items() if user.name in users]
        homes = {home for home, _ in used}
        for home, name in used:
            homes |= {enum.name for enum, _ in self._enumerator(self._homes[home], name)}
        return homes - {user.name}

    def public(self, home: Module) -> list[str]:
        """Definitions with users in other modules."""
        names = [name for name in self._of(home) if self._used[home.name, name] != {home.name}]
        return self._definitions(home, names)

    def private(self, home: Module) -> list[str]:
        """Definitions without users in other modules."""
        names = [name for name in self._of(home) if self._used[home.name, name] == {home.name}]
        return self._definitions(home, names)

    def _check(self, program: Program) -> None:
        """Refuse a local name or a member of a struct that means something else in C."""
        modules = self._sources.modules.values()
        macros = {f"{module.name.upper()}_H" for module in modules}
        macros |= {c_name(name) for _, name in self._used}
        taken = macros | set(program.functions)
        for module in modules:
            taken |= {enumerator(n, each.name) for n, enum in module.enums.items() for each in enum}
            for struct in module.structs.values():
                for field in struct.fields:
                    if c_name(field.name) in macros:
                        at = ast.Pass(lineno=struct.line)
                        raise module.refuse(at, f"{field.name}: {_ELSEWHERE}")
        for typed in program.functions.values():
            for name, node in _locals(typed).items():
                if c_name(name) in taken:
                    raise typed.function.module.refuse(node, f"{name}: {_ELSEWHERE}")

    def _of(self, home: Module) -> list[str]:
        return [name for name in home.assignments if (home.name, name) in self._used]

    def _definitions(self, home: Module, names: list[str]) -> list[str]:
        lines = []
        for name in names:
            value = home.lookup(name)
            text = str(value) if isinstance(value, int) else number(value, self._precision)
            for _, enumerator in self._enumerator(home, name):
                text = enumerator
            if text == c_name(name):
                continue
            line = f"#define {c_name(name)} {text if value >= 0 else f'({text})'}"
            said = home.comments.get(home.assignments[name].lineno)
            lines += with_comment(line, said.text, "") if said and not said.alone else [line]
        return lines

    def _enumerator(self, home: Module, name: str) -> Iterator[tuple[Module, str]]:
        """The enumerator called ``name``, if any."""
        match home.assignments[name]:
            case ast.Call(
                func=ast.Name(id="int"),
                args=[ast.Attribute(value=ast.Name(id=enum), attr=member)],
            ):
                declared = home.lookup(enum)
                module = self._sources.module(declared.__module__)
                yield module, enumerator(enum, member)


def _locals(typed: Typed) -> dict[str, ast.AST]:
    """Names declared in a C function: local names, and names for calls with several results."""
    calls = typed.calls.items()
    found: dict[str, ast.AST] = {
        each.function.name: call for call, each in calls if isinstance(each.result, Answers)
    }
    for node in ast.walk(typed.function.tree):
        name = getattr(node, "id", getattr(node, "arg", None))
        if name in typed.names:
            found.setdefault(name, node)
    return found


def origin(sources: Sources, user: Module, name: str) -> Module:
    """The module that defines ``name`` as used in ``user``."""
    for node in user.tree.body:
        names = [alias.name for alias in node.names] if isinstance(node, ast.ImportFrom) else []
        if isinstance(node, ast.ImportFrom) and node.module and name in names:
            return origin(sources, sources.module(node.module), name)
    return user


def enumerator(enum: str, member: str) -> str:
    """FaultState.CLEAR as FAULT_STATE_CLEAR."""
    return f"{snake(enum).upper()}_{member}"


def snake(words: str) -> str:
    """FaultState as fault_state."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", words).lower()


def enumerations(module: Module) -> list[str]:
    """C code of every enumeration in ``module``, with comments from the docstrings."""
    lines: list[str] = []
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.name not in module.enums:
            continue
        lines += ["", *comment(ast.get_docstring(node) or node.name)]
        lines.append(f"enum {module.name}_{snake(node.name)} {{")
        body = node.body
        for at, each in enumerate(body):
            match each:
                case ast.Assign(
                    targets=[ast.Name(id=member)], value=ast.Constant(value=int(value))
                ):
                    line = f"    {enumerator(node.name, member)} = {value},"
                    match body[at + 1 : at + 2]:
                        case [ast.Expr(value=ast.Constant(value=str(said)))]:
                            lines += with_comment(line, plain(said), "    ")
                        case _:
                            lines.append(line)
        lines.append("};")
    return lines
