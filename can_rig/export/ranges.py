"""The ranges of integers that the source determines, and refusal of what C leaves undefined.

Numbers, loops, sums, products, ``%``, ``min`` and ``max`` give ranges. Nothing is known of fields,
parameters and results of functions: their range has no ends, and proves or refuses nothing. A
condition around an index narrows no range.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable, Mapping
from typing import Final

from can_rig.export.source import INT, Array, indices_of, names_in
from can_rig.export.subset import Typed

Range = tuple[float, float]
"""The least and the largest value; infinite where unknown."""

UNKNOWN: Final[Range] = (-math.inf, math.inf)
LEAST, LARGEST = -(2**31), 2**31 - 1


def check_ranges(typed: Typed) -> None:
    """Check every index and every integer of a function.

    Raises:
        ExportError: an index beyond its array, an integer beyond 32 bits, or a name that is no
            ASCII.
    """
    _Ranges(typed).check()


class _Ranges:
    def __init__(self, typed: Typed) -> None:
        self._typed, self._module = typed, typed.function.module
        self._assigned: dict[str, list[tuple[ast.expr, Mapping[str, Range]]]] = {}
        self._unknown = set(typed.function.parameters)
        self._places: list[tuple[ast.AST, Mapping[str, Range]]] = []

    def check(self) -> None:
        for node in ast.walk(self._typed.function.tree):
            name = str(getattr(node, "id", getattr(node, "attr", getattr(node, "arg", ""))))
            if not name.isascii():
                raise self._module.refuse(node, f"{name}: must be a name in ASCII, as C has them")
        self._block(self._typed.function.body, {})
        for place, counters in self._places:
            for node in ast.walk(place):
                if isinstance(node, ast.Subscript):
                    self._check_index(node, counters)
                elif isinstance(node, ast.BinOp):
                    self._check_integer(node, counters)

    def _block(self, body: Iterable[ast.stmt], counters: Mapping[str, Range]) -> None:
        """Collect assignments and places, with the ranges of the counters around them."""
        for node in body:
            match node:
                case ast.If():
                    self._places.append((node.test, counters))
                    self._block(node.body, counters)
                    self._block(node.orelse, counters)
                case ast.For(target=ast.Name(id=counter), iter=ast.Call(args=ends)):
                    self._places.append((node.iter, counters))
                    start = self._of(ends[0], counters)[0] if len(ends) > 1 else 0
                    last = self._of(ends[-1], counters)[1] - 1
                    self._block(node.body, {**counters, counter: (start, last)})
                case _:
                    self._places.append((node, counters))
                    self._assign(node, counters)

    def _assign(self, node: ast.stmt, counters: Mapping[str, Range]) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    if isinstance(target, ast.Name):
                        self._assigned.setdefault(target.id, []).append((value, counters))
                    elif isinstance(target, ast.Tuple):
                        self._unknown |= {each.id for each in names_in(target)}
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                self._assigned.setdefault(name, []).append((value, counters))
            case ast.AugAssign(target=ast.Name(id=name)):
                self._unknown.add(name)

    def _check_index(self, node: ast.Subscript, counters: Mapping[str, Range]) -> None:
        array = self._typed.types[node.value]
        indices = indices_of(node)
        if not isinstance(array, Array) or any(isinstance(each, ast.Slice) for each in indices):
            return
        for index, size in zip(indices, array.shape, strict=True):
            least, largest = self._of(index, counters)
            wrong = least if -math.inf < least < 0 else largest
            if -math.inf < least < 0 or size <= largest < math.inf:
                raise self._module.refuse(
                    node, f"{{}}: index {wrong:.0f} is possible: must be from 0 to {size - 1}"
                )

    def _check_integer(self, node: ast.BinOp, counters: Mapping[str, Range]) -> None:
        if self._typed.types.get(node) is INT:
            for end in self._of(node, counters):
                if math.isfinite(end) and not LEAST <= end <= LARGEST:
                    raise self._module.refuse(
                        node, f"{{}} can be {end:.0f}: must be from -2**31 to 2**31 - 1"
                    )

    def _of(self, node: ast.expr, counters: Mapping[str, Range]) -> Range:
        """The range of an integer."""
        match node:
            case ast.Constant(value=int(value)):
                return (value, value)
            case ast.Name(id=name) if name in counters:
                return counters[name]
            case ast.Name(id=name):
                return self._of_name(name)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                least, largest = self._of(operand, counters)
                return (-largest, -least)
            case ast.IfExp(body=one, orelse=other):
                return _around([self._of(one, counters), self._of(other, counters)])
            case ast.BinOp(left=left, op=op, right=right):
                return _combined(op, self._of(left, counters), self._of(right, counters))
            case ast.Call(func=ast.Name(id="min" | "max" as extreme), args=arguments):
                pick = min if extreme == "min" else max
                ranges = [self._of(each, counters) for each in arguments]
                return (pick(each[0] for each in ranges), pick(each[1] for each in ranges))
        return UNKNOWN

    def _of_name(self, name: str) -> Range:
        """The range of a number of the module, or of all values that a name gets."""
        if name in self._unknown:
            return UNKNOWN
        if name not in self._typed.names:
            value = self._module.lookup(name)
            return (value, value) if isinstance(value, int) else UNKNOWN
        self._unknown.add(name)  # while in its own value
        found = [self._of(value, counters) for value, counters in self._assigned.get(name, [])]
        self._unknown.discard(name)
        return _around(found or [UNKNOWN])


def _around(ranges: list[Range]) -> Range:
    return (min(least for least, _ in ranges), max(largest for _, largest in ranges))


def _combined(op: ast.operator, left: Range, right: Range) -> Range:
    if isinstance(op, ast.Add):
        return (left[0] + right[0], left[1] + right[1])
    if isinstance(op, ast.Sub):
        return (left[0] - right[1], left[1] - right[0])
    if isinstance(op, ast.Mod) and right[0] > 0 and right[1] < math.inf:
        return (0, right[1] - 1)
    if isinstance(op, ast.Mult):
        products = [0.0 if 0 in (a, b) else a * b for a in left for b in right]
        return (min(products), max(products))
    return UNKNOWN
