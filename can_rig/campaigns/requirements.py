"""Requirements: expressions over metrics, read by ``ast`` and computed here, never by ``eval``.

Numbers, metrics, ``+ - * /``, comparisons, ``and``, ``or``, ``not``, parentheses; no other syntax.
A missing metric (no such moment in the run) makes dependent expressions unknown, as in Kleene's
logic: ``false and unknown`` is false, ``true and unknown`` unknown.

Each expression has a margin too: positive if the expression holds, larger for a safer run, and
relative to the bound, so that margins of different units compare.
"""

from __future__ import annotations

import ast
import math
import operator
import sys
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, Final

from can_rig.errors import ScenarioError

Values = Mapping[str, float | bool | None]

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


@dataclass(frozen=True)
class Verdict:
    """Result of a requirement in a run.

    Attributes:
        passed: None if the run lacks a necessary metric.
        margin: above zero where it passed, in parts of the bound; None likewise.
    """

    passed: bool | None
    margin: float | None


UNKNOWN: Final = Verdict(None, None)


class Requirement:
    """One expression, checked on construction.

    Args:
        name: of the requirement.
        text: the expression.
        known: permitted names.

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
            self._tree = ast.parse(text, mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ScenarioError(f"{self._where}: must be an expression over metrics") from None
        self.names = frozenset(
            node.id for node in ast.walk(self._tree) if isinstance(node, ast.Name)
        )
        for unknown in sorted(self.names - set(known)):
            raise ScenarioError(
                f"{self._where}: {unknown}: no such metric; there are {', '.join(sorted(known))}"
            )
        self._check(self._tree, truth=True)

    def of(self, values: Values) -> Verdict:
        """The verdict on a run with the given values."""
        return self._truth(self._tree, values)

    def _check(self, node: ast.expr, *, truth: bool) -> None:
        """Refuse any syntax except expressions over metrics; ``truth``: require a verdict."""
        match node:
            case ast.BoolOp(values=parts) if truth:
                self._check_all(parts, truth=True)
            case ast.UnaryOp(op=ast.Not(), operand=part) if truth:
                self._check(part, truth=True)
            case ast.Compare(left=left, ops=ops, comparators=others) if truth and all(
                type(op) in COMPARISONS for op in ops
            ):
                self._check_all([left, *others], truth=False)
            case ast.Name() | ast.Constant(value=bool()):
                return
            case ast.UnaryOp(op=ast.USub(), operand=part) if not truth:
                self._check(part, truth=False)
            case ast.BinOp(left=left, op=op, right=right) if not truth and type(op) in ARITHMETIC:
                self._check_all([left, right], truth=False)
            case ast.Constant(value=int() | float() as number) if not truth:
                if abs(number) > sys.float_info.max:
                    raise ScenarioError(f"{self._where}: a number above 1.8e308: must be finite")
            case _:
                raise ScenarioError(
                    f"{self._where}: {ast.unparse(node)}: must be "
                    f"{'a comparison, ' if truth else 'a number, '}a metric, or such with "
                    f"{'and, or, not' if truth else '+ - * /'}"
                )

    def _check_all(self, nodes: list[ast.expr], *, truth: bool) -> None:
        for node in nodes:
            self._check(node, truth=truth)

    def _truth(self, node: ast.expr, values: Values) -> Verdict:
        match node:
            case ast.BoolOp(op=ast.And(), values=parts):
                return _all([self._truth(part, values) for part in parts])
            case ast.BoolOp(values=parts):
                return _not(_all([_not(self._truth(part, values)) for part in parts]))
            case ast.UnaryOp(operand=part):
                return _not(self._truth(part, values))
            case ast.Compare(left=left, ops=ops, comparators=others):
                numbers = [self._number(part, values) for part in (left, *others)]
                pairs = zip(ops, numbers, numbers[1:], strict=False)
                return _all([_compared(op, a, b) for op, a, b in pairs])
        value = self._number(node, values)
        return UNKNOWN if value is None else Verdict(bool(value), 1.0 if value else -1.0)

    def _number(self, node: ast.expr, values: Values) -> float | None:
        match node:
            case ast.Name(id=name):
                return values[name]
            case ast.Constant(value=number):
                return number if isinstance(number, int | float) else None
            case ast.UnaryOp(operand=part):
                value = self._number(part, values)
                return None if value is None else -value
            case ast.BinOp(left=left, op=op, right=right):
                one, other = self._number(left, values), self._number(right, values)
                if one is None or other is None:
                    return None
                try:
                    result = ARITHMETIC[type(op)](one, other)
                except (ZeroDivisionError, OverflowError):
                    return None
                return result if math.isfinite(result) else None
        raise AssertionError(ast.dump(node))


def _compared(op: ast.cmpop, one: float | None, other: float | None) -> Verdict:
    if one is None or other is None:
        return UNKNOWN
    passed = COMPARISONS[type(op)](one, other)
    distance = abs(float(one) - float(other)) / (abs(float(other)) or 1.0)
    if isinstance(op, ast.Eq | ast.NotEq) and distance == 0.0:
        distance = 1.0
    return Verdict(passed, distance if passed else -distance)


def _not(verdict: Verdict) -> Verdict:
    if verdict.passed is None or verdict.margin is None:
        return UNKNOWN
    return Verdict(not verdict.passed, -verdict.margin)


def _all(verdicts: list[Verdict]) -> Verdict:
    """Kleene's ``and``: false decides, unknown comes second."""
    known = [verdict.margin for verdict in verdicts if verdict.margin is not None]
    if any(verdict.passed is False for verdict in verdicts):
        return Verdict(False, min(known))
    if any(verdict.passed is None for verdict in verdicts):
        return UNKNOWN
    return Verdict(True, min(known))


def margin(verdicts: Collection[Verdict]) -> float | None:
    """The least margin; None if no requirement yields a margin."""
    known: list[Any] = [each.margin for each in verdicts if each.margin is not None]
    return min(known) if known else None
