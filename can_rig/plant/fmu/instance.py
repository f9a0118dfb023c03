"""An FMU in this process: unpacked, loaded, at rest, removed together with its ``Instance``."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager, suppress
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

import fmpy
from fmpy.simulation import (
    apply_start_values,
    settable_in_initialization_mode,
    settable_in_instantiated,
)

from can_rig.errors import one_line
from can_rig.plant.fmu.description import Description, Variable
from can_rig.plant.fmu.unpacking import unpack

if TYPE_CHECKING:
    from collections.abc import Iterator


class FmuError(Exception):
    """An FMU that violates FMI, or reports an error."""


class Instance:
    """An FMU at rest at 0 s, its inputs 0, its parameters set.

    Each instance has a folder and a library, so two instances never share an FMU's static memory.

    Raises:
        FmuError: a failure while loading or starting the FMU.
    """

    def __init__(self, description: Description) -> None:
        self._said = _Said()
        self.description = description
        folder = mkdtemp(prefix="can-rig-fmu-")
        # multiprocessing's Finalize, because a forked node ends without running Python's atexit.
        Finalize(self, shutil.rmtree, (folder, True), exitpriority=0)
        with _working_directory(), self.explained(hidden=f"{folder}{os.sep}"):
            unpack(description.path, Path(folder))
            self.fmu = fmpy.simulation.instantiate_fmu(
                folder,
                description.model,
                "CoSimulation" if description.co_simulation else "ModelExchange",
                logger=self._said.hear,
            )
            Finalize(self, _free, (self.fmu,), exitpriority=1)
            self._start()

    def _start(self) -> None:
        fmu, model, parameters = self.fmu, self.description.model, self.description.parameters
        if model.fmiVersion.startswith("2"):
            fmu.setupExperiment(startTime=0.0)
        left = apply_start_values(fmu, model, parameters, settable_in_instantiated)
        fmu.enterInitializationMode()
        apply_start_values(fmu, model, left, settable_in_initialization_mode)
        self.write_inputs(0.0, 0.0)
        fmu.exitInitializationMode()

    def write_inputs(self, first: float, second: float) -> None:
        """Set both inputs; inside ``explained``."""
        for variable, value in zip(self.description.inputs, (first, second), strict=True):
            getattr(self.fmu, f"set{variable.access}")([variable.reference], [value])

    def read(self, variable: Variable) -> float:
        """The present value; inside ``explained``."""
        return float(getattr(self.fmu, f"get{variable.access}")([variable.reference])[0])

    @contextmanager
    def explained(self, hidden: str = "") -> Iterator[None]:
        """Turn every failure in this context into an ``FmuError`` with the FMU's last message."""
        try:
            yield
        except Exception as error:
            reason = one_line(error).replace(hidden, "").rstrip(".")
            said = self._said.last
            raise FmuError(f"{reason}; the FMU says: {said}" if said else reason) from None


class _Said:
    """The last message of an FMU."""

    def __init__(self) -> None:
        self.last = ""

    def hear(self, *arguments: Any) -> None:
        """Callback of FMI 2 and 3; the last argument is the message."""
        message = arguments[-1]
        if isinstance(message, bytes):
            self.last = " ".join(message.decode(errors="replace").split())


def _free(fmu: Any) -> None:
    with suppress(Exception):  # the FMU has no further message
        fmu.freeInstance()


@contextmanager
def _working_directory() -> Iterator[None]:
    """FMPy changes to a library's folder, and stays there after a failed load."""
    here = Path.cwd()
    try:
        yield
    finally:
        os.chdir(here)
