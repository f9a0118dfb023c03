"""A Python module as the translator reads it: types, functions, constants, structs and comments.

The types of the subset are real numbers, integers, truth values, structs and arrays of fixed size.
A real number has the precision of the constant table. A literal lacks a precision until ``real``
sets it: numba would assume double precision.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final

from can_rig.errors import ExportError
from firmware_model.law.structs import Field, Struct, fields_of


@dataclass(frozen=True)
class Scalar:
    """A scalar type: ``name`` for messages, ``c`` its name in C."""

    name: str
    c: str


REAL: Final = Scalar("a real number", "real")
INT: Final = Scalar("an integer", "int32_t")
BOOL: Final = Scalar("a truth value", "bool")
LITERAL: Final = Scalar("a literal without a precision", "")


@dataclass(frozen=True, eq=False)
class CStruct:
    """A struct of the target's memory."""

    module: str
    tag: str
    declared: type[Struct]
    line: int

    @property
    def fields(self) -> tuple[Field, ...]:
        """Its members."""
        return fields_of(self.declared)


@dataclass(frozen=True)
class Record:
    """A struct, passed by address."""

    struct: CStruct


@dataclass(frozen=True)
class Array:
    """An array of fixed size, which functions get by its address."""

    element: Scalar | Record
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Answers:
    """Several values that a function returns, by name; in C a struct."""

    tag: str
    items: tuple[tuple[str, Scalar], ...]


Type = Scalar | Record | Array | Answers | None
"""None: no result."""


def in_words(type_: Type) -> str:
    """The type as a message names it."""
    match type_:
        case Scalar(name=name):
            return name
        case Record(struct=struct):
            return f"the struct {struct.tag}"
        case Array(element=Record(struct=struct), shape=shape):
            return f"an array of {shape[0]} structs {struct.tag}"
        case Array(shape=shape):
            return f"an array of shape {shape}"
        case Answers(items=items):
            return f"{len(items)} values"
    return "nothing"


@dataclass(frozen=True)
class Comment:
    """A comment of the source; ``alone`` for a comment without code on its line."""

    text: str
    alone: bool


class Function:
    """A function of the target.

    Attributes:
        name, c_name: in Python, and in C, where all functions share one space of names.
        body: its statements, without the docstring.
    """

    def __init__(self, module: Module, tree: ast.FunctionDef) -> None:
        self.module, self.tree, self.name = module, tree, tree.name
        self.c_name = f"{module.name}_{tree.name}"
        self.parameters = [argument.arg for argument in tree.args.args]
        self.docstring = ast.get_docstring(tree) or ""
        self.body = tree.body[1:] if self.docstring else tree.body
        self.nodes = [node for statement in self.body for node in ast.walk(statement)]


class Module:
    """A module of the target, from its imported namespace and its text."""

    def __init__(self, namespace: ModuleType) -> None:
        self.namespace = namespace
        self.name = namespace.__name__.rpartition(".")[2]
        self.path = Path(str(namespace.__file__))
        self.text = self.path.read_text(encoding="utf-8")
        self.lines = self.text.splitlines()
        self.tree = ast.parse(self.text)
        self.docstring = ast.get_docstring(self.tree) or ""
        found = (node for node in self.tree.body if isinstance(node, ast.FunctionDef))
        self.functions = {node.name: Function(self, node) for node in found}
        """Every function of the module by name, marked for the target or not."""

    @cached_property
    def assignments(self) -> dict[str, ast.expr]:
        """Values assigned to the module's names, by name."""
        found: dict[str, ast.expr] = {}
        for node in self.tree.body:
            if not isinstance(node, ast.Assign):
                continue
            for target, value in paired(node):
                if isinstance(target, ast.Name):
                    found[target.id] = value
        return found

    @cached_property
    def structs(self) -> dict[type[Struct], CStruct]:
        """The module's structs, by their declaration.

        Raises:
            ExportError: a field is declared wrongly.
        """
        found = {}
        for node in self.tree.body:
            declared = self.lookup(node.name) if isinstance(node, ast.ClassDef) else None
            if isinstance(declared, type) and issubclass(declared, Struct):
                try:
                    _refuse_circle(declared)
                except (TypeError, NameError) as error:
                    raise self.refuse(_declaration(node, str(error)), str(error)) from None
                tag = f"{self.name}_{snake(declared.__name__)}"
                found[declared] = CStruct(self.name, tag, declared, node.lineno)
        return found

    @cached_property
    def enums(self) -> dict[str, type[IntEnum]]:
        """The module's enumerations, by name."""
        names = (node.name for node in self.tree.body if isinstance(node, ast.ClassDef))
        found = {name: getattr(self.namespace, name) for name in names}
        return {name: each for name, each in found.items() if issubclass(each, IntEnum)}

    @cached_property
    def comments(self) -> dict[int, Comment]:
        """The comments by line, without remarks to tools."""
        found = {}
        for token in tokenize.generate_tokens(io.StringIO(self.text).readline):
            text = token.string.lstrip("#").strip()
            if token.type == tokenize.COMMENT and not text.startswith(("fmt:", "noqa", "type:")):
                alone = not token.line[: token.start[1]].strip()
                found[token.start[0]] = Comment(text, alone)
        return found

    def lookup(self, name: str) -> Any:
        """The object called ``name`` in this module; None if undefined."""
        return getattr(self.namespace, name, None)

    def refuse(self, node: ast.AST, what: str) -> ExportError:
        """An error for ``node``: place, reason and remedy; ``{}`` in ``what`` is the node."""
        what = what.replace("{}", ast.unparse(node).split("\n")[0])
        return ExportError(f"{self.path}:{getattr(node, 'lineno', 1)}: {what}")


class Sources:
    """Every requested module, read once."""

    def __init__(self) -> None:
        self.modules: dict[str, Module] = {}

    def module(self, name: str) -> Module:
        """The imported module called ``name``, as in ``sys.modules``."""
        if name not in self.modules:
            self.modules[name] = Module(sys.modules[name])
        return self.modules[name]

    def function(self, value: object) -> Function | None:
        """The target's function behind ``value``, compiled or not; None for other objects."""
        plain = getattr(value, "py_func", value)
        if not isinstance(plain, FunctionType):
            return None
        found = self.module(plain.__module__).functions.get(plain.__name__)
        if found is None:
            return None
        tree = found.tree
        first = min([tree.lineno, *(each.lineno for each in tree.decorator_list)])
        return found if plain.__code__.co_firstlineno == first else None

    def struct(self, declared: object) -> CStruct | None:
        """The struct of this declaration, among the modules read so far; None for a number."""
        if not isinstance(declared, type):
            return None
        found = (module.structs.get(declared) for module in self.modules.values())
        return next((struct for struct in found if struct), None)


def _declaration(struct: ast.stmt, error: str) -> ast.stmt:
    """Where a struct declares the field that an error of ``fields_of`` names; else the struct."""
    name = error.partition(":")[0].rpartition(".")[2]
    fields = (each for each in getattr(struct, "body", []) if isinstance(each, ast.AnnAssign))
    return next((each for each in fields if ast.unparse(each.target) == name), struct)


def _refuse_circle(struct: type[Struct], within: tuple[type[Struct], ...] = ()) -> None:
    """Refuse a declaration that contains itself, alone or through others.

    Raises:
        TypeError: names both; or see ``fields_of``.
    """
    for field in fields_of(struct):
        if not isinstance(field.kind, type):
            continue
        if field.kind in (*within, struct):
            raise TypeError(
                f"{struct.__module__}.{struct.__qualname__}.{field.name}: must not contain "
                f"{field.kind.__qualname__}, which contains it"
            )
        _refuse_circle(field.kind, (*within, struct))


def snake(words: str) -> str:
    """FaultState as fault_state."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", words).lower()


def paired(node: ast.Assign) -> list[tuple[ast.expr, ast.expr]]:
    """Each target of an assignment with its value; two tuples are paired element by element."""
    found: list[tuple[ast.expr, ast.expr]] = []
    for target in node.targets:
        names, values = (getattr(each, "elts", []) for each in (target, node.value))
        if names and len(names) == len(values):
            found += zip(names, values, strict=True)
        else:
            found.append((target, node.value))
    return found


def indices_of(node: ast.Subscript, dimensions: int = 1) -> list[ast.expr]:
    """An index for each dimension; a[:] selects every dimension."""
    indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if all(isinstance(index, ast.Slice) for index in indices):
        return [*indices, *(ast.Slice() for _ in range(dimensions - len(indices)))]
    return indices


def names_in(*nodes: ast.AST) -> list[ast.Name]:
    """Every name in the nodes, in no particular order."""
    return [each for node in nodes for each in ast.walk(node) if isinstance(each, ast.Name)]
