"""The table and the state are C structs, and every member says what it is."""

import ctypes
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from firmware_model.law.layout import State, Table, precision_of, state_type, table_type
from firmware_model.law.structs import Field, Struct, fields_of, zeroed

UNITS = {"1", "tick", "y", "u1", "u2", "command", "output", "input", "m", "s", "rad"}
TYPES = {"table": (Table, table_type), "state": (State, state_type)}
PRECISIONS = {"float32": ctypes.c_float, "float64": ctypes.c_double}


def fields(struct: type[Struct]) -> Iterator[Field]:
    """Every field, those of nested structs included."""
    for field in fields_of(struct):
        yield field
        if isinstance(field.kind, type):
            yield from fields(field.kind)


def c_struct(struct: type[Struct], real: Any) -> type[ctypes.Structure]:
    """The struct as ctypes lays it out: by the natural alignment of its members."""
    members = []
    for field in fields_of(struct):
        kind: Any = real if field.kind == "real" else ctypes.c_int32
        if isinstance(field.kind, type):
            kind = c_struct(field.kind, real)
        for size in reversed(field.shape):
            kind = kind * size
        members.append((field.name, kind))
    return type("CStruct", (ctypes.Structure,), {"_fields_": members})


def compare(layout: np.dtype[Any], struct: type[ctypes.Structure]) -> None:
    assert layout.itemsize == ctypes.sizeof(struct)
    assert list(layout.names or ()) == [name for name, *_ in struct._fields_]
    for name, kind, *_ in struct._fields_:
        member, offset = layout.fields[name][:2]  # type: ignore[index]
        assert offset == getattr(struct, name).offset, name
        assert member.itemsize == ctypes.sizeof(kind), name
        if member.base.names:
            compare(member.base, getattr(kind, "_type_", kind))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("which", TYPES)
def test_members_lie_where_a_c_compiler_puts_them(which, precision):
    struct, type_of = TYPES[which]
    compare(type_of(precision), c_struct(struct, PRECISIONS[precision]))


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("which", TYPES)
def test_there_are_numbers_of_the_precision_and_32_bit_integers_alone(which, precision):
    def leaves(layout: np.dtype[Any]) -> Iterator[np.dtype[Any]]:
        for name in layout.names or ():
            member = layout[name]
            yield from leaves(member.base) if member.base.names else [member.base]

    assert set(leaves(TYPES[which][1](precision))) == {np.dtype(precision), np.dtype(np.int32)}


@pytest.mark.parametrize("which", TYPES)
def test_every_field_says_its_unit_and_its_meaning(which):
    for field in fields(TYPES[which][0]):
        assert {unit.removesuffix("²") for unit in field.unit.split("/")} <= UNITS, field
        assert field.meaning, field
        assert field.meaning == field.meaning.strip(" ."), field


@pytest.mark.parametrize("which", TYPES)
def test_no_field_hides_an_attribute_of_a_record(which):
    """Interpreted, fields are attributes: ``size`` or ``real`` would be something else."""
    assert not {field.name for field in fields(TYPES[which][0])} & set(dir(np.record))


def test_a_nested_field_is_written_in_place():
    state = zeroed(State, "float64")[0]
    state.reference_shaper.shaped = 2.0
    state.estimator.channel_1.accumulators[1, 0] = 3.0
    assert state["reference_shaper"]["shaped"] == 2.0
    assert state["estimator"]["channel_1"]["accumulators"][1, 0] == 3.0


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_table_says_its_precision(precision):
    assert precision_of(zeroed(Table, precision)[0]) == precision
