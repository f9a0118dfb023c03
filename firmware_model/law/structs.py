"""Declaration of the memory on the target: structs of fields with unit and meaning.

Each module of this room declares two structs, ``CONSTANTS`` and ``STATE``; ``layout`` nests the
structs. A struct becomes a numpy record type with the offsets that a C compiler gives it.

Units are those of the plant: ``u1`` and ``u2`` of the two commands (N m and N for the car), ``y``
of the measurement (m/s²), ``tick`` for a sampling period, ``1`` for a pure number.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

MAX_SECTIONS = 8  # of each filter: order 16
MAX_LATENCY_TICKS = 64
MAX_SHOWN_TICKS = 2 * MAX_LATENCY_TICKS  # of the bus, and of a dead time

Precision = Literal["float64", "float32"]
FloatArray = NDArray[np.float64]
Record = Any  # one numpy record: numba and mypy share no type name for records
RecordArray = Any  # an array of them, shape (n,)


@dataclass(frozen=True)
class Field:
    """One member of a struct.

    Attributes:
        name: its name, unique in its struct.
        unit: unit of the value or of the array's elements; see this module.
        meaning: what it stands for.
        kind: a real number in the precision of the table, a 32-bit integer, or a struct.
        shape: () for one value, else an array's.
    """

    name: str
    unit: str
    meaning: str
    kind: Literal["real", "int32"] | tuple[Field, ...] = "real"
    shape: tuple[int, ...] = ()


Struct = tuple[Field, ...]


@cache
def struct_type(struct: Struct, precision: Precision) -> np.dtype[np.void]:
    """The aligned layout of ``struct`` with its real numbers in ``precision``."""

    def type_of(field: Field) -> np.dtype[Any]:
        if isinstance(field.kind, tuple):
            return struct_type(field.kind, precision)
        return np.dtype(precision if field.kind == "real" else np.int32)

    return np.dtype([(field.name, type_of(field), field.shape) for field in struct], align=True)


@cache
def record_type(struct: Struct, precision: Precision) -> np.dtype[np.void]:
    """``struct_type`` with members (nested members too) readable and writable as attributes."""
    return np.dtype((np.record, struct_type(struct, precision)))
