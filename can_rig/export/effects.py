"""Side effects of functions, and refusal of expressions whose order C may change.

Python computes operands and arguments from left to right, C in any order. So in an expression a
function that changes something stands beside names, literals and constants of the table only; local
names cannot change during the expression, and structs without writers never change.
"""

import ast
from collections.abc import Iterator

from can_rig.export.source import Array, CStruct, Record, names_in, paired
from can_rig.export.subset import Program, Typed


class Effects:
    """The side effects of a program's functions, which write the structs in ``changing``.

    Raises:
        ExportError: the value of an expression depends on C's order of evaluation.
    """

    def __init__(self, program: Program) -> None:
        self._written: dict[Typed, set[str]] = {}
        self.changing: set[CStruct] = set()
        functions = list(program.functions.values())
        for typed in functions:
            self._written[typed] = set(self._writes(typed))
        for typed in functions:
            self._check_order(typed)

    def written(self, typed: Typed) -> set[str]:
        """Names of the parameters that ``typed`` writes, directly or through members."""
        return self._written[typed]

    def _writes(self, typed: Typed) -> Iterator[str]:
        """The names that ``typed`` writes, aliases included."""
        aliases = {
            (one.id, value)
            for node in typed.function.nodes
            if isinstance(node, ast.Assign)
            for one, value in paired(node)
            if isinstance(one, ast.Name) and isinstance(typed.names.get(one.id), Record | Array)
        }
        for node in typed.function.nodes:
            targets: list[ast.expr] = []
            if isinstance(node, ast.Assign):
                targets = [one for each in node.targets for one in getattr(each, "elts", [each])]
            elif isinstance(node, ast.AugAssign):
                targets = [node.target]
            targets = [each for each in targets if not isinstance(each, ast.Name)]
            if isinstance(node, ast.Call) and node in typed.calls:
                callee = typed.calls[node]
                pairs = zip(callee.function.parameters, node.args, strict=True)
                targets = [each for name, each in pairs if name in self._written[callee]]
            for target in targets:
                self._note(typed, target)
                found = {_root(target)}
                while more := {_root(whole) for alias, whole in aliases if alias in found} - found:
                    found |= more
                for alias, whole in aliases:
                    if alias in found:
                        self._note(typed, whole)
                yield from filter(None, found)

    def _note(self, typed: Typed, node: ast.expr) -> None:
        """Every struct on the way to ``node`` changes."""
        while True:
            kind = typed.types.get(node)
            if isinstance(node, ast.Name):
                kind = typed.names[node.id]
            if isinstance(kind, Record):
                self.changing.add(kind.struct)
            if not isinstance(node, ast.Attribute | ast.Subscript):
                return
            node = node.value

    def _check_order(self, typed: Typed) -> None:
        """Refuse the first expression whose value depends on the order of its parts."""
        for node in typed.function.nodes:
            match node:
                case ast.BinOp(left=left, right=right):
                    self._unordered(typed, node, [left, right])
                case ast.Compare(left=left, comparators=others):
                    self._unordered(typed, node, [left, *others])
                case ast.Call(args=arguments):
                    self._unordered(typed, node, arguments)
                case ast.AugAssign(target=target, value=value):
                    self._unordered(typed, node, [target, value])
                case ast.Subscript(slice=ast.Tuple(elts=indices)):
                    self._unordered(typed, node, indices)
                case ast.Assign():
                    self._assign(typed, node)
                case ast.For(iter=ast.Call(args=ends)):
                    self._loop(typed, node, ends)

    def _unordered(self, typed: Typed, node: ast.AST, parts: list[ast.expr]) -> None:
        for part in parts:
            others = (other for other in parts if other is not part)
            if self._acts(typed, part) and not all(self._stable(typed, each) for each in others):
                raise typed.function.module.refuse(
                    node, f"{ast.unparse(part)} changes something, and C may compute what stands "
                    "beside it before or after: must be on a line of its own"
                )  # fmt: skip

    def _assign(self, typed: Typed, node: ast.Assign) -> None:
        """Several targets get the same value, or each its own, one after the other."""
        refuse, first, value = typed.function.module.refuse, node.targets[0], node.value
        for target, each in paired(node):
            filled = isinstance(typed.types.get(target), Array)
            if filled and any(
                isinstance(one, ast.Subscript) or one in typed.calls for one in ast.walk(each)
            ):
                what = f"{ast.unparse(each)}: must be a name or a literal to go to several places"
                raise refuse(node, what)
        if isinstance(first, ast.Tuple) and isinstance(value, ast.Tuple):
            for i, target in enumerate(first.elts):
                self._unordered(typed, node, [*_indices(target), value.elts[i]])
                for later in value.elts[i + 1 :]:
                    if not self._untouched(typed, target, later):
                        raise refuse(
                            node, f"{{}}: {ast.unparse(later)} may be what was just assigned: "
                            "must be two statements"
                        )  # fmt: skip
        elif len(node.targets) > 1 and not self._settled(typed, node.targets, value):
            what = f"{ast.unparse(value)}: must be a name or a literal to go to several places"
            raise refuse(node, what)
        else:
            indices = [index for target in node.targets for index in _indices(target)]
            self._unordered(typed, node, [*indices, value])

    def _settled(self, typed: Typed, targets: list[ast.expr], value: ast.expr) -> bool:
        """Whether ``value`` stays the same while one target after the other gets ``value``."""
        stored = {each.id for each in targets if isinstance(each, ast.Name)}
        read = {each.id for each in names_in(value)}
        return self._stable(typed, value) and not stored & read

    def _untouched(self, typed: Typed, target: ast.expr, later: ast.expr) -> bool:
        """Whether ``later`` is independent of the assignment to ``target``."""
        if isinstance(target, ast.Name):
            return all(node.id != target.id for node in names_in(later))
        return self._stable(typed, later) or isinstance(typed.types.get(later), Record | Array)

    def _loop(self, typed: Typed, node: ast.For, ends: list[ast.expr]) -> None:
        """C looks at the end of a range in every turn."""
        stored = {each.id for each in names_in(*node.body) if isinstance(each.ctx, ast.Store)}
        for end in ends:
            if not self._stable(typed, end) or stored & {name.id for name in names_in(end)}:
                raise typed.function.module.refuse(
                    end, "range({}): must be a name, a number or a constant of the table that "
                    "the loop does not change"
                )  # fmt: skip

    def _acts(self, typed: Typed, node: ast.expr) -> bool:
        """Whether computing ``node`` changes something."""
        inside = (typed.calls.get(each) for each in ast.walk(node) if isinstance(each, ast.Call))
        return any(callee is not None and self._written[callee] for callee in inside)

    def _stable(self, typed: Typed, node: ast.expr) -> bool:
        """Whether ``node`` is the same before and after any call."""
        if self._acts(typed, node):
            return False
        for inner in ast.walk(node):
            if isinstance(inner, ast.Call) and inner in typed.calls:
                if any(isinstance(each, Record | Array) for each in typed.calls[inner].arguments):
                    return False
            elif isinstance(inner, ast.Attribute | ast.Subscript) and not isinstance(
                typed.types.get(inner), Record | Array
            ):
                owner = typed.types.get(inner.value)
                if isinstance(owner, Array):
                    owner = typed.types.get(getattr(inner.value, "value", inner.value))
                elif owner is None:
                    continue
                if not isinstance(owner, Record) or owner.struct in self.changing:
                    return False
        return True


def _root(node: ast.expr) -> str | None:
    """The variable that contains ``node``; None if ``node`` is no part of a variable."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


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
