"""A pair of .c and .h for each module of the target, and the constant table of a scenario in C.

A function of the target becomes a function of C, statement by statement, with its comments.
Expressions keep the order and the precision of the source. C declares each local name in the
innermost block around all its uses. Numbers that the source names become macros of C. Lines have at
most 100 columns.
"""

import ast
import math
import re
import sys
import textwrap
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from inspect import unwrap
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.export.effects import Effects
from can_rig.export.ranges import NO_ASCII, check_ranges
from can_rig.export.source import (
    INT,
    REAL,
    Answers,
    Array,
    Comment,
    CStruct,
    Module,
    Record,
    Scalar,
    Sources,
    Type,
    indices_of,
    names_in,
    snake,
)
from can_rig.export.subset import EXTREMES, PLAIN_REAL, ROUNDED_EXACTLY, Program, Typed, called
from firmware_model.discretisation.filters import KEYWORDS, literal
from firmware_model.discretisation.schedules import schedule
from firmware_model.discretisation.tables import build
from firmware_model.law.layout import Table, precision_of
from firmware_model.law.schedule import Constants
from firmware_model.law.structs import Field, Precision, Struct, fields_of

WIDTH: Final = 100
INDENT: Final = "    "
LAST_RESORT: Final = 99  # deeper than any nesting

WORDS: Final = f"""
    {KEYWORDS}
    NULL EOF errno assert NAN INFINITY memset memcpy linux unix
    sqrt sqrtf ceil ceilf rint rintf fabs fabsf signbit
    real real_is_finite real_min real_max real_copysign int_min int_max int_modulo REAL_H
"""
TAKEN: Final = re.compile(
    r"(FLT|DBL|LDBL|DECIMAL|FP|MATH|M)_\w+|HUGE_VAL[FL]?|U?INT\w*_(MAX|MIN|C)|u?int\w*_t"
    r"|(PTRDIFF|SIG_ATOMIC|SIZE|WCHAR|WINT)_(MAX|MIN)|_[A-Z_]\w*|" + "|".join(WORDS.split())
)
"""Keywords, macros and types of C and of its headers, and functions that exported lines call."""


def name(python: str) -> str:
    """``python`` as a name in C, where some words are taken."""
    return f"{python}_" if TAKEN.fullmatch(python.rstrip("_")) else python


def number(value: float, precision: Precision) -> str:
    """A literal with the exact value in ``precision``."""
    with np.errstate(over="ignore"):
        value = float(np.dtype(precision).type(value))
    if math.isnan(value):
        return "NAN" if precision == "float32" else "(double)NAN"
    if math.isinf(value):
        sign = "-" if value < 0.0 else ""
        return f"{sign}INFINITY" if precision == "float32" else f"{sign}(double)INFINITY"
    return literal(value, precision)


IN_ASCII: Final = {
    "²": "^2", "³": "^3", "½": "1/2", "→": "->", "≤": "<=", "·": "*", "Σ": "sum", "ᵀ": "^T",
    "⁺": "+", "⁻": "^-", "¹": "1", "₁": "1", "\N{COMBINING CIRCUMFLEX ACCENT}": "^",
    "\N{COMBINING DIAERESIS}": "''",
}  # fmt: skip


def in_ascii(text: str) -> str:
    """``text`` for tools without Unicode: letters by their names; others become '?'."""

    def letter(found: re.Match[str]) -> str:
        _, _, said = unicodedata.name(found[0], "").partition(" LETTER ")
        name, _, _ = said.lower().partition(" with ")
        return IN_ASCII.get(found[0], name.replace("lamda", "lambda") or "?")

    return re.sub(r"[^\x00-\x7F]", letter, text)


def plain(text: str) -> str:
    """Text of a docstring as text of a comment."""
    return in_ascii(text).replace("``", "'").replace("*/", "* /").replace("/*", "/ *")


def comment(text: str, indent: str = "") -> list[str]:
    """A block comment, as the text has its lines; no comment for an empty text."""
    lines = [line.rstrip() for line in plain(text).splitlines()]
    if not lines:
        return []
    if len(lines) == 1 and len(indent) + len(lines[0]) + 6 <= WIDTH:
        return [f"{indent}/* {lines[0]} */"]
    width = WIDTH - len(indent) - 3
    lines = "\n\n".join(
        textwrap.fill(part, width) if max(map(len, part.split("\n"))) > width + 4 else part
        for part in "\n".join(lines).split("\n\n")
    ).splitlines()
    body = [f"{indent} * {line}".rstrip() for line in lines[1:]]
    return [f"{indent}/* {lines[0]}", *body, f"{indent} */"]


def with_comment(line: str, text: str, indent: str) -> list[str]:
    """``line`` and a comment after the line, or before the line if space is short."""
    one = f"{line} /* {plain(text)} */"
    if "\n" not in line and len(one) <= WIDTH:
        return [one]
    return [*comment(text, indent), line]


def wrapped(line: str, indent: str, inner: str | None = None) -> list[str]:
    """``line`` broken where its outermost operands or arguments begin.

    Continuation lines are indented.
    """
    if len(indent) + len(line) <= WIDTH:
        return [indent + line]
    places = [(rank, at) for rank, at in _breaks(line) if len(indent) + at <= WIDTH]
    if not places:
        return [indent + line]
    least = min(rank for rank, _ in places)
    at = max(place for rank, place in places if rank == least)
    inner = indent + INDENT * 2 if inner is None else inner
    return [indent + line[:at].rstrip(), *wrapped(line[at:].lstrip(), inner, inner)]


OPERATOR: Final = re.compile(r" (?:([?:])|(&&|\|\|)|([-+])|([*/])) ")
"""An operator; the number of its group grows with its precedence."""


def _breaks(line: str) -> list[tuple[tuple[int, int], int]]:
    """Where a line may be broken: nesting depth in brackets, precedence, and position."""
    depth, found = 0, []
    for at, letter in enumerate(line):
        if letter in "([{":
            depth += 1
            if letter == "(":
                found.append(((LAST_RESORT, depth), at + 1))
        elif letter in ")]}":
            depth -= 1
        elif letter == ",":
            found.append(((depth, 0), at + 1))
        elif line[at : at + 3] == " = ":
            found.append(((LAST_RESORT, 0), at + 2))
        elif letter == " " and (operator := OPERATOR.match(line, at)):
            found.append(((depth, operator.lastindex or 0), at))
    return found


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
    """The declarations of a function, by statement."""

    before: dict[ast.stmt, list[str]]  # names declared before it, without a value
    at: dict[ast.stmt, set[str]]  # names declared by it, their first assignment
    once: set[str]  # names with a single assignment


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
        case Array(element=Record() as element):
            return declarator(element, c_name, constant)
        case Array(element=Scalar() as element, shape=(_,)):
            return f"{const}{element.c} *{c_name}"
        case Array(element=Scalar() as element, shape=(_, *rest)):
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
    """Writes a function."""

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
            elif isinstance(target, ast.Name) and target.id == "_":
                self._line(f"(void){self._text(value, UNARY)};", remark)
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
                case [] if before == "if":
                    pass
                case []:
                    self._lines += [
                        f"{self._indent}}} else {{",
                        f"{self._indent}{INDENT}/* as it is */",
                    ]
                case _:
                    self._line("} else {")
                    self._block(node.orelse)
            break
        self._line("}")

    def _for(self, node: ast.For) -> None:
        assert isinstance(node.iter, ast.Call)
        assert isinstance(node.target, ast.Name)
        remark = self._take_comment(node.iter)
        ends = [self._text(each, SUM) for each in node.iter.args]
        start, stop = ["0", *ends][-2:] if len(ends) < 3 else ends[:2]
        ends_at, step = ("<", "++") if len(ends) < 3 else (">", "--")
        i = self._free("i") if node.target.id == "_" else name(node.target.id)
        self._line(f"for (int32_t {i} = {start}; {i} {ends_at} {stop}; {i}{step}) {{", remark)
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
        array = f"({array})" if array.startswith("&") else array
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


_ELSEWHERE: Final = "is a number or a function of the exported C too: must be another name"
_TITLES: Final = {"CONSTANTS": "Constants", "STATE": "State", "TABLE": "The constant table"}


class Names:
    """The named numbers of a program, each in its defining module.

    Raises:
        ExportError: a number's name or a function's name would hide another name.
    """

    def __init__(self, program: Program, precision: Precision) -> None:
        self._sources = program.sources
        self._precision: Precision = precision
        self._used: dict[tuple[str, str], set[str]] = {}  # (module, name) → using modules
        self._homes: dict[str, Module] = {}
        for typed in program.functions.values():
            user = typed.function.module
            for node in typed.function.nodes:
                if not isinstance(node, ast.Name) or node.id in typed.names:
                    continue
                value = user.lookup(node.id)
                if isinstance(value, int | float):
                    home = _origin(self._sources, user, node.id)
                    if node.id not in home.assignments:
                        what = f"{{}}: must have an assignment in a module: {{}} = {value}"
                        raise user.refuse(node, what)
                    self._homes[home.name] = home
                    self._used.setdefault((home.name, node.id), set()).add(user.name)
        self._check(program)

    def headers(self, user: Module) -> set[str]:
        """Modules whose names or enumerations ``user`` uses."""
        used = [(home, name) for (home, name), users in self._used.items() if user.name in users]
        homes = {home for home, _ in used}
        for home, name_ in used:
            homes |= {enum.name for enum, _ in self._enumerator(self._homes[home], name_)}
        return homes - {user.name}

    def definitions(self, home: Module, private: bool) -> list[str]:
        """Definitions of ``home`` as macros: private without users in other modules."""
        lines = []
        for found, node in home.assignments.items():
            users = self._used.get((home.name, found))
            if users is None or (users == {home.name}) != private:
                continue
            value = home.lookup(found)
            text = str(value) if isinstance(value, int) else number(value, self._precision)
            for _, enumerator in self._enumerator(home, found):
                text = enumerator
            if text == name(found):
                continue
            line = f"#define {name(found)} {text if value >= 0 else f'({text})'}"
            said = home.comments.get(node.lineno)
            lines += with_comment(line, said.text, "") if said and not said.alone else [line]
        return lines

    def _check(self, program: Program) -> None:
        """Refuse a local name or a member of a struct that means something else in C."""
        modules = self._sources.modules.values()
        macros = {f"{module.name.upper()}_H" for module in modules}
        macros |= {name(used) for _, used in self._used}
        taken = macros | set(program.functions)
        for module in modules:
            taken |= {_enumerator(n, each.name) for n, e in module.enums.items() for each in e}
            for struct in module.structs.values():
                for field in struct.fields:
                    at = ast.Pass(lineno=struct.line)
                    if not field.name.isascii():
                        raise module.refuse(at, f"{field.name}: {NO_ASCII}")
                    if name(field.name) in macros:
                        raise module.refuse(at, f"{field.name}: {_ELSEWHERE}")
        for typed in program.functions.values():
            for local, node in _locals(typed).items():
                if name(local) in taken:
                    raise typed.function.module.refuse(node, f"{local}: {_ELSEWHERE}")

    def _enumerator(self, home: Module, found: str) -> Iterator[tuple[Module, str]]:
        """The enumerator called ``found``, if any."""
        match home.assignments[found]:
            case ast.Call(
                func=ast.Name(id="int"), args=[ast.Attribute(value=ast.Name(id=enum), attr=member)]
            ):
                declared = home.lookup(enum)
                module = self._sources.module(declared.__module__)
                yield module, _enumerator(enum, member)


def _locals(typed: Typed) -> dict[str, ast.AST]:
    """Names declared in a C function: local names, and names for calls with several results."""
    calls = typed.calls.items()
    found: dict[str, ast.AST] = {
        each.function.name: call for call, each in calls if isinstance(each.result, Answers)
    }
    for node in ast.walk(typed.function.tree):
        local = getattr(node, "id", getattr(node, "arg", None))
        if local in typed.names:
            found.setdefault(local, node)
    return found


def _origin(sources: Sources, user: Module, found: str) -> Module:
    """The module that defines ``found`` as used in ``user``."""
    for node in user.tree.body:
        names = [alias.name for alias in getattr(node, "names", [])]
        if isinstance(node, ast.ImportFrom) and found in names:
            home = sys.modules.get(node.module or "")
            if home and str(getattr(home, "__file__", "")).endswith(".py"):
                return _origin(sources, sources.module(home.__name__), found)
    return user


def _enumerator(enum: str, member: str) -> str:
    """FaultState.CLEAR as FAULT_STATE_CLEAR."""
    return f"{snake(enum).upper()}_{member}"


def _enumerations(module: Module) -> list[str]:
    """C code of every enumeration in ``module``, with comments from the docstrings."""
    lines: list[str] = []
    for node in module.tree.body:
        if not isinstance(node, ast.ClassDef) or node.name not in module.enums:
            continue
        lines += ["", *comment(ast.get_docstring(node) or node.name)]
        lines.append("enum {")
        for each, after in zip(node.body, [*node.body[1:], None], strict=True):
            match each:
                case ast.Assign(targets=[ast.Name(id=member)]):
                    if not member.isascii():
                        raise module.refuse(each, f"{member}: {NO_ASCII}")
                    value = module.enums[node.name][member].value
                    line = f"    {_enumerator(node.name, member)} = {value},"
                    match after:
                        case ast.Expr(value=ast.Constant(value=str(said))):
                            lines += with_comment(line, plain(said), "    ")
                        case _:
                            lines.append(line)
        lines.append("};")
    return lines


class Checked:
    """A program that has the same meaning in C, in either precision.

    Args:
        program: the program.
        entries: C names of the functions called by other programs.

    Raises:
        ExportError: C has another order of evaluation; or see ``check_ranges``.
    """

    def __init__(self, program: Program, entries: set[str]) -> None:
        self.program, self.entries, self.effects = program, entries, Effects(program)
        check_ranges(program, entries, self.effects.changing)


def c_files(checked: Checked, structs: list[CStruct], precision: Precision) -> dict[str, str]:
    """The files of a program, text by file name.

    Args:
        checked: the program.
        structs: its memory: structs named by other programs; the functions need not use every
            struct.
        precision: of its real numbers.

    Raises:
        ExportError: C has another meaning for a name.
    """
    return _CFiles(checked, structs, precision).files()


class _CFiles:
    def __init__(self, checked: Checked, structs: list[CStruct], precision: Precision) -> None:
        program = checked.program
        self._effects = checked.effects
        self._program = program
        self._precision: Precision = precision
        self._names = Names(program, precision)
        self._structs = list(self._with_members(structs))
        self._public = checked.entries | {
            callee.function.c_name
            for typed in program.functions.values()
            for callee in typed.calls.values()
            if callee.function.module is not typed.function.module
        }

    def files(self) -> dict[str, str]:
        found = {}
        for module in self._modules():
            found[f"{module.name}.h"] = _text(self._header(module))
            if any(self._functions(module)):
                found[f"{module.name}.c"] = _text(self._source(module))
        return found

    def _modules(self) -> list[Module]:
        """Modules with C code."""
        wanted = {module.name for module in self._program.modules}
        wanted |= {struct.module for struct in self._structs}
        for module in self._program.modules:
            wanted |= self._names.headers(module)
        modules = {module.name: module for module in self._program.sources.modules.values()}
        return [each for each in modules.values() if each.name in wanted or each.enums]

    def _with_members(self, structs: list[CStruct]) -> dict[CStruct, None]:
        """Each struct once, after the structs of its members."""
        found: dict[CStruct, None] = {}
        for struct in structs:
            found |= self._with_members(self._members(struct)) | {struct: None}
        return found

    def _members(self, struct: CStruct) -> list[CStruct]:
        found = (self._program.sources.struct(field.kind) for field in struct.fields)
        return [each for each in found if each is not None]

    def _functions(self, module: Module) -> list[Typed]:
        return [
            typed for typed in self._program.functions.values() if typed.function.module is module
        ]

    def _header(self, module: Module) -> list[str]:
        guard = f"{module.name.upper()}_H"
        own = [struct for struct in self._structs if struct.module == module.name]
        exported = [t for t in self._functions(module) if t.function.c_name in self._public]
        needed = {m.module for struct in own for m in self._members(struct)} - {module.name}
        lines = comment(module.docstring)
        lines += [f"#ifndef {guard}", f"#define {guard}", "", '#include "real.h"']
        lines += [f'#include "{each}.h"' for each in sorted(needed)]
        lines += ["", *self._names.definitions(module, private=False), *_enumerations(module)]
        for struct in own:
            lines += ["", *self._struct(struct, module)]
        outside = {
            kind.struct.tag
            for typed in exported
            for kind in typed.arguments
            if isinstance(kind, Record) and kind.struct.module not in needed | {module.name}
        }
        lines += ["", *(f"struct {tag};" for tag in sorted(outside))]
        for typed in exported:
            lines += ["", *_answers(typed), *comment(typed.function.docstring)]
            lines += wrapped(f"{signature(typed, self._effects)};", "")
        return [*lines, "", "#endif"]

    def _struct(self, struct: CStruct, module: Module) -> list[str]:
        python = struct.tag.removeprefix(f"{struct.module}_").upper()
        title = [_TITLES.get(python, python.capitalize().replace("_", " "))]
        title += [line.rstrip(".:") for line in module.docstring.splitlines()[:1]]
        lines = [*comment(": ".join(title)), f"struct {struct.tag} {{"]
        for field in struct.fields:
            lines += with_comment(f"    {self._member(field)};", plain(_meaning(field)), "    ")
        return [*lines, "};"]

    def _member(self, field: Field) -> str:
        sizes = "".join(f"[{size}]" for size in field.shape)
        if isinstance(field.kind, type):
            struct = self._program.sources.struct(field.kind)
            assert struct is not None
            return f"struct {struct.tag} {name(field.name)}{sizes}"
        return f"{'real' if field.kind == 'real' else 'int32_t'} {name(field.name)}{sizes}"

    def _source(self, module: Module) -> list[str]:
        functions = self._functions(module)
        needed = {callee.function.module.name for t in functions for callee in t.calls.values()}
        needed |= {
            kind.struct.module
            for typed in functions
            for kind in (*typed.types.values(), *typed.names.values())
            if isinstance(kind, Record)
        }
        needed |= self._names.headers(module)
        lines = [f'#include "{module.name}.h"', ""]
        lines += [f'#include "{each}.h"' for each in sorted(needed - {module.name})]
        lines += ['#include "rounding.h"', "", *self._names.definitions(module, private=True)]
        for typed in functions:
            storage = ""
            lines += ["", f"/* {module.path.name}, line {typed.function.tree.lineno} */"]
            if typed.function.c_name not in self._public:
                lines += [*_answers(typed), *comment(typed.function.docstring)]
                storage = "static "
            lines += wrapped(storage + signature(typed, self._effects), "")
            lines += CFunction(typed, self._effects, self._precision).body()
        return lines


def _answers(typed: Typed) -> list[str]:
    if not isinstance(typed.result, Answers):
        return []
    members = [f"    {declarator(kind, name(n), False)};" for n, kind in typed.result.items]
    title = f"What {typed.function.c_name} answers."
    return [*comment(title), f"struct {typed.result.tag} {{", *members, "};", ""]


def _meaning(field: Field) -> str:
    unit = "" if field.unit == "1" else f"[{field.unit}] "
    return f"{unit}{field.meaning}"


def _text(lines: list[str]) -> str:
    """The lines as a file, without empty ones side by side."""
    kept = [line for at, line in enumerate(lines) if line or (at and lines[at - 1])]
    return "\n".join(kept) + "\n"


def constants_files(table: Table, title: str, speeds: Constants | None = None) -> dict[str, str]:
    """``constants.h`` and ``constants.c``: the table, with exact numbers.

    Args:
        table: of ``tables.build``.
        title: the description of the table.
        speeds: of ``schedules.schedule``, where the speed of the car changes.
    """
    memories: list[tuple[str, type[Struct], Struct, Callable[..., object]]] = [
        ("layout_table controller_table", Table, table, build)
    ]
    if speeds is not None:
        memories.append(("schedule_constants controller_schedule", Constants, speeds, schedule))
    header = [
        *comment(title), "#ifndef CONSTANTS_H", "#define CONSTANTS_H", "", '#include "layout.h"',
        *([] if speeds is None else ['#include "schedule.h"']), "",
        *(f"extern const struct {what};" for what, *_ in memories), "", "#endif",
    ]  # fmt: skip
    source = [*comment(title), '#include "constants.h"']
    for what, struct, record, maker in memories:
        members = _members(struct, record, precision_of(table), INDENT)
        place = unwrap(maker).__code__
        line = f"/* {Path(place.co_filename).name}, line {place.co_firstlineno} */"
        source += ["", line, f"const struct {what} = {{", *members, "};"]
    return {"constants.h": _text(header), "constants.c": _text(source)}


def _members(struct: type[Struct], record: Any, precision: Precision, indent: str) -> Iterator[str]:
    """Every member except zeros; C initialises missing members with zero."""
    zeros, fields = 0, fields_of(struct)
    for field in fields:
        value = record[field.name]
        if isinstance(field.kind, type) and field.shape:
            yield f"{indent}.{name(field.name)} = {{"
            for each in value:
                inside = _members(field.kind, each, precision, indent + 2 * INDENT)
                yield from (f"{indent}{INDENT}{{", *inside, f"{indent}{INDENT}}},")
            yield f"{indent}}},"
        elif isinstance(field.kind, type):
            inside = _members(field.kind, value, precision, indent + INDENT)
            yield from (f"{indent}.{name(field.name)} = {{", *inside, f"{indent}}},")
        elif _is_zero(np.asarray(value)):
            zeros += 1
        else:
            yield from _initialised(field, np.asarray(value), precision, indent)
    if zeros == len(fields):  # an initialiser must not be empty
        nested = len(fields[0].shape)
        yield f"{indent}.{name(fields[0].name)} = {'{' * nested}0{'}' * nested},"


def _initialised(field: Field, value: Any, precision: Precision, indent: str) -> Iterator[str]:
    remark = f" /* {plain(_meaning(field))} */"
    if value.ndim < 2:
        text = f".{name(field.name)} = {_initialiser(field, value, precision)},"
        if len(indent + text + remark) <= WIDTH:
            yield indent + text + remark
        else:
            yield from (indent + remark[1:], *wrapped(text, indent))
        return
    yield from with_comment(f"{indent}.{name(field.name)} = {{", _meaning(field), indent)
    for row in _without_last_zeros(value):
        yield from wrapped(f"{_initialiser(field, row, precision)},", indent + INDENT)
    yield f"{indent}}},"


def _initialiser(field: Field, value: Any, precision: Precision) -> str:
    if np.ndim(value):
        each = (_initialiser(field, one, precision) for one in _without_last_zeros(value))
        return f"{{{', '.join(each)}}}"
    return number(float(value), precision) if field.kind == "real" else str(int(value))


def _without_last_zeros(value: Any) -> Any:
    """The elements down to the last that differs from zero, but at least one."""
    last = max((at for at, one in enumerate(value) if not _is_zero(one)), default=0)
    return value[: last + 1]


def _is_zero(value: Any) -> bool:
    """Whether all elements equal C's default initialisation: -0.0 does not."""
    return not np.any(value) and not np.any(np.signbit(value))
