"""The control law as compiled C, in place of the compiled Python."""

import ctypes
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from can_rig.errors import ExportError
from can_rig.export.compiler import loaded, shared_library
from can_rig.export.law import CHANGE_SPEED, ENTRIES, HEAR, law_files
from firmware_model.firmware import ChangeSpeed, Hear, Memories, Step
from firmware_model.law.layout import State, Table, precision_of
from firmware_model.law.structs import Precision, Records, zeroed


class CompiledLaw:
    """The compiled functions of the control law; see `firmware_model.firmware.Law`.

    Table and state are the same memory: a record of numpy has the layout that C gives its struct.

    Args:
        precision: of its real numbers.
        library: compiled from ``law_files(precision, changes_speed)``; None: compile here.
        changes_speed: whether ``change_speed_of`` is called.

    Raises:
        ExportError: compiling or loading fails.
    """

    def __init__(
        self, precision: Precision, library: Path | None = None, changes_speed: bool = False
    ) -> None:
        self._precision = precision
        files = law_files(precision, changes_speed)
        code = loaded(shared_library(files) if library is None else library)
        real = ctypes.c_float if precision == "float32" else ctypes.c_double

        def function(name: str, memories: int, inputs: int) -> Callable[..., None]:
            found = getattr(code, name)
            found.argtypes = [*(ctypes.c_void_p,) * memories, *(real,) * inputs]
            found.restype = None
            return found  # type: ignore[no-any-return]

        self._start_up, self._step, self._reset = (
            function(f"controller_{name}", 2, inputs)
            for name, inputs in zip(ENTRIES, (0, 2, 1), strict=True)
        )
        self._hear = function(f"further_sensors_{HEAR}", 2, 3)
        if changes_speed:
            self._change_speed = function(f"schedule_{CHANGE_SPEED}", 4, 1)

    def init(self, table: Table) -> Records[State]:
        """A state at rest, shape (1,)."""
        if precision_of(table) != self._precision:
            raise ExportError(
                f"a table of {precision_of(table)}: must be {self._precision}, as the law is"
            )
        states = zeroed(State, self._precision)
        self._start_up(_address(table), _address(states))
        return states

    def step_of(self, tables: Records[Table], states: Records[State]) -> Step:
        """``controller.step``, bound to the table and the state."""
        step, memory = self._step, (_address(tables), _address(states))
        names = ("command_1", "command_2", "fault_estimate", "mode", "fault_state")
        answers = [
            *(states[name].item for name in names),
            states["supervision"]["hypotheses"]["verdict"].item,
        ]

        def stepped(reference: float, measurement: float) -> tuple[Any, ...]:
            step(*memory, reference, measurement)
            return tuple([answer() for answer in answers])

        return stepped

    def hear_of(self, tables: Records[Table], states: Records[State]) -> Hear:
        """``further_sensors.hear``, bound to the table and the state."""
        return partial(self._hear, _address(tables), _address(states))

    def reset(self, table: Table, state: State, reference: float) -> None:
        """As ``controller.reset``."""
        self._reset(_address(table), _address(state), reference)

    def change_speed_of(self, memories: Memories) -> ChangeSpeed:
        """``schedule.change_first_speed``, bound to the arrays; the caller must keep the arrays."""
        return partial(self._change_speed, *map(_address, memories))


def _address(memory: Any) -> int:
    """Where a record lies, or the first of an array of them."""
    return int(memory.__array_interface__["data"][0])
