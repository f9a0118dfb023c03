"""Further outputs of a plant by numbers, against scipy alone."""

import can
import cantools
import numpy as np
import pytest
from scipy import linalg

from can_rig.results.signals import read_signals
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load
from tests.helpers import DBC, on_a_bus, on_no_bus, refuses

OUTPUTS = ([0.0, 1.0, 0.0, 0.0], [0.5, 0.0, 0.0, -2.0])
SENSORS = (
    f"sensor=[{{measures='yaw-rate', c={OUTPUTS[0]}, period_s=0.02, phase_s=0.01}}, "
    f"{{measures='steering-angle', c={OUTPUTS[1]}, corner_hz=5, period_s=0.01}}]"
)
PUSH = ("plant.e=[0, 0, 0, 1]", "disturbance={kind='push', size=3, at_s=0.5}")


@pytest.mark.parametrize("settings", [(), PUSH], ids=["calm", "pushed"])
def test_each_frame_says_the_row_of_the_states(tmp_path, settings):
    """The states follow from what the actuators apply and the world pushes, by the exponential."""
    scenario = load("two-masses", [SENSORS, "duration_s=3", "fault.at_s=1", *settings])
    logs = [tmp_path / "nodes.log", tmp_path / "none.log"]
    on_a_bus(scenario, logs[0])
    on_no_bus(scenario, logs[1])
    assert logs[0].read_bytes() == logs[1].read_bytes()
    network = network_of(scenario)
    signals = read_signals(logs[0], network, scenario.tick_s)
    lag_s = 1.0 / (2 * np.pi * 5)
    a, corner = np.array(scenario.plant.a), np.array([OUTPUTS[1]]) / lag_s
    inputs = np.hstack([np.array(scenario.plant.b), np.array([[0.0], [0.0], [0.0], [1.0]])])
    whole = np.zeros((9, 9))  # states, filter, held inputs, slope of the push
    whole[:4, :4], whole[4, :4], whole[4, 4] = a, corner, -1.0 / lag_s
    whole[:4, 5:8], whole[7, 8] = inputs, 1.0 / scenario.tick_s
    step, x = linalg.expm(whole * scenario.tick_s), np.zeros(9)
    push = signals.plant.get("push", np.zeros(len(signals)))
    expected = []
    names = ("applied_torque_nm", "applied_force_difference_n")
    applied = zip(*(signals.plant[name] for name in names), strict=True)
    for tick, (first, second) in enumerate(applied):
        expected.append((x[:4] @ OUTPUTS[0], x[4]))
        then = push[min(tick + 1, len(push) - 1)]
        x[5:] = first, second, push[tick], then - push[tick]
        x = step @ x
    database, seen = cantools.database.load_file(DBC / "plant_by_numbers.dbc"), [0, 0]
    for message in can.LogReader(logs[0]):
        frame = database.get_message_by_frame_id(message.arbitration_id)
        if frame.name in {"OUTPUT_2", "OUTPUT_4"}:
            at = ("OUTPUT_2", "OUTPUT_4").index(frame.name)
            said = frame.decode(bytes(message.data))
            assert str(said["Valid"]) == "VALID"
            truth = expected[int(said["Tick"])][at]
            assert float(said[f"Output{2 + 2 * at}"]) == pytest.approx(truth, abs=6e-5)
            seen[at] += 1
    assert seen == [150, 300]
    assert np.ptp([each[1] for each in expected]) > 0.1
    signals.write_csv(tmp_path / "signals.csv", scenario.plant)
    header = (tmp_path / "signals.csv").read_text().splitlines()[0].split(",")
    assert {"measured_output_2", "measured_output_4"} <= set(header)


@pytest.mark.parametrize(
    ("name", "sensor", "said"),
    [
        ("two-masses", "{measures='yaw-rate'}", "sensor.c: must have 4 numbers, as many as plant"),
        ("two-masses", "{measures='yaw-rate', c=[1]}", "sensor.c: must have 4 numbers, as many as"),
        ("two-masses", "{measures='torque-echo', c=[1,0,0,0]}", "sensor.c: must be left out; only"),
        ("cluster", "{measures='yaw-rate', c=[1,0,0,0]}", "sensor.c: must be left out; only a fur"),
        ("chapter-2", "{measures='yaw-rate', c=[1]}", "further outputs needs plant.kind = 'sta"),
    ],
)  # fmt: skip
def test_what_is_no_output_is_refused(name, sensor, said):
    with refuses(said):
        load(name, [f"sensor={sensor}"])
