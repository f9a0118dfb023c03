"""The controller node of the ``--controller`` option: a law of the rig, or an application in C."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from can_rig.errors import ExportError
from can_rig.export.controllers import Application, Controller
from can_rig.frames.network import Network
from can_rig.nodes.bus_access import Send
from can_rig.nodes.lockstep.controller_node import ControllerNode
from can_rig.nodes.lockstep.ecu_node import EcuNode
from can_rig.scenario.settings import Scenario
from firmware_model.firmware import Law


@contextmanager
def lockstep_controller(
    scenario: Scenario, network: Network, send: Send, controller: Controller
) -> Iterator[ControllerNode | EcuNode]:
    """The controller node in lockstep; see ``ControllerNode``."""
    if not isinstance(controller, Application):
        yield ControllerNode(scenario, network, send, law=controller)
        return
    ecu = controller.start()
    try:
        yield EcuNode(scenario, network, send, ecu)
    finally:
        ecu.close()


def in_real_time(controller: Controller) -> Law:
    """The control law for a node by the wall clock.

    Raises:
        ExportError: an application, whose receive rules support lockstep only.
    """
    if isinstance(controller, Application):
        raise ExportError("real time: the controller must be python or c")
    return controller
