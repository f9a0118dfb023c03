"""The controller of a run by its name on the command line."""

from __future__ import annotations

from can_rig.controllers import SERIAL
from can_rig.controllers.compiled_law import CompiledLaw
from can_rig.controllers.ecus import (
    BenchEcu,
    EmulatedBoard,
    HostEcu,
    host_library,
    serial_ecu,
)
from can_rig.controllers.our_law import PYTHON, in_node
from can_rig.controllers.protocol import Supplied, WholeNode
from can_rig.export.application import application, identity
from can_rig.export.boards import firmware_image
from can_rig.scenario.build import network_of
from can_rig.scenario.settings import Scenario


def controller_of(name: str, scenario: Scenario) -> Supplied:
    """The controller of ``scenario``.

    Args:
        name: a name of ``CONTROLLERS``, or ``SERIAL`` with the device of a port.
        scenario: the run.

    Raises:
        ExportError: no compiler, or a compiler error.
        MissingExtraError: a serial port without pyserial.
    """
    if name == "python":
        return PYTHON
    if name == "c":
        return in_node(
            CompiledLaw(scenario.design.precision, changes_speed=scenario.drive.is_given)
        )
    if name == "ecu":
        library = host_library(scenario)
        return WholeNode(lambda: HostEcu(library))
    receivers = network_of(scenario).offered
    if name.startswith(SERIAL):
        expected = identity(application(scenario))
        port = name.removeprefix(SERIAL)
        return WholeNode(lambda: serial_ecu(port, expected, scenario.name, receivers))
    board = name.removeprefix("arm:")
    image = firmware_image(scenario, board)
    return WholeNode(lambda: BenchEcu(EmulatedBoard(image, board), receivers))
