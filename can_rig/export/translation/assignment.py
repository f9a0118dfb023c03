"""Whether every local name has a value wherever it is read, whichever way led there."""

from __future__ import annotations

import ast

from can_rig.export.translation.source import Function

Known = set[str] | None
"""Names with a value; None for unreachable code."""


def check_assigned(function: Function) -> None:
    """Check all paths through ``function``.

    Raises:
        ExportError: a name may be read without a value.
    """
    _Ways(function).block(function.body, set(function.parameters))


class _Ways:
    """The paths through one function."""

    def __init__(self, function: Function) -> None:
        self._module = function.module
        nodes = [node for statement in function.body for node in ast.walk(statement)]
        self._locals = {name for node in nodes for name in _stored(node)}
        self._counters = {
            node.target.id
            for node in nodes
            if isinstance(node, ast.For) and isinstance(node.target, ast.Name)
        }

    def block(self, body: list[ast.stmt], known: Known) -> Known:
        """Names with a value after ``body``; ``known`` had values before."""
        for node in body:
            if known is None:
                raise self._module.refuse(node, "is never reached: must not be there")
            known = self._statement(node, known)
        return known

    def _statement(self, node: ast.stmt, known: set[str]) -> Known:
        match node:
            case ast.If():
                self._read(node.test, known)
                ways = [self.block(part, known) for part in (node.body, node.orelse)]
                ends = [way for way in ways if way is not None]
                return set.intersection(*ends) if ends else None
            case ast.For(target=ast.Name(id=counter)):
                self._read(node.iter, known)
                self.block(node.body, known | {counter})
                return known  # the loop may have no turn
            case ast.Return() | ast.Break() | ast.Continue():
                self._read(node, known)
                return None
            case ast.AnnAssign(value=ast.expr() as value):
                self._read(value, known)
            case _:
                self._read(node, known)
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            self._require(node.target, known)
        return known | {name for each in ast.walk(node) for name in _stored(each)}

    def _read(self, node: ast.AST, known: set[str]) -> None:
        for each in ast.walk(node):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load):
                self._require(each, known)

    def _require(self, name: ast.Name, known: set[str]) -> None:
        if name.id in known or name.id not in self._locals:
            return
        what = f"{name.id}: must be assigned on every way that leads here"
        if name.id in self._counters:
            what = f"{name.id} ends with its loop: must be another name, assigned inside the loop"
        raise self._module.refuse(name, what)


def _stored(node: ast.AST) -> list[str]:
    return [node.id] if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else []
