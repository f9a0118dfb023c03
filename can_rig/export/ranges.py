"""Proof that every index lies in its array and every integer in 32 bits; refusal without a proof.

Each integer has a range, of all values that any run can give it: numbers, loops, arithmetic, the
arguments of all calls, the answers of functions, the assignments to a field, and what conditions
leave (``if i > 0:``). Memory begins with zeros; the range of a constant of the table stands in its
declaration (``structs.Struct``). A real number has a range too where comparisons have excluded NaN,
because ``int(x)`` of any other number is undefined in C.

The ranges are a fixed point of the whole program (P. and R. Cousot, Abstract Interpretation, 1977):
ranges grow from nothing until no assignment leaves them; a range that does not settle goes to
infinity, and two more passes take back what no assignment needs.
"""

import ast
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import nullcontext, suppress
from functools import cache
from typing import Final

import numpy as np

from can_rig.export.source import INT, REAL, Array, CStruct, Record, Type, indices_of, paired
from can_rig.export.subset import EXTREMES, PLAIN_REAL, Program, Typed, called

Range = tuple[float, float]
"""The least and the largest value, neither of them NaN; infinite where unknown."""

Key = tuple[str, str, str | int]
"""A field by struct and name, or a parameter or an answer by function and name or place."""

Ranges = dict[str, Range]
"""Ranges by local name or path (``state.n``), as far as known."""

ANY: Final[Range] = (-math.inf, math.inf)
LEAST, LARGEST = -(2**31), 2**31 - 1
SETTLING: Final = 4  # passes until what still grows goes to infinity
SMALL: Final = 1e15  # real numbers whose arithmetic gives no infinity and no NaN
ROUNDING: Final = 1e-5  # relative, of real numbers in either precision
UNDERFLOW: Final = 1.5e-45  # absolute

OPPOSITE: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
}  # fmt: skip
MIRRORED: Final[dict[type[ast.cmpop], type[ast.cmpop]]] = {
    ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE,
}  # fmt: skip
NO_ASCII: Final = "must be a name in ASCII, as C has them"
STEPS: Final = (np.rint, np.ceil)


def check_ranges(program: Program, entries: Collection[str], changing: Collection[CStruct]) -> None:
    """Check every index and every integer of a program.

    Args:
        program: the program.
        entries: C names of the functions that other programs call, with any numbers.
        changing: the structs that the program writes, which begin with zeros.

    Raises:
        ExportError: an index that may lie beyond its array, an integer that may be beyond 32 bits,
            a division by zero, a real number without bounds as an integer, or a name that is no
            ASCII.
    """
    for typed in program.functions.values():
        _check_names(typed)
    _Proof(program, entries, changing).check()


def _check_names(typed: Typed) -> None:
    for node in ast.walk(typed.function.tree):
        name = str(getattr(node, "id", getattr(node, "attr", getattr(node, "arg", ""))))
        if not name.isascii():
            raise typed.function.module.refuse(node, f"{name}: {NO_ASCII}")


class _Proof:
    """The fixed point: ``known`` are the ranges assumed in a pass, ``found`` those that follow."""

    def __init__(
        self, program: Program, entries: Collection[str], changing: Collection[CStruct]
    ) -> None:
        self._changing = changing
        self._functions = list(reversed(program.functions.values()))  # callers first
        self._entries = entries
        self.written = {
            _field(target, typed)
            for typed in self._functions
            for node in ast.walk(typed.function.tree)
            if isinstance(node, ast.Assign | ast.AugAssign)
            for target, _ in _pairs(node)
            if isinstance(target, ast.Attribute)
        }
        self.changed = {field for _, _, field in self.written}
        self.known: dict[Key, Range | None] = {}
        self.found: dict[Key, Range | None] = {}
        self.checking = False
        calls = {node for typed in self._functions for node in typed.calls}
        self.has_call = cache(lambda node: any(each in calls for each in ast.walk(node)))
        self.path, self.in_array = cache(ast.unparse), cache(_in_array)
        """Of a node; each pass asks for the same nodes."""

    def check(self) -> None:
        """Find the ranges, then check every function with them."""
        growths: Counter[Key] = Counter()
        while grown := self._grown():
            growths.update(grown.keys())
            for key, each in grown.items():
                before = self.known.get(key)
                self.known[key] = each
                if growths[key] > SETTLING and before is not None and each is not None:
                    least = each[0] if each[0] == before[0] else -math.inf
                    self.known[key] = (least, each[1] if each[1] == before[1] else math.inf)
        settled = self.known
        for _ in range(2):
            self._follow()
            self.known = self.found
        if self._grown():
            self.known = settled  # taking back has taken too much
        self.checking = True
        self._follow()

    def _grown(self) -> dict[Key, Range | None]:
        """The ranges of a pass that are not within the known ranges."""
        self._follow()
        joined = {key: _around(each, self.known.get(key, each)) for key, each in self.found.items()}
        known = self.known
        return {k: each for k, each in joined.items() if k not in known or known[k] != each}

    def _follow(self) -> None:
        self.found = {}
        for typed in self._functions:
            _Pass(self, typed).run(typed.function.c_name in self._entries)

    def add(self, key: Key, found: Range | None) -> None:
        """A value that a field, a parameter or an answer gets; None: may be NaN."""
        self.found[key] = _around(found, self.found.get(key, found))

    def of_field(self, struct: CStruct, name: str) -> Range:
        """Zero in memory that the program writes, and as declared, or else all that is assigned."""
        key = ("field", struct.tag, name)
        found = self.known.get(key, (0, 0)) if key in self.written else ANY
        found = _declared(struct, name) or found
        return (_around((0, 0), found) if struct in self._changing else found) or ANY


class _NotFollowedError(Exception):
    """A called function has not been followed to an answer yet."""


class _Pass:
    """One function, from its first statement to its last, with the ranges known so far."""

    def __init__(self, proof: _Proof, typed: Typed) -> None:
        self._proof, self._typed = proof, typed
        self._module, self._name = typed.function.module, typed.function.c_name
        self._breaks: list[Ranges] = []
        self._continues: list[Ranges] = []

    def run(self, is_entry: bool) -> None:
        """Follow the function, if anything calls it."""
        ranges: Ranges = {}
        for name, kind in zip(self._typed.function.parameters, self._typed.arguments, strict=True):
            known = self._proof.known.get(("parameter", self._name, name))
            if kind is INT and known is None and not is_entry:
                return  # no call has been followed yet
            if known is not None and not is_entry:
                ranges[name] = known
        with nullcontext() if self._proof.checking else suppress(_NotFollowedError):
            self._block(self._typed.function.body, ranges)

    # --- statements ------------------------------------------------------------------------------

    def _block(self, body: list[ast.stmt], ranges: Ranges | None) -> Ranges | None:
        """The ranges after ``body``; None where ``body`` never ends."""
        for node in body:
            if ranges is None:
                break
            ranges = self._statement(node, ranges)
        return ranges

    def _statement(self, node: ast.stmt, ranges: Ranges) -> Ranges | None:
        match node:
            case ast.If():
                self._of(node.test, ranges)
                ways = [
                    self._block(body, self._where(node.test, truth, ranges))
                    for body, truth in ((node.body, True), (node.orelse, False))
                ]
                return _joined(*ways)
            case ast.For():
                return self._loop(node, ranges)
            case ast.Return():
                self._answer(node.value, ranges)
                return None
            case ast.Break():
                self._breaks.append(ranges)
                return None
            case ast.Continue():
                self._continues.append(ranges)
                return None
            case ast.Expr(value=value):
                self._of(value, ranges)
            case ast.Assign() | ast.AnnAssign() | ast.AugAssign():
                self._assign(node, ranges)
        return ranges

    def _assign(self, node: ast.Assign | ast.AnnAssign | ast.AugAssign, ranges: Ranges) -> None:
        if isinstance(node, ast.AugAssign):
            left, right = self._of(node.target, ranges), self._of(node.value, ranges)
            kind = self._type_of(node.target)
            self._store(node.target, self._computed(node, node.op, kind, left, right), ranges)
            return
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Call() as call):
                self._of(call, ranges)
                callee = self._typed.calls[call].function.c_name
                found = [(each, self._answer_of(callee, at)) for at, each in enumerate(targets)]
            case _:
                found = [(target, self._of(value, ranges)) for target, value in _pairs(node)]
        for target, value in found:
            self._store(target, value, ranges)

    def _store(self, target: ast.expr, value: Range | None, ranges: Ranges) -> None:
        if isinstance(target, ast.Subscript | ast.Attribute):
            self._of(target, ranges)
        if isinstance(target, ast.Subscript):
            return
        path, last = self._proof.path(target), getattr(target, "attr", "")
        same = f".{last}" if last else None
        for other in list(ranges):  # other names of the same memory, and members of the old record
            if other == path or other.startswith(f"{path}.") or (same and other.endswith(same)):
                del ranges[other]
        if value is not None and not self._proof.in_array(target):
            ranges[path] = value
        if isinstance(target, ast.Attribute) and self._type_of(target) is INT:
            owner = self._type_of(target.value)
            assert isinstance(owner, Record)
            self._proof.add(("field", owner.struct.tag, last), value or ANY)
            least, largest = _declared(owner.struct, last) or ANY
            if not least <= (value or ANY)[0] <= (value or ANY)[1] <= largest:
                what = f"must be from {least:.0f} to {largest:.0f}"
                self._refuse(target, f"{{}} can be beyond its declared range: {what}")

    def _loop(self, node: ast.For, ranges: Ranges) -> Ranges | None:
        assert isinstance(node.iter, ast.Call)
        assert isinstance(node.target, ast.Name)
        ends = [self._of(each, ranges) or ANY for each in node.iter.args]
        start, stop = ends[0] if len(ends) > 1 else (0, 0), ends[min(len(ends) - 1, 1)]
        counter = (start[0], stop[1] - 1)
        if len(ends) > 2:  # downwards
            counter = (stop[0] + 1, start[1])
        if counter[1] < counter[0]:
            return ranges
        outer = self._breaks, self._continues
        entered = self._limited(node.iter.args[-1], ast.Gt, start, ranges)
        head, turn, self._breaks = entered if len(ends) < 3 and entered else ranges, 0, []
        while True:
            self._continues = []
            end = self._block(node.body, {**head, node.target.id: counter})
            after = _joined(head, end, *self._continues)
            assert after is not None
            if after == head:
                break
            turn += 1
            head = after if turn < SETTLING else {
                path: each for path, each in after.items() if head.get(path) == each
            }  # fmt: skip
        found = _joined(ranges, head, *self._breaks)
        self._breaks, self._continues = outer
        return found

    def _answer_of(self, function: str, place: int) -> Range | None:
        key = ("answer", function, place)
        if key not in self._proof.known:
            raise _NotFollowedError
        return self._proof.known[key]

    def _answer(self, value: ast.expr | None, ranges: Ranges) -> None:
        values = value.elts if isinstance(value, ast.Tuple) else [value] if value else []
        for place, each in enumerate(values):
            self._proof.add(("answer", self._name, place), self._of(each, ranges))

    # --- expressions -----------------------------------------------------------------------------

    def _type_of(self, node: ast.expr) -> Type:
        found = self._typed.types.get(node)
        return self._typed.names.get(node.id) if isinstance(node, ast.Name) and not found else found

    def _refuse(self, node: ast.AST, what: str) -> None:
        if self._proof.checking:
            raise self._module.refuse(node, what)

    def _of(self, node: ast.expr, ranges: Ranges) -> Range | None:
        """The range of a number; None for a real number that may be NaN, and for other things."""
        match node:
            case ast.Constant(value=int() | float() as value):
                return (value, value)
            case ast.Name(id=name):
                return self._of_name(name, ranges)
            case ast.Attribute():
                return self._of_path(node, ranges)
            case ast.Subscript():
                self._check_index(node, ranges)
            case ast.UnaryOp(op=op, operand=operand):
                found = self._of(operand, ranges)
                if isinstance(op, ast.Not) or not found:
                    return None
                negative = (-found[1], -found[0])
                return self._checked(node, negative) if self._type_of(node) is INT else negative
            case ast.BinOp(left=left, op=op, right=right):
                one, other = self._of(left, ranges), self._of(right, ranges)
                return self._computed(node, op, self._type_of(node), one, other)
            case ast.BoolOp() | ast.IfExp():
                return self._of_either(node, ranges)
            case ast.Compare(left=left, comparators=[right]):
                self._of(left, ranges)
                self._of(right, ranges)
            case ast.Call():
                return self._call(node, ranges)
        return None

    def _of_either(self, node: ast.BoolOp | ast.IfExp, ranges: Ranges) -> Range | None:
        """Of an expression with parts that only some runs evaluate."""
        found: list[Range | None] = [None]
        if isinstance(node, ast.BoolOp):
            reached: Ranges | None = ranges
            for each in node.values:
                if reached is not None:
                    self._of(each, reached)
                    reached = self._where(each, isinstance(node.op, ast.And), reached)
        else:
            self._of(node.test, ranges)
            cases = ((node.body, True), (node.orelse, False))
            ways = [(each, self._where(node.test, truth, ranges)) for each, truth in cases]
            found = [self._of(each, way) for each, way in ways if way is not None]
        self._forget(node, ranges)
        return _around(found[0], found[-1])

    def _of_name(self, name: str, ranges: Ranges) -> Range | None:
        if name not in self._typed.names:
            value = self._module.lookup(name)
            known = isinstance(value, int | float) and not math.isnan(value)
            return (value, value) if known else None
        return ranges.get(name, ANY if self._typed.names[name] is INT else None)

    def _of_path(self, node: ast.Attribute, ranges: Ranges) -> Range | None:
        owner, kind = self._type_of(node.value), self._type_of(node)
        self._of(node.value, ranges)
        if kind not in (INT, REAL) or not isinstance(owner, Record):
            return None
        known = ranges.get(self._proof.path(node))
        return self._proof.of_field(owner.struct, node.attr) if not known and kind is INT else known

    def _check_index(self, node: ast.Subscript, ranges: Ranges) -> None:
        array, indices = self._type_of(node.value), indices_of(node)
        if not isinstance(array, Array) or any(isinstance(each, ast.Slice) for each in indices):
            return
        for index, size in zip(indices, array.shape, strict=True):
            least, largest = self._of(index, ranges) or ANY
            if least < 0 or largest >= size:
                wrong = least if least < 0 else largest
                said = f"index {wrong:.0f} is" if math.isfinite(wrong) else "any index seems"
                self._refuse(node, f"{{}}: {said} possible: must be from 0 to {size - 1}")

    def _computed(
        self, node: ast.AST, op: ast.operator, kind: Type, left: Range | None, right: Range | None
    ) -> Range | None:
        found = _combined(op, left, right) if left and right else None
        if kind is not INT:
            small = all(abs(end) < SMALL for each in (left, right) for end in each or ANY)
            return _rounded(found) if found and small else None
        if isinstance(op, ast.Mod) and (right or ANY)[0] <= 0 <= (right or ANY)[1]:
            self._refuse(node, "{}: must not divide by 0, which is possible")
        return self._checked(node, found or ANY)

    def _checked(self, node: ast.AST, found: Range) -> Range:
        """The range of an integer, which must be within 32 bits."""
        for end in found:
            if not LEAST <= end <= LARGEST:
                said = f"{end:.0f}" if math.isfinite(end) else "any number"
                self._refuse(node, f"{{}} can be {said}: must be from -2**31 to 2**31 - 1")
        return found

    def _call(self, node: ast.Call, ranges: Ranges) -> Range | None:
        found = [self._of(each, ranges) for each in node.args]
        callee = called(self._module, node)
        if node in self._typed.calls:
            return self._called(self._typed.calls[node], found, ranges)
        if callee in EXTREMES:
            return _extreme(callee, found)
        if callee is int:
            if found[0] is None:
                what = "{}: any number seems possible: must be compared with limits before"
                self._refuse(node, what)
            least, largest = found[0] or ANY
            return self._checked(node, (_whole(least), _whole(largest)))
        if callee is PLAIN_REAL:
            return found[0] and _rounded(found[0])
        return found[0] and (found[0][0] - 1, found[0][1] + 1) if callee in STEPS else None

    def _called(self, callee: Typed, found: list[Range | None], ranges: Ranges) -> Range | None:
        name = callee.function.c_name
        parameters = zip(callee.function.parameters, callee.arguments, found, strict=True)
        for parameter, kind, value in parameters:
            if kind in (INT, REAL):
                known = value or (ANY if kind is INT else None)
                self._proof.add(("parameter", name, parameter), known)
        self._forget(None, ranges)
        return self._answer_of(name, 0) if callee.result in (INT, REAL) else None

    def _forget(self, node: ast.expr | None, ranges: Ranges) -> None:
        """Forget the fields that a call may have changed, if ``node`` has a call; None: a call."""
        if node is not None and not self._proof.has_call(node):
            return
        for path in list(ranges):
            if "." in path and path.rpartition(".")[2] in self._proof.changed:
                del ranges[path]

    # --- conditions ------------------------------------------------------------------------------

    def _where(self, test: ast.expr, truth: bool, ranges: Ranges | None) -> Ranges | None:
        """The ranges where ``test`` is true, or false; None where it cannot be."""
        found = None if ranges is None else self._decided(test, truth, {**ranges})
        if found is not None:
            self._forget(test, found)
        return found

    def _decided(self, test: ast.expr, truth: bool, ranges: Ranges) -> Ranges | None:
        match test:
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self._where(operand, not truth, ranges)
            case ast.BoolOp(op=op, values=values):
                ways: list[Ranges | None] = []
                rest: Ranges | None = ranges
                for each in values:
                    ways.append(self._where(each, truth, rest))
                    rest = self._where(each, isinstance(op, ast.And), rest)
                return ways[-1] if isinstance(op, ast.And) == truth else _joined(*ways)
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self._compared(left, type(op), right, truth, ranges)
            case ast.Name() | ast.Attribute() if self._type_of(test) is INT:
                return self._limited(test, ast.NotEq if truth else ast.Eq, (0, 0), ranges)
        return ranges

    def _compared(
        self, left: ast.expr, op: type[ast.cmpop], right: ast.expr, truth: bool, ranges: Ranges
    ) -> Ranges | None:
        of_left, of_right = self._of(left, ranges), self._of(right, ranges)
        if not truth:
            if of_left is None or of_right is None:
                return ranges  # a comparison with NaN is false
            op = OPPOSITE[op]
        limited = self._limited(left, op, of_right or ANY, ranges)
        if limited is None:
            return None
        return self._limited(right, MIRRORED.get(op, op), of_left or ANY, limited)

    def _limited(
        self, node: ast.expr, op: type[ast.cmpop], limit: Range, ranges: Ranges
    ) -> Ranges | None:
        """The ranges where the number at ``node`` compares so with one of ``limit``."""
        if not isinstance(node, ast.Name | ast.Attribute) or self._proof.in_array(node):
            return ranges
        least, largest = self._of(node, ranges) or ANY
        step = 1 if self._type_of(node) is INT else 0
        if op is ast.NotEq:
            if not step:
                return ranges
            least += limit == (least, least)
            largest -= limit == (largest, largest)
        if op in (ast.Lt, ast.LtE, ast.Eq):
            largest = min(largest, limit[1] - step * (op is ast.Lt))
        if op in (ast.Gt, ast.GtE, ast.Eq):
            least = max(least, limit[0] + step * (op is ast.Gt))
        return {**ranges, self._proof.path(node): (least, largest)} if least <= largest else None


def _in_array(node: ast.expr) -> bool:
    """Whether ``node`` is a field of an element: the same text, another element in a later turn."""
    return any(isinstance(each, ast.Subscript) for each in ast.walk(node))


def _declared(struct: CStruct, name: str) -> Range | None:
    return next(each.range for each in struct.fields if each.name == name)


def _field(target: ast.Attribute, typed: Typed) -> Key:
    owner = typed.types[target.value]
    return ("field", owner.struct.tag if isinstance(owner, Record) else "", target.attr)


def _pairs(node: ast.Assign | ast.AnnAssign | ast.AugAssign) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Each target of an assignment, with its value or the call that gives all values."""
    if not isinstance(node, ast.Assign):
        if node.value is not None:
            yield node.target, node.value
        return
    for target, value in paired(node):
        for each in target.elts if isinstance(target, ast.Tuple) else [target]:
            yield each, value


def _around(one: Range | None, other: Range | None) -> Range | None:
    if one is None or other is None:
        return None
    return (min(one[0], other[0]), max(one[1], other[1]))


def _joined(*ways: Ranges | None) -> Ranges | None:
    """What holds after either way; None where no way goes on."""
    open_ways = [each for each in ways if each is not None]
    if not open_ways:
        return None
    found: Ranges = {}
    for path in set.intersection(*(set(each) for each in open_ways)):
        ends = [each[path] for each in open_ways]
        found[path] = (min(least for least, _ in ends), max(largest for _, largest in ends))
    return found


def _combined(op: ast.operator, left: Range, right: Range) -> Range | None:
    """The range of a sum, a difference, a product, a quotient or a remainder."""
    match op:
        case ast.Add():
            found = (left[0] + right[0], left[1] + right[1])
        case ast.Sub():
            found = (left[0] - right[1], left[1] - right[0])
        case ast.Mod():
            return (0, right[1] - 1) if right[0] >= 0 else ANY
        case ast.Mult():
            products = [0.0 if 0 in (a, b) else a * b for a in left for b in right]
            found = (min(products), max(products))
        case ast.Div() if right[0] > 0 or right[1] < 0:
            quotients = [a / b for a in left for b in right]
            found = (min(quotients), max(quotients))
        case _:
            return None
    return None if any(map(math.isnan, found)) else found


def _extreme(pick: Callable[..., float], ranges: list[Range | None]) -> Range | None:
    """The least or the largest; the first number, where the others may be NaN."""
    if ranges[0] is None:
        return None
    others = [each or ANY for each in ranges[1:]]
    least, largest = zip(ranges[0], *others, strict=True)
    return (pick(least), pick(largest))


def _rounded(found: Range) -> Range:
    """The range of a real number after a rounding."""
    least, largest = (ROUNDING * abs(end) + UNDERFLOW for end in found)
    return (found[0] - least, found[1] + largest)


def _whole(end: float) -> float:
    return math.trunc(end) if math.isfinite(end) else end
