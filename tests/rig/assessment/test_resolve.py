"""``from-bus``: loading keeps the word, the assessment puts the number in."""

import json

from can_rig.assessment.bus_timing import latency_ticks
from can_rig.assessment.resolve import load, load_run, resolve
from can_rig.scenario.build import network_of
from can_rig.scenario.loading import draft, read

BUS = ("latency_ticks=from-bus", "tick_s=0.002", "bus.bitrate=500000")


def test_loading_keeps_the_words_and_resolving_puts_in_what_the_assessment_says():
    written = read("thesis-step", BUS)
    assert written.latency_from_bus
    assert written.scenario.latency_ticks == 0
    found = resolve(written)
    network = network_of(found)
    assert found.latency_ticks == latency_ticks(network, 500_000, 0.002, found.bus.compute_s) > 0
    assert found == load("thesis-step", BUS)


def test_a_draft_leaves_the_values_that_it_is_made_of_as_they_are():
    values = {"latency_ticks": "from-bus", "design": {"tau_s": 0.002}}
    before = json.dumps(values)
    assert draft("x", values).latency_from_bus
    assert json.dumps(values) == before


def test_without_a_word_nothing_is_resolved():
    written = read("thesis-step")
    assert not written.latency_from_bus
    assert resolve(written) is written.scenario


def test_a_run_folder_holds_numbers_and_a_word_may_change_them_again():
    found = load("thesis-step", BUS)
    recorded = json.loads(json.dumps(found.as_dict()))
    assert recorded["latency_ticks"] == found.latency_ticks
    assert load_run(recorded) == found
    late = load("thesis-step", ["latency_ticks=5"]).as_dict()
    assert load_run(late, ["latency_ticks=from-bus"]).latency_ticks == 1
