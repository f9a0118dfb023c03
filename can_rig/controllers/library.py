"""A controller in a C shared library: ``controller.h`` states its functions."""

import ctypes
import math
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import RigError, ScenarioError
from can_rig.scenario.controller_settings import LIBRARY
from can_rig.scenario.plant_settings import flat
from can_rig.scenario.remembered import state_of_file

ABI: Final = 1
HEADER: Final = Path(__file__).with_name("controller.h")
FUNCTIONS: Final = ("controller_abi", "controller_new", "controller_reset", "controller_step",
                    "controller_free")  # fmt: skip
NOT_SAID: Final = -1


class CInputs(ctypes.Structure):
    """``struct controller_inputs``."""

    _fields_ = (
        ("reference", ctypes.c_double),
        ("measurement", ctypes.c_double),
        ("speed_mps", ctypes.c_double),
        ("witness_names", ctypes.POINTER(ctypes.c_char_p)),
        ("witnesses", ctypes.POINTER(ctypes.c_double)),
        ("witness_count", ctypes.c_uint32),
    )


class CAnswer(ctypes.Structure):
    """``struct controller_answer``."""

    _fields_ = (
        ("command_1", ctypes.c_double),
        ("command_2", ctypes.c_double),
        ("fault_estimate", ctypes.c_double),
        ("mode", ctypes.c_int32),
        ("fault_state", ctypes.c_int32),
        ("verdict", ctypes.c_int32),
    )


_LIBRARIES: Final[dict[Path, tuple[tuple[object, ...], ctypes.CDLL]]] = {}
"""Every library of this process, with the state of its file."""


def _loaded(path: Path) -> ctypes.CDLL:
    """The library at ``path`` as the file is now; the linker keeps the first one of a path.

    Raises:
        OSError: not a library.
    """
    state = tuple(state_of_file(str(path)))
    if path not in _LIBRARIES:
        _LIBRARIES[path] = state, ctypes.CDLL(str(path))
    elif _LIBRARIES[path][0] != state:
        with TemporaryDirectory() as folder:
            _LIBRARIES[path] = state, ctypes.CDLL(shutil.copy(path, folder))
    return _LIBRARIES[path][1]


class LibraryController:
    """The controller in a shared library; see ``protocol.Controller``.

    Raises:
        ScenarioError: no such library, a missing function, another version, or no controller.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        chosen = setup.scenario.controller
        path = Path(chosen.kind.removeprefix(LIBRARY))
        where = f"controller.kind = {chosen.kind!r}"
        if not path.is_file():
            raise ScenarioError(f"{where}: there is no such file")
        try:
            library: Any = _loaded(path.resolve())
        except OSError as error:
            raise ScenarioError(
                f"{where}: must be a shared library, as of cc -shared -fPIC: {error}"
            ) from None
        missing = [name for name in FUNCTIONS if not hasattr(library, name)]
        if missing:
            raise ScenarioError(
                f"{where}: must have the functions of {HEADER.name}; {', '.join(missing)} missing"
            )
        if (found := library.controller_abi()) != ABI:
            raise ScenarioError(f"{where}: controller_abi() is {found}: must be {ABI}")
        library.controller_new.restype = ctypes.c_void_p
        library.controller_reset.restype = library.controller_free.restype = None
        parameters = _parameters(where, dict(flat(chosen.parameters)))
        names = (ctypes.c_char_p * len(parameters))(*(name.encode() for name in parameters))
        values = (ctypes.c_double * len(parameters))(*parameters.values())
        made = library.controller_new(
            ctypes.c_double(setup.tick_s), ctypes.c_uint32(len(parameters)), names, values
        )
        if not made:
            raise ScenarioError(f"{where}: controller_new answers NULL for these parameters")
        self._library, self._controller = library, ctypes.c_void_p(made)
        self._inputs, self._answer = CInputs(), CAnswer()
        self._names: tuple[str, ...] = ()
        self._arguments = self._controller, ctypes.byref(self._inputs), ctypes.byref(self._answer)

    def reset(self, reference: float) -> None:
        """See ``protocol.Controller``."""
        self._library.controller_reset(self._controller, ctypes.c_double(reference))

    def step(self, inputs: Inputs) -> Answer:
        """See ``protocol.Controller``.

        Raises:
            RigError: the library reports a failure.
        """
        given, answer = self._inputs, self._answer
        given.reference, given.measurement, given.speed_mps, _ = inputs
        if inputs.witnesses:
            self._give(tuple(inputs.witnesses), tuple(inputs.witnesses.values()))
        answer.fault_estimate = math.nan
        answer.mode = answer.fault_state = answer.verdict = NOT_SAID
        status = self._library.controller_step(*self._arguments)
        if status:
            raise RigError(f"controller_step answers {status}: must be 0")
        return Answer(
            answer.command_1,
            answer.command_2,
            None if math.isnan(answer.fault_estimate) else answer.fault_estimate,
            *(None if code == NOT_SAID else code
              for code in (answer.mode, answer.fault_state, answer.verdict)),
        )  # fmt: skip

    def _give(self, names: tuple[str, ...], values: Sequence[float]) -> None:
        if names != self._names:
            self._names = names
            self._kept = (ctypes.c_char_p * len(names))(*(name.encode() for name in names))
            self._values = (ctypes.c_double * len(names))()
            self._inputs.witness_names, self._inputs.witnesses = self._kept, self._values
            self._inputs.witness_count = len(names)
        self._values[:] = list(values)

    def __del__(self) -> None:
        if hasattr(self, "_controller"):
            self._library.controller_free(self._controller)


def _parameters(where: str, given: dict[str, Any]) -> dict[str, float]:
    for name, value in given.items():
        if not isinstance(value, bool | int | float):
            raise ScenarioError(
                f"{where}: controller.parameters.{name} = {value!r}: must be a number in C"
            )
    return {name: float(value) for name, value in given.items()}
