"""Accepted values of a target, to the last meaningful value, and the defaults."""

from __future__ import annotations

import math
from typing import Any

import pytest

from firmware_model.discretisation.targets import Target
from firmware_model.errors import ParameterError
from firmware_model.law.structs import MAX_LATENCY_TICKS

TINY = 5e-324
POSITIVE = ("limit_1", "limit_2", "rate_1", "rate_2", "reference_acceleration")
RATES = ("false_alarms_per_hour", "suspicions_per_hour")
SIZES = ("lsb_1", "lsb_2", "noise_rms", "resolution", "safe_stop_s")

ACCEPTED: list[dict[str, Any]] = [
    {"latency_ticks": 0},
    {"latency_ticks": MAX_LATENCY_TICKS},
    *({name: value} for name in POSITIVE for value in (TINY, 0.5, math.inf)),
    *({name: value} for name in RATES for value in (TINY, 0.5, 1e300)),
    *({name: value} for name in SIZES for value in (0.0, TINY, 1e300)),
    {"noise_pole": 0.0},
    {"noise_pole": math.nextafter(1.0, 0.0)},
    *({"estimator": rule} for rule in ("tustin", "tustin-held", "zoh")),
]
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"latency_ticks": -1}, f"latency_ticks = -1: must be 0 to {MAX_LATENCY_TICKS}"),
    ({"latency_ticks": MAX_LATENCY_TICKS + 1}, f"must be 0 to {MAX_LATENCY_TICKS}"),
    *(({name: value}, f"{name} = {value:g}: must be above 0")
      for name in POSITIVE for value in (0.0, -TINY, -math.inf, math.nan)),
    *(({name: value}, f"{name} = {value:g}: must be finite and above 0")
      for name in RATES for value in (0.0, -TINY, math.inf, math.nan)),
    *(({name: value}, f"{name} = {value:g}: must be finite and 0 or above")
      for name in SIZES for value in (-TINY, math.inf, math.nan)),
    *(({"noise_pole": value}, "must be 0 or above, below 1") for value in (-TINY, 1.0, math.nan)),
    ({"estimator": "euler"}, "estimator = 'euler': must be one of tustin, tustin-held, zoh"),
]  # fmt: skip


@pytest.mark.parametrize("change", ACCEPTED, ids=str)
def test_the_last_value_that_means_something_is_accepted(change: dict[str, Any]) -> None:
    target = Target(1e-3, **change)
    assert {name: getattr(target, name) for name in change} == change


@pytest.mark.parametrize(("change", "reason"), REFUSED, ids=str)
def test_the_first_that_does_not_is_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Target(1e-3, **change)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_by_default_it_is_the_thesis_s() -> None:
    """No latency, no limits, no grid: d̂ is compensated as it is, always."""
    target = Target(1e-3)
    assert (target.latency_ticks, target.estimator) == (0, "tustin")
    for name in POSITIVE:
        assert getattr(target, name) == math.inf
    for name in ("lsb_1", "lsb_2", "safe_stop_s"):
        assert getattr(target, name) == 0.0
    assert target.on_confirmation is False
    assert target.prewarp_rad_per_s is None
    assert target.precision == "float64"
    # What is decided meanwhile: by a perfect sensor on a car that is the model.
    assert (target.noise_rms, target.noise_pole, target.resolution) == (0.0, 0.0, 0.0)
    assert target.mismatch.cars == ()
    assert (target.false_alarms_per_hour, target.suspicions_per_hour) == (1e-3, 3600.0)
