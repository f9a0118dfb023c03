"""C on the target: what it goes on from where the actuator cannot follow, and where it settles."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from firmware_model.design.continuous_design import DesignSpecification, design
from firmware_model.design.plants import steer_by_wire
from firmware_model.design.zpk import ZeroPoleGain
from firmware_model.discretisation.tables import build
from firmware_model.discretisation.targets import Target
from firmware_model.discretisation.tustin import tustin
from firmware_model.target.controller import init
from firmware_model.target.filters.biquad import output
from firmware_model.target.filters.tracking import CONSTANTS, settle_tracking, track
from firmware_model.target.structs import record_type

CAR, TICK_S = steer_by_wire(), 1e-3
DESIGN = design(CAR, DesignSpecification())
TABLE = build(DESIGN, Target(TICK_S))


def test_where_the_actuator_cannot_follow_c_goes_on_from_the_error_that_it_can() -> None:
    """Conditioning: had that been the error, C would have asked for what is possible."""
    state, constants = init(TABLE)[0].tracking, TABLE.tracking
    c = tustin(DESIGN.tracking, TICK_S)
    realisable, done = [], []
    for error in np.random.default_rng(3).standard_normal(50):
        asked = output(constants.filter, state.filter, error)
        possible = min(max(asked, -3.0), 3.0)
        track(constants, state, error, asked, possible)
        realisable.append(error + (possible - asked) / c.feedthrough)
        done.append(possible)
    assert max(done) == 3.0
    assert min(done) == -3.0
    np.testing.assert_allclose(signal.sosfilt(c.sos, realisable), done, rtol=1e-7)


def test_c_with_an_integrator_settles_at_the_command() -> None:
    state = init(TABLE)[0].tracking
    settle_tracking(TABLE.tracking, state, 5.0, 42.5)
    assert output(TABLE.tracking.filter, state.filter, 0.0) == pytest.approx(42.5, rel=1e-9)


def test_c_without_one_settles_where_the_reference_leads() -> None:
    constants = np.zeros(1, record_type(CONSTANTS, "float64"))[0]
    lag = tustin(ZeroPoleGain.lag(0.01, 2).scaled(3.0), TICK_S).coefficients
    constants.filter.n = len(lag)
    constants.filter.coefficients[: len(lag)] = lag
    state = init(TABLE)[0].tracking
    settle_tracking(constants, state, 5.0, 42.5)
    assert output(constants.filter, state.filter, 5.0) == pytest.approx(15.0, rel=1e-9)
