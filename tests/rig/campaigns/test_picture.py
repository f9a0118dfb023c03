"""What the panels of a campaign's picture are called: by the plant's own signals."""

from __future__ import annotations

import pytest

from can_rig.assessment.resolve import load
from can_rig.campaigns.report import label_of
from can_rig.drawing.names import names_of

OF_CAR = {
    "deviation_peak_after_fault_mps2": "deviation peak after fault in m/s²",
    "error_integral_after_fault_mps": "error integral after fault in m/s",
    "torque_peak_nm": "torque peak in N m",
    "force_difference_settled_n": "force difference settled in N",
    "detection_delay_s": "detection delay in s",
    "false_alarms_per_hour": "false alarms in 1/h",
}
OF_COLUMN = {
    "deviation_peak_after_fault_mps2": "deviation peak after fault in %",
    "error_integral_after_fault_mps": "error integral after fault in % s",
    "torque_peak_nm": "reflux peak in mol/s",
    "force_difference_settled_n": "boil-up settled",
    "dstar_carried_mps2": "purity carried in %",
    "detection_delay_s": "detection delay in s",
}
COLUMN = [
    "plant.input_1={name='reflux', unit='mol/s'}",
    "plant.input_2={name='boil-up', unit=''}",
    "plant.output={name='purity', unit='%'}",
]


@pytest.mark.parametrize(("metric", "said"), OF_CAR.items())
def test_a_metric_of_the_car(metric: str, said: str) -> None:
    assert label_of(metric, names_of(load("default").plant)).replace("\n", " ") == said


@pytest.mark.parametrize(("metric", "said"), OF_COLUMN.items())
def test_a_metric_of_a_plant_by_numbers(metric: str, said: str) -> None:
    names = names_of(load("chapter-2", COLUMN).plant)
    assert label_of(metric, names).replace("\n", " ") == said
