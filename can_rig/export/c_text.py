"""How C is set: lines of at most 100 columns, comments, numbers."""

from __future__ import annotations

import math
import re
import textwrap
from typing import Final

import numpy as np

from firmware_model.discretisation.filters import KEYWORDS
from firmware_model.law.structs import Precision

WIDTH: Final = 100
INDENT: Final = "    "
LAST_RESORT: Final = 99  # deeper than any nesting

WORDS: Final = f"""
    {KEYWORDS}
    NULL EOF errno assert NAN INFINITY memset memcpy
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
    if math.isnan(value):
        return "NAN" if precision == "float32" else "(double)NAN"
    if math.isinf(value):
        sign = "-" if value < 0.0 else ""
        return f"{sign}INFINITY" if precision == "float32" else f"{sign}(double)INFINITY"
    if precision == "float32":
        shortest = str(np.float32(value))
        return f"{shortest if '.' in shortest or 'e' in shortest else shortest + '.0'}f"
    return repr(float(value))


def plain(text: str) -> str:
    """Text of a docstring as text of a comment."""
    return text.replace("``", "'").replace("*/", "* /").replace("/*", "/ *")


def comment(text: str, indent: str = "") -> list[str]:
    """A block comment, as the text has its lines; no comment for an empty text."""
    lines = [line.rstrip() for line in plain(text).splitlines()]
    if not lines:
        return []
    if len(lines) == 1 and len(indent) + len(lines[0]) + 6 <= WIDTH:
        return [f"{indent}/* {lines[0]} */"]
    if len(lines) == 1:
        lines = textwrap.wrap(lines[0], WIDTH - len(indent) - 3)
    body = [f"{indent} * {line}".rstrip() for line in lines[1:]]
    return [f"{indent}/* {lines[0]}", *body, f"{indent} */"]


def with_comment(line: str, text: str, indent: str) -> list[str]:
    """``line`` with a comment behind, or before if space is short."""
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
    places = [
        (rank, at)
        for rank, at in _breaks(line)
        if len(indent) + at + (1 if line[at] == "," else 0) <= WIDTH
    ]
    if not places:
        return [indent + line]
    least = min(rank for rank, _ in places)
    at = max(place for rank, place in places if rank == least)
    at += 1 if line[at] == "," else 0
    inner = indent + INDENT * 2 if inner is None else inner
    return [indent + line[:at].rstrip(), *wrapped(line[at:].lstrip(), inner, inner)]


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
            found.append(((depth, 0), at))
        elif line[at : at + 3] == " = ":
            found.append(((LAST_RESORT, 0), at + 2))
        else:
            for tightness, operators in enumerate((" [?:] ", r" (&&|\|\|) ", " [-+] ", " [*/] ")):
                if re.match(operators, line[at:]):
                    found.append(((depth, tightness + 1), at))
    return found
