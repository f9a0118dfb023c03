"""Mutants of a C file: small changes, each of which back-to-back tests ought to notice.

| what                          | becomes                                            |
|-------------------------------|----------------------------------------------------|
| `+`, `*`, `<<`, `&`           | `-`, `/`, `>>`, `|`, and the other way round       |
| `<`, `>=`, `==` ...           | `<=` and `>=`, and likewise every other comparison |
| `&&`                          | `||`, and the other way round                      |
| `!`, `-` before a value       | left out                                           |
| a number                      | 0 ↔ 1; twice a real one; one more than an integer  |
| `real_min`, `int_min`         | `real_max`, `int_max`, and the other way round     |
| `true`                        | `false`, and the other way round                   |
| a condition of an if          | its negation                                       |
| an assignment, a call         | left out                                           |

Declarations of types, comments, includes and prototypes are left alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from mutation_sites import Mutant

OPERATORS: Final = {
    " + ": [" - "], " - ": [" + "], " * ": [" / "], " / ": [" * "], " % ": [" * "],
    " += ": [" -= "], " -= ": [" += "], " *= ": [" /= "], " /= ": [" *= "],
    " << ": [" >> "], " >> ": [" << "], " & ": [" | "], " | ": [" & "], " ^ ": [" & "],
    " < ": [" <= ", " >= "], " <= ": [" < ", " > "], " > ": [" >= ", " <= "],
    " >= ": [" > ", " < "], " == ": [" != "], " != ": [" == "],
    " && ": [" || "], " || ": [" && "], "++": ["--"], "--": ["++"],
    "real_min(": ["real_max("], "real_max(": ["real_min("],
    "int_min(": ["int_max("], "int_max(": ["int_min("],
    "true": ["false"], "false": ["true"], "(-": ["("], "= -": ["= "], "!(": ["("], "!": [""],
}  # fmt: skip
TOKENS: Final = re.compile(
    r"/\*.*?\*/|\"[^\"]*\"|(?<![\w.])(?P<number>0x[0-9A-F]+u?|\d+\.\d+(?:e[-+]?\d+)?f?|\d+u?)(?![\w.])"
    r"|(?P<operator> (?:\+|-|\*|/|%|\+=|-=|\*=|/=|<<|>>|&|\||\^|<|<=|>|>=|==|!=|&&|\|\|) "
    r"|\+\+|--|\b(?:real|int)_(?:min|max)\(|\btrue\b|\bfalse\b|\(-(?=\w)|= -(?=\w)|!\(|!(?=\w))"
)
STATEMENT: Final = re.compile(
    r"^ +(?:\(void\))?[\w>.\[\]()&*-]+ ?(?:[-+*/]?=[^=].*|\(.*\)|\+\+|--);"
)
DECLARATION: Final = re.compile(
    r"^\s*(?:typedef|struct|enum|extern|static|const|real|int\d+_t|uint\d+_t|int|bool|double|void)\b"
)


def mutants(source: str) -> Iterator[Mutant]:
    """Every mutant of a C file, in the order of its lines; no two are alike."""
    lines = source.splitlines(keepends=True)
    comment = body = False
    for at, line in enumerate(lines):
        comment = comment or line.lstrip().startswith("/*")
        body = body and not line.startswith("}")
        if not comment and (body or line.startswith("#define ")):
            for after in dict.fromkeys(_changes(line)):
                changed = "".join([*lines[:at], after, *lines[at + 1 :]])
                here = range(at + 1, at + 2)
                yield Mutant(at + 1, _plain(line), _plain(after), changed, here)
        body = body or line.startswith("{")
        comment = comment and "*/" not in line


def _changes(line: str) -> Iterator[str]:
    for found in TOKENS.finditer(line):
        if found["number"] and not line[: found.start()].endswith(("INT64_C(", "TERMS ")):
            others = _numbers(found["number"])
        else:
            others = OPERATORS.get(found["operator"] or "", [])
        for other in others:
            yield line[: found.start()] + other + line[found.end() :]
    condition = re.match(r"( *(?:\} else )?if )\((.*)\) \{(.*)$", line.rstrip("\n"))
    if condition and not re.search(r" (?:<|<=|>|>=|==|!=) ", condition[2]):
        yield f"{condition[1]}(!({condition[2]})) {{{condition[3]}\n"
    if STATEMENT.match(line) and not DECLARATION.match(line) and "return" not in line:
        yield re.match(" *", line)[0] + ";\n"  # type: ignore[index]


def _numbers(number: str) -> list[str]:
    """Other numbers in place of one."""
    suffix = "".join(re.findall("[fu]$", number))
    plain = number.removesuffix(suffix)
    if plain.startswith("0x"):
        return [f"0x{int(plain, 16) ^ 1:X}{suffix}"]
    if "." in plain:
        value = float(plain)
        known = {0.0: ["1.0"], 1.0: ["0.0", "2.0"]}.get(value, [repr(2.0 * value)])
        return [f"{each}{suffix}" for each in known]
    value_ = int(plain)
    return [f"{each}{suffix}" for each in ({0: [1], 1: [0, 2]}.get(value_, [value_ + 1]))]


def _plain(line: str) -> str:
    """A line without its comment and indentation."""
    return " ".join(re.sub(r"/\*.*?\*/", "", line).split())
