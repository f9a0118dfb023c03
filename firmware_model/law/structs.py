"""Declaration of the memory on the target: structs of fields with unit and meaning.

Each module of this room declares two structs, ``Constants`` and ``State``; ``layout`` nests the
structs. A declaration is the one source of the NumPy layout, with the offsets that a C compiler
gives it, of what a type checker sees, and of the struct in C.

Units are those of the plant: ``u1`` and ``u2`` of the two commands (N m and N for the car), ``y``
of the measurement (m/s²), ``tick`` for a sampling period, ``1`` for a pure number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
    Literal,
    Self,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    overload,
)

import numpy as np
from numpy.typing import DTypeLike, NDArray

MAX_SECTIONS = 8  # of each filter: order 16
MAX_LATENCY_TICKS = 64
MAX_COUNTED = 1_000_000  # ticks, samples
MAX_SHOWN_TICKS = 2 * MAX_LATENCY_TICKS  # of the bus, and of a dead time

Precision = Literal["float64", "float32"]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

Function = TypeVar("Function", bound=Callable[..., object])


def _cached(function: Function) -> Function:
    """``functools.cache``, with the types of the arguments still checked."""
    return cast(Function, cache(function))


class Struct:
    """Base of the declarations: each field has a type, a unit, a meaning and, an array, a shape.

    A field is ``name: Annotated[type, unit, meaning]`` with the type ``float`` for a real number in
    the precision of the table, ``int`` for a 32-bit integer, or another declaration; an array of
    real numbers is ``Annotated[FloatArray, unit, meaning, shape]``, and an array of n structs
    ``Annotated[Records[Row], unit, meaning, (n,)]``. An integer of a table is
    ``Annotated[int, unit, meaning, (least, largest)]``, from which the translator to C proves the
    indices. No instance is ever made: a record of ``record_type`` has these fields, and the class
    is its type for a type checker.
    """

    if TYPE_CHECKING:  # what every record of NumPy has

        @property
        def dtype(self) -> np.dtype[np.void]:
            """The layout."""

        @property
        def nbytes(self) -> int:
            """The size in bytes."""

        @property
        def __array_interface__(self) -> dict[str, Any]:
            """The address and the layout."""

        def copy(self) -> Self:
            """An independent record."""

        def tobytes(self) -> bytes:
            """The memory, with its padding."""

        def __getitem__(self, name: str) -> Any:
            """The field called ``name``."""

        def __setitem__(self, name: str, value: object) -> None:
            """Write the field called ``name``."""


Of = TypeVar("Of", bound=Struct)

if TYPE_CHECKING:

    class Records(Generic[Of]):
        """An array of records of a declaration, shape (n,), as a type checker sees the array."""

        dtype: np.dtype[np.void]
        itemsize: int
        flags: Any

        def __len__(self) -> int:
            """How many."""

        def __iter__(self) -> Iterator[Of]:
            """Each record, in the memory of the array."""

        @overload
        def __getitem__(self, at: int) -> Of: ...
        @overload
        def __getitem__(self, at: str) -> Any: ...
        def __getitem__(self, at: int | str) -> Any:
            """One record, or a field of all, in the memory of the array."""

        def __setitem__(self, at: int | slice | str, record: object) -> None:
            """Overwrite a record, or a field of all."""

        def copy(self) -> Records[Of]:
            """Independent records."""

        def view(self, kind: DTypeLike) -> NDArray[Any]:
            """The memory of the array as numbers of one kind."""

        def tobytes(self) -> bytes:
            """The memory, with its padding."""

        @property
        def __array_interface__(self) -> dict[str, Any]:
            """The address and the layout."""

else:
    Records = np.ndarray


@dataclass(frozen=True)
class Field:
    """One member of a struct.

    Attributes:
        name: its name, unique in its struct.
        unit: unit of the value or of the array's elements; see this module.
        meaning: what it stands for.
        kind: a real number in the precision of the table, a 32-bit integer, or a struct.
        shape: () for one value, else an array's.
        range: the least and the largest value of an integer; None: as assigned.
    """

    name: str
    unit: str
    meaning: str
    kind: Literal["real", "int32"] | type[Struct] = "real"
    shape: tuple[int, ...] = ()
    range: tuple[int, int] | None = None

    @property
    def paths(self) -> list[tuple[str | int, ...]]:
        """The path of each of its structs: name, and index in an array."""
        return [(self.name, i) for i in range(*self.shape)] if self.shape else [(self.name,)]


@_cached
def fields_of(struct: type[Struct]) -> tuple[Field, ...]:
    """The fields of a declaration, inherited ones first.

    Raises:
        TypeError: a field has no unit and meaning, or a type that no target has.
    """
    hints = get_type_hints(struct, include_extras=True)
    return tuple(_field(struct, name, hint) for name, hint in hints.items())


def _field(struct: type[Struct], name: str, hint: Any) -> Field:
    said: tuple[Any, ...] = getattr(hint, "__metadata__", ())
    kinds: dict[object, Literal["real", "int32"]] = {
        float: "real", int: "int32", FloatArray: "real"
    }  # fmt: skip
    match getattr(hint, "__origin__", None), said:
        case type() as kind, (str(unit), str(meaning)) if issubclass(kind, Struct):
            return Field(name, unit, meaning, kind)
        case kind, (str(unit), str(meaning)) if kind in (float, int):
            return Field(name, unit, meaning, kinds[kind])
        case kind, (str(unit), str(meaning), (int(least), int(largest))) if (
            kind is int and least <= largest
        ):
            return Field(name, unit, meaning, "int32", range=(least, largest))
        case kind, (str(unit), str(meaning), (int(n),)) if n > 0 and (row := _element(kind)):
            return Field(name, unit, meaning, row, (n,))
        case kind, (str(unit), str(meaning), tuple(shape)) if kind == FloatArray and all(
            isinstance(each, int) and each > 0 for each in shape
        ):
            return Field(name, unit, meaning, kinds[kind], shape)
    raise TypeError(
        f"{struct.__module__}.{struct.__qualname__}.{name}: must be Annotated[float, unit, "
        "meaning], of an int or a Struct likewise, Annotated[int, unit, meaning, "
        "(least, largest)], Annotated[FloatArray, unit, meaning, shape], or "
        "Annotated[Records[a Struct], unit, meaning, (n,)]"
    )


def _element(kind: Any) -> type[Struct] | None:
    """The struct of an array of structs."""
    element = next(iter(get_args(kind)), None) if get_origin(kind) is Records else None
    return element if isinstance(element, type) and issubclass(element, Struct) else None


@_cached
def struct_type(struct: type[Struct], precision: Precision) -> np.dtype[np.void]:
    """The aligned layout of ``struct`` with its real numbers in ``precision``."""

    def type_of(field: Field) -> np.dtype[Any]:
        if isinstance(field.kind, type):
            return struct_type(field.kind, precision)
        return np.dtype(precision if field.kind == "real" else np.int32)

    return np.dtype(
        [(field.name, type_of(field), field.shape) for field in fields_of(struct)], align=True
    )


@_cached
def record_type(struct: type[Struct], precision: Precision) -> np.dtype[np.void]:
    """``struct_type`` with members (nested members too) readable and writable as attributes."""
    return np.dtype((np.record, struct_type(struct, precision)))


def zeroed(struct: type[Of], precision: Precision, n: int = 1) -> Records[Of]:
    """``n`` records of zeros, which read and write as ``record_type`` says."""
    return cast("Records[Of]", np.zeros(n, record_type(struct, precision)))


def copied(record: Of) -> Records[Of]:
    """A copy of one record, in an array."""
    return cast("Records[Of]", np.array([record], record.dtype))


def leaves(
    struct: type[Struct], dtype: np.dtype[np.void], at: int = 0
) -> Iterator[tuple[tuple[str | int, ...], int, np.dtype[Any]]]:
    """Path, offset and layout of each number, and each array of numbers, of a struct."""
    assert dtype.fields is not None
    for field in fields_of(struct):
        kind, offset, *_ = dtype.fields[field.name]
        if isinstance(field.kind, type):
            for i, own in enumerate(field.paths):
                first = at + offset + i * kind.base.itemsize
                for path, inner, numbers in leaves(field.kind, kind.base, first):
                    yield (*own, *path), inner, numbers
        else:
            yield (field.name,), at + offset, kind


@_cached
def ranges_of(struct: type[Struct]) -> dict[tuple[str | int, ...], tuple[int, int]]:
    """The declared range of each integer, nested ones too, by path."""
    found: dict[tuple[str | int, ...], tuple[int, int]] = {}
    for field in fields_of(struct):
        if isinstance(field.kind, type):
            inner = ranges_of(field.kind).items()
            found |= {(*own, *path): each for own in field.paths for path, each in inner}
        elif field.range is not None:
            found[field.name,] = field.range
    return found


def values(struct: type[Struct], record: Any) -> bytes:
    """The numbers of a record, low byte first, without padding."""
    found = b""
    for path, *_ in leaves(struct, record.dtype):
        value = record
        for each in path:
            value = value[each]
        found += as_bytes(np.asarray(value))
    return found


def as_bytes(numbers: Any) -> bytes:
    """Integers and real numbers; every not-a-number is infinity plus one bit, as in C."""
    plain = np.array(numbers).astype(numbers.dtype.newbyteorder("<"))
    if plain.dtype.kind == "f":
        bits = plain.reshape(-1).view(f"<u{plain.dtype.itemsize}")
        bits[np.isnan(plain.reshape(-1))] = np.array(np.inf, plain.dtype).view(bits.dtype) + 1
    return plain.tobytes()
