"""Expressions of the subset as expressions of C, in the order and precision of the source."""

from __future__ import annotations

import ast
import math
from typing import Final

from can_rig.export.translation.calls import EXTREMES, ROUNDED_EXACTLY, called
from can_rig.export.translation.expressions import indices_of
from can_rig.export.translation.program import Typed
from can_rig.export.translation.types import INT, REAL, Array, Record
from can_rig.export.writing.c_text import name, number
from firmware_model.target.precision import real
from firmware_model.target.structs import Precision

CHOICE, OR, AND, EQUALITY, ORDER, SUM, PRODUCT, UNARY, WHOLE = range(9)
BINARY: Final = {
    ast.Add: ("+", SUM), ast.Sub: ("-", SUM), ast.Mult: ("*", PRODUCT), ast.Div: ("/", PRODUCT),
    ast.Lt: ("<", ORDER), ast.LtE: ("<=", ORDER), ast.Gt: (">", ORDER), ast.GtE: (">=", ORDER),
    ast.Eq: ("==", EQUALITY), ast.NotEq: ("!=", EQUALITY), ast.And: ("&&", AND), ast.Or: ("||", OR),
}  # fmt: skip


class CExpressions:
    """Writes the expressions of a function.

    Args:
        typed: the function.
        precision: of its real numbers.
    """

    def __init__(self, typed: Typed, precision: Precision) -> None:
        self._typed = typed
        self._precision: Precision = precision

    def text(self, node: ast.expr, least: int = CHOICE) -> str:
        """``node`` in C; with brackets if its precedence is below ``least``."""
        text, binds = self._write(node)
        return text if binds >= least else f"({text})"

    def condition(self, node: ast.expr, least: int = CHOICE) -> str:
        """``node`` where only whether it holds matters."""
        if self._typed.expressions.get(node) is not INT:
            return self.text(node, least)
        text = f"{self.text(node, SUM)} != 0"
        return text if least <= EQUALITY else f"({text})"

    def _write(self, node: ast.expr) -> tuple[str, int]:
        match node:
            case ast.Constant(value=bool(value)):
                return ("true" if value else "false"), WHOLE
            case ast.Constant(value=int(value)):
                return str(value), WHOLE
            case ast.Constant(value=float(value)):
                return number(value, self._precision), WHOLE
            case ast.Name(id=found):
                return name(found), WHOLE
            case ast.Attribute():
                return self._attribute(node), WHOLE
            case ast.Subscript():
                return self._subscript(node), WHOLE
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!{self.condition(operand, WHOLE)}", UNARY
            case ast.UnaryOp(operand=operand):
                return f"-{self.text(operand, WHOLE)}", UNARY
            case ast.BinOp(op=ast.Mod()):
                return f"int_modulo({self.text(node.left)}, {self.text(node.right)})", WHOLE
            case ast.BinOp(left=left, op=op, right=right):
                sign, binds = BINARY[type(op)]
                return f"{self.text(left, binds)} {sign} {self.text(right, binds + 1)}", binds
            case ast.BoolOp(op=op, values=values):
                sign, binds = BINARY[type(op)]
                parts = (self.condition(each, EQUALITY) for each in values)
                return f" {sign} ".join(parts), binds
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                sign, binds = BINARY[type(op)]
                return f"{self.text(left, SUM)} {sign} {self.text(right, SUM)}", binds
            case ast.IfExp(test=test, body=body, orelse=orelse):
                test_text = self.condition(test, OR)
                return f"{test_text} ? {self.text(body, OR)} : {self.text(orelse, OR)}", CHOICE
            case ast.Call():
                return self._call(node)
        raise NotImplementedError(ast.dump(node))  # typing has already refused other nodes

    def _attribute(self, node: ast.Attribute) -> str:
        if isinstance(node.value, ast.Name):
            return f"{name(node.value.id)}->{name(node.attr)}"
        return f"{self.text(node.value)}.{name(node.attr)}"

    def _subscript(self, node: ast.Subscript) -> str:
        kind = self._typed.expressions[node]
        array = self.text(node.value)
        if isinstance(kind, Array):  # a part of an array is where it begins
            ends = indices_of(node, 1)
            lower = ends[0].lower if isinstance(ends[0], ast.Slice) else None
            return array if lower is None else f"&{array}[{self.text(lower)}]"
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return array + "".join(f"[{self.text(index)}]" for index in indices)

    def _call(self, node: ast.Call) -> tuple[str, int]:
        if node in self._typed.calls:
            arguments = ", ".join(self.address(each) for each in node.args)
            return f"{self._typed.calls[node].function.c_name}({arguments})", WHOLE
        callee = called(self._typed.function.module, node)
        if getattr(callee, "py_func", callee) is getattr(real, "py_func", real):
            kind = self._typed.expressions[node.args[0]]
            if kind is INT:
                return f"(real){self.text(node.args[0], UNARY)}", UNARY
            return self._write(node.args[0])
        if callee is int:
            return f"(int32_t){self.text(node.args[0], UNARY)}", UNARY
        arguments = ", ".join(self.text(each) for each in node.args)
        if callee is math.isfinite:
            return f"real_is_finite({arguments})", WHOLE
        if callee in EXTREMES:
            return self._extreme(node, EXTREMES[callee]), WHOLE
        library = ROUNDED_EXACTLY[callee]
        if library == "copysign":
            return f"real_copysign({arguments})", WHOLE
        return f"{library}{'f' if self._precision == 'float32' else ''}({arguments})", WHOLE

    def _extreme(self, node: ast.Call, which: str) -> str:
        kind = "real" if self._typed.expressions[node] is REAL else "int"
        text = self.text(node.args[0])
        for each in node.args[1:]:
            text = f"{kind}_{which}({text}, {self.text(each)})"
        return text

    def address(self, node: ast.expr) -> str:
        """``node`` as an argument: structs by their address."""
        kind = self._typed.expressions.get(node)
        if isinstance(kind, Record) and not isinstance(node, ast.Name):
            return f"&{self.text(node)}"
        return self.text(node)
