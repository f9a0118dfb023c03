"""An FMU as a plant class."""

from __future__ import annotations

from can_rig.errors import ScenarioError
from can_rig.fmu.file import Request, describe
from can_rig.fmu.instance import FmuError, Instance, stepping
from can_rig.plant.disturbances import AT, CALM, inputs_of
from can_rig.scenario.driving import WORLD_COLUMNS
from can_rig.scenario.plant_settings import SIGNALS, PlantSettings
from firmware_model.law.structs import FloatArray


class FmuPlant:
    """The FMU of ``plant.kind``; see ``plant.protocol.ReportingPlant`` and ``PlantInTheWorld``.

    Raises:
        ScenarioError: no FMU, a failing start, or a name unknown to the FMU.
    """

    def __init__(self, settings: PlantSettings) -> None:
        pushed = inputs_of(settings)
        self._description = describe(
            Request(
                "plant",
                settings.kind,
                settings.variables,
                settings.parameters,
                inputs=(*SIGNALS[:2], *pushed),
                outputs=SIGNALS[2:],
                fmi_type=settings.fmi_type,
                at_rest=dict(zip(WORLD_COLUMNS, CALM.tolist(), strict=True)),
            )
        )
        self._columns = [AT[each] for each in pushed]
        self._calm = CALM[self._columns].tolist()
        try:
            self.reset()
        except FmuError as error:
            reason = f"does not start: {error}"
            raise ScenarioError(f"plant.kind = {settings.kind!r}: {reason}") from None

    def reset(self) -> None:
        """Return to rest by a new instance, because the reset of some FMUs fails.

        Raises:
            FmuError: see ``Instance``.
        """
        self._instance = Instance(self._description)
        with self._instance.explained():
            self._stepping = stepping(self._instance)

    def advance(
        self,
        dt_s: float,
        torque_nm: float,
        force_difference_n: float,
        world: FloatArray | None = None,
    ) -> float:
        """The output ``dt_s`` seconds later; the inputs keep their values until then.

        The world pushes with its mean over the step.

        Raises:
            FmuError: the FMU or CVODE fails.
        """
        with self._instance.explained():
            pushes = self._calm if world is None else world.mean(axis=0)[self._columns].tolist()
            self._stepping.step(dt_s, (torque_nm, force_difference_n, *pushes))
            return self._instance.read(self._description.outputs[SIGNALS[2]])

    def signals(self) -> dict[str, float]:
        """The variables in ``plant.variables`` besides the inputs and the output.

        Raises:
            FmuError: the FMU fails.
        """
        with self._instance.explained():
            signals = self._description.signals
            return {name: self._instance.read(variable) for name, variable in signals.items()}
