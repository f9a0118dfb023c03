"""Mutants of a module: small changes of its syntax tree, each of which some test ought to notice.

    for mutant in mutants(source):
        print(mutant.line, mutant.before, "→", mutant.after)

| what             | becomes                                                                       |
|------------------|-------------------------------------------------------------------------------|
| `a + b`, `a * b` | `a - b`, `a / b`, and the other way round; likewise shifts and bit operators  |
| `-a`, `not a`    | `a`                                                                           |
| `a < b`          | `a <= b`, `a >= b`; likewise every other comparison                           |
| `a and b`        | `a or b`, `a`, `b`                                                            |
| a condition      | its negation                                                                  |
| a number         | 0 ↔ 1; twice a float; one more than an int; `True` ↔ `False`                  |
| a call           | min ↔ max, floor ↔ ceil, sin ↔ cos, expm1 → exp - 1; abs, round: the argument |
| a statement      | left out: a call, an assignment that replaces a value, a raise                |
| `break`          | `continue`, and the other way round                                           |
| `return a`       | `return None`                                                                 |

Texts, annotations, decorators, imports, what is raised, and `strict=True` are left alone.
"""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

_BINARY: Final[dict[type, Any]] = {
    ast.Add: ast.Sub(), ast.Sub: ast.Add(), ast.Mult: ast.Div(), ast.Div: ast.Mult(),
    ast.FloorDiv: ast.Mult(), ast.Mod: ast.Mult(), ast.Pow: ast.Mult(),
    ast.LShift: ast.RShift(), ast.RShift: ast.LShift(),
    ast.BitAnd: ast.BitOr(), ast.BitOr: ast.BitAnd(), ast.BitXor: ast.BitAnd(),
}  # fmt: skip
_COMPARISONS: Final[dict[type, Any]] = {
    ast.Lt: (ast.LtE(), ast.GtE()), ast.LtE: (ast.Lt(), ast.Gt()),
    ast.Gt: (ast.GtE(), ast.LtE()), ast.GtE: (ast.Gt(), ast.Lt()),
    ast.Eq: (ast.NotEq(),), ast.NotEq: (ast.Eq(),),
    ast.Is: (ast.IsNot(),), ast.IsNot: (ast.Is(),),
    ast.In: (ast.NotIn(),), ast.NotIn: (ast.In(),),
}  # fmt: skip
_CALLS: Final = {
    "min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum",
    "floor": "ceil", "ceil": "floor", "sin": "cos", "cos": "sin",
}  # fmt: skip
_ARGUMENT_ALONE: Final = {"abs", "fabs", "round", "rint"}
_LEFT_ALONE: Final = {"annotation", "returns", "decorator_list", "bases", "exc", "cause"}


@dataclass(frozen=True)
class Mutant:
    """One changed module."""

    line: int
    before: str
    """The lines that change, as one."""
    after: str
    source: str
    """The whole module."""
    lines: range
    """The lines that change."""


def mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a module, in the order of its lines; no two are alike."""
    lines = source.splitlines(keepends=True)
    seen = set()
    for node, replacement in sorted(_changes(ast.parse(source)), key=lambda c: c[0].lineno):
        first, last = node.lineno - 1, node.end_lineno
        old = "".join(lines[first:last])
        start = old.encode()[: node.col_offset].decode()  # columns count bytes
        end = lines[last - 1].encode()[node.end_col_offset :].decode()
        new = f"{start}{replacement}{end}"
        source_after = "".join([*lines[:first], new, *lines[last:]])
        mutant = Mutant(
            node.lineno, _plain(old), _plain(new), source_after, range(node.lineno, last + 1)
        )
        if mutant.source != source and mutant not in seen:
            seen.add(mutant)
            yield mutant


def functions_of(source: str) -> dict[int, set[int]]:
    """By line of a module, the body of the outermost function around the line."""
    bodies: dict[int, set[int]] = {}
    for node in ast.walk(ast.parse(source)):  # outer nodes first
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = {*range(node.body[0].lineno, (node.end_lineno or 0) + 1)}
            for line in body:
                bodies.setdefault(line, body)
    return bodies


def _plain(lines: str) -> str:
    """Code without comments, line breaks and superfluous blanks."""
    return " ".join(" ".join(line.partition("  # ")[0] for line in lines.splitlines()).split())


def _changes(node: ast.AST, values: frozenset[str] = frozenset()) -> Iterator[tuple[Any, str]]:
    """Nodes, and the text that takes the place of each.

    ``values`` are the names with a second value beside that of a statement.
    """
    if isinstance(node, ast.FunctionDef):
        values = _set_twice(node)
    if isinstance(node, ast.stmt):
        yield from ((node, text) for text in _statements(node, values))
    elif isinstance(node, ast.expr):
        yield from ((node, f"({text})") for text in (*_operators(node), *_values(node)))
    condition = getattr(node, "test", None)
    if isinstance(condition, ast.expr) and not isinstance(
        condition, ast.Compare | ast.UnaryOp | ast.Constant
    ):
        yield condition, f"(not ({ast.unparse(condition)}))"
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.JoinedStr | ast.arg) or name in _LEFT_ALONE:
                continue
            if isinstance(child, ast.AST) and getattr(child, "arg", None) != "strict":
                yield from _changes(child, values)


def _set_twice(function: ast.FunctionDef) -> frozenset[str]:
    """Parameters, and names that are assigned to more than once."""
    count = Counter(argument.arg for argument in function.args.args)
    count.update(count)
    for node in ast.walk(function):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            count[node.id] += 1
    return frozenset(name for name, times in count.items() if times > 1)


def _statements(node: ast.stmt, values: frozenset[str]) -> Iterator[str]:
    match node:
        case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise():
            yield "pass"
        case ast.Assign(targets=targets):
            names = [n for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            if all(n.id in values for n in names if isinstance(n.ctx, ast.Store)):
                yield "pass"
        case ast.Break():
            yield "continue"
        case ast.Continue():
            yield "break"
        case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
            yield "return None"


def _operators(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.BinOp(left=left, op=op, right=right) if type(op) in _BINARY:
            yield ast.unparse(ast.BinOp(left, _BINARY[type(op)], right))
        case ast.UnaryOp(op=ast.USub() | ast.Not() | ast.Invert(), operand=operand):
            yield ast.unparse(operand)
        case ast.Compare(left=left, ops=ops, comparators=others):
            for at, compared in enumerate(ops):
                for other in _COMPARISONS[type(compared)]:
                    changed = [*ops[:at], other, *ops[at + 1 :]]
                    yield ast.unparse(ast.Compare(left, changed, others))
        case ast.BoolOp(op=op, values=parts):
            yield ast.unparse(ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), parts))
            for at in range(len(parts)):
                kept = [*parts[:at], *parts[at + 1 :]]
                yield ast.unparse(ast.BoolOp(op, kept) if len(kept) > 1 else kept[0])


def _values(node: ast.expr) -> Iterator[str]:
    match node:
        case ast.Constant(value=bool(value)):
            yield repr(not value)
        case ast.Constant(value=int(value) | float(value)):
            if value in (0, 1):
                yield repr(type(value)(1 - value))
            if value:
                yield repr(value + 1 if isinstance(value, int) else value * 2)
        case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[first, *_]):
            call = ast.unparse(node)
            if name in _CALLS:
                yield call.replace(name, _CALLS[name], 1)
            elif name == "expm1":
                yield call.replace(name, "exp", 1) + " - 1.0"
            elif name in _ARGUMENT_ALONE:
                yield ast.unparse(first)
