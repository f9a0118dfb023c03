"""Cars that nobody here wrote: CommonRoad's ST and STD with their own parameters in the model."""

import numpy as np
import pytest
from vehiclemodels.parameters_vehicle2 import parameters_vehicle2

from can_rig.plant.frameless import frameless
from can_rig.scenario.loading import load
from firmware_model.law.status import FaultState

LOST_S = 2.0


def believed():
    """Vehicle 2, with the stiffness of a tire from its cornering force at the static load."""
    car = parameters_vehicle2()
    load_n = car.m * 9.81 / (car.a + car.b)
    values = {
        "mass_kg": car.m, "yaw_inertia_kgm2": car.I_z, "front_axle_distance_m": car.a,
        "rear_axle_distance_m": car.b, "rear_track_m": car.T_r,
        "front_cornering_stiffness_n_per_rad": -car.tire.p_ky1 * load_n * car.b / 2.0,
        "rear_cornering_stiffness_n_per_rad": -car.tire.p_ky1 * load_n * car.a / 2.0,
    }  # fmt: skip
    return [f"plant.{key}={value}" for key, value in values.items()]


def scenario(model, *changes, base="ideal"):
    own = [
        *believed(), "plant.kind=tests.rig.plant.commonroad:CommonRoadCar",
        f"plant.parameters.model={model}", "plant.parameters.vehicle=2",
        "reference.amplitude_mps2=0.5", f"fault.at_s={LOST_S}", "duration_s=4",
    ]  # fmt: skip
    return load(base, [*own, *changes])


@pytest.mark.parametrize(
    ("model", "base"),
    [
        ("st", "ideal"),
        ("st", "default"),
        # The tires of the drift model pull to one side a little, 3 mm/s² at rest: a bias, which
        # a sensor that is said to be perfect shows at once.
        ("std", "default"),
    ],
)
def test_a_loss_is_confirmed_and_compensated_without_an_alarm_before(model, base):
    chosen = scenario(model, base=base)
    trace = frameless(chosen)
    lost = trace.time_s >= LOST_S
    assert not np.isin(trace.fault_state[~lost], (FaultState.SUSPECTED, FaultState.CONFIRMED)).any()
    assert trace.time_s[lost][trace.fault_state[lost] == FaultState.CONFIRMED][0] < LOST_S + 0.1
    settled = trace.time_s >= 3.5
    noise_mps2 = chosen.plant.sensor.noise_mps2  # more than D* has
    assert np.abs(trace.error[settled]).max() < 1e-4 + noise_mps2
    assert np.abs(trace.command_2[settled]).min() > 500.0
