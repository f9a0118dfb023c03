"""A function of the target as a function of C, statement by statement, with its comments.

Expressions keep the order and the precision of the source. C declares each local name in the
innermost block around all its uses.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from can_rig.export.c_text import INDENT, comment, name, number, with_comment, wrapped
from can_rig.export.effects import Effects
from can_rig.export.source import (
    INT,
    REAL,
    Answers,
    Array,
    Comment,
    Record,
    Scalar,
    Type,
    indices_of,
    names_in,
)
from can_rig.export.subset import EXTREMES, PLAIN_REAL, ROUNDED_EXACTLY, Typed, called
from firmware_model.law.structs import Precision

CHOICE, OR, AND, EQUALITY, ORDER, SUM, PRODUCT, UNARY, WHOLE = range(9)
BINARY: Final = {
    ast.Add: ("+", SUM), ast.Sub: ("-", SUM), ast.Mult: ("*", PRODUCT), ast.Div: ("/", PRODUCT),
    ast.Lt: ("<", ORDER), ast.LtE: ("<=", ORDER), ast.Gt: (">", ORDER), ast.GtE: (">=", ORDER),
    ast.Eq: ("==", EQUALITY), ast.NotEq: ("!=", EQUALITY), ast.And: ("&&", AND), ast.Or: ("||", OR),
}  # fmt: skip

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
    without = {"_", *typed.function.parameters}
    for place, block, node in _uses(typed.function.body, ()):
        statements |= {place[-1]: block[place[-1][1]]}
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name):
            without.add(node.target.id)
        for each in _own_names(node):
            places.setdefault(each.id, []).append(place)
            if isinstance(each.ctx, ast.Store):
                again = isinstance(node, ast.AugAssign) and each is node.target
                stores[each.id] = stores.get(each.id, 0) + 1 + again
    found = Declarations({}, {}, {local for local, n in stores.items() if n == 1})
    for local, uses in places.items():
        if local not in stores or local in without:
            continue
        depth = _common(uses)
        first = statements[uses[0][depth - 1]]
        if _assigns(first, local) and len(uses[0]) == depth:
            found.at.setdefault(first, set()).add(local)
        else:
            found.before.setdefault(first, []).append(local)
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


def _own_names(node: ast.stmt) -> list[ast.Name]:
    """The names of a statement itself, not of the blocks in it."""
    match node:
        case ast.If(test=part) | ast.For(iter=part):
            return names_in(part)
    return names_in(node)


def declarator(kind: Type, c_name: str, constant: bool) -> str:
    """The declaration of a name; structs and arrays become pointers."""
    const = "const " if constant else ""
    match kind:
        case Record():
            return f"{const}struct {kind.struct.tag} *{c_name}"
        case Array(element=element, shape=(_,)):
            return f"{const}{element.c} *{c_name}"
        case Array(element=element, shape=(_, *rest)):
            sizes = "".join(f"[{size}]" for size in rest)
            return f"{const}{element.c} (*{c_name}){sizes}"
        case Scalar():
            return f"{const}{kind.c} {c_name}"
    raise NotImplementedError(kind)


def signature(typed: Typed, effects: Effects) -> str:
    """How a function is declared, without storage class and semicolon."""
    kinds, written, result = typed.names, effects.written(typed), "void"
    if isinstance(typed.result, Answers):
        result = f"struct {typed.result.tag}"
    elif isinstance(typed.result, Scalar):
        result = typed.result.c
    parameters = ", ".join(
        declarator(
            kinds[each], name(each), not isinstance(kinds[each], Scalar) and each not in written
        )
        for each in typed.function.parameters
    )
    return f"{result} {typed.function.c_name}({parameters or 'void'})"


class CFunction:
    """Writes a function.

    Args:
        typed: the function.
        effects: of the whole program.
        precision: of its real numbers.
    """

    def __init__(self, typed: Typed, effects: Effects, precision: Precision) -> None:
        self._typed, self._types = typed, typed.types
        self._precision: Precision = precision
        self._written = effects.written(typed)
        self._declared = declarations(typed)
        self._lines: list[str] = []
        self._indent = ""
        self._answers = 0
        self._taken = {name(each) for each in typed.names}
        tree = typed.function.tree
        self._comments: list[tuple[int, Comment]] = [
            (line, each)
            for line, each in sorted(typed.function.module.comments.items())
            if tree.body[0].lineno <= line <= (tree.end_lineno or line)
        ]

    def body(self) -> list[str]:
        """The statements, in brackets."""
        self._lines = ["{"]
        self._block(self._typed.function.body)
        return [*self._lines, "}"]

    # --- statements ------------------------------------------------------------------------------

    def _block(self, body: list[ast.stmt]) -> None:
        self._indent += INDENT
        for node in body:
            self._blank_line_before(node)
            while self._comments and self._comments[0][0] < node.lineno:
                self._lines += comment(self._comments.pop(0)[1].text, self._indent)
            for each in self._declared.before.get(node, []):
                kind = self._typed.names[each]
                constant = not isinstance(kind, Scalar) and each not in self._written
                self._line(f"{declarator(kind, name(each), constant)};")
            self._statement(node)
        self._indent = self._indent.removesuffix(INDENT)

    def _blank_line_before(self, node: ast.stmt) -> None:
        """Keep the source's blank line."""
        first = min([node.lineno, *(line for line, _ in self._comments[:1])])
        text = self._typed.function.module.lines
        if not text[first - 2].strip() and not self._lines[-1].endswith("{"):
            self._lines.append("")

    def _take_comment(self, node: ast.stmt | ast.expr) -> str | None:
        """Take the comments down to the end of ``node``, which belong to the current statement."""
        taken, last_line = [], node.end_lineno or node.lineno
        while self._comments and self._comments[0][0] <= last_line:
            taken.append(self._comments.pop(0)[1].text)
        return " ".join(taken) or None

    def _line(self, text: str, remark: str | None = None) -> None:
        lines = wrapped(text, self._indent)
        if remark is not None and len(lines) == 1:
            lines = with_comment(lines[0], remark, self._indent)
        elif remark is not None:
            lines = [*comment(remark, self._indent), *lines]
        self._lines += lines

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.If():
                self._if(node)
                return
            case ast.For():
                self._for(node)
                return
        remark = self._take_comment(node)
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                self._assign(node, zip(targets, values, strict=True), remark)
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Call() as value):
                self._unpack(node, targets, value, remark)
            case ast.Assign(targets=targets, value=value):
                self._assign(node, ((target, value) for target in targets), remark)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign(node, [(target, value)], remark)
            case ast.AugAssign(target=target, op=op, value=value):
                sign, _ = BINARY[type(op)]
                self._line(f"{self._text(target)} {sign}= {self._text(value)};", remark)
            case ast.Return():
                self._return(node, remark)
            case ast.Expr(value=value):
                ignored = isinstance(self._types.get(value), Scalar | Answers)
                self._line(f"{'(void)' if ignored else ''}{self._text(value)};", remark)
            case ast.Break():
                self._line("break;", remark)
            case ast.Continue():
                self._line("continue;", remark)

    def _assign(
        self,
        node: ast.stmt,
        pairs: Iterator[tuple[ast.expr, ast.expr]] | list[tuple[ast.expr, ast.expr]],
        remark: str | None,
    ) -> None:
        for target, value in pairs:
            if isinstance(target, ast.Subscript) and isinstance(self._types.get(target), Array):
                self._fill(target, value, remark)
            else:
                self._line(f"{self._place(node, target)} = {self._address(value)};", remark)
            remark = None

    def _place(self, node: ast.stmt, target: ast.expr) -> str:
        """The left side of an assignment; a declaration if the name is new."""
        if isinstance(target, ast.Name) and target.id in self._declared.at.get(node, set()):
            kind = self._typed.names[target.id]
            once = target.id in self._declared.once
            constant = once if isinstance(kind, Scalar) else target.id not in self._written
            return declarator(kind, name(target.id), constant)
        return self._text(target)

    def _fill(self, target: ast.Subscript, value: ast.expr, remark: str | None) -> None:
        """The same value into every element."""
        array = self._types[target.value]
        assert isinstance(array, Array)
        text, outside = self._text(target.value), self._indent
        indices = indices_of(target, len(array.shape))
        for wanted, index, size in zip("ijkm", indices, array.shape, strict=False):
            lower, upper = getattr(index, "lower", None), getattr(index, "upper", None)
            first, end = self._text(lower) if lower else "0", self._text(upper) if upper else size
            i = self._free(wanted)
            self._line(f"for (int32_t {i} = {first}; {i} < {end}; {i}++) {{", remark)
            text, remark = f"{text}[{i}]", None
            self._indent += INDENT
        self._line(f"{text} = {self._text(value)};")
        while self._indent != outside:
            self._indent = self._indent.removesuffix(INDENT)
            self._line("}")

    def _free(self, wanted: str) -> str:
        """A name unused in the function."""
        while wanted in self._taken:
            wanted += "_"
        return wanted

    def _unpack(
        self, node: ast.stmt, targets: list[ast.expr], value: ast.Call, remark: str | None
    ) -> None:
        """Every value of a call that answers several."""
        answers = self._types[value]
        assert isinstance(answers, Answers)
        self._answers += 1
        number = f"_{self._answers}" if self._answers > 1 else ""
        whole = self._free(name(self._typed.calls[value].function.name) + number)
        self._taken.add(whole)
        self._line(f"const struct {answers.tag} {whole} = {self._text(value)};", remark)
        for target, (member, _) in zip(targets, answers.items, strict=True):
            if not (isinstance(target, ast.Name) and target.id == "_"):
                self._line(f"{self._place(node, target)} = {whole}.{name(member)};")

    def _return(self, node: ast.Return, remark: str | None) -> None:
        if node.value is None:
            self._line("return;", remark)
        elif isinstance(self._typed.result, Answers):
            members = (name(member) for member, _ in self._typed.result.items)
            values = ", ".join(f".{member} = {member}" for member in members)
            self._line(f"return (struct {self._typed.result.tag}){{{values}}};", remark)
        else:
            self._line(f"return {self._text(node.value)};", remark)

    def _if(self, node: ast.If) -> None:
        before = "if"
        while True:
            remark = self._take_comment(node.test)
            self._line(f"{before} ({self._condition(node.test)}) {{", remark)
            self._block(node.body)
            match node.orelse:
                case [ast.If() as other] if other not in self._declared.before:
                    node, before = other, "} else if"
                    continue
                case []:
                    pass
                case _:
                    self._line("} else {")
                    self._block(node.orelse)
            break
        self._line("}")

    def _for(self, node: ast.For) -> None:
        assert isinstance(node.iter, ast.Call)
        assert isinstance(node.target, ast.Name)
        remark = self._take_comment(node.iter)
        start, stop = ["0", *map(self._text, node.iter.args)][-2:]
        i = self._free("i") if node.target.id == "_" else name(node.target.id)
        self._line(f"for (int32_t {i} = {start}; {i} < {stop}; {i}++) {{", remark)
        self._block(node.body)
        self._line("}")

    # --- expressions -----------------------------------------------------------------------------

    def _text(self, node: ast.expr, least: int = CHOICE) -> str:
        """``node`` in C; with brackets if its precedence is below ``least``."""
        text, binds = self._write(node)
        return text if binds >= least else f"({text})"

    def _condition(self, node: ast.expr, least: int = CHOICE) -> str:
        """``node`` where only whether it holds matters."""
        if self._types.get(node) is not INT:
            return self._text(node, least)
        text = f"{self._text(node, SUM)} != 0"
        return text if least <= EQUALITY else f"({text})"

    def _address(self, node: ast.expr) -> str:
        """``node`` as an argument: structs by their address."""
        by_address = isinstance(self._types.get(node), Record) and not isinstance(node, ast.Name)
        return f"{'&' if by_address else ''}{self._text(node)}"

    def _write(self, node: ast.expr) -> tuple[str, int]:
        match node:
            case ast.Constant(value=bool(value)):
                return ("true" if value else "false"), WHOLE
            case ast.Constant(value=int(value)):
                return str(value), WHOLE
            case ast.Constant(value=float(value)):
                return number(value, self._precision), WHOLE
            case ast.Name(id=found):
                return name(found), WHOLE
            case ast.Attribute(value=ast.Name(id=owner), attr=member):
                return f"{name(owner)}->{name(member)}", WHOLE
            case ast.Attribute(value=whole, attr=member):
                return f"{self._text(whole)}.{name(member)}", WHOLE
            case ast.Subscript():
                return self._subscript(node), WHOLE
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!{self._condition(operand, WHOLE)}", UNARY
            case ast.UnaryOp(operand=operand):
                return f"-{self._text(operand, WHOLE)}", UNARY
            case ast.BinOp(op=ast.Mod()):
                return f"int_modulo({self._text(node.left)}, {self._text(node.right)})", WHOLE
            case ast.BinOp(left=left, op=op, right=right):
                sign, binds = BINARY[type(op)]
                return f"{self._text(left, binds)} {sign} {self._text(right, binds + 1)}", binds
            case ast.BoolOp(op=op, values=values):
                sign, binds = BINARY[type(op)]
                return f" {sign} ".join(self._condition(each, EQUALITY) for each in values), binds
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                sign, binds = BINARY[type(op)]
                return f"{self._text(left, SUM)} {sign} {self._text(right, SUM)}", binds
            case ast.IfExp(test=test, body=body, orelse=orelse):
                one, other = self._text(body, OR), self._text(orelse, OR)
                return f"{self._condition(test, OR)} ? {one} : {other}", CHOICE
            case ast.Call():
                return self._call(node)
        raise NotImplementedError(ast.dump(node))  # typing has already refused other nodes

    def _subscript(self, node: ast.Subscript) -> str:
        array, indices = self._text(node.value), indices_of(node)
        if isinstance(self._types[node], Array):  # a part of an array is where it begins
            lower = indices[0].lower if isinstance(indices[0], ast.Slice) else None
            return array if lower is None else f"&{array}[{self._text(lower)}]"
        return array + "".join(f"[{self._text(index)}]" for index in indices)

    def _call(self, node: ast.Call) -> tuple[str, int]:
        if node in self._typed.calls:
            arguments = ", ".join(self._address(each) for each in node.args)
            return f"{self._typed.calls[node].function.c_name}({arguments})", WHOLE
        callee, first = called(self._typed.function.module, node), node.args[0]
        if callee is int or (callee is PLAIN_REAL and self._types[first] is INT):
            return f"({'int32_t' if callee is int else 'real'}){self._text(first, UNARY)}", UNARY
        if callee is PLAIN_REAL:
            return self._write(first)
        if callee in EXTREMES:
            kind, text = "real" if self._types[node] is REAL else "int", self._text(first)
            for each in node.args[1:]:
                text = f"{kind}_{EXTREMES[callee]}({text}, {self._text(each)})"
            return text, WHOLE
        if callee is math.isfinite:
            function = "real_is_finite"
        elif ROUNDED_EXACTLY[callee] == "copysign":
            function = "real_copysign"
        else:
            function = ROUNDED_EXACTLY[callee] + ("f" if self._precision == "float32" else "")
        return f"{function}({', '.join(self._text(each) for each in node.args)})", WHOLE
