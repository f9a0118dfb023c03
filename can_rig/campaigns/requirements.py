"""Requirements: expressions over metrics, read by ``ast`` and computed here, never by ``eval``.

Numbers, metrics, ``+ - * /``, comparisons, ``and``, ``or``, ``not``, parentheses; no other syntax.
A missing metric (no such moment in the run) makes dependent expressions unknown, as in Kleene's
logic: ``false and unknown`` is false, ``true and unknown`` unknown.

The value of an expression is its margin: above zero if the expression holds, below zero if not,
larger for a safer run, and in parts of the bound, so that margins of different units compare.
"""

import ast
import math
import operator
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any, Final

from can_rig.errors import ScenarioError

Values = Mapping[str, Any]
"""Metrics by name: numbers, truth values, or None; no requirement reads the words among them."""

ARITHMETIC: Final[dict[type[ast.operator], Callable[[float, float], float]]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
COMPARISONS: Final[dict[type[ast.cmpop], Callable[[float, float], bool]]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
LONGEST: Final = 500
"""Limit on the characters of an expression; bounds the depth of nesting."""


Margin = float | None
"""None if the run lacks a necessary metric."""


class Requirement:
    """One expression, checked on construction.

    Raises:
        ScenarioError: invalid syntax, or an unknown name.
    """

    def __init__(self, name: str, text: str, known: Collection[str]) -> None:
        self.name = name
        self.text = text
        self._where = f"requirements.{name} = {text!r}"
        if len(text) > LONGEST:
            raise ScenarioError(f"{self._where[:60]}...: must be at most {LONGEST} characters")
        try:
            tree = ast.parse(text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ScenarioError(f"{self._where}: must be an expression over metrics") from None
        self.names = frozenset(node.id for node in ast.walk(tree) if isinstance(node, ast.Name))
        for unknown in sorted(self.names - set(known)):
            raise ScenarioError(
                f"{self._where}: {unknown}: no such metric; there are {', '.join(sorted(known))}"
            )
        self.of: Callable[[Values], Margin] = self._truth(tree)
        """The margin of a run with the given values."""

    def _truth(self, node: ast.expr) -> Callable[[Values], Margin]:
        """The margin of a comparison, of a metric, or of truths joined by and, or, not."""
        match node:
            case ast.BoolOp(op=op, values=parts):
                truths = [self._truth(part) for part in parts]
                if isinstance(op, ast.And):
                    return lambda values: _all([truth(values) for truth in truths])
                return lambda values: _not(_all([_not(truth(values)) for truth in truths]))
            case ast.UnaryOp(op=ast.Not(), operand=part):
                truth = self._truth(part)
                return lambda values: _not(truth(values))
            case ast.Compare(left=left, ops=ops, comparators=others) if all(
                type(op) in COMPARISONS for op in ops
            ):
                numbers = [self._number(part) for part in (left, *others)]

                def compared(values: Values) -> Margin:
                    found = [number(values) for number in numbers]
                    pairs = zip(ops, found, found[1:], strict=False)
                    return _all([_compared(op, one, other) for op, one, other in pairs])

                return compared
            case ast.Name() | ast.Constant(value=bool()):
                number = self._number(node)
                return lambda values: (
                    None if (it := number(values)) is None else 1.0 if it else -1.0
                )
        raise ScenarioError(
            f"{self._where}: {ast.unparse(node)}: must be a comparison, a metric, or such with "
            "and, or, not"
        )

    def _number(self, node: ast.expr) -> Callable[[Values], float | None]:
        """The value of a number, of a metric, or of arithmetic; None without a result."""
        match node:
            case ast.Name(id=name):
                return lambda values: values[name]
            case ast.Constant(value=int() | float() as constant):
                if abs(constant) > sys.float_info.max:
                    raise ScenarioError(f"{self._where}: a number above 1.8e308: must be finite")
                return lambda _: constant
            case ast.UnaryOp(op=ast.USub(), operand=part):
                negated = self._number(part)
                return lambda values: None if (it := negated(values)) is None else -it
            case ast.BinOp(left=left, op=op, right=right) if type(op) in ARITHMETIC:
                computed, one, other = ARITHMETIC[type(op)], self._number(left), self._number(right)
                return lambda values: _computed(computed, one(values), other(values))
        raise ScenarioError(
            f"{self._where}: {ast.unparse(node)}: must be a number, a metric, or such with + - * /"
        )


def _computed(
    operation: Callable[[float, float], float], one: float | None, other: float | None
) -> float | None:
    if one is None or other is None:
        return None
    try:
        result = operation(one, other)
    except (ZeroDivisionError, OverflowError):
        return None
    return result if math.isfinite(result) else None


def _compared(op: ast.cmpop, one: float | None, other: float | None) -> Margin:
    if one is None or other is None:
        return None
    distance = abs(float(one) - float(other)) / (abs(float(other)) or 1.0)
    if distance == 0.0:  # the least number keeps the sign of a comparison at its bound
        distance = 1.0 if isinstance(op, ast.Eq | ast.NotEq) else sys.float_info.min
    return distance if COMPARISONS[type(op)](one, other) else -distance


def _not(margin: Margin) -> Margin:
    return None if margin is None else -margin


def _all(margins: list[Margin]) -> Margin:
    """Kleene's ``and``: false decides, unknown comes second."""
    least = least_of(margins)
    return None if None in margins and (least is None or least > 0.0) else least


def least_of(margins: Iterable[Margin]) -> Margin:
    """The least margin; None if no requirement yields a margin."""
    return min((margin for margin in margins if margin is not None), default=None)
