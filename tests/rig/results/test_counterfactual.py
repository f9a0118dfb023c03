"""The rig's own run without its fault, to the last bit."""

import numpy as np
import pytest

from can_rig.results import counterfactual
from can_rig.results.counterfactual import fault_free, loop_of
from can_rig.results.metrics import metrics, metrics_of
from can_rig.results.signals import Signals
from can_rig.scenario.loading import load
from tests.rig.plant.failing import FAILING
from tests.rig.results.quiet import COLUMNS, quiet


@pytest.mark.parametrize(
    ("name", "settings"),
    [("thesis-step", []), ("thesis-sine", ["plant.sensor.noise_mps2=0.005", "seed=7"]),
     ("chapter-2", []), ("nonlinear-car", ["plant.sensor.noise_mps2=0.005"]),
     ("thesis-sine", ["latency_ticks=1", "design.tau_s=0.01", "design.tau_q_s=0.02"]),
     ("thesis-step", ["plant.mass_kg=1500", "model.mass_kg=1400", "limits.torque_nm=500"])],
)  # fmt: skip
def test_fault_free_is_the_rig_s_own_run_without_the_fault(run, name, settings):
    """Same plant, limits, noise and latency, to the last bit of D*."""
    short = ["duration_s=0.3", "fault.at_s=0.1", *settings]
    _, signals = run(name, *short, "fault.kind=none")
    found = fault_free(load(name, short), signals)
    np.testing.assert_array_equal(found.dstar_mps2, signals.dstar_mps2)
    np.testing.assert_array_equal(found.force_difference_n, signals.force_difference_n)


def test_fault_free_ends_where_a_plant_fails_by_itself():
    failing = [FAILING, "plant.parameters.calls=70"]
    scenario = load("thesis-step", ["duration_s=0.1", "fault.at_s=0.05", *failing])
    broken = fault_free(scenario, quiet(scenario))
    assert np.isfinite(broken.dstar_mps2[:71]).all()
    assert np.isnan(broken.dstar_mps2[71:]).all()
    assert np.isnan(broken.force_difference_n[71:]).all()
    assert np.abs(broken.dstar_mps2[:71]).max() > 0.0
    # Without a run to compare with, the metric is None.
    assert metrics(scenario, quiet(scenario))["deviation_settled_after_fault_mps2"] is None


def test_fault_free_of_a_log_that_starts_late():
    scenario = load("thesis-sine", ["duration_s=0.2"])
    signals = quiet(scenario)
    late = Signals(*(getattr(signals, name)[150:] for name in COLUMNS))
    np.testing.assert_array_equal(
        fault_free(scenario, late).dstar_mps2, fault_free(scenario, signals).dstar_mps2[150:]
    )
    empty = Signals(*(getattr(signals, name)[:0] for name in COLUMNS))
    assert fault_free(scenario, empty).dstar_mps2.shape == (0,)


@pytest.mark.parametrize("kind", ["actuator-dead", "sensor-biased", "frames-missing", "none"])
def test_it_is_the_run_from_rest_by_every_metric(kind, monkeypatch):
    scenario = load("default", ["duration_s=0.3", "fault.at_s=0.2", f"fault.kind={kind}"])
    begun = metrics_of(scenario)
    if kind != "none":
        assert loop_of(scenario.healthy).done == scenario.ticks  # the metrics went on with it
    monkeypatch.setattr(counterfactual, "_begin_without_fault", lambda loop, scenario: None)
    assert metrics_of(scenario) == begun
