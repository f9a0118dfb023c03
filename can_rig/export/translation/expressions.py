"""The type of every expression of a function; expressions outside the subset are refused."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from can_rig.export.translation.source import Function, Sources
from can_rig.export.translation.types import (
    BOOL,
    INT,
    LITERAL,
    REAL,
    Array,
    Record,
    Scalar,
    Type,
    in_words,
)

ARITHMETIC: Final = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod)
INT32: Final = range(-(2**31), 2**31)
ORDER: Final = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
Call = Callable[[ast.Call], Type]


class Expressions:
    """Types of the expressions of one function.

    Args:
        sources: every module of the target.
        function: the function.
        names: known types of the function's names; read when a name occurs.
        call: types a call.
    """

    def __init__(
        self, sources: Sources, function: Function, names: dict[str, Type], call: Call
    ) -> None:
        self._sources = sources
        self._module = function.module
        self._names = names
        self._call = call
        self.types: dict[ast.expr, Type] = {}

    def of(self, node: ast.expr) -> Type:
        """The type of ``node``.

        Raises:
            ExportError: the expression is outside the subset.
        """
        if isinstance(node, ast.Call):
            self.types[node] = self._call(node)
            return self.types[node]
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._module.refuse(node, f"{ast.unparse(node)}: the subset has no such thing")
        found: Type = method(node)
        self.types[node] = found
        return found

    def value(self, node: ast.expr) -> Scalar:
        """The type of an operand: a real number with a precision, an integer or a truth value."""
        found = self.of(node)
        if found is LITERAL:
            raise self._module.refuse(
                node, f"{ast.unparse(node)} has no precision: must be real({ast.unparse(node)}, x)"
            )
        if not isinstance(found, Scalar):
            raise self._module.refuse(
                node, f"{ast.unparse(node)} is {in_words(found)}: must be one value"
            )
        return found

    def require(self, node: ast.expr, *wanted: Scalar) -> Scalar:
        """The type of an operand, which must be in ``wanted``."""
        found = self.value(node)
        if found not in wanted:
            words = " or ".join(in_words(each) for each in wanted)
            raise self._module.refuse(
                node, f"{ast.unparse(node)} is {in_words(found)}: must be {words}"
            )
        return found

    def condition(self, node: ast.expr) -> None:
        """Type ``node`` as a condition: a nonzero integer is true."""
        if isinstance(node, ast.BoolOp):
            for each in node.values:
                self.condition(each)
            self.types[node] = BOOL
        else:
            self.require(node, BOOL, INT)

    def constant(self, node: ast.expr) -> int | float | None:
        """The value of ``node``, if the source has a literal; else None."""
        value: Any = None
        if isinstance(node, ast.Constant):
            value = node.value
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            inner = self.constant(node.operand)
            value = None if inner is None else -inner
        elif isinstance(node, ast.Name) and node.id not in self._names:
            value = self._module.lookup(node.id)
        return value if isinstance(value, int | float) and not isinstance(value, bool) else None

    def _constant(self, node: ast.Constant) -> Type:
        if isinstance(node.value, bool):
            return BOOL
        if isinstance(node.value, int):
            return self._integer(node, node.value)
        if isinstance(node.value, float):
            return LITERAL
        raise self._module.refuse(node, f"{node.value!r}: must be a number")

    def _integer(self, node: ast.expr, value: int) -> Type:
        """An integer literal, which must fit the target's integer."""
        if value not in INT32:
            raise self._module.refuse(
                node, f"{ast.unparse(node)}: must be an integer from -2**31 to 2**31 - 1"
            )
        return INT

    def _name(self, node: ast.Name) -> Type:
        if node.id in self._names:
            return self._names[node.id]
        value = self._module.lookup(node.id)
        if isinstance(value, int) and not isinstance(value, bool):
            return self._integer(node, value)
        if isinstance(value, float):
            return LITERAL
        raise self._module.refuse(
            node, f"{node.id}: must be a name of this function, or a number of the module"
        )

    def _attribute(self, node: ast.Attribute) -> Type:
        owner = self.of(node.value)
        if isinstance(owner, Record):
            for field in owner.struct.fields:
                if field.name != node.attr:
                    continue
                if isinstance(field.kind, tuple):
                    struct = self._sources.struct(field.kind)
                    if struct is None or field.shape:
                        raise self._module.refuse(
                            node, f"{node.attr}: must be one struct that a module declares by name"
                        )
                    return Record(struct)
                scalar = REAL if field.kind == "real" else INT
                return Array(scalar, field.shape) if field.shape else scalar
        raise self._module.refuse(node, f"{ast.unparse(node)}: {in_words(owner)} has no such field")

    def _subscript(self, node: ast.Subscript) -> Type:
        array = self.of(node.value)
        if not isinstance(array, Array):
            raise self._module.refuse(
                node, f"{ast.unparse(node.value)} is {in_words(array)}: must be an array"
            )
        indices = indices_of(node, len(array.shape))
        if len(indices) != len(array.shape):
            raise self._module.refuse(
                node, f"{ast.unparse(node)}: must have an index for each of {array.shape}"
            )
        if not any(isinstance(index, ast.Slice) for index in indices):
            for index, size in zip(indices, array.shape, strict=True):
                self.require(index, INT)
                at = self.constant(index)
                if at is not None and not 0 <= at < size:
                    raise self._module.refuse(
                        index, f"{ast.unparse(node)}: index {at} must be from 0 to {size - 1}"
                    )
            return array.element
        if len(indices) > 1 and isinstance(node.ctx, ast.Load):
            raise self._module.refuse(
                node, f"{ast.unparse(node)}: a part of {len(indices)} dimensions must be filled"
            )
        ranges = [
            self.extent(index, size) for index, size in zip(indices, array.shape, strict=True)
        ]
        return Array(array.element, tuple(stop - start for start, stop in ranges))

    def extent(self, index: ast.expr, size: int) -> tuple[int, int]:
        """First index and end of a slice, both literals."""
        if not isinstance(index, ast.Slice) or index.step is not None:
            raise self._module.refuse(index, "must be a slice without a step in every dimension")
        start = 0 if index.lower is None else self.constant(index.lower)
        stop = size if index.upper is None else self.constant(index.upper)
        if not (isinstance(start, int) and isinstance(stop, int) and 0 <= start < stop <= size):
            raise self._module.refuse(
                index, f"slice of {size} elements: its ends must be integers of the source"
            )
        return start, stop

    def _unaryop(self, node: ast.UnaryOp) -> Type:
        if isinstance(node.op, ast.Not):
            self.condition(node.operand)
            return BOOL
        if not isinstance(node.op, ast.USub):
            raise self._module.refuse(node, f"{ast.unparse(node)}: must be -x or not x")
        if isinstance(node.operand, ast.Constant):
            value = self.constant(node)
            if not isinstance(value, int):
                return self.of(node.operand)
            self.types[node.operand] = INT
            return self._integer(node, value)
        return self.require(node.operand, REAL, INT)

    def _binop(self, node: ast.BinOp) -> Type:
        if not isinstance(node.op, ARITHMETIC):
            raise self._module.refuse(node, f"{ast.unparse(node)}: must be +, -, *, / or %")
        wanted = {ast.Div: (REAL,), ast.Mod: (INT,)}.get(type(node.op), (REAL, INT))
        left, right = (self.require(each, *wanted) for each in (node.left, node.right))
        if left is not right:
            raise self._module.refuse(
                node,
                f"{ast.unparse(node)}: {in_words(left)} and {in_words(right)}: must be real(n, x)",
            )
        if isinstance(node.op, ast.Mod) and self.constant(node.right) == 0:
            raise self._module.refuse(node, f"{ast.unparse(node)}: must not divide by 0")
        return left

    def _boolop(self, node: ast.BoolOp) -> Type:
        for each in node.values:
            self.require(each, BOOL)
        return BOOL

    def _compare(self, node: ast.Compare) -> Type:
        if len(node.ops) != 1:
            raise self._module.refuse(node, f"{ast.unparse(node)}: must be two comparisons")
        if not isinstance(node.ops[0], (*ORDER, ast.Eq, ast.NotEq)):
            raise self._module.refuse(node, f"{ast.unparse(node)}: must be <, <=, >, >=, == or !=")
        sides = node.left, node.comparators[0]
        kinds = [self.of(each) for each in sides]
        if kinds.count(LITERAL) == 1 and REAL in kinds:
            literal = self.constant(sides[kinds.index(LITERAL)])
            if literal is not None and float(np.float32(literal)) == literal:
                return BOOL
        left, right = (self.require(each, REAL, INT) for each in sides)
        if left is not right:
            raise self._module.refuse(
                node, f"{ast.unparse(node)}: {in_words(left)} and {in_words(right)}: must be alike"
            )
        return BOOL

    def _ifexp(self, node: ast.IfExp) -> Type:
        self.condition(node.test)
        one, other = (self.value(each) for each in (node.body, node.orelse))
        if one is not other:
            raise self._module.refuse(node, f"{ast.unparse(node)}: both answers must be alike")
        return one


def indices_of(node: ast.Subscript, dimensions: int) -> list[ast.expr]:
    """An index for each dimension; a[:] selects every dimension."""
    indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if all(isinstance(index, ast.Slice) for index in indices):
        return [*indices, *(ast.Slice() for _ in range(dimensions - len(indices)))]
    return indices
