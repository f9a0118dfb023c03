"""What a fault makes of a command or a reading, and of a loop with it, by hand."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from firmware_model.analysis.hardware import (
    ADDED,
    BY,
    EXACT_FRAMES,
    GAIN,
    HEALTHY,
    HELD,
    LATE,
    REPLACED,
    SENSOR,
    SLEW,
    carried,
    distorted,
    frame_of,
)
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import Simulation
from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target

TICK_S, TICKS = 1e-3, 40
TABLE = build(design(steer_by_wire(), DesignSpecification()), Target(TICK_S))


@pytest.mark.every_case
@pytest.mark.parametrize(
    ("changes", "previous", "expected"),
    [({}, 9.0, 2.0), ({GAIN: 0.5, ADDED: 3.0}, 9.0, 4.0), ({HELD: 1.0}, 9.0, 9.0),
     ({SLEW: 0.5}, 9.0, 8.5), ({SLEW: 0.5}, -9.0, -8.5), ({SLEW: 100.0}, 9.0, 2.0),
     ({SLEW: 0.5}, math.nan, 2.0)],
)  # fmt: skip
def test_what_is_said_or_done_instead(changes, previous, expected):
    fault = HEALTHY.copy()
    for at, value in changes.items():
        fault[at] = value
    assert distorted(2.0, previous, fault) == expected


@given(st.floats(), st.sampled_from([16, 32, 64]))
def test_a_frame_of_a_float_carries_what_ieee_754_says(value, bits):
    kind = np.dtype(f"f{bits // 8}").type
    most = float(np.finfo(kind).max)
    with np.errstate(over="ignore", under="ignore"):
        expected = float(kind(min(max(value, -most), most)))
    np.testing.assert_equal(carried(value, frame_of(0.0, -most, most, bits)), expected)


@given(st.integers(-32_768, 32_767), st.floats(-0.499, 0.499), st.sampled_from([1e-3, 0.3, 7.0]))
def test_a_frame_carries_whole_steps(steps, off, lsb):
    frame = frame_of(lsb, -32_768 * lsb, 32_767 * lsb)
    assert carried((steps + off) * lsb, frame) == steps * lsb
    assert carried(steps * lsb, frame) == steps * lsb
    assert carried(1e9, frame) == 32_767 * lsb
    assert carried(-math.inf, frame) == -32_768 * lsb
    assert math.isnan(carried(math.nan, frame))


def loop(faults: np.ndarray | None = None, lsb: float = 0.0) -> Simulation:
    more = {} if faults is None else {"faults": faults}
    plant = sample(steer_by_wire(), TICK_S)
    frames = EXACT_FRAMES.copy()
    frames[SENSOR] = frame_of(lsb, -math.inf, math.inf)
    made = Simulation(TABLE, plant, np.full(TICKS, 0.5), frames=frames, **more)
    made.run()
    return made


def healthy() -> np.ndarray:
    return np.tile(HEALTHY, (TICKS, 3, 1))


@pytest.mark.compiled
def test_faults_that_do_nothing_change_nothing():
    for name in ("measured", "command_1", "command_2", "fault_estimate"):
        assert np.array_equal(getattr(loop(healthy()).trace, name), getattr(loop().trace, name))


def test_a_sensor_that_is_late_says_what_was():
    faults = healthy()
    faults[10:, SENSOR, LATE] = 7
    trace = loop(faults).trace
    assert np.array_equal(trace.measured[10:], trace.measurement[3:-7])
    early = healthy()
    early[:5, SENSOR, LATE] = 10  # no reading yet
    assert not loop(early).trace.measured[:5].any()


def test_what_comes_in_place_of_a_frame_is_what_is_used():
    faults = healthy()
    faults[20, SENSOR, [REPLACED, BY]] = 1.0, 0.125
    faults[25:, 1, [REPLACED, BY]] = 1.0, 700.0
    trace = loop(faults, lsb=1e-3).trace
    assert trace.measured[20] == 0.125
    other = loop(lsb=1e-3).trace
    assert np.array_equal(trace.measured[:20], other.measured[:20])
    force = (trace.measurement - other.measurement)[30]
    assert force != 0.0


def test_late_actuators_do_what_they_were_told_before():
    faults = healthy()
    faults[:, :2, LATE] = 3
    late, other = loop(faults).trace, loop().trace
    assert np.array_equal(late.measurement[:5], np.r_[np.zeros(3), other.measurement[:2]])
