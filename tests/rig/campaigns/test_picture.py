"""What the panels of a campaign's picture are called: by the plant's own signals."""

import numpy as np
import pytest

from can_rig.assessment.resolve import load
from can_rig.campaigns.report import is_far_reaching, label_of, label_of_key
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
def test_a_metric_of_the_car(metric, said):
    assert label_of(metric, names_of(load("default").plant)).replace("\n", " ") == said


@pytest.mark.parametrize(("metric", "said"), OF_COLUMN.items())
def test_a_metric_of_a_plant_by_numbers(metric, said):
    names = names_of(load("chapter-2", COLUMN).plant)
    assert label_of(metric, names).replace("\n", " ") == said


@pytest.mark.parametrize(
    ("key", "said"),
    [("fault.at_s", "fault: begin in s"), ("fault.0.left", "fault 0: share left"),
     ("plant.front_cornering_stiffness_n_per_rad", "plant: front cornering stiffness in N/rad"),
     ("latency_ticks", "latency ticks")],
)  # fmt: skip
def test_an_axis_is_named_in_words_with_its_unit(key, said):
    assert label_of_key(key).replace("\n", " ") == said


def test_a_tail_makes_an_axis_logarithmic_and_zero_keeps_the_axis_linear():
    tail = np.array([1.0] * 99 + [11.0])
    assert is_far_reaching(np.append(tail, np.nan))
    assert not is_far_reaching(np.append(tail, 0.0))
    assert not is_far_reaching(np.linspace(1.0, 9.0, 50))
