"""The keys of a further sensor: what it measures, how well, and when its frames come.

Defaults are figures of clusters in series: a yaw rate in steps of 0.005 °/s and an acceleration in
steps of 1.274e-4 g every 10 ms, with the noise and the corner of the sensors in them.
"""

import math
from dataclasses import dataclass as plain_dataclass
from typing import Annotated, Final, Literal, get_args

from pydantic import Field
from pydantic.dataclasses import dataclass

from can_rig.scenario.plant_settings import STRICT

Measured = Literal[
    "yaw-rate", "lateral-acceleration", "steering-angle", "torque-echo", "force-difference-echo"
]
MEASURED: Final[tuple[Measured, ...]] = get_args(Measured)
"""What a sensor can measure, in the order of the frames; each word names its sensor."""
YAW_RATE: Final[Measured] = "yaw-rate"
LATERAL_ACCELERATION: Final[Measured] = "lateral-acceleration"
ECHOES: Final[tuple[Measured, ...]] = ("torque-echo", "force-difference-echo")
"""What each actuator says it applies, by channel."""
HEARD: Final[tuple[Measured, ...]] = (*ECHOES, YAW_RATE, LATERAL_ACCELERATION)
"""What the rig's own law hears, in the order of the numbers of ``further_sensors.hear``."""

USUAL_PERIOD_S: Final = 0.01
LONGEST_PERIOD_S: Final = 1.0
WHOLE: Final = 1e-6  # of a tick
SAMPLE_TICKS: Final = 1 << 12
"""The sample's tick is sent modulo this number."""


@plain_dataclass(frozen=True)
class Usual:
    """What is measured, and the figures of a usual sensor; units are those of ``column``."""

    column: str
    """Of ``signals.csv``, ending in the unit."""
    signal: str
    """The name by which a plant class reports the quantity; empty: the actuator has the sensor."""
    noise: float
    resolution: float
    corner_hz: float | None


DEGREE: Final = math.pi / 180.0
GRAVITY_MPS2: Final = 9.80665
STEERING_RATIO: Final = 16.0
"""From the steering wheel, whose angle cars send, to the road wheels."""

USUAL: Final[dict[str, Usual]] = {
    "yaw-rate": Usual(
        "measured_yaw_rate_rad_per_s", "yaw_rate_rad_per_s", 0.1 * DEGREE, 0.005 * DEGREE, 50.0
    ),
    "lateral-acceleration": Usual(
        "measured_lateral_acceleration_mps2",
        "specific_force_mps2",
        0.006 * GRAVITY_MPS2,
        1.274e-4 * GRAVITY_MPS2,
        50.0,
    ),
    "steering-angle": Usual(
        "measured_steering_angle_rad",
        "steering_angle_rad",
        0.0,
        0.1 * DEGREE / STEERING_RATIO,
        None,
    ),
    "torque-echo": Usual("torque_echo_nm", "", 0.2, 0.1, None),
    "force-difference-echo": Usual("force_difference_echo_n", "", 5.0, 1.0, None),
}


@dataclass(frozen=True, config=STRICT)
class FurtherSensor:
    """A sensor with frames of its own, beside D* or instead of it.

    The quantity passes a filter of first order (``corner_hz``, 0: none), gets noise and the
    resolution, both in the unit of the column, and waits ``delay_s`` for its frame. Unset figures
    are those of ``USUAL``. A frame is sent every ``period_s`` from ``phase_s`` on. ``signal`` names
    the quantity in the report of a plant class or an FMU. The first three words of ``MEASURED``
    are outputs 2 to 4 of a plant by numbers, each with the row ``c`` (n,) of its states; such a
    sensor is perfect by default.
    """

    measures: Measured
    period_s: Annotated[float, Field(gt=0.0, le=LONGEST_PERIOD_S)] | None = None
    phase_s: Annotated[float, Field(ge=0.0, le=LONGEST_PERIOD_S)] = 0.0
    delay_s: Annotated[float, Field(ge=0.0, le=LONGEST_PERIOD_S)] = 0.0
    noise: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    resolution: Annotated[float, Field(ge=0.0, le=1e6)] | None = None
    corner_hz: Annotated[float, Field(ge=0.0, le=1e5)] | None = None
    signal: str = ""
    c: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.corner_hz is not None and 0.0 < self.corner_hz < 1e-3:
            raise ValueError(f"corner_hz = {self.corner_hz:g}: must be 0 (none) or at least 0.001")
        if self.signal and not self.signal.isidentifier():
            raise ValueError(f"signal = {self.signal!r}: must be a name of letters, digits and _")
        if self.signal and self.measures in ECHOES:
            raise ValueError(
                f"signal = {self.signal!r}: must not be set for {self.measures!r}, which the "
                "actuator says"
            )

    @property
    def usual(self) -> Usual:
        """What is measured."""
        usual = USUAL[self.measures]
        return usual if self.c is None else Usual(usual.column, usual.signal, 0.0, 0.0, None)

    @property
    def noise_rms(self) -> float:
        """Rms of the noise."""
        return self.usual.noise if self.noise is None else self.noise

    @property
    def step(self) -> float:
        """The resolution; 0: none."""
        return self.usual.resolution if self.resolution is None else self.resolution

    @property
    def lag_s(self) -> float:
        """The time constant of the filter; 0: no filter."""
        corner_hz = self.usual.corner_hz if self.corner_hz is None else self.corner_hz
        return 1.0 / (2.0 * math.pi * corner_hz) if corner_hz else 0.0

    @property
    def role(self) -> str:
        """The role of its frame."""
        return self.measures.replace("-", "_")

    @property
    def source(self) -> str:
        """The name of its quantity in a plant's report; empty for an echo."""
        return self.signal or self.usual.signal

    def timing(self, tick_s: float) -> tuple[int, int, int]:
        """Period, phase and delay in ticks."""
        period_s = self.period_s or max(math.ceil(USUAL_PERIOD_S / tick_s - WHOLE), 1) * tick_s
        period, phase, delay = (
            round(time_s / tick_s) for time_s in (period_s, self.phase_s, self.delay_s)
        )
        return period, phase, delay

    def refuse_times(self, tick_s: float) -> None:
        """Refuse times that are no whole number of ticks.

        Raises:
            ValueError: names the key.
        """
        for key in ("period_s", "phase_s", "delay_s"):
            time_s = getattr(self, key)
            if time_s is None:
                continue
            ticks = time_s / tick_s
            if abs(ticks - round(ticks)) > WHOLE or (key == "period_s" and ticks < 0.5):
                raise ValueError(
                    f"{key} = {time_s:g}: must be a whole number of ticks of {tick_s:g} s"
                )
        period, phase, delay = self.timing(tick_s)
        if phase >= period:
            raise ValueError(
                f"phase_s = {self.phase_s:g}: must be less than the period, {period * tick_s:g} s"
            )
        if delay >= SAMPLE_TICKS // 2:
            raise ValueError(
                f"delay_s = {self.delay_s:g}: must be less than {SAMPLE_TICKS // 2} ticks, which "
                "the sample's tick can tell"
            )
