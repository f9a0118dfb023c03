"""What can run as the controller, by the name that a command gives it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from can_rig.export.running.compiled_law import CompiledLaw
from can_rig.export.running.ecu import Ecu
from can_rig.export.running.emulated_ecu import EmulatedEcu, firmware_image
from can_rig.export.running.host_ecu import HostEcu, host_library
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Law


@dataclass(frozen=True)
class Application:
    """A whole controller node in C.

    Attributes:
        start: starts it.
    """

    start: Callable[[], Ecu]


Controller = Law | Application
"""What runs as the control law in a node of ours, or a node of its own."""

PYTHON: Final = PYTHON_LAW


def controller_of(name: str, scenario: Scenario) -> Controller:
    """What runs as the controller of ``scenario``, by one of ``choices.CONTROLLERS``.

    Raises:
        ExportError: there is no compiler, or it refuses.
    """
    if name == "python":
        return PYTHON_LAW
    if name == "c":
        return CompiledLaw(scenario.design.precision)
    if name == "ecu":
        library = host_library(scenario)
        return Application(lambda: HostEcu(library))
    board = name.removeprefix("arm:")
    image = firmware_image(scenario, board)
    return Application(lambda: EmulatedEcu(image, board))
