"""MC/DC of C, measured by a variant of the files that records the values of all conditions.

Compilers before gcc 14 and clang 18 measure no MC/DC. A decision stands in ``if``, in a loop,
before ``?``, or in another expression with a comparison, ``&&``, ``||`` or ``!``. The conditions of
a decision are the parts without ``&&``, ``||`` and ``!``. The variant records each combination of
their values; C leaves out a condition that cannot change the outcome any more.

A condition is proven if the condition has decided the outcome both ways: masking MC/DC, as gcc 14
measures.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Final

from can_rig.export.law import support

TOKEN: Final = re.compile(
    r"(?P<skip>\s+|/\*.*?\*/|//[^\n]*|^[ \t]*#(?:[^\n\\]|\\.)*)"
    r'|(?P<word>\d[\w.]*[eE][-+]\w+|\w[\w.]*|"(?:\\.|[^"\\])*"|\'(?:\\.|[^\'\\])*\')'
    r"|(?P<sign>->|\+\+|--|<<=|>>=|<<|>>|&&|\|\||[-+*/%&|^=!<>]=|.)",
    re.DOTALL | re.MULTILINE,
)
RECORDER: Final = ("recorder.h", "recorder.c")
OPEN, CLOSE = "([{", ")]}"
COMPARISONS: Final = {"<", "<=", ">", ">=", "==", "!="}
ENDS: Final = {
    ",", ";", "?", ":", "=", "return", *OPEN, *CLOSE,
    *(f"{sign}=" for sign in ("+", "-", "*", "/", "%", "&", "|", "^", "<<", ">>")),
}  # fmt: skip
"""What an expression of conditions does not contain, outside its brackets."""

Tree = int | tuple["str | Tree", ...]
"""The number of a condition, or ``("&&", …)``, ``("||", …)`` and ``("!", …)`` of trees."""
Span = tuple[int, int]
"""The first token, and the first that does not belong any more."""


@dataclass(frozen=True)
class Token:
    """A word, a number or an operator of C."""

    text: str
    at: int
    """The place of its first character."""


def tokens(text: str) -> list[Token]:
    """The tokens of C, without comments and what is for the preprocessor."""
    found = TOKEN.finditer(text)
    return [Token(each[0], each.start()) for each in found if each.lastgroup != "skip"]


@dataclass(frozen=True)
class Decision:
    """A decision.

    Attributes:
        lines: the line of each condition.
        texts: the conditions.
        tree: how they are joined.
    """

    file: str
    lines: tuple[int, ...]
    texts: tuple[str, ...]
    tree: Tree

    def unproven(self, seen: Iterable[int]) -> Iterator[tuple[str, str, str]]:
        """The conditions without a proof: ``file:line``, condition, what was seen of the condition.

        Args:
            seen: the recorded combinations; a condition has two bits: 1 false, 2 true.
        """
        values: dict[int, set[int]] = {}
        deciding: dict[int, set[int]] = {}
        for combination in seen:
            _, by = _outcome(self.tree, combination)
            for k in range(len(self.texts)):
                value = combination >> 2 * k & 3
                values.setdefault(k, set()).add(value)
                if k in by:
                    deciding.setdefault(k, set()).add(value)
        for k, (line, text) in enumerate(zip(self.lines, self.texts, strict=True)):
            if len(deciding.get(k, ())) < 2:
                had = values.get(k, set()) - {0}
                once = {frozenset(): "not evaluated", frozenset({1}): "never true",
                        frozenset({2}): "never false"}  # fmt: skip
                yield f"{self.file}:{line}", text, once.get(frozenset(had), "never decides alone")


def _outcome(tree: Tree, combination: int) -> tuple[bool | None, set[int]]:
    """The value of a tree, None: not evaluated; and the conditions that decide the value."""
    if isinstance(tree, int):
        value = (None, False, True)[combination >> 2 * tree & 3]
        return value, {tree}
    sign, *parts = tree
    judged = [_outcome(part, combination) for part in parts if not isinstance(part, str)]
    known = [(value, by) for value, by in judged if value is not None]
    if not known:
        return None, set()
    last, by = known[-1]
    if sign == "!":
        return not last, by
    if last is (sign == "&&"):  # so were all before
        return last, set().union(*(each for _, each in known))
    return last, by


class _File:
    """The decisions of a file of C."""

    def __init__(self, name: str, text: str) -> None:
        self._name, self._text, self._tokens = name, text, tokens(text)
        self._words = [token.text for token in self._tokens]
        self._pair: dict[int, int] = {}
        opened: list[int] = []
        for at, word in enumerate(self._words):
            if word in OPEN:
                opened.append(at)
            elif word in CLOSE:
                begin = opened.pop()
                self._pair |= {begin: at, at: begin}

    def decisions(self) -> Iterator[tuple[Span, list[Span], Decision]]:
        """Places of a decision and of its conditions, and the decision; outer decisions first."""
        spans = set()
        for at, word in enumerate(self._words):
            if word in {"if", "while"}:
                spans.add((at + 2, self._pair[at + 1]))
            elif word in COMPARISONS | {"&&", "||", "!", "?"}:
                spans.add((self._end(at - 1, -1) + 1, at if word == "?" else self._end(at, 1)))
        within: set[Span] = set()
        for span in sorted(spans, key=lambda each: (each[0], -each[1])):
            if span in within:
                continue
            conditions: list[Span] = []
            tree = self._tree(span, conditions, within)
            if conditions:
                places = [self.characters(each) for each in conditions]
                lines = tuple(self._text.count("\n", 0, begin) + 1 for begin, _ in places)
                texts = tuple(" ".join(self._text[b:e].split()) for b, e in places)
                yield span, conditions, Decision(self._name, lines, texts, tree)

    def _end(self, at: int, step: int) -> int:
        """Where the expression around ``at`` ends in one direction."""
        around = ("(", "[") if step > 0 else (")", "]")
        while (word := self._words[at]) not in ENDS or word in around:
            at = self._pair.get(at, at) + step
        return at

    def _tree(self, span: Span, conditions: list[Span], within: set[Span]) -> Tree:
        within.add(span)
        first, end = span
        if self._words[first] == "(" and self._pair[first] == end - 1:
            return self._tree((first + 1, end - 1), conditions, within)
        parts = [at for at in self._outermost(span) if self._words[at] in {"&&", "||"}]
        for sign in ("||", "&&"):
            cuts = [at for at in parts if self._words[at] == sign]
            if cuts:
                ends = zip([first, *(at + 1 for at in cuts)], [*cuts, end], strict=True)
                return (sign, *(self._tree(each, conditions, within) for each in ends))
        if self._words[first] == "!" and not any(
            self._words[at] in COMPARISONS for at in self._outermost(span)
        ):
            return ("!", self._tree((first + 1, end), conditions, within))
        conditions.append(span)
        return len(conditions) - 1

    def _outermost(self, span: Span) -> Iterator[int]:
        """The tokens outside brackets."""
        at, end = span
        while at < end:
            yield at
            at = self._pair.get(at, at) + 1

    def characters(self, span: Span) -> tuple[int, int]:
        """Where a span begins and ends in the text."""
        last = self._tokens[span[1] - 1]
        return self._tokens[span[0]].at, last.at + len(last.text)


class Recording:
    """The variant of files that records its conditions.

    Attributes:
        files: text by file name, with the recorder; each line is where it was.
        decisions: in the order of the record.
    """

    def __init__(self, files: Mapping[str, str]) -> None:
        self.decisions: list[Decision] = []
        self.files = {name: self._variant(name, text) for name, text in files.items()}
        sizes = [4 ** len(each.texts) for each in self.decisions]
        self._begins = [0, *accumulate(sizes)]
        begins = ", ".join(map(str, self._begins))
        for name in RECORDER:
            self.files[name] = support(name, begins=begins, size=str(sum(sizes)))

    def _variant(self, name: str, text: str) -> str:
        """The file; at the same place an outer expression begins first and ends last."""
        if not name.endswith((".c", ".h")):
            return text
        file, added = _File(name, text), list[tuple[int, int, int, str]]()
        for span, conditions, decision in file.decisions():
            number = len(self.decisions)
            self.decisions.append(decision)
            for k, each in enumerate([span, *conditions]):
                what = f"recorder_condition({number}, {k - 1}, ("
                if k == 0:
                    what = f"(recorder_begin({number}), recorder_end({number}, ("
                begin, end = file.characters(each)
                rank = 2 * (end - begin) + (k == 0)
                added.append((begin, 1, -rank, what))
                added.append((end, 0, rank, ") != 0))" if k == 0 else ") != 0)"))
        for at, _, _, what in sorted(added, reverse=True):
            text = text[:at] + what + text[at:]
        return f'#include "recorder.h"\n#line 1\n{text}'

    def seen(self, record: bytes) -> list[set[int]]:
        """By decision, the combinations of a program's record."""
        parts = (record[begin:end] for begin, end in pairwise(self._begins))
        return [{at for at, seen in enumerate(part) if seen} for part in parts]
