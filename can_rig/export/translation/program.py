"""A program: entry points and their callees, each function with a single signature."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass

from can_rig.export.translation.assignment import check_assigned
from can_rig.export.translation.calls import called, type_of_arithmetic
from can_rig.export.translation.expressions import Expressions
from can_rig.export.translation.source import Function, Module, Sources
from can_rig.export.translation.statements import Statements
from can_rig.export.translation.types import (
    BOOL,
    INT,
    LITERAL,
    REAL,
    Array,
    Record,
    Type,
    in_words,
)
from firmware_model.target.precision import real

ANNOTATED = {"float": REAL, "int": INT, "bool": BOOL}


@dataclass(eq=False)
class Typed:
    """A function with its types.

    Attributes:
        function: the function.
        names: types of all its names: parameters, then assigned names.
        result: type of the result.
        expressions: types of its expressions.
        calls: the called functions of the target, by call node.
    """

    function: Function
    names: dict[str, Type]
    result: Type
    expressions: dict[ast.expr, Type]
    calls: dict[ast.Call, Typed]

    @property
    def arguments(self) -> list[Type]:
        """Types of its parameters."""
        return [self.names[name] for name in self.function.parameters]


class Program:
    """Every function of the target that the entry points need.

    Attributes:
        sources: the modules of the functions.
        functions: by name in C, callees before callers.
    """

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self.functions: dict[str, Typed] = {}
        self._open: list[Function] = []  # in progress: a call of them is recursion

    @property
    def modules(self) -> list[Module]:
        """The modules with functions of the program, callees first."""
        return list(dict.fromkeys(typed.function.module for typed in self.functions.values()))

    def add(self, function: Function, arguments: Sequence[Type]) -> Typed:
        """Add ``function`` and its callees, for arguments of the given types.

        Raises:
            ExportError: something is outside the subset.
        """
        module, tree = function.module, function.tree
        if function in self._open:
            raise module.refuse(tree, f"{function.name} calls itself: must be a loop")
        known = self.functions.get(function.c_name)
        if known is not None:
            if known.arguments != list(arguments):
                raise module.refuse(
                    tree, f"{function.name} gets {_all(arguments)} and {_all(known.arguments)}: "
                    "must be one type for each parameter, or two functions"
                )  # fmt: skip
            return known
        names = dict(zip(function.parameters, arguments, strict=True))
        self._check_signature(function, names)
        calls: dict[ast.Call, Typed] = {}

        def call(node: ast.Call) -> Type:
            callee = self.sources.function(called(module, node))
            if callee is None or called(module, node) is real:
                return type_of_arithmetic(module, node, expressions)
            kinds = [_argument(module, each, expressions) for each in node.args]
            if node.keywords or len(kinds) != len(callee.parameters):
                raise module.refuse(
                    node, f"{ast.unparse(node)}: must have {len(callee.parameters)} arguments "
                    "by position"
                )  # fmt: skip
            calls[node] = self.add(callee, kinds)
            return calls[node].result

        expressions = Expressions(self.sources, function, names, call)
        statements = Statements(function, names, expressions)
        self._open.append(function)
        statements.type_all()
        self._open.pop()
        check_assigned(function)
        typed = Typed(function, names, statements.result, expressions.types, calls)
        self.functions[function.c_name] = typed
        return typed

    @staticmethod
    def _check_signature(function: Function, names: dict[str, Type]) -> None:
        """Check that the annotations agree with the callers."""
        arguments = function.tree.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.defaults:
            raise function.module.refuse(
                function.tree, f"{function.name}: must have parameters by position only"
            )
        for argument in arguments.args:
            annotation = argument.annotation
            said = ANNOTATED.get(ast.unparse(annotation) if annotation else "")
            got = names[argument.arg]
            if (said or got) != got or (said is None and not isinstance(got, Record | Array)):
                raise function.module.refuse(
                    argument, f"{argument.arg} is {in_words(got)}: its annotation must say so"
                )


def _argument(module: Module, node: ast.expr, expressions: Expressions) -> Type:
    kind = expressions.of(node)
    if kind is LITERAL:
        raise module.refuse(
            node, f"{ast.unparse(node)} has no precision: must be real({ast.unparse(node)}, x)"
        )
    return kind


def _all(kinds: Sequence[Type]) -> str:
    return ", ".join(in_words(kind) for kind in kinds)
