"""What the plant reports and no frame carries: beside the log, in signals.csv, in tables."""

import csv

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_array_equal
from scipy.signal import cont2discrete, dlsim

from can_rig.errors import LogError, RigError
from can_rig.logs.plant_signals import read_plant_signals
from can_rig.nodes.recording import PlantRecorder
from can_rig.plant.simulated import SimulatedPlant
from can_rig.results.counterfactual import applied_commands
from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.views.signal_table import read_table
from firmware_model.design.vehicle import vehicle_state_space
from tests.helpers import load, record

SHORT = ("duration_s=0.3", "fault.at_s=0.15")
REPORTED = [
    "true_dstar_mps2", "side_slip_rad", "yaw_rate_rad_per_s", "steering_angle_rad",
    "applied_torque_nm", "applied_force_difference_n",
]  # fmt: skip


def signals_of(folder, *settings, name="ideal"):
    log, _, scenario = record(folder, *SHORT, *settings, name=name)
    network = network_of(scenario)
    return log, scenario, read_signals(log, network, scenario.tick_s)


def test_the_car_s_motion_is_that_of_its_equations_under_what_was_applied(tmp_path):
    _, scenario, signals = signals_of(tmp_path)
    assert list(signals.plant) == REPORTED
    a, b, c = vehicle_state_space(scenario.plant)
    system = cont2discrete((a, b, np.eye(4), np.zeros((4, 2))), scenario.tick_s)
    applied = np.column_stack([signals.plant[name] for name in REPORTED[-2:]])
    _, states, _ = dlsim((*system[:4], scenario.tick_s), applied)
    for state, name in ((0, "side_slip_rad"), (1, "yaw_rate_rad_per_s"), (3, "steering_angle_rad")):
        np.testing.assert_allclose(
            signals.plant[name], states[:, state], atol=1e-7 * np.abs(states[:, state]).max()
        )
        assert np.abs(signals.plant[name]).max() > 1e-4
    np.testing.assert_allclose(signals.plant["true_dstar_mps2"], states @ c[0], atol=1e-7)
    np.testing.assert_allclose(signals.dstar_mps2, states @ c[0], atol=1e-6)  # a perfect sensor


def test_what_immediate_actuators_apply_is_what_the_log_says(tmp_path):
    log, scenario, signals = signals_of(tmp_path)
    reported = applied_commands(scenario, signals)
    log.with_suffix(".plant.csv").unlink()
    alone = read_signals(log, network_of(scenario), scenario.tick_s)
    assert alone.plant == {}
    for ours, theirs in zip(reported, applied_commands(scenario, alone), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
        assert np.abs(ours).max() > 1.0


def test_with_a_lag_the_report_has_what_the_log_cannot_tell(tmp_path):
    orders = ("design.alpha_q=4", "design.alpha=3", "design.tau_q_s=0.02", "design.tau_s=0.02")
    _, scenario, signals = signals_of(tmp_path, "plant.torque_actuator.lag_s=0.02", *orders)
    torque, _ = applied_commands(scenario, signals)
    lost = signals.time_s >= 0.15
    fading = torque[lost] / torque[lost][0]
    np.testing.assert_allclose(fading, np.exp(-0.001 * np.arange(lost.sum()) / 0.02), rtol=1e-6)


def test_signals_csv_has_the_columns_after_those_of_the_frames(tmp_path):
    log, scenario, signals = signals_of(tmp_path)
    signals.write_csv(tmp_path / "signals.csv", scenario.plant)
    head, first, *_ = csv.reader((tmp_path / "signals.csv").open())
    assert head[8:] == REPORTED
    assert len(first) == len(head)
    columns = read_table(log, scenario).columns
    np.testing.assert_allclose(columns["yaw_rate_rad_per_s"], signals.plant["yaw_rate_rad_per_s"])
    assert read_table(tmp_path / "signals.csv", scenario).name_and_unit("yaw_rate_rad_per_s") == (
        "yaw rate",
        "rad/s",
    )


def test_a_plant_that_is_no_car_reports_what_it_has(tmp_path):
    _, _, signals = signals_of(tmp_path, name="chapter-2")
    assert list(signals.plant) == [REPORTED[0], *REPORTED[-2:]]


def test_a_line_that_was_not_finished_is_not_read(tmp_path):
    log, scenario, signals = signals_of(tmp_path)
    path = log.with_suffix(".plant.csv")
    text = path.read_text()
    path.write_text(text[: text.rindex("\n", 0, len(text) // 2) + 4])
    cut = read_signals(log, network_of(scenario), scenario.tick_s)
    there = np.isfinite(cut.plant["yaw_rate_rad_per_s"])
    assert 100 < there.sum() < 200
    np.testing.assert_array_equal(
        cut.plant["yaw_rate_rad_per_s"][there], signals.plant["yaw_rate_rad_per_s"][there]
    )


@pytest.mark.parametrize("letters", [245, 251])
def test_a_log_s_name_may_leave_no_room_for_a_name_beside(tmp_path, letters):
    assert read_plant_signals(tmp_path / f"{'x' * letters}.log", 0, 1) == {}


@pytest.mark.parametrize("text", [b"tick,a\n0,x\n", b"tick,a\n0,1,2\n", b"tick,\xff\n0,1\n"])
def test_another_file_of_that_name_is_refused_in_one_line(tmp_path, text):
    log, scenario, _ = signals_of(tmp_path)
    log.with_suffix(".plant.csv").write_bytes(text)
    with pytest.raises(LogError, match=r"\.plant\.csv: not readable as signals of a plant") as bad:
        read_signals(log, network_of(scenario), scenario.tick_s)
    assert "\n" not in str(bad.value)


CLASS = """
class Car:
    def __init__(self, settings): self.gain = settings.parameters["gain"]; self.reset()
    def reset(self): self.y = 0.0
    def advance(self, dt_s, torque_nm, force_difference_n):
        self.y += dt_s * (self.gain * torque_nm - self.y)
        return self.y
    def signals(self): return {signals}
"""


def own(tmp_path, signals):
    name = f"car{abs(hash((signals, str(tmp_path))))}"
    (tmp_path / f"{name}.py").write_text(CLASS.replace("{signals}", signals))
    return load("default", [f"plant.kind={name}:Car", "plant.parameters.gain=0.5"])


def test_a_plant_of_one_s_own_has_parameters_and_signals_of_its_own(tmp_path):
    scenario = own(tmp_path, "{'gain_mps2_per_nm': self.gain, 'y_mps2': self.y}")
    plant = SimulatedPlant(scenario)
    rows = [plant.advance(tick, 2.0, 0.0) for tick in range(4)]
    assert list(rows[0]) == [REPORTED[0], "gain_mps2_per_nm", "y_mps2", *REPORTED[-2:]]
    assert [row["gain_mps2_per_nm"] for row in rows] == [0.5] * 4
    assert rows[3]["y_mps2"] == rows[3]["true_dstar_mps2"] > 0.0
    assert scenario.model.parameters == {}


@pytest.mark.parametrize(
    ("signals", "line"),
    [
        ("[1.0]", r"signals\(\) at 0 s gives \[1.0\]: must be a dict"),
        ("{'yaw rate': 1.0}", "names 'yaw rate': must be a name that no other column has"),
        ("{'dstar_mps2': 1.0}", "names 'dstar_mps2': must be a name that no other column has"),
        ("{'a_rad': 'x'}", "gives a_rad = 'x': must be a number"),
        ("{'a_rad': 10**400}", "gives a_rad = 10+: must be a number"),
        ("{'a_rad': 1 / 0}", "signals\\(\\) at 0 s failed: ZeroDivisionError"),
    ],
)
def test_signals_that_are_none_are_refused_in_one_line(tmp_path, signals, line):
    plant = SimulatedPlant(own(tmp_path, signals))
    with pytest.raises(RigError, match=line):
        plant.advance(0, 0.0, 0.0)


def test_signals_that_change_their_names_are_refused_in_one_line(tmp_path):
    """The columns of the file are those of the first tick; other values would be lost."""
    plant = SimulatedPlant(own(tmp_path, "{'b_m': 0.0} if self.y else {'a_rad': 1.0}"))
    with pytest.raises(RigError, match=r"signals\(\) at .* names b_m: must be a_rad, as before"):
        for tick in range(9):
            plant.advance(tick, 2.0, 0.0)


def test_signals_in_another_order_keep_their_columns_and_a_missing_one_is_no_number(tmp_path):
    with PlantRecorder(tmp_path / "bus.log") as recorder:
        for tick, row in enumerate(({"a": 1.0, "b": 2.0}, {"b": 4.0, "a": 3.0}, {"b": 6.0})):
            recorder.record(tick, row)
    found = read_plant_signals(tmp_path / "bus.log", 0, 3)
    assert_array_equal(found["a"], [1.0, 3.0, np.nan])
    assert_array_equal(found["b"], [2.0, 4.0, 6.0])


@given(st.lists(st.tuples(st.floats(), st.floats()), min_size=1))
def test_every_value_and_name_comes_back_from_the_file_as_it_was(tmp_path_factory, rows):
    """Numbers of NumPy's too, which a plant that runs interpreted reports."""
    names = ("größe_m", "flow_mol_per_s")
    columns = dict(zip(names, np.array(rows, ndmin=2).T, strict=True))
    log = tmp_path_factory.mktemp("reported") / "bus.log"
    with PlantRecorder(log) as recorder:
        recorder.record_columns(0, columns)
        for tick, row in enumerate([*rows, *rows], len(rows)):
            number = float if tick < 2 * len(rows) else np.float64
            recorder.record(tick, dict(zip(names, map(number, row), strict=True)))
    read = read_plant_signals(log, 0, 3 * len(rows))
    assert list(read) == list(names)
    for name in names:
        assert_array_equal(read[name], np.tile(columns[name], 3))
