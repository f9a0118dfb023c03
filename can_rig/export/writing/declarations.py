"""Where C declares each local name: in the innermost block around all uses."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

from can_rig.export.translation.program import Typed

Place = tuple[tuple[int, int], ...]
"""Place of a use: the blocks around the use, outermost first, each with the statement's index."""


@dataclass(frozen=True)
class Declarations:
    """The declarations of a function.

    Attributes:
        before: names declared before a statement, without a value.
        at: names declared by their first assignment.
        once: names with a single assignment.
    """

    before: dict[ast.stmt, list[str]]
    at: dict[ast.stmt, set[str]]
    once: set[str]


def declarations(typed: Typed) -> Declarations:
    """Where every name that ``typed`` assigns is declared."""
    places: dict[str, list[Place]] = {}
    statements: dict[tuple[int, int], ast.stmt] = {}
    stores: dict[str, int] = {}
    loops = set()
    for place, block, node in _uses(typed.function.body, ()):
        statements |= {place[-1]: block[place[-1][1]]}
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            loops.add(node.target.id)
        for each in _own_names(node):
            places.setdefault(each.id, []).append(place)
            if isinstance(each.ctx, ast.Store):
                stores[each.id] = stores.get(each.id, 0) + 1
        if isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
            stores[node.target.id] += 1
    found = Declarations({}, {}, {name for name, n in stores.items() if n == 1})
    for name, uses in places.items():
        if name not in stores or name in typed.function.parameters or name in loops or name == "_":
            continue
        depth = _common(uses)
        key = uses[0][depth - 1]
        first = statements[key]
        if _assigns(first, name) and len(uses[0]) == depth:
            found.at.setdefault(first, set()).add(name)
        else:
            found.before.setdefault(first, []).append(name)
    return found


def _common(places: list[Place]) -> int:
    """Number of blocks that the places share."""
    depth = 0
    for level in zip(*places, strict=False):
        if len({block for block, _ in level}) != 1:
            break
        depth += 1
        if len({index for _, index in level}) != 1:
            break
    return depth


def _assigns(node: ast.stmt, name: str) -> bool:
    """Whether ``node`` assigns ``name`` without reading it."""
    if isinstance(node, ast.AnnAssign):
        return isinstance(node.target, ast.Name) and node.target.id == name
    if not isinstance(node, ast.Assign):
        return False
    targets = [one for each in node.targets for one in getattr(each, "elts", [each])]
    read = any(each.id == name and isinstance(each.ctx, ast.Load) for each in _own_names(node))
    return not read and any(isinstance(one, ast.Name) and one.id == name for one in targets)


def _uses(body: list[ast.stmt], around: Place) -> Iterator[tuple[Place, list[ast.stmt], ast.stmt]]:
    """Every statement, its place and its block."""
    for index, node in enumerate(body):
        place = (*around, (id(body), index))
        yield place, body, node
        for inner in (getattr(node, "body", []), getattr(node, "orelse", [])):
            yield from _uses(inner, place)


def _own_names(node: ast.stmt) -> Iterator[ast.Name]:
    """The names of a statement itself, not of the blocks in it."""
    match node:
        case ast.If():
            parts: list[ast.AST] = [node.test]
        case ast.For():
            parts = [node.iter]
        case _:
            parts = [node]
    for part in parts:
        yield from (each for each in ast.walk(part) if isinstance(each, ast.Name))
