"""The control law as compiled C, in place of the compiled Python of `firmware_model`.

Table and state are the same memory: a record of numpy has the layout that C gives its struct.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from can_rig.errors import ExportError
from can_rig.export.law import CHANGE_SPEED, ENTRIES, law_files
from can_rig.export.running.compiler import shared_library
from firmware_model.firmware import ChangeSpeed, Memories, Step
from firmware_model.target.layout import precision_of, state_type
from firmware_model.target.structs import Precision, Record, RecordArray


class CompiledLaw:
    """The entry points of the law in a library; see `firmware_model.firmware.Law`.

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
        path = shared_library(files) if library is None else library
        try:
            loaded = ctypes.CDLL(str(path))
        except OSError as error:
            raise ExportError(f"{path}: cannot be loaded: {error}") from None
        real = ctypes.c_float if precision == "float32" else ctypes.c_double
        functions = [getattr(loaded, f"controller_{name}") for name in ENTRIES]
        for function, inputs in zip(functions, (0, 2, 1), strict=True):
            function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, *(real,) * inputs]
            function.restype = None
        self._start_up, self._step, self._reset = functions
        self._change_speed: Callable[..., None] | None = None
        if changes_speed:
            change = getattr(loaded, f"schedule_{CHANGE_SPEED}")
            change.argtypes, change.restype = [*(ctypes.c_void_p,) * 4, real], None
            self._change_speed = change

    def init(self, table: Record) -> RecordArray:
        """A state at rest, shape (1,)."""
        if precision_of(table) != self._precision:
            raise ExportError(
                f"a table of {precision_of(table)}: must be {self._precision}, as the law is"
            )
        states: RecordArray = np.zeros(1, state_type(self._precision))
        self._start_up(_address(table), _address(states))
        return states

    def step_of(self, tables: RecordArray, states: RecordArray) -> Step:
        """``controller.step``, bound to the table and the state."""
        step, memory = self._step, (_address(tables), _address(states))
        one, other = states["command_1"], states["command_2"]
        estimate, mode, fault_state = (
            states[name] for name in ("fault_estimate", "mode", "fault_state")
        )
        verdict = states["hypotheses"]["verdict"]

        def stepped(
            reference: float, measurement: float
        ) -> tuple[float, float, float, int, int, int]:
            step(*memory, reference, measurement)
            return (
                one.item(),
                other.item(),
                estimate.item(),
                mode.item(),
                fault_state.item(),
                verdict.item(),
            )

        return stepped

    def reset(self, table: Record, state: Record, reference: float) -> None:
        """As ``controller.reset``."""
        self._reset(_address(table), _address(state), reference)

    def change_speed_of(self, memories: Memories) -> ChangeSpeed:
        """``schedule.change_first_speed``, bound to the arrays; the caller must keep the arrays."""
        assert self._change_speed is not None
        return partial(self._change_speed, *map(_address, memories))


def _address(memory: Record) -> int:
    """Where a record lies, or the first of an array of them."""
    return int(memory.__array_interface__["data"][0])
