"""Side effects of functions, and refusal of expressions whose order C may change.

Python computes operands and arguments from left to right, C in any order. So in an expression a
function that changes something stands beside names, literals and constants of the table only; local
names cannot change during the expression, and structs without writers never change.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

from can_rig.export.translation.program import Program, Typed
from can_rig.export.translation.types import Array, CStruct, Record


class Effects:
    """The side effects of a program's functions.

    Args:
        program: the whole program.

    Raises:
        ExportError: the value of an expression depends on C's order of evaluation.
    """

    def __init__(self, program: Program) -> None:
        self._written: dict[Typed, set[str]] = {}
        self._changing: set[CStruct] = set()
        functions = list(program.functions.values())
        for typed in functions:
            self._written[typed] = set(self._writes(typed))
        for typed in functions:
            _Order(self, typed).check()

    def written(self, typed: Typed) -> set[str]:
        """Names of the parameters that ``typed`` writes, directly or through members."""
        return self._written[typed]

    def pure(self, typed: Typed) -> bool:
        """Whether the function has no side effect."""
        return not self._written[typed]

    def changes(self, struct: CStruct) -> bool:
        """Whether any function writes to the struct."""
        return struct in self._changing

    def _writes(self, typed: Typed) -> Iterator[str]:
        """The names that ``typed`` writes, aliases included."""
        aliases = dict(_aliases(typed))
        for node in _walk(typed):
            targets: list[ast.expr] = []
            if isinstance(node, ast.Assign):
                targets = [one for each in node.targets for one in _flat(each)]
            elif isinstance(node, ast.AugAssign):
                targets = [node.target]
            elif isinstance(node, ast.Call) and node in typed.calls:
                callee = typed.calls[node]
                pairs = zip(callee.function.parameters, node.args, strict=True)
                targets = [each for name, each in pairs if name in self._written[callee]]
            for target in targets:
                if isinstance(target, ast.Name) and not isinstance(node, ast.Call):
                    continue
                self._note(typed, target)
                name: str | None = root(target)
                while name is not None:
                    yield name
                    name = aliases.get(name)

    def _note(self, typed: Typed, target: ast.expr) -> None:
        """Every struct on the way to ``target`` changes."""
        node: ast.expr = target
        while True:
            kind = typed.expressions.get(node)
            if isinstance(node, ast.Name):
                kind = typed.names[node.id]
            if isinstance(kind, Record):
                self._changing.add(kind.struct)
            if not isinstance(node, ast.Attribute | ast.Subscript):
                return
            node = node.value


class _Order:
    """Looks for expressions whose value depends on the order of their parts."""

    def __init__(self, effects: Effects, typed: Typed) -> None:
        self._effects = effects
        self._typed = typed
        self._module = typed.function.module

    def check(self) -> None:
        """Refuse the first offence."""
        for node in _walk(self._typed):
            match node:
                case ast.BinOp(left=left, right=right):
                    self._unordered(node, [left, right])
                case ast.Compare(left=left, comparators=others):
                    self._unordered(node, [left, *others])
                case ast.Call(args=arguments):
                    self._unordered(node, arguments)
                case ast.AugAssign(target=target, value=value):
                    self._unordered(node, [target, value])
                case ast.Assign(targets=targets, value=value):
                    self._assign(node, targets, value)
                case ast.For(iter=ast.Call(args=ends)):
                    self._loop(node, ends)

    def _unordered(self, node: ast.AST, parts: list[ast.expr]) -> None:
        for part in parts:
            if not self._acts(part):
                continue
            if not all(self._stable(other) for other in parts if other is not part):
                raise self._module.refuse(
                    node, f"{ast.unparse(part)} changes something, and C may compute what stands "
                    "beside it before or after: must be on a line of its own"
                )  # fmt: skip

    def _assign(self, node: ast.Assign, targets: list[ast.expr], value: ast.expr) -> None:
        """Several targets get the same value, or each its own, one after the other."""
        first = targets[0]
        if isinstance(first, ast.Tuple) and isinstance(value, ast.Tuple):
            for i, target in enumerate(first.elts):
                self._unordered(node, [*_indices(target), value.elts[i]])
                for later in value.elts[i + 1 :]:
                    if not self._untouched(target, later):
                        raise self._module.refuse(
                            node, f"{ast.unparse(node)}: {ast.unparse(later)} may be what was just "
                            "assigned: must be two statements"
                        )  # fmt: skip
        elif len(targets) > 1 and not self._stable(value):
            raise self._module.refuse(
                node, f"{ast.unparse(value)}: must be a name or a literal to go to several places"
            )
        else:
            indices = [index for target in targets for index in _indices(target)]
            self._unordered(node, [*indices, value])

    def _untouched(self, target: ast.expr, later: ast.expr) -> bool:
        """Whether ``later`` is independent of the assignment to ``target``."""
        if isinstance(target, ast.Name):
            return all(node.id != target.id for node in _names(later))
        return self._stable(later) or self._typed.expressions.get(later).__class__ in (
            Record,
            Array,
        )

    def _loop(self, node: ast.For, ends: list[ast.expr]) -> None:
        """C looks at the end of a range in every turn."""
        for end in ends:
            names = {name.id for name in _names(end)}
            stored = (
                each.id
                for inside in node.body
                for each in _names(inside)
                if isinstance(each.ctx, ast.Store)
            )
            if not self._stable(end) or names & set(stored):
                raise self._module.refuse(
                    end, f"range({ast.unparse(end)}): must be a name, a number or a constant of "
                    "the table that the loop does not change"
                )  # fmt: skip

    def _acts(self, node: ast.expr) -> bool:
        """Whether computing ``node`` changes something."""
        return any(
            inner in self._typed.calls and not self._effects.pure(self._typed.calls[inner])
            for inner in ast.walk(node)
            if isinstance(inner, ast.Call)
        )

    def _stable(self, node: ast.expr) -> bool:
        """Whether ``node`` is the same before and after any call."""
        if self._acts(node):
            return False
        for inner in ast.walk(node):
            if isinstance(inner, ast.Call) and inner in self._typed.calls:
                arguments = self._typed.calls[inner].arguments
                if any(isinstance(each, Record | Array) for each in arguments):
                    return False
            if isinstance(inner, ast.Attribute | ast.Subscript) and not self._is_address(inner):
                owner = self._typed.expressions.get(inner.value)
                if isinstance(owner, Record) and not self._effects.changes(owner.struct):
                    continue
                if isinstance(owner, Array) and self._constant_array(inner.value):
                    continue
                if owner is not None:
                    return False
        return True

    def _is_address(self, node: ast.expr) -> bool:
        return isinstance(self._typed.expressions.get(node), Record | Array)

    def _constant_array(self, node: ast.expr) -> bool:
        owner = self._typed.expressions.get(getattr(node, "value", node))
        return isinstance(owner, Record) and not self._effects.changes(owner.struct)


def root(node: ast.expr) -> str | None:
    """The variable that contains ``node``; None if ``node`` is no part of a variable."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


def _aliases(typed: Typed) -> Iterator[tuple[str, str]]:
    """Aliases of a part of another object, with the object's expression."""
    for node in _walk(typed):
        if not isinstance(node, ast.Assign):
            continue
        for target in node.targets:
            sides = [(target, node.value)]
            if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
                sides = list(zip(target.elts, node.value.elts, strict=True))
            for one, value in sides:
                whole = root(value)
                if not isinstance(one, ast.Name) or whole is None:
                    continue
                if isinstance(typed.names.get(one.id), Record | Array):
                    yield one.id, whole


def _indices(target: ast.expr) -> list[ast.expr]:
    """Index expressions that locate ``target``."""
    if isinstance(target, ast.Tuple):
        return [index for each in target.elts for index in _indices(each)]
    found = []
    while isinstance(target, ast.Attribute | ast.Subscript):
        if isinstance(target, ast.Subscript):
            index = target.slice
            found += index.elts if isinstance(index, ast.Tuple) else [index]
        target = target.value
    return [each for each in found if not isinstance(each, ast.Slice)]


def _flat(target: ast.expr) -> list[ast.expr]:
    return target.elts if isinstance(target, ast.Tuple) else [target]


def _walk(typed: Typed) -> Iterator[ast.AST]:
    for statement in typed.function.body:
        yield from ast.walk(statement)


def _names(node: ast.AST) -> Iterator[ast.Name]:
    return (each for each in ast.walk(node) if isinstance(each, ast.Name))
