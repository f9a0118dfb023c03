"""A fault in words: what, by how much, when."""

import pytest

from can_rig.drawing.names import CAR, disturbance_in_words, fault_in_words, fault_label
from can_rig.scenario.disturbance_settings import DisturbanceSettings
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
    "yaw rate scaled by -1 at 2 s (sensor scaled)": FaultSettings(
        "sensor-scaled", "yaw-rate", gain=-1.0
    ),
    "steering torque late by 10 ticks at 2 s (frames late)": FaultSettings("frames-late"),
}


@pytest.mark.parametrize("words", WORDS)
def test_in_words(words):
    values = WORDS[words].__dict__ | {"at_s": 2.0}
    assert fault_in_words(FaultSettings(**values), CAR, 20.0) == words


def test_a_fault_after_the_end_says_so():
    assert fault_in_words(FaultSettings("frames-missing"), CAR, 5.0) == (
        "steering torque lost at 10 s, after the end of the run (frames missing)"
    )
    assert fault_label(FaultSettings("sensor-dead"), CAR) == "D* lost"


@pytest.mark.parametrize(
    ("disturbance", "words"),
    [
        (DisturbanceSettings("gust", 3.0, 2.0, force_n=-600.0), "gust of -600 N from 3 s to 5 s"),
        (
            DisturbanceSettings("turbulence", 0.0, intensity_n=80.0, length_m=20.0),
            "turbulence of 80 N rms from 0 s",
        ),
        (DisturbanceSettings("bank", bank_percent=4.0), "road banked by 4 % from 5 s"),
        (
            DisturbanceSettings("friction", 30.0, front=0.5, rear=0.4),
            "friction factor of the front axle 0.5 and the rear axle 0.4 from 30 s, "
            "after the end of the run",
        ),
        (
            DisturbanceSettings("friction", rear=0.4),
            "friction factor of the rear axle 0.4 from 5 s",
        ),
        (
            DisturbanceSettings("steering-kick", 1.0, 0.5, torque_nm=2.0),
            "steering kick of 2 N m from 1 s to 1.5 s",
        ),
    ],
)
def test_a_disturbance_in_words(disturbance, words):
    assert disturbance_in_words(disturbance, 20.0) == words
