"""The controllers of a run, selected by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from can_rig.export.application import application
from can_rig.export.choices import SERIAL
from can_rig.export.running.bench_ecu import BenchEcu
from can_rig.export.running.compiled_law import CompiledLaw
from can_rig.export.running.ecu import Ecu, identity
from can_rig.export.running.emulated_ecu import EmulatedBoard, firmware_image
from can_rig.export.running.host_ecu import HostEcu, host_library
from can_rig.export.running.serial_link import serial_ecu
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import PYTHON_LAW, Law


@dataclass(frozen=True)
class Application:
    """A whole controller node in C.

    Attributes:
        start: creates the node.
    """

    start: Callable[[], Ecu]


Controller = Law | Application
"""A control law for a node in Python, or a complete node."""

PYTHON: Final = PYTHON_LAW


def controller_of(name: str, scenario: Scenario) -> Controller:
    """The controller of ``scenario``.

    Args:
        name: a name of ``choices.CONTROLLERS``, or ``choices.SERIAL`` with the device of a port.
        scenario: the run.

    Raises:
        ExportError: no compiler, or a compiler error.
        MissingExtraError: a serial port without pyserial.
    """
    if name == "python":
        return PYTHON_LAW
    if name == "c":
        return CompiledLaw(scenario.design.precision, changes_speed=scenario.drive.is_given)
    if name == "ecu":
        library = host_library(scenario)
        return Application(lambda: HostEcu(library))
    receivers = network_of(scenario).offered
    if name.startswith(SERIAL):
        expected = identity(application(scenario))
        port = name.removeprefix(SERIAL)
        return Application(lambda: serial_ecu(port, expected, scenario.name, receivers))
    board = name.removeprefix("arm:")
    image = firmware_image(scenario, board)
    return Application(lambda: BenchEcu(EmulatedBoard(image, board), receivers))
