"""A plant that fails by itself, in mid-run."""

from can_rig.scenario.plant_settings import PlantSettings

FAILING = "plant.kind=tests.rig.plant.failing:Failing"


class Failing:
    """Gets stuck once, after so many calls of ``advance``: the parameter ``calls``."""

    def __init__(self, settings: PlantSettings) -> None:
        self.most = settings.parameters["calls"]
        self.reset()

    def reset(self) -> None:
        self.calls, self.dstar_mps2 = 0, 0.0

    def advance(self, dt_s: float, torque_nm: float, force_difference_n: float) -> float:
        self.calls += 1
        if self.calls == self.most + 1:
            raise RuntimeError("stuck")
        self.dstar_mps2 += (0.02 * torque_nm - self.dstar_mps2) * dt_s
        return self.dstar_mps2

    def signals(self) -> dict[str, int]:
        return {"calls": self.calls}
