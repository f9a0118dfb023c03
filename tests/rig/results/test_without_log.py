"""The metrics of a run that is not recorded, which begins as the run without its fault."""

from __future__ import annotations

import pytest

from can_rig.assessment.resolve import load
from can_rig.results import without_log
from can_rig.results.counterfactual import loop_of
from can_rig.results.without_log import metrics_of


@pytest.mark.parametrize("kind", ["actuator-dead", "sensor-biased", "frames-missing", "none"])
def test_it_is_the_run_from_rest_by_every_metric(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load("default", ["duration_s=0.3", "fault.at_s=0.2", f"fault.kind={kind}"])
    begun = metrics_of(scenario)
    if kind != "none":
        assert loop_of(scenario.healthy).done == scenario.ticks  # the metrics went on with it
    monkeypatch.setattr(without_log, "_begin_without_fault", lambda loop, scenario: None)
    assert metrics_of(scenario) == begun
