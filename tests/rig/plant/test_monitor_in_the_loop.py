"""The monitor in whole runs: silent where a car follows, a bound where a loop swings."""

import math

import numpy as np
import pytest

from can_rig import load_scenario
from can_rig.campaigns.plan import plan
from can_rig.campaigns.settings import read_campaign
from can_rig.plant.frameless import frameless
from can_rig.plant.nonlinear_car import NonlinearCar
from can_rig.scenario.plant_settings import PlantSettings
from firmware_model.law.status import Verdict
from firmware_model.law.structs import FloatArray

MONITOR = [verdict for verdict in Verdict if verdict > Verdict.CANNOT_BE_TOLD]
HEALTHY = {"fault.kind": "none", "duration_s": 14.0}


class SpringyColumn(NonlinearCar):
    """A car whose torque goes through a column that swings at 5 Hz, unknown to the design."""

    FREQUENCY_RAD_PER_S, DAMPING = 10.0 * math.pi, 0.1

    def __init__(self, settings: PlantSettings) -> None:
        super().__init__(settings)
        self._torque = self._rate = 0.0

    def advance(
        self,
        dt_s: float,
        torque_nm: float,
        force_difference_n: float,
        world: FloatArray | None = None,
    ) -> float:
        """See ``NonlinearCar``."""
        steps = math.ceil(dt_s / 1e-3 - 1e-9)
        part_s, omega, output = dt_s / steps, self.FREQUENCY_RAD_PER_S, 0.0
        for _ in range(steps):
            pull = omega * omega * (torque_nm - self._torque)
            self._rate += part_s * (pull - 2.0 * self.DAMPING * omega * self._rate)
            self._torque += part_s * self._rate
            output = super().advance(part_s, self._torque, force_difference_n, world)
        return output


def test_no_weather_stops_a_car_that_follows():
    drawn = plan(read_campaign("weather", runs=30, seed=77))
    traces = [frameless(drawn.scenario_of(run)) for run in range(30)]
    stopped = [np.isin(trace.verdict, MONITOR).any() for trace in traces]
    astray = [np.abs(trace.error).max() > 1.0 for trace in traces]
    assert stopped == astray
    assert not all(astray)


@pytest.mark.parametrize(
    ("name", "changes", "free", "bound"),
    [
        ("chassis-can", {"reference.kind": "sine"}, 15.0, 5.4),
        ("noisy", {"reference.kind": "step"}, 6.0, 5.4),
    ],
)
def test_a_car_on_ice_is_bounded(name, changes, free, bound):
    ice = {"kind": "friction", "front": 0.3, "rear": 0.3, "at_s": 6.0}
    with_and_without = [
        frameless(
            load_scenario(name, {**HEALTHY, **changes, "disturbance": ice, "limits.monitor": on})
        )
        for on in (True, False)
    ]
    peaks = [np.abs(trace.measurement).max() for trace in with_and_without]
    assert peaks[1] > free
    assert peaks[0] < bound


@pytest.mark.parametrize("name", ["default", "highway"])
def test_a_column_that_swings_comes_to_rest(name):
    column = {
        "fault.kind": "none",
        "reference.kind": "sine",
        "duration_s": 4.0,
        "plant.kind": f"{__name__}:SpringyColumn",
    }
    bounded = frameless(load_scenario(name, column))
    free = frameless(load_scenario(name, {**column, "limits.monitor": False}))
    late = bounded.time_s > 3.0
    assert max(bounded.verdict) in (Verdict.SWINGING, Verdict.ASTRAY)
    assert np.abs(bounded.measurement[late]).max() < 0.5
    assert np.abs(free.measurement[late]).max() > 2.0
