"""A Python module as the translator reads it: functions, constants, structs and comments."""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

from can_rig.errors import ExportError
from can_rig.export.translation.types import CStruct
from firmware_model.target.structs import Field


@dataclass(frozen=True)
class Comment:
    """A comment of the source; ``alone`` for a comment without code on its line."""

    text: str
    alone: bool


@dataclass(frozen=True, eq=False)
class Function:
    """A function of the target."""

    module: Module
    tree: ast.FunctionDef

    @property
    def name(self) -> str:
        """Its name in Python."""
        return self.tree.name

    @property
    def c_name(self) -> str:
        """Its name in C, where all functions share one space of names."""
        return f"{self.module.name}_{self.name}"

    @property
    def parameters(self) -> list[str]:
        """Names of its parameters."""
        return [argument.arg for argument in self.tree.args.args]

    @property
    def docstring(self) -> str:
        """The docstring."""
        return ast.get_docstring(self.tree) or ""

    @property
    def body(self) -> list[ast.stmt]:
        """Its statements, without the docstring."""
        return self.tree.body[1:] if self.docstring else self.tree.body


class Module:
    """A module of the target.

    Args:
        namespace: the imported module.
    """

    def __init__(self, namespace: ModuleType) -> None:
        self.namespace = namespace
        self.name = namespace.__name__.rpartition(".")[2]
        self.path = Path(str(namespace.__file__))
        self.text = self.path.read_text(encoding="utf-8")
        self.lines = self.text.splitlines()
        self.tree = ast.parse(self.text)

    @property
    def docstring(self) -> str:
        """The docstring."""
        return ast.get_docstring(self.tree) or ""

    @cached_property
    def functions(self) -> dict[str, Function]:
        """Every function of the module by name, marked for the target or not."""
        found = (node for node in self.tree.body if isinstance(node, ast.FunctionDef))
        return {node.name: Function(self, node) for node in found}

    @cached_property
    def assignments(self) -> dict[str, ast.expr]:
        """Values assigned to the module's names, by name."""
        found: dict[str, ast.expr] = {}
        for node in self.tree.body:
            if not isinstance(node, ast.Assign):
                continue
            for target in node.targets:
                if isinstance(target, ast.Name):
                    found[target.id] = node.value
                elif isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                    pairs = zip(target.elts, node.value.elts, strict=True)
                    found |= {one.id: value for one, value in pairs if isinstance(one, ast.Name)}
        return found

    @cached_property
    def structs(self) -> dict[int, CStruct]:
        """The module's structs, by the identity of their fields."""
        found = {}
        for name, value in self.assignments.items():
            fields = getattr(self.namespace, name)
            if isinstance(fields, tuple) and fields and isinstance(fields[0], Field):
                tag = f"{self.name}_{name.lower()}"
                found[id(fields)] = CStruct(self.name, tag, fields, value.lineno)
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
        """An error for ``node``: place, reason and remedy."""
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
        return self.module(plain.__module__).functions.get(plain.__name__)

    def struct(self, fields: object) -> CStruct | None:
        """The struct with these fields, among the modules read so far."""
        for module in self.modules.values():
            if id(fields) in module.structs:
                return module.structs[id(fields)]
        return None
