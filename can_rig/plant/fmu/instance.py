"""An FMU in this process: unpacked, loaded, at rest, and gone with the object that holds it."""

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
    """An FMU that does not do as FMI says, or says itself that something is wrong."""


class Instance:
    """An FMU at rest at 0 s, its inputs 0, its parameters set.

    It has a folder and a library of its own, so no two share what an FMU keeps in static memory.

    Raises:
        FmuError: it cannot be loaded, or does not start.
    """

    def __init__(self, description: Description) -> None:
        self._said = _Said()
        self.description = description
        folder = mkdtemp(prefix="can-rig-fmu-")
        # Of multiprocessing, because a forked node leaves without Python's own atexit.
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
        """The value of now; inside ``explained``."""
        return float(getattr(self.fmu, f"get{variable.access}")([variable.reference])[0])

    @contextmanager
    def explained(self, hidden: str = "") -> Iterator[None]:
        """What fails in here is an ``FmuError``, with what the FMU itself says about it."""
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
        """Of FMI 2 and 3, whose last argument is the message."""
        message = arguments[-1]
        if isinstance(message, bytes):
            self.last = " ".join(message.decode(errors="replace").split())


def _free(fmu: Any) -> None:
    with suppress(Exception):  # it has nothing to say any more
        fmu.freeInstance()


@contextmanager
def _working_directory() -> Iterator[None]:
    """FMPy goes to the folder of a library, and stays there if that cannot be loaded."""
    here = Path.cwd()
    try:
        yield
    finally:
        os.chdir(here)
