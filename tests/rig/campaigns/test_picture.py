"""The panels of a campaign's picture: names by the plant's own signals, and labels apart."""

from itertools import combinations

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from can_rig.campaigns.report import draw, is_far_reaching, label_of, label_of_key
from can_rig.campaigns.rows import read_columns, requirements_of
from can_rig.campaigns.statistics import columns_needed, summarise
from can_rig.drawing.names import names_of
from can_rig.scenario.loading import load
from tests.rig.campaigns.running import planned, ran

OF_CAR = {
    "deviation_peak_after_fault_mps2": "deviation peak after fault in m/s²",
    "error_integral_after_fault_mps": "error integral after fault in m/s",
    "torque_peak_nm": "steering torque peak in N m",
    "force_difference_settled_n": "rear force difference settled in N",
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


@pytest.mark.parametrize("kinds", [2, 9])
def test_the_words_of_an_axis_stand_apart(tmp_path, kinds):
    words = ["none", "actuator-dead", "actuator-late", "sensor-dead", "sensor-stuck", "sensor-late",
             "sensor-biased", "frames-missing", "frames-late"][:kinds]  # fmt: skip
    four = "torque_peak_nm < force_difference_peak_n + torque_rms_nm + deviation_peak_mps2"
    axes, requirements = {"fault.kind": {"values": words}}, {"four panels": four}
    plan = planned(runs=27, axes=axes, requirements=requirements)
    required = requirements_of(plan)
    columns = read_columns(ran(tmp_path / "some", plan).table, columns_needed(plan, required))
    figure = draw(plan, required, columns, summarise(plan, required, columns))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    labelled = set()
    for axis in figure.axes:
        for texts in (axis.get_xticklabels(), axis.get_yticklabels()):
            seen = [text for text in texts if text.get_visible() and text.get_text() in words]
            labelled |= {text.get_text() for text in seen}
            boxes = [text.get_window_extent(canvas.get_renderer()) for text in seen]
            assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert labelled == set(words)
