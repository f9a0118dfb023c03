"""The stages between bus and car: the keys of both actuators and the sensor.

All stages are immediate and perfect by default, like the thesis's.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Final, Self

from pydantic import ConfigDict, Field, PositiveFloat
from pydantic.dataclasses import dataclass

from firmware_model.design.actuator_dynamics import Stage

STRICT: Final = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
"""Refuse unknown keys, text for numbers, and non-finite numbers."""

SHORTEST_LAG_S = 1e-6  # no tick could show a shorter lag

Lag = Annotated[float, Field(ge=0.0, le=10.0)]
DeadTime = Annotated[float, Field(ge=0.0, le=100.0)]


@dataclass(frozen=True, config=STRICT)
class ActuatorLag:
    """A lag of first order, ``lag_s``, or of second order, behind a dead time."""

    lag_s: Lag = 0.0
    natural_frequency_rad_per_s: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    damping: Annotated[float, Field(gt=0.0, le=100.0)] = 1.0
    dead_time_s: DeadTime = 0.0

    def __post_init__(self) -> None:
        if 0.0 < self.lag_s < SHORTEST_LAG_S:
            raise ValueError(
                f"lag_s = {self.lag_s:g}: must be 0 (none) or at least {SHORTEST_LAG_S:g} s"
            )
        if self.lag_s > 0.0 and self.natural_frequency_rad_per_s is not None:
            raise ValueError(
                f"lag_s = {self.lag_s:g}: must not stand beside natural_frequency_rad_per_s = "
                f"{self.natural_frequency_rad_per_s:g}; an actuator has one or the other"
            )

    @property
    def stage(self) -> Stage:
        """The linear part of the lag."""
        return Stage(self.lag_s, self.natural_frequency_rad_per_s, self.damping, self.dead_time_s)

    @property
    def lags(self) -> bool:
        """Whether the actuator follows with a lag, apart from a dead time."""
        return self.lag_s > 0.0 or self.natural_frequency_rad_per_s is not None

    def slower(self, factor: float) -> Self:
        """A copy with every time constant multiplied by ``factor``."""
        omega = self.natural_frequency_rad_per_s
        return replace(
            self,
            lag_s=self.lag_s * factor,
            natural_frequency_rad_per_s=None if omega is None else omega / factor,
        )


@dataclass(frozen=True, config=STRICT)
class TorqueActuator(ActuatorLag):
    """The steering motor; without limits, the motor follows every sent command."""

    limit_nm: PositiveFloat | None = None
    rate_nm_per_s: PositiveFloat | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Largest magnitude and rate of the motor's output."""
        return _or_none(self.limit_nm), _or_none(self.rate_nm_per_s)


@dataclass(frozen=True, config=STRICT)
class ForceDifferenceActuator(ActuatorLag):
    """The rear drives; without limits, the drives follow every sent command."""

    limit_n: PositiveFloat | None = None
    rate_n_per_s: PositiveFloat | None = None

    @property
    def limits(self) -> tuple[float, float]:
        """Largest magnitude and rate of the drives' output."""
        return _or_none(self.limit_n), _or_none(self.rate_n_per_s)


@dataclass(frozen=True, config=STRICT)
class SensorSettings:
    """The sensor of D*: a dead time, a filter, noise and a resolution, in this order.

    The filter colours the noise; the rms describes the coloured noise.
    """

    noise_mps2: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    resolution_mps2: Annotated[float, Field(ge=0.0, le=1e6)] = 0.0
    corner_hz: Annotated[float, Field(ge=1e-3, le=1e5)] | None = None
    dead_time_s: DeadTime = 0.0

    @property
    def lag_s(self) -> float:
        """The time constant of the filter; 0: no filter."""
        return 0.0 if self.corner_hz is None else 1.0 / (2.0 * math.pi * self.corner_hz)

    @property
    def stage(self) -> Stage:
        """The linear part of the sensor."""
        return Stage(self.lag_s, dead_time_s=self.dead_time_s)


def _or_none(limit: float | None) -> float:
    return math.inf if limit is None else limit
