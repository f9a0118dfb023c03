"""``from-bus``: loading puts in what the timing of the bus says."""

import json

from can_rig.frames.bus_timing import latency_ticks
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import load, load_run, load_values

BUS = ("latency_ticks=from-bus", "tick_s=0.002", "bus.bitrate=500000")


def test_the_number_is_that_of_the_bus():
    found = load("thesis-step", BUS)
    network = network_of(found)
    assert found.latency_ticks == latency_ticks(network, 500_000, 0.002, found.bus.compute_s) > 0
    assert load("thesis-step").latency_ticks == 0


def test_the_values_that_a_scenario_is_made_of_stay_as_they_are():
    values = {"latency_ticks": "from-bus", "design": {"tau_s": 0.002}}
    before = json.dumps(values)
    assert load_values("x", values).latency_ticks > 0
    assert json.dumps(values) == before


def test_a_run_folder_holds_numbers_and_a_word_may_change_them_again():
    found = load("thesis-step", BUS)
    recorded = json.loads(json.dumps(found.as_dict()))
    assert recorded["latency_ticks"] == found.latency_ticks
    assert load_run(recorded) == found
    late = load("thesis-step", ["latency_ticks=5"]).as_dict()
    assert load_run(late, ["latency_ticks=from-bus"]).latency_ticks == 1
