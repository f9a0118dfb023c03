"""What can be injected, and what is refused before it is sent."""

import math

import pytest

from can_rig.errors import RigError
from can_rig.frames.operator_frames import Command
from can_rig.plant.faults.injection import injected, require_possible


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (Command("INJECT", "sensor-drift", "sensor"), "its value is drift_per_s; .* must be set"),
        (Command("INJECT", "actuator-dead", "torque", 2.0), "left = 2.0: must be less than 1"),
        (Command("INJECT", "frames-missing", "torque", 1.0), "has no value"),
        (Command("INJECT", "actuator-late", "torque", 2.4), "must be a whole number of ticks"),
        (Command("INJECT", "actuator-dead", "sensor"), "must be of torque or force-difference"),
        (Command("INJECT", "actuator-dead", "torque", 0.0, 60.0), "must be 0.1 to 25.5 s"),
        (Command("INJECT", "sensor-biased", "sensor", 0.0004), "must be 0 or at least 0.001"),
        (Command("MOVE_REFERENCE", value=math.nan), "value nan: must be -8388.61 to 8388.61"),
        (Command("MOVE_REFERENCE", value=1e9), "must be -8388.61 to 8388.61"),
        (Command("PACE", value=-1.0), "must be above 0"),
        (Command("STEP", value=0.0), "must be a whole number of ticks, 1 at least"),
    ],
)
def test_what_no_frame_or_no_node_could_do_is_refused(command, why):
    with pytest.raises(RigError, match=why):
        require_possible(command)


def test_what_is_possible_is_injected():
    command = Command("INJECT", "actuator-late", "torque", 3.0, 25.5)
    require_possible(command)
    fault = injected(command, 7, 1_000_000)
    assert (fault.late_ticks, fault.at_s, fault.for_s) == (3, 0.007, 25.5)
    assert injected(command._replace(value=0.0), 7, 1_000_000) is None
    assert injected(command._replace(place="sensor"), 7, 1_000_000) is None
