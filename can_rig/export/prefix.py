"""Other names for an export, so that several exports link into one program."""

import re
from collections.abc import Mapping
from typing import Final

from can_rig.errors import ExportError

COMMENT_OR_TEXT: Final = re.compile(r'(/\*.*?\*/|"(?:[^"\\\n]|\\.)*")', re.S)
TAG: Final = re.compile(r"^(?:struct|enum) (\w+) \{", re.M)
ENUM: Final = re.compile(r"^enum (?:\w+ )?\{(.*?)^\};", re.M | re.S)
NAMED: Final = (
    re.compile(r"^#define (\w+)", re.M),
    re.compile(r"^typedef .*?(\w+);", re.M),
    re.compile(r"^(?:extern )?const (?:struct )?\w+ (\w+)(?:\[\w*\])?(?: =|;)", re.M),
    re.compile(r"^(?:static inline )?(?!static|typedef|return)\w[\w *]*?\b(\w+)\(", re.M),
)
"""Macros, types, objects and functions, as exported files declare them."""


def with_prefix(texts: Mapping[str, str], prefix: str) -> dict[str, str]:
    """The files with ``prefix`` and ``_`` before each name at file scope, macros in capitals.

    Members, parameters and static functions keep their names.

    Args:
        texts: text by file name.
        prefix: lower-case letters, digits and ``_``, first a letter.

    Raises:
        ExportError: another prefix.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", prefix):
        raise ExportError(
            f"--prefix {prefix!r}: must have lower-case letters, digits and _, first a letter"
        )
    code = {name: text for name, text in texts.items() if name.endswith((".c", ".h"))}
    plain = "\n".join(COMMENT_OR_TEXT.sub("", text) for text in code.values())
    tags = "|".join({*TAG.findall(plain)})
    found = {name for pattern in NAMED for name in pattern.findall(plain)} - {"main"}
    found |= {name for body in ENUM.findall(plain) for name in re.findall(r"^ +(\w+)", body, re.M)}
    names = re.compile(rf"\b(?:(struct|enum) ({tags})|({'|'.join(sorted(found))}))\b")

    def renamed(match: re.Match[str]) -> str:
        keyword, tag, name = match.groups()
        if keyword:
            return f"{keyword} {prefix}_{tag}"
        return f"{prefix.upper() if name.isupper() else prefix}_{name}"

    def part(text: str) -> str:
        if text.startswith('"'):
            return text
        in_comment = text.startswith("/*")  # where "real" is a word
        return names.sub(lambda m: m[0] if in_comment and "_" not in m[0] else renamed(m), text)

    return {
        **texts,
        **{name: "".join(map(part, COMMENT_OR_TEXT.split(text))) for name, text in code.items()},
    }
