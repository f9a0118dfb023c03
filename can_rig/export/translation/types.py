"""The types of the subset: real numbers, integers, truth values, structs and arrays of fixed size.

A real number has the precision of the constant table. A literal lacks a precision until ``real``
sets it: numba would assume double precision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from firmware_model.target.structs import Struct


@dataclass(frozen=True)
class Scalar:
    """A scalar type; ``c`` is its name in C."""

    name: str
    c: str


REAL: Final = Scalar("real", "real")
INT: Final = Scalar("int", "int32_t")
BOOL: Final = Scalar("bool", "bool")
LITERAL: Final = Scalar("literal", "")


@dataclass(frozen=True, eq=False)
class CStruct:
    """A struct of the target's memory.

    Attributes:
        module: the declaring module.
        tag: its name in C.
        fields: its members.
        line: line of the declaration.
    """

    module: str
    tag: str
    fields: Struct
    line: int


@dataclass(frozen=True)
class Record:
    """A struct, passed by address."""

    struct: CStruct


@dataclass(frozen=True)
class Array:
    """An array of fixed size, which functions get by its address."""

    element: Scalar
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Answers:
    """Several values that a function returns, by name; in C a struct."""

    tag: str
    items: tuple[tuple[str, Scalar], ...]


Type = Scalar | Record | Array | Answers | None
"""None: no result."""


def in_words(type_: Type) -> str:
    """The type as a message names it."""
    match type_:
        case None:
            return "nothing"
        case Scalar():
            return {"real": "a real number", "int": "an integer", "bool": "a truth value"}.get(
                type_.name, "a literal without a precision"
            )
        case Record():
            return f"the struct {type_.struct.tag}"
        case Array():
            return f"an array of shape {type_.shape}"
        case Answers():
            return f"{len(type_.items)} values"
