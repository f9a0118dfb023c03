"""A function of the target as a function of C, statement by statement, with its comments."""

from __future__ import annotations

import ast

from can_rig.export.translation.effects import Effects
from can_rig.export.translation.expressions import indices_of
from can_rig.export.translation.program import Typed
from can_rig.export.translation.source import Comment
from can_rig.export.translation.types import Answers, Array, Record, Scalar, Type
from can_rig.export.writing.c_expressions import CExpressions
from can_rig.export.writing.c_text import INDENT, comment, name, with_comment, wrapped
from can_rig.export.writing.declarations import declarations
from firmware_model.target.structs import Precision


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


def result(kind: Type) -> str:
    """The type of what a function returns."""
    if isinstance(kind, Answers):
        return f"struct {kind.tag}"
    return kind.c if isinstance(kind, Scalar) else "void"


def signature(typed: Typed, effects: Effects) -> str:
    """How a function is declared, without storage class and semicolon."""
    written = effects.written(typed)
    parameters = ", ".join(
        declarator(
            typed.names[each],
            name(each),
            not isinstance(typed.names[each], Scalar) and each not in written,
        )
        for each in typed.function.parameters
    )
    return f"{result(typed.result)} {typed.function.c_name}({parameters or 'void'})"


class CFunction:
    """Writes a function.

    Args:
        typed: the function.
        effects: of the whole program.
        precision: of its real numbers.
    """

    def __init__(self, typed: Typed, effects: Effects, precision: Precision) -> None:
        self._typed = typed
        self._expressions = CExpressions(typed, precision)
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

    def _block(self, body: list[ast.stmt]) -> None:
        self._indent += INDENT
        for node in body:
            self._blank_line_before(node)
            self._comments_before(node.lineno)
            for each in self._declared.before.get(node, []):
                self._declare_only(each)
            self._statement(node)
        self._indent = self._indent.removesuffix(INDENT)

    def _blank_line_before(self, node: ast.stmt) -> None:
        """Keep the source's blank line."""
        first = min([node.lineno, *(line for line, _ in self._comments[:1])])
        text = self._typed.function.module.lines
        if not text[first - 2].strip() and not self._lines[-1].endswith("{"):
            self._lines.append("")

    def _comments_before(self, line: int) -> None:
        while self._comments and self._comments[0][0] < line:
            self._lines += comment(self._comments.pop(0)[1].text, self._indent)

    def _take_comment(self, last_line: int) -> str | None:
        """Take the comments down to ``last_line``, which belong to the current statement."""
        taken = []
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

    def _declare_only(self, local: str) -> None:
        kind = self._typed.names[local]
        constant = not isinstance(kind, Scalar) and local not in self._written
        self._line(f"{declarator(kind, name(local), constant)};")

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.If():
                self._if(node)
                return
            case ast.For():
                self._for(node)
                return
        remark = self._take_comment(node.end_lineno or node.lineno)
        match node:
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
                for target, value in zip(targets, values, strict=True):
                    self._assign(node, target, value, remark)
                    remark = None
            case ast.Assign(targets=[ast.Tuple(elts=targets)], value=value):
                self._unpack(node, targets, value, remark)
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._assign(node, target, value, remark)
                    remark = None
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign(node, target, value, remark)
            case ast.AugAssign(target=target, op=op, value=value):
                sign = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}[type(op)]
                place = self._expressions.text(target)
                self._line(f"{place} {sign}= {self._expressions.text(value)};", remark)
            case ast.Return():
                self._return(node, remark)
            case ast.Expr(value=value):
                ignored = isinstance(self._typed.expressions.get(value), Scalar | Answers)
                text = self._expressions.text(value)
                self._line(f"{'(void)' if ignored else ''}{text};", remark)
            case ast.Break():
                self._line("break;", remark)
            case ast.Continue():
                self._line("continue;", remark)

    def _assign(
        self, node: ast.stmt, target: ast.expr, value: ast.expr, remark: str | None
    ) -> None:
        kind = self._typed.expressions.get(target)
        if isinstance(target, ast.Subscript) and isinstance(kind, Array):
            self._fill(target, value, remark)
            return
        place = self._place(node, target)
        self._line(f"{place} = {self._expressions.address(value)};", remark)

    def _place(self, node: ast.stmt, target: ast.expr) -> str:
        """The left side of an assignment; a declaration if the name is new."""
        if isinstance(target, ast.Name) and target.id in self._declared.at.get(node, set()):
            kind = self._typed.names[target.id]
            once = target.id in self._declared.once
            constant = once if isinstance(kind, Scalar) else target.id not in self._written
            return declarator(kind, name(target.id), constant)
        return self._expressions.text(target)

    def _fill(self, target: ast.Subscript, value: ast.expr, remark: str | None) -> None:
        """The same value into every element."""
        array = self._typed.expressions[target.value]
        assert isinstance(array, Array)
        text, depth = self._expressions.text(target.value), 0
        for index, size in zip(indices_of(target, len(array.shape)), array.shape, strict=True):
            lower, upper = "0", str(size)
            if isinstance(index, ast.Slice):
                lower = self._expressions.text(index.lower) if index.lower else lower
                upper = self._expressions.text(index.upper) if index.upper else upper
            i = self._free("ijkm"[depth])
            self._line(f"for (int32_t {i} = {lower}; {i} < {upper}; {i}++) {{", remark)
            text, depth, remark = f"{text}[{i}]", depth + 1, None
            self._indent += INDENT
        self._line(f"{text} = {self._expressions.text(value)};")
        for _ in range(depth):
            self._indent = self._indent.removesuffix(INDENT)
            self._line("}")

    def _free(self, wanted: str) -> str:
        """A name unused in the function."""
        while wanted in self._taken:
            wanted += "_"
        return wanted

    def _unpack(
        self, node: ast.stmt, targets: list[ast.expr], value: ast.expr, remark: str | None
    ) -> None:
        """Every value of a call that answers several."""
        answers = self._typed.expressions[value]
        assert isinstance(answers, Answers)
        self._answers += 1
        called = self._typed.calls[value].function.name if isinstance(value, ast.Call) else ""
        whole = self._free(name(called) + (f"_{self._answers}" if self._answers > 1 else ""))
        self._taken.add(whole)
        text = self._expressions.text(value)
        self._line(f"const struct {answers.tag} {whole} = {text};", remark)
        for target, (member, _) in zip(targets, answers.items, strict=True):
            if not (isinstance(target, ast.Name) and target.id == "_"):
                self._line(f"{self._place(node, target)} = {whole}.{name(member)};")

    def _return(self, node: ast.Return, remark: str | None) -> None:
        if node.value is None:
            self._line("return;", remark)
        elif isinstance(self._typed.result, Answers):
            members = ", ".join(
                f".{name(member)} = {name(member)}" for member, _ in self._typed.result.items
            )
            self._line(f"return (struct {self._typed.result.tag}){{{members}}};", remark)
        else:
            self._line(f"return {self._expressions.text(node.value)};", remark)

    def _if(self, node: ast.If) -> None:
        before = "if"
        while True:
            remark = self._take_comment(node.test.end_lineno or node.lineno)
            self._line(f"{before} ({self._expressions.condition(node.test)}) {{", remark)
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
        remark = self._take_comment(node.iter.end_lineno or node.lineno)
        ends = [self._expressions.text(end) for end in node.iter.args]
        start, stop = ("0", *ends) if len(ends) == 1 else ends
        i = self._free("i") if node.target.id == "_" else name(node.target.id)
        self._line(f"for (int32_t {i} = {start}; {i} < {stop}; {i}++) {{", remark)
        self._block(node.body)
        self._line("}")
