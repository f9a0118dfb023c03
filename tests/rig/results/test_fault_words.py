"""A fault in words: what, by how much, when."""

from __future__ import annotations

import pytest

from can_rig.drawing.names import CAR, fault_in_words, fault_label
from can_rig.scenario.fault_settings import FaultSettings

WORDS = {
    "steering torque lost at 2 s (actuator dead)": FaultSettings("actuator-dead"),
    "75 % of steering torque lost at 2 s (actuator dead)": FaultSettings(
        "actuator-dead", left=0.25
    ),
    "rear force difference offset by 30 N at 2 s (actuator offset)": FaultSettings(
        "actuator-offset", "force-difference", offset=30.0
    ),
    "steering torque stuck from 2 s to 3 s (actuator stuck)": FaultSettings(
        "actuator-stuck", for_s=1.0
    ),
    "D* biased by -0.5 m/s² at 2 s": FaultSettings("sensor-biased", bias_mps2=-0.5),
    "D* drifting by 0.1 m/s²/s at 2 s (sensor drift)": FaultSettings(
        "sensor-drift", drift_per_s=0.1
    ),
    "steering torque rate limited to 5 N m/s at 2 s (actuator rate limited)": FaultSettings(
        "actuator-rate-limited", rate_per_s=5.0
    ),
    "D* forged as 3 m/s² at 2 s, every 4 ticks (frames forged)": FaultSettings(
        "frames-forged", "sensor", value=3.0, every=4
    ),
    "steering torque late by 10 ticks at 2 s (frames late)": FaultSettings("frames-late"),
}


@pytest.mark.parametrize("words", WORDS)
def test_in_words(words: str) -> None:
    values = WORDS[words].__dict__ | {"at_s": 2.0}
    assert fault_in_words(FaultSettings(**values), CAR, 20.0) == words


def test_a_fault_after_the_end_says_so() -> None:
    assert fault_in_words(FaultSettings("frames-missing"), CAR, 5.0) == (
        "steering torque lost at 10 s, after the end of the run (frames missing)"
    )
    assert fault_label(FaultSettings("sensor-dead"), CAR) == "D* lost"
