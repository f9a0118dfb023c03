"""The controller of a run by its name on the command line."""

from can_rig.controllers.filters_law import filters_law
from can_rig.controllers.library import LibraryController
from can_rig.controllers.our_law import PYTHON
from can_rig.controllers.peer import Peer, class_of
from can_rig.controllers.protocol import InNode, NodeController, Supplied
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import ExportError, require
from can_rig.frames.network import Network
from can_rig.scenario.controller_settings import FILTERS
from can_rig.scenario.settings import Scenario


def peer_of(scenario: Scenario) -> Peer:
    """A new controller of ``scenario``, of another kind than the rig's own law, at rest.

    Raises:
        ScenarioError: the controller cannot be made.
        MissingExtraError: an FMU without FMPy.
    """
    setup, chosen = ControllerSetup(scenario), scenario.controller
    if chosen.kind == FILTERS:
        return Peer(setup, lambda: filters_law(setup))
    if chosen.is_library:
        return Peer(setup, lambda: LibraryController(setup))
    if chosen.is_fmu:
        require("fmpy", "fmu")
        from can_rig.controllers.fmu_controller import FmuController  # noqa: PLC0415 (slow)

        return Peer(setup, lambda: FmuController(setup))
    return Peer(setup, class_of(setup))


def _start(scenario: Scenario, _network: Network) -> NodeController:
    return peer_of(scenario)


PEER = InNode(_start, without_frames=True)
"""The controller of the scenario, of another kind than the rig's own law."""


def controller_of(name: str, scenario: Scenario) -> Supplied:
    """The controller of ``scenario``.

    Args:
        name: a name of ``CONTROLLERS``, or ``SERIAL`` with the device of a port.
        scenario: the run.

    Raises:
        ExportError: no compiler, or a compiler error.
        MissingExtraError: a serial port without pyserial.
    """
    if not scenario.controller.is_ours:
        if name != "python":
            raise ExportError(
                f"--controller {name}: must be left out for controller.kind = "
                f"{scenario.controller.kind!r}, which runs as it is"
            )
        return PEER
    if name == "python":
        return PYTHON
    from can_rig.controllers.ecus import in_c  # noqa: PLC0415 (the translator to C takes 0.1 s)

    return in_c(name, scenario)
