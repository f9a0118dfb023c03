"""The subset of Python that becomes C: the type of every expression, and refusal of the rest."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from can_rig.export.source import (
    BOOL,
    INT,
    LITERAL,
    REAL,
    Answers,
    Array,
    Function,
    Module,
    Record,
    Scalar,
    Sources,
    Type,
    in_words,
    indices_of,
)
from firmware_model.law.precision import real

ANNOTATED: Final = {"float": REAL, "int": INT, "bool": BOOL}
ARITHMETIC: Final = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Mod)
INT32: Final = range(-(2**31), 2**31)
COMPARISONS: Final = (ast.Lt, ast.LtE, ast.Gt, ast.GtE, ast.Eq, ast.NotEq)

ROUNDED_EXACTLY: Final[Mapping[Any, str]] = {
    np.sqrt: "sqrt", np.ceil: "ceil", np.rint: "rint", np.copysign: "copysign", abs: "fabs",
}  # fmt: skip
"""Functions of real numbers with equal bits on every machine, and their names in C."""

EXTREMES: Final[Mapping[Any, str]] = {min: "min", max: "max"}
PLAIN_REAL: Final = getattr(real, "py_func", real)
NOT_CALLABLE: Final = (
    "{}: must be a function of the target, real, int, min, max, abs, math.isfinite, "
    "np.sqrt, np.ceil, np.rint or np.copysign"
)


def called(module: Module, node: ast.Call) -> Any:
    """The plain callee of ``node``, resolved in the imported ``module``; None if unknown."""
    found = None
    match node.func:
        case ast.Name(id=name):
            builtins = {"min": min, "max": max, "abs": abs, "int": int}
            found = module.lookup(name) or builtins.get(name)
        case ast.Attribute(value=ast.Name(id=owner), attr=name):
            found = getattr(module.lookup(owner), name, None)
    return getattr(found, "py_func", found)


def _takes(callee: Any, n: int) -> bool:
    """Whether ``callee`` is known and takes ``n`` arguments."""
    if callee in EXTREMES:
        return n >= 2
    if callee in (np.copysign, PLAIN_REAL):
        return n == 2
    return n == 1 and (callee in ROUNDED_EXACTLY or callee in (int, math.isfinite))


class Program:
    """Every function of the target that the entry points need, each with a single signature.

    ``functions`` has them by their names in C, callees before callers.
    """

    def __init__(self, sources: Sources) -> None:
        self.sources = sources
        self.functions: dict[str, Typed] = {}
        self._open: list[Function] = []  # in progress: a call of them is recursion

    @property
    def modules(self) -> list[Module]:
        """The modules with functions of the program, callees first."""
        return list(dict.fromkeys(typed.function.module for typed in self.functions.values()))

    def add(self, function: Function, arguments: Sequence[Type]) -> Typed:
        """Add ``function`` and its callees, for arguments of the given types.

        Raises:
            ExportError: something is outside the subset.
        """
        if function in self._open:
            raise function.module.refuse(
                function.tree, f"{function.name} calls itself: must be a loop"
            )
        known = self.functions.get(function.c_name)
        if known is None:
            self._open.append(function)
            known = Typed(self, function, arguments)
            self._open.pop()
            self.functions[function.c_name] = known
        elif known.arguments != list(arguments):
            one, other = (", ".join(map(in_words, each)) for each in (arguments, known.arguments))
            raise function.module.refuse(
                function.tree, f"{function.name} gets {one} and {other}: "
                "must be one type for each parameter, or two functions"
            )  # fmt: skip
        return known


class Typed:
    """A function with its types: of all ``names``, first the parameters, and of expressions.

    ``calls`` has the called functions of the target by call node.

    Raises:
        ExportError: something is outside the subset.
    """

    def __init__(self, program: Program, function: Function, arguments: Sequence[Type]) -> None:
        self.function, self.arguments = function, list(arguments)
        self.names: dict[str, Type] = dict(zip(function.parameters, arguments, strict=True))
        self.result: Type = None
        self.types: dict[ast.expr, Type] = {}
        self.calls: dict[ast.Call, Typed] = {}
        self._program, self._module, self._refuse = program, function.module, function.module.refuse
        self._loops: list[str] = []  # names of the loops around a statement
        self._counters: set[str] = set()  # names of all loops so far
        self._returned = False
        self._check_signature()
        self._block(function.body)
        last = function.body[-1] if function.body else function.tree
        if self.result is not None and not _always_returns(last):
            raise self._refuse(last, f"{function.name} must end with a return")
        self._stored = {name for node in function.nodes for name in _stored(node)}
        self._check_assigned(function.body, set(function.parameters))

    def _check_signature(self) -> None:
        """Check that the annotations agree with the callers."""
        tree = self.function.tree
        arguments = tree.args
        if arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.defaults:
            raise self._refuse(tree, f"{tree.name}: must have parameters by position only")
        for argument in arguments.args:
            annotation = argument.annotation
            said = ANNOTATED.get(ast.unparse(annotation) if annotation else "")
            got = self.names[argument.arg]
            if (said or got) != got or (said is None and not isinstance(got, Record | Array)):
                raise self._refuse(
                    argument, f"{argument.arg} is {in_words(got)}: its annotation must say so"
                )

    # --- statements ------------------------------------------------------------------------------

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Assign():
                self._assignment(node)
            case ast.AnnAssign(target=ast.Name() as target, value=ast.expr() as value):
                self._bind(target, self._value(value))
            case ast.AugAssign(op=ast.Mod()):
                raise self._refuse(node, "{}: must be x = x % n")
            case ast.AugAssign():
                self._of(ast.copy_location(ast.BinOp(node.target, node.op, node.value), node))
                self._store(node.target, self._of(node.target))
            case ast.If():
                self._condition(node.test)
                self._block(node.body)
                self._block(node.orelse)
            case ast.For():
                self._loop(node)
            case ast.Return():
                self._answer(node)
            case ast.Expr(value=ast.Call() as call):
                self._of(call)
            case ast.Pass() | ast.Break() | ast.Continue():
                pass
            case _:
                first = ast.unparse(node).splitlines()[0].rstrip(":")
                raise self._refuse(
                    node, f"{first}: must be an assignment, a call, if, for ... in range(...) "
                    "or return"
                )  # fmt: skip

    def _assignment(self, node: ast.Assign) -> None:
        """Type an assignment: one value to several names, or several values to as many names."""
        first, value = node.targets[0], node.value
        if not isinstance(first, ast.Tuple) or len(node.targets) > 1:
            kind = self._assigned(value)
            for target in node.targets:
                self._store(target, kind)
            return
        if isinstance(value, ast.Tuple):
            if len(first.elts) != len(value.elts):
                raise self._refuse(node, "must have as many values as names")
            kinds = [self._assigned(each) for each in value.elts]
        else:
            answers = self._of(value)
            if not isinstance(answers, Answers) or len(answers.items) != len(first.elts):
                raise self._refuse(
                    value, f"{{}} is {in_words(answers)}: must be {len(first.elts)} values"
                )
            kinds = [kind for _, kind in answers.items]
        names = [each.id for each in first.elts if isinstance(each, ast.Name) and each.id != "_"]
        if len(set(names)) != len(names):
            raise self._refuse(node, "{}: must be different names")
        for target, kind in zip(first.elts, kinds, strict=True):
            self._store(target, kind)

    def _assigned(self, value: ast.expr) -> Type:
        kind = self._of(value)
        if kind is None or isinstance(kind, Answers):
            raise self._refuse(value, f"{{}} is {in_words(kind)}: must be one value")
        return kind

    def _store(self, target: ast.expr, kind: Type) -> None:
        """Check that ``target`` can hold a value of type ``kind``."""
        if isinstance(target, ast.Name):
            self._bind(target, kind)
            return
        held = self._of(target)
        if isinstance(held, Array) and isinstance(target, ast.Subscript):
            held = held.element  # all of a slice gets the same value
        fits = held is kind or (held is REAL and kind is LITERAL)
        if not isinstance(held, Scalar) or not fits:
            raise self._refuse(target, f"{{}} gets {in_words(kind)}: must be {in_words(held)}")

    def _bind(self, target: ast.Name, kind: Type) -> None:
        """Bind a name to its only type."""
        if target.id == "_":
            return
        if kind is LITERAL:
            raise self._refuse(
                target, "{} gets a literal without a precision: must be real(..., x)"
            )
        if target.id in self._counters:
            raise self._refuse(target, "{} counts a loop: must not be assigned")
        known = self.names.setdefault(target.id, kind)
        if known != kind:
            raise self._refuse(
                target, f"{{}} is {in_words(known)} before and {in_words(kind)} here: "
                "must be one type, or two names"
            )  # fmt: skip
        self.types[target] = kind

    def _loop(self, node: ast.For) -> None:
        """A loop over range(stop), range(start, stop) or range(start, stop, -1).

        Its counter has no other use, for C ends the counter with the loop.
        """
        match node:
            case ast.For(
                target=ast.Name() as target,
                iter=ast.Call(func=ast.Name(id="range"), args=ends, keywords=[]),
                orelse=[],
            ) if 1 <= len(ends) <= 2 or (len(ends) == 3 and self._literal(ends[2]) == -1):
                for end in ends:
                    self._require(end, INT)
            case _:
                what = "must be for i in range(stop), range(start, stop) or range(start, stop, -1)"
                raise self._refuse(node, f"{{}} {what}")
        taken = target.id in self.names and target.id not in self._counters
        if taken or (target.id in self._loops and target.id != "_"):
            raise self._refuse(
                target, "{} has another use: must be a name that only counts this loop"
            )
        if target.id != "_":
            self.names[target.id] = self.types[target] = INT
            self._counters.add(target.id)
        self._loops.append(target.id)
        self._block(node.body)
        self._loops.pop()

    def _answer(self, node: ast.Return) -> None:
        kind: Type = None
        if isinstance(node.value, ast.Tuple):
            found = (each.id for each in node.value.elts if isinstance(each, ast.Name))
            names = [each for each in dict.fromkeys(found) if each in self.names]
            if len(names) != len(node.value.elts):
                what = "must return different names of the function, which C needs for its struct"
                raise self._refuse(node, what)
            items = [self._value(each) for each in node.value.elts]
            kind = Answers(self.function.c_name, tuple(zip(names, items, strict=True)))
        elif node.value is not None:
            kind = self._value(node.value)
        if self._returned and kind != self.result:
            raise self._refuse(
                node, f"returns {in_words(kind)}: must be {in_words(self.result)} as before"
            )
        self._returned, self.result = True, kind

    # --- expressions -----------------------------------------------------------------------------

    def _of(self, node: ast.expr) -> Type:
        """The type of any expression."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._refuse(node, "{}: the subset has no such thing")
        found: Type = method(node)
        self.types[node] = found
        return found

    def _value(self, node: ast.expr) -> Scalar:
        """The type of an operand: a real number with a precision, an integer or a truth value."""
        found = self._argument(node)
        if not isinstance(found, Scalar):
            raise self._refuse(node, f"{{}} is {in_words(found)}: must be one value")
        return found

    def _argument(self, node: ast.expr) -> Type:
        found = self._of(node)
        if found is LITERAL:
            raise self._refuse(node, "{} has no precision: must be real({}, x)")
        return found

    def _require(self, node: ast.expr, *wanted: Scalar) -> Scalar:
        """The type of an operand, which must be in ``wanted``."""
        found = self._value(node)
        if found not in wanted:
            words = " or ".join(in_words(each) for each in wanted)
            raise self._refuse(node, f"{{}} is {in_words(found)}: must be {words}")
        return found

    def _condition(self, node: ast.expr) -> None:
        """Type ``node`` as a condition: a nonzero integer is true."""
        if isinstance(node, ast.BoolOp):
            for each in node.values:
                self._condition(each)
            self.types[node] = BOOL
        else:
            self._require(node, BOOL, INT)

    def _literal(self, node: ast.expr) -> int | float | None:
        """The value of ``node``, if the source has a literal; else None."""
        value: Any = None
        if isinstance(node, ast.Constant):
            value = node.value
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            inner = self._literal(node.operand)
            value = None if inner is None else -inner
        elif isinstance(node, ast.Name) and node.id not in self.names:
            value = self._module.lookup(node.id)
        return value if isinstance(value, int | float) and not isinstance(value, bool) else None

    def _number(self, node: ast.expr, value: object, what: str) -> Type:
        """The type of a literal; an integer must fit the target's integer."""
        if isinstance(value, float):
            return LITERAL
        if isinstance(value, bool) or not isinstance(value, int):
            raise self._refuse(node, what)
        if int(value) not in INT32:  # another type than int would be compared with each number
            raise self._refuse(node, "{}: must be an integer from -2**31 to 2**31 - 1")
        return INT

    def _constant(self, node: ast.Constant) -> Type:
        if isinstance(node.value, bool):
            return BOOL
        return self._number(node, node.value, "{}: must be a number")

    def _name(self, node: ast.Name) -> Type:
        if node.id in self.names:
            return self.names[node.id]
        what = "{}: must be a name of this function, or a number of the module"
        return self._number(node, self._module.lookup(node.id), what)

    def _attribute(self, node: ast.Attribute) -> Type:
        owner = self._of(node.value)
        fields = owner.struct.fields if isinstance(owner, Record) else ()
        field = next((each for each in fields if each.name == node.attr), None)
        if field is None:
            raise self._refuse(node, f"{{}}: {in_words(owner)} has no such field")
        if not isinstance(field.kind, type):
            scalar = REAL if field.kind == "real" else INT
            return Array(scalar, field.shape) if field.shape else scalar
        struct = self._program.sources.struct(field.kind)
        if struct is None:
            what = f"{node.attr}: must be a struct that a module declares by name"
            raise self._refuse(node, what)
        return Array(Record(struct), field.shape) if field.shape else Record(struct)

    def _subscript(self, node: ast.Subscript) -> Type:
        array = self._of(node.value)
        if not isinstance(array, Array):
            raise self._refuse(node.value, f"{{}} is {in_words(array)}: must be an array")
        indices = indices_of(node, len(array.shape))
        if len(indices) != len(array.shape):
            raise self._refuse(node, f"{{}}: must have an index for each of {array.shape}")
        pairs = list(zip(indices, array.shape, strict=True))
        if not any(isinstance(index, ast.Slice) for index in indices):
            for index, size in pairs:
                self._require(index, INT)
                at = self._literal(index)
                if at is not None and not 0 <= at < size:
                    raise self._refuse(node, f"{{}}: index {at} must be from 0 to {size - 1}")
            return array.element
        if isinstance(array.element, Record):
            raise self._refuse(node, f"{{}} is {in_words(array)}: must have an index")
        if len(indices) > 1 and isinstance(node.ctx, ast.Load):
            raise self._refuse(node, f"{{}}: a part of {len(indices)} dimensions must be filled")
        return Array(array.element, tuple(self._extent(index, size) for index, size in pairs))

    def _extent(self, index: ast.expr, size: int) -> int:
        """The length of a slice with literal ends."""
        if not isinstance(index, ast.Slice) or index.step is not None:
            raise self._refuse(index, "must be a slice without a step in every dimension")
        start = 0 if index.lower is None else self._literal(index.lower)
        stop = size if index.upper is None else self._literal(index.upper)
        if not (isinstance(start, int) and isinstance(stop, int) and 0 <= start < stop <= size):
            raise self._refuse(
                index, f"slice of {size} elements: its ends must be integers of the source"
            )
        return stop - start

    def _unaryop(self, node: ast.UnaryOp) -> Type:
        if isinstance(node.op, ast.Not):
            self._condition(node.operand)
            return BOOL
        if not isinstance(node.op, ast.USub):
            raise self._refuse(node, "{}: must be -x or not x")
        if isinstance(node.operand, ast.Constant):
            value = self._literal(node)
            if not isinstance(value, int):
                return self._of(node.operand)
            self.types[node.operand] = INT
            return self._number(node, value, "")
        return self._require(node.operand, REAL, INT)

    def _binop(self, node: ast.BinOp) -> Type:
        if not isinstance(node.op, ARITHMETIC):
            raise self._refuse(node, "{}: must be +, -, *, / or %")
        wanted = {ast.Div: (REAL,), ast.Mod: (INT,)}.get(type(node.op), (REAL, INT))
        left, right = (self._require(each, *wanted) for each in (node.left, node.right))
        if left is not right:
            what = f"{{}}: {in_words(left)} and {in_words(right)}: must be real(n, x)"
            raise self._refuse(node, what)
        if isinstance(node.op, ast.Mod) and self._literal(node.right) == 0:
            raise self._refuse(node, "{}: must not divide by 0")
        return left

    def _boolop(self, node: ast.BoolOp) -> Type:
        for each in node.values:
            self._require(each, BOOL)
        return BOOL

    def _compare(self, node: ast.Compare) -> Type:
        if len(node.ops) != 1:
            raise self._refuse(node, "{}: must be two comparisons")
        if not isinstance(node.ops[0], COMPARISONS):
            raise self._refuse(node, "{}: must be <, <=, >, >=, == or !=")
        sides = node.left, node.comparators[0]
        kinds = [self._of(each) for each in sides]
        if kinds.count(LITERAL) == 1 and REAL in kinds:
            literal = self._literal(sides[kinds.index(LITERAL)])
            if literal is not None and float(np.float32(literal)) == literal:
                return BOOL
        left, right = (self._require(each, REAL, INT) for each in sides)
        if left is not right:
            raise self._refuse(node, f"{{}}: {in_words(left)} and {in_words(right)}: must be alike")
        return BOOL

    def _ifexp(self, node: ast.IfExp) -> Type:
        self._condition(node.test)
        one, other = (self._value(each) for each in (node.body, node.orelse))
        if one is not other:
            raise self._refuse(node, "{}: both answers must be alike")
        return one

    def _call(self, node: ast.Call) -> Type:
        callee = called(self._module, node)
        function = None if callee is PLAIN_REAL else self._program.sources.function(callee)
        if function is None:
            return self._arithmetic(node, callee)
        kinds = [self._argument(each) for each in node.args]
        if node.keywords or len(kinds) != len(function.parameters):
            what = f"{{}}: must have {len(function.parameters)} arguments by position"
            raise self._refuse(node, what)
        self.calls[node] = self._program.add(function, kinds)
        return self.calls[node].result

    def _arithmetic(self, node: ast.Call, callee: Any) -> Type:
        """The type of a call to a function outside the target."""
        if node.keywords:
            raise self._refuse(node, "{}: must have no arguments by name")
        if callee is None or not _takes(callee, len(node.args)):
            raise self._refuse(node, NOT_CALLABLE)
        if callee is PLAIN_REAL:
            if self._of(node.args[0]) is not LITERAL:
                self._require(node.args[0], REAL, INT)
            return self._require(node.args[1], REAL)
        if callee in EXTREMES:
            kinds = [self._require(each, REAL, INT) for each in node.args]
            if len(set(kinds)) != 1:
                raise self._refuse(node, "{}: all must be real, or all integers")
            return kinds[0]
        for each in node.args:
            self._require(each, REAL)
        return INT if callee is int else BOOL if callee is math.isfinite else REAL

    # --- values of names -------------------------------------------------------------------------

    def _check_assigned(self, body: list[ast.stmt], known: set[str] | None) -> set[str] | None:
        """The names with a value after ``body``; None for unreachable code.

        Raises:
            ExportError: some way leads to a name without a value, or no way to a statement.
        """
        for node in body:
            if known is None:
                raise self._refuse(node, "is never reached: must not be there")
            known = self._known_after(node, known)
        return known

    def _known_after(self, node: ast.stmt, known: set[str]) -> set[str] | None:
        match node:
            case ast.If():
                self._read(node.test, known)
                ways = [self._check_assigned(part, known) for part in (node.body, node.orelse)]
                ends = [way for way in ways if way is not None]
                return set.intersection(*ends) if ends else None
            case ast.For(target=ast.Name(id=counter)):
                self._read(node.iter, known)
                self._check_assigned(node.body, known | {counter})
                return known  # the loop may have no turn
            case ast.AnnAssign(value=ast.expr() as value):
                self._read(value, known)
            case ast.AugAssign(target=ast.Name() as target):
                self._read(node, known)
                self._require_value(target, known)
            case _:
                self._read(node, known)
        if isinstance(node, ast.Return | ast.Break | ast.Continue):
            return None
        return known | {name for each in ast.walk(node) for name in _stored(each)}

    def _read(self, node: ast.AST, known: set[str]) -> None:
        for each in ast.walk(node):
            if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Load):
                self._require_value(each, known)

    def _require_value(self, name: ast.Name, known: set[str]) -> None:
        if name.id in known or name.id not in self._stored:
            return
        what = "{}: must be assigned on every way that leads here"
        if name.id in self._counters:
            what = "{} ends with its loop: must be another name, assigned inside the loop"
        raise self._refuse(name, what)


def _always_returns(node: ast.stmt) -> bool:
    if isinstance(node, ast.If):
        return all(part and _always_returns(part[-1]) for part in (node.body, node.orelse))
    return isinstance(node, ast.Return)


def _stored(node: ast.AST) -> list[str]:
    return [node.id] if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else []
