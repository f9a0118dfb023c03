"""An FMU as a controller: inputs set, one communication step of a tick, outputs read."""

import math
from typing import Final

from can_rig.controllers.protocol import Answer, Inputs
from can_rig.controllers.setup import ControllerSetup
from can_rig.errors import RigError, ScenarioError
from can_rig.fmu.file import Request, describe
from can_rig.fmu.instance import FmuError, Instance, stepping

INPUTS: Final = ("reference", "measurement")
COMMANDS: Final = ("command_1", "command_2")
SAID: Final = ("fault_estimate", "mode", "fault_state", "verdict")


class FmuController:
    """See ``protocol.Controller``.

    ``controller.variables`` names the FMU's variables: reference, measurement and both commands,
    ``speed_mps`` and further witnesses as inputs, and the other parts of an answer.

    Raises:
        ScenarioError: no FMU, a failing start, or a name unknown to the FMU.
    """

    def __init__(self, setup: ControllerSetup) -> None:
        chosen = setup.scenario.controller
        for key in (*INPUTS, *COMMANDS):
            if not chosen.variables.get(key):
                raise ScenarioError(
                    f"controller.variables.{key}: must be set, as the name of the FMU's variable"
                )
        outputs = [key for key in (*COMMANDS, *SAID) if key in chosen.variables]
        self._further = [key for key in chosen.variables if key not in (*INPUTS, *outputs)]
        self._description = describe(
            Request(
                "controller",
                chosen.kind,
                chosen.variables,
                chosen.parameters,
                inputs=(*INPUTS, *self._further),
                outputs=outputs,
                codes=SAID[1:],
            )
        )
        self._where = f"controller.kind = {chosen.kind!r}"
        self._tick_s = setup.tick_s
        self._started = False
        self._start()

    def _start(self) -> None:
        if self._started:
            return
        try:
            self._instance = Instance(self._description)
            with self._instance.explained():
                self._stepping = stepping(self._instance)
        except FmuError as error:
            raise ScenarioError(f"{self._where}: does not start: {error}") from None
        self._started = True

    def reset(self, reference: float) -> None:
        """A new instance, at rest: an FMU has no steady state at another reference."""
        self._start()

    def step(self, inputs: Inputs) -> Answer:
        """See ``protocol.Controller``.

        Raises:
            RigError: the FMU fails.
        """
        known = {"speed_mps": inputs.speed_mps, **inputs.witnesses}
        values = [*inputs[:2], *(known.get(key, math.nan) for key in self._further)]
        try:
            with self._instance.explained():
                self._stepping.step(self._tick_s, values)
                said = {
                    key: self._instance.read(variable)
                    for key, variable in self._description.outputs.items()
                }
        except FmuError as error:
            raise RigError(str(error)) from None
        self._started = False  # a reset needs a new instance
        codes = [None if key not in said else int(said[key]) for key in SAID[1:]]
        one, two = (said[key] for key in COMMANDS)
        mode, fault_state, verdict = codes
        return Answer(one, two, said.get(SAID[0]), mode, fault_state, verdict)
