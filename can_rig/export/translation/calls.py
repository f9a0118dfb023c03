"""The callee of a call: a function of the target, or exactly rounded arithmetic."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from can_rig.export.translation.expressions import Expressions
from can_rig.export.translation.source import Module
from can_rig.export.translation.types import BOOL, INT, LITERAL, REAL, Type
from firmware_model.target.precision import real

ROUNDED_EXACTLY: Final[Mapping[Any, str]] = {
    np.sqrt: "sqrt", np.ceil: "ceil", np.rint: "rint", np.copysign: "copysign", abs: "fabs",
}  # fmt: skip
"""Functions of real numbers with equal bits on every machine, and their names in C."""

EXTREMES: Final[Mapping[Any, str]] = {min: "min", max: "max"}

WORDS: Final = (
    "must be a function of the target, real, int, min, max, abs, math.isfinite, "
    "np.sqrt, np.ceil, np.rint or np.copysign"
)


def called(module: Module, node: ast.Call) -> Any:
    """The callee of ``node``, resolved in the imported ``module``; None if unknown."""
    match node.func:
        case ast.Name(id=name):
            return module.lookup(name) or {"min": min, "max": max, "abs": abs, "int": int}.get(name)
        case ast.Attribute(value=ast.Name(id=owner), attr=name):
            return getattr(module.lookup(owner), name, None)
    return None


def type_of_arithmetic(module: Module, node: ast.Call, expressions: Expressions) -> Type:
    """The type of a call to a function outside the target.

    Raises:
        ExportError: the call is outside the subset.
    """
    callee = called(module, node)
    if node.keywords:
        raise module.refuse(node, f"{ast.unparse(node)}: must have no arguments by name")
    if callee is None or not _number_of_arguments(callee, len(node.args)):
        raise module.refuse(node, f"{ast.unparse(node)}: {WORDS}")
    if getattr(callee, "py_func", callee) is getattr(real, "py_func", real):
        if expressions.of(node.args[0]) is not LITERAL:
            expressions.require(node.args[0], REAL, INT)
        expressions.require(node.args[1], REAL)
        return REAL
    if callee is int:
        expressions.require(node.args[0], REAL)
        return INT
    if callee in EXTREMES:
        kinds = [expressions.require(each, REAL, INT) for each in node.args]
        if len(set(kinds)) != 1:
            raise module.refuse(node, f"{ast.unparse(node)}: all must be real, or all integers")
        return kinds[0]
    for each in node.args:
        expressions.require(each, REAL)
    return BOOL if callee is math.isfinite else REAL


def _number_of_arguments(callee: Any, n: int) -> bool:
    """Whether ``callee`` is known and takes ``n`` arguments."""
    if callee in EXTREMES:
        return n >= 2
    if callee is np.copysign or getattr(callee, "py_func", callee) is getattr(
        real, "py_func", real
    ):
        return n == 2
    return n == 1 and (callee in ROUNDED_EXACTLY or callee in (int, math.isfinite))
