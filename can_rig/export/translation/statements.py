"""The type of every name of a function, from its statements."""

from __future__ import annotations

import ast

from can_rig.export.translation.expressions import Expressions
from can_rig.export.translation.source import Function
from can_rig.export.translation.types import (
    INT,
    LITERAL,
    REAL,
    Answers,
    Array,
    Scalar,
    Type,
    in_words,
)


class Statements:
    """Assigns types to the statements of one function.

    Args:
        function: the function.
        names: types of its names; assigned names are added.
        expressions: types its expressions.

    Attributes:
        result: type of the result.
    """

    def __init__(
        self, function: Function, names: dict[str, Type], expressions: Expressions
    ) -> None:
        self._function = function
        self._module = function.module
        self._names = names
        self._expressions = expressions
        self._loops: list[str] = []  # names of the loops around a statement
        self._counters: set[str] = set()  # names of all loops so far
        self.result: Type = None
        self._returned = False

    def type_all(self) -> None:
        """Type the whole function.

        Raises:
            ExportError: something is outside the subset.
        """
        body = self._function.body
        self._block(body)
        last = body[-1] if body else self._function.tree
        if self.result is not None and not _always_returns(last):
            raise self._module.refuse(last, f"{self._function.name} must end with a return")

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign():
                self._assign(node)
            case ast.AnnAssign(target=ast.Name() as target, value=ast.expr() as value):
                self._bind(target, self._expressions.value(value))
            case ast.AugAssign(op=ast.Mod()):
                raise self._module.refuse(node, f"{ast.unparse(node)}: must be x = x % n")
            case ast.AugAssign():
                self._expressions.of(ast.BinOp(node.target, node.op, node.value, **_at(node)))
                self._store(node.target, self._expressions.of(node.target))
            case ast.If():
                self._expressions.condition(node.test)
                self._block(node.body)
                self._block(node.orelse)
            case ast.For():
                self._for(node)
            case ast.Return():
                self._return(node)
            case ast.Expr(value=ast.Call() as call):
                self._expressions.of(call)
            case ast.Pass() | ast.Break() | ast.Continue():
                pass
            case _:
                first = ast.unparse(node).splitlines()[0].rstrip(":")
                raise self._module.refuse(
                    node, f"{first}: must be an assignment, a call, if, for ... in range(...) "
                    "or return"
                )  # fmt: skip

    def _assign(self, node: ast.Assign) -> None:
        """Type an assignment: one value to several names, or several values to as many names."""
        first = node.targets[0]
        if isinstance(first, ast.Tuple) and len(node.targets) == 1:
            if isinstance(node.value, ast.Tuple):
                if len(first.elts) != len(node.value.elts):
                    raise self._module.refuse(node, "must have as many values as names")
                kinds = [self._assigned(each) for each in node.value.elts]
            else:
                answers = self._expressions.of(node.value)
                if not isinstance(answers, Answers) or len(answers.items) != len(first.elts):
                    raise self._module.refuse(
                        node, f"{ast.unparse(node.value)} is {in_words(answers)}: must be "
                        f"{len(first.elts)} values"
                    )  # fmt: skip
                kinds = [kind for _, kind in answers.items]
            for target, kind in zip(first.elts, kinds, strict=True):
                self._store(target, kind)
            return
        kind = self._assigned(node.value)
        for target in node.targets:
            self._store(target, kind)

    def _assigned(self, value: ast.expr) -> Type:
        kind = self._expressions.of(value)
        if kind is None or isinstance(kind, Answers):
            raise self._module.refuse(
                value, f"{ast.unparse(value)} is {in_words(kind)}: must be one value"
            )
        return kind

    def _store(self, target: ast.expr, kind: Type) -> None:
        """Check that ``target`` can hold a value of type ``kind``."""
        if isinstance(target, ast.Name):
            self._bind(target, kind)
            return
        held = self._expressions.of(target)
        if isinstance(held, Array) and isinstance(target, ast.Subscript):
            held = held.element  # all of a slice gets the same value
        fits = held is kind or (held is REAL and kind is LITERAL)
        if not isinstance(held, Scalar) or not fits:
            raise self._module.refuse(
                target, f"{ast.unparse(target)} gets {in_words(kind)}: must be {in_words(held)}"
            )

    def _bind(self, target: ast.Name, kind: Type) -> None:
        """Bind a name to its only type."""
        if target.id == "_":
            return
        if kind is LITERAL:
            raise self._module.refuse(
                target, f"{target.id} gets a literal without a precision: must be real(..., x)"
            )
        if target.id in self._counters:
            raise self._module.refuse(target, f"{target.id} counts a loop: must not be assigned")
        known = self._names.setdefault(target.id, kind)
        if known != kind:
            raise self._module.refuse(
                target,
                f"{target.id} is {in_words(known)} before and {in_words(kind)} here: "
                "must be one type, or two names",
            )
        self._expressions.types[target] = kind

    def _for(self, node: ast.For) -> None:
        """A loop over range(stop) or range(start, stop), neither of which changes meanwhile."""
        what = "must be for i in range(stop) or range(start, stop)"
        match node:
            case ast.For(
                target=ast.Name() as target,
                iter=ast.Call(func=ast.Name(id="range"), args=ends, keywords=[]),
                orelse=[],
            ) if 1 <= len(ends) <= 2:
                for end in ends:
                    self._expressions.require(end, INT)
            case _:
                raise self._module.refuse(node, f"{ast.unparse(node).splitlines()[0]} {what}")
        self._count(target)
        self._loops.append(target.id)
        self._block(node.body)
        self._loops.pop()

    def _count(self, target: ast.Name) -> None:
        """Check that a loop counter has no other use, because C ends the counter with the loop."""
        taken = target.id in self._names and target.id not in self._counters
        if taken or (target.id in self._loops and target.id != "_"):
            raise self._module.refuse(
                target, f"{target.id} has another use: must be a name that only counts this loop"
            )
        if target.id != "_":
            self._names[target.id] = self._expressions.types[target] = INT
            self._counters.add(target.id)

    def _return(self, node: ast.Return) -> None:
        kind: Type = None
        if isinstance(node.value, ast.Tuple):
            names = [each.id for each in node.value.elts if isinstance(each, ast.Name)]
            if len(names) != len(node.value.elts):
                raise self._module.refuse(node, "must return names, which C needs for its struct")
            items = [self._expressions.value(each) for each in node.value.elts]
            kind = Answers(self._function.c_name, tuple(zip(names, items, strict=True)))
        elif node.value is not None:
            kind = self._expressions.value(node.value)
        if self._returned and kind != self.result:
            raise self._module.refuse(
                node, f"returns {in_words(kind)}: must be {in_words(self.result)} as before"
            )
        self._returned, self.result = True, kind


def _always_returns(node: ast.stmt) -> bool:
    if isinstance(node, ast.If):
        return all(part and _always_returns(part[-1]) for part in (node.body, node.orelse))
    return isinstance(node, ast.Return)


def _at(node: ast.stmt) -> dict[str, int]:
    return {"lineno": node.lineno, "col_offset": node.col_offset}
