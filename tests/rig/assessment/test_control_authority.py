"""Whether X_diff carries the loss: against the nonlinear car, which slides where it does not."""

from __future__ import annotations

import pytest

from can_rig.assessment.limitations import ControlAuthority, control_authority
from can_rig.assessment.resolve import load
from can_rig.plant.nonlinear_car import NonlinearCar
from can_rig.scenario.build import network_of


def of(*settings: str, name: str = "default") -> ControlAuthority:
    scenario = load(name, settings)
    found = control_authority(scenario, network_of(scenario))
    assert found is not None
    return found


def test_needs_what_the_settled_run_holds() -> None:
    """Trap 7: 2989 N per m/s² of the physics car, 3455 N of the published one."""
    assert of().needed_n == pytest.approx(2989.0, abs=1.0)
    assert of("plant.variant=published").needed_n == pytest.approx(3455.0, abs=1.0)
    assert of("reference.amplitude_mps2=-0.5").needed_n == pytest.approx(1494.6, abs=0.5)


def settled_dstar(force_difference_n: float, *settings: str) -> float:
    """D* of the nonlinear car after 30 s of X_diff alone, no torque on the column."""
    car, dstar = NonlinearCar(load("nonlinear-car", settings).plant), 0.0
    for _ in range(3000):
        dstar = car.advance(0.01, 0.0, force_difference_n)
    return dstar


@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_tires_end_where_the_nonlinear_car_slides(friction: float) -> None:
    """Below the limit X_diff holds what it should; a tenth above, the rear axle is gone."""
    setting = f"plant.friction={friction}"
    carried = of(setting, "limits.force_difference_n=20000").carries_mps2
    at = of(setting, f"reference.amplitude_mps2={0.9 * carried}")
    assert at.enough
    assert settled_dstar(at.needed_n, setting) == pytest.approx(0.9 * carried, rel=0.1)
    beyond = of(setting, f"reference.amplitude_mps2={1.1 * carried}")
    assert not beyond.enough
    sliding = settled_dstar(beyond.needed_n, setting)
    assert abs(sliding - 1.1 * carried) > 0.3 * carried


def test_the_smaller_of_limit_and_tires_counts() -> None:
    tight, wide = of("limits.force_difference_n=1000"), of("limits.force_difference_n=20000")
    assert tight.available_n == tight.limit_n == 1000.0
    assert not tight.enough
    assert tight.carries_mps2 == pytest.approx(1000.0 / 2989.0, rel=1e-3)
    assert wide.available_n == wide.tires_n < 4849.0  # μ m g l_f/(l_f + l_r), less what Y_r takes
    assert "NOT ENOUGH" in str(tight)
    assert "enough: " in str(wide)


def test_it_is_the_largest_of_the_reference_that_counts() -> None:
    assert of(name="lane-change").reference_mps2 == pytest.approx(1.0, rel=1e-4)
    assert of(name="lane-change").enough


def test_chapter_2_has_no_tires() -> None:
    scenario = load("chapter-2")
    assert control_authority(scenario, network_of(scenario)) is None
