"""The keys of a fault: place, kind, begin and duration.

The first word of a kind names the place: an actuator, a sensor, or a frame in transit. A scenario
has any number of faults; faults may overlap.
"""

import math
from collections.abc import Iterable
from typing import Annotated, Final, Literal, get_args

from pydantic import Field, PositiveFloat
from pydantic.dataclasses import dataclass

from can_rig.scenario.plant_settings import STRICT
from can_rig.scenario.sensor_settings import ECHOES, MEASURED, Measured

FaultKind = Literal[
    "none",
    "actuator-dead",
    "actuator-stuck",
    "actuator-offset",
    "actuator-drift",
    "actuator-oscillating",
    "actuator-rate-limited",
    "actuator-late",
    "sensor-biased",
    "sensor-dead",
    "sensor-stuck",
    "sensor-drift",
    "sensor-oscillating",
    "sensor-rate-limited",
    "sensor-late",
    "sensor-scaled",
    "sensor-lying",
    "sensor-invalid",
    "sensor-tick-stuck",
    "sensor-swapped",
    "frames-missing",
    "frames-corrupted",
    "frames-repeated",
    "frames-late",
    "frames-forged",
    "controller-restarted",
]
Channel = Literal["torque", "force-difference"]
CHANNELS: Final[tuple[Channel, Channel]] = get_args(Channel)
"""Names of input 1 and input 2, for any plant."""
SENSOR: Final = "sensor"
"""The place of the measured output's frame."""
PLACES: Final = (*CHANNELS, SENSOR)
"""Places of faults; the index is the place's number."""
CONTROLLER: Final = "controller"
"""The place of a fault of the controller node itself."""
RESTARTED: Final = "controller-restarted"

MAX_DURATION_S: Final = 1e6
FOR_GOOD_NS: Final = 1 << 62  # later than any run
MAX_LATE_TICKS: Final = 1000

Moment = Annotated[float, Field(ge=0.0, le=MAX_DURATION_S)]
"""A moment of a run, or a duration of zero or more, s."""

Number = Annotated[float, Field(ge=-1e9, le=1e9)]
"""The number of a fault, in the unit of its place; sums and squares of such numbers are finite."""

NUMBER: Final = {
    "actuator-dead": "left",
    "sensor-dead": "left",
    "actuator-stuck": "value",
    "sensor-stuck": "value",
    "actuator-offset": "offset",
    "actuator-drift": "drift_per_s",
    "sensor-drift": "drift_per_s",
    "actuator-oscillating": "amplitude",
    "sensor-oscillating": "amplitude",
    "actuator-rate-limited": "rate_per_s",
    "sensor-rate-limited": "rate_per_s",
    "actuator-late": "late_ticks",
    "sensor-late": "late_ticks",
    "sensor-biased": "bias_mps2",
    "sensor-scaled": "gain",
    "frames-late": "late_ticks",
    "frames-forged": "value",
}
"""The key of each kind's number, for kinds with a number."""

OPTIONAL_NUMBER: Final = ("actuator-stuck", "sensor-stuck")
"""Kinds with an optional number."""

OF_ECHOES: Final = ("sensor-lying",)
SWAPPED: Final = "sensor-swapped"
OF_FURTHER_SENSORS: Final = (*OF_ECHOES, "sensor-invalid", "sensor-tick-stuck", SWAPPED)
"""Kinds of a sensor whose frame says the validity and the tick of the sample."""


def key_of(kind: str, place: str) -> str:
    """The key of the number of a fault; empty: the fault has none."""
    if kind == SWAPPED:
        return "other"
    if kind == "sensor-biased" and place in MEASURED:
        return "offset"
    return NUMBER.get(kind, "")


class Spell:
    """The kind and the time of a fault or a disturbance."""

    kind: str
    at_s: float
    for_s: float | None
    noun = "fault"

    @property
    def end_s(self) -> float:
        """Infinite for an endless one."""
        return math.inf if self.for_s is None else self.at_s + self.for_s

    @property
    def span_ns(self) -> tuple[int, int]:
        """Begin and end; whole nanoseconds, so that rounding never shifts a tick."""
        begin_ns = round(self.at_s * 1e9)
        if self.for_s is None:
            return begin_ns, FOR_GOOD_NS
        return begin_ns, begin_ns + round(self.for_s * 1e9)


@dataclass(frozen=True, config=STRICT)
class FaultSettings(Spell):
    """One fault from ``at_s`` on, endless or for ``for_s`` seconds, at every ``every``-th tick.

    ``channel`` names the actuator, the further sensor, or the sender of the frames. ``value``,
    ``offset``, ``drift_per_s``, ``amplitude`` and ``rate_per_s`` have the unit of the failing
    signal: N m, N, m/s², rad/s or rad. ``other`` names the second of two swapped sensors.
    """

    kind: FaultKind = "none"
    channel: Literal[Channel, "sensor", Measured] = "torque"
    at_s: Moment = 10.0
    for_s: Annotated[float, Field(gt=0.0, le=MAX_DURATION_S)] | None = None
    every: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    left: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    bias_mps2: Number = 0.1
    value: Number | None = None
    offset: Number | None = None
    drift_per_s: Number | None = None
    amplitude: Number | None = None
    frequency_rad_per_s: PositiveFloat = 10.0
    rate_per_s: PositiveFloat | None = None
    gain: Number | None = None
    other: Measured | None = None
    late_ticks: Annotated[int, Field(ge=1, le=MAX_LATE_TICKS)] = 10
    state_survives: bool = False

    def __post_init__(self) -> None:
        needed = None if self.kind in OPTIONAL_NUMBER else NUMBER.get(self.kind)
        if needed is not None and getattr(self, needed) is None:
            raise ValueError(f"{needed}: must be set for {self.kind!r}")
        if self.kind.startswith("actuator-") and self.channel not in CHANNELS:
            raise ValueError(
                f"channel = {self.channel!r}: must be {' or '.join(CHANNELS)} for {self.kind!r}"
            )
        allowed = ECHOES if self.kind in OF_ECHOES else MEASURED
        if self.kind in OF_FURTHER_SENSORS and self.channel not in allowed:
            raise ValueError(
                f"channel = {self.channel!r}: must be {' or '.join(allowed)} for {self.kind!r}"
            )
        if (self.other is None) == (self.kind == SWAPPED) or self.other == self.channel:
            given = "other" if self.other is None else f"other = {self.other!r}"
            must = "another sensor than the channel" if self.kind == SWAPPED else "left out"
            raise ValueError(f"{given}: must be {must} for {self.kind!r}")
        if self.channel in MEASURED:
            if self.kind == RESTARTED:
                raise ValueError(
                    f"channel = {self.channel!r}: must be one of {', '.join(PLACES)} for "
                    f"{self.kind!r}"
                )
            if self.kind == "sensor-biased" and self.offset is None:
                raise ValueError(
                    f"offset: must be set for {self.kind!r} of {self.channel!r}, in the unit of "
                    "that sensor"
                )
        if self.kind == RESTARTED:
            if self.for_s is None:
                raise ValueError(
                    f"for_s: must be set for {RESTARTED!r}, the time without power before the "
                    "controller begins again"
                )
            if self.every != 1:
                raise ValueError(f"every = {self.every}: must be 1 for {RESTARTED!r}")

    @property
    def place(self) -> str:
        """The failing place: one of ``PLACES``, a further sensor, or ``CONTROLLER``."""
        if self.kind == RESTARTED:
            return CONTROLLER
        if self.kind.startswith("sensor-") and self.channel not in MEASURED:
            return SENSOR
        return self.channel

    @property
    def bias(self) -> float:
        """What a biased sensor reads too much, in its unit."""
        return self.offset or 0.0 if self.channel in MEASURED else self.bias_mps2

    @property
    def acts_on_frames(self) -> bool:
        """Whether the fault acts on the bus or on a sender."""
        return self.kind.startswith("frames-")

    @property
    def needs_a_bus(self) -> bool:
        """Whether a log needs nodes: other frames than the regular, perhaps damaged commands."""
        alone = "frames-missing" if self.place == SENSOR else "frames-corrupted"
        regular = self.place in PLACES and self.kind in {"frames-missing", alone}
        return self.acts_on_frames and not regular

    @property
    def loses_a_channel(self) -> bool:
        """Whether an actuator ignores its command, in full or in part."""
        return self.kind != "none" and self.place in CHANNELS

    @property
    def span_ns(self) -> tuple[int, int]:
        """See ``Spell``; of no fault after any run."""
        return (FOR_GOOD_NS, FOR_GOOD_NS) if self.kind == "none" else super().span_ns

    def span_ticks(self, tick_ns: int) -> tuple[int, int]:
        """The first tick of the fault, and the first tick after the fault."""
        begin_ns, end_ns = self.span_ns
        return -(-begin_ns // tick_ns), -(-end_ns // tick_ns)

    def ticks(self, tick_ns: int, run: range) -> range:
        """The ticks of ``run`` with the fault active."""
        begin, end = self.span_ticks(tick_ns)
        steps = -(-max(run.start - begin, 0) // self.every)
        return range(begin + steps * self.every, min(end, run.stop), self.every)


@dataclass(frozen=True)
class Outage:
    """Ticks in which the controller has no power, from ``start`` until before ``stop``.

    ``state_survives``: the controller begins again with the state saved before ``start``.
    """

    start: int
    stop: int
    state_survives: bool = False

    def __contains__(self, tick: int) -> bool:
        return self.start <= tick < self.stop


def outages(faults: Iterable[FaultSettings], tick_ns: int) -> tuple[Outage, ...]:
    """The outages of the controller, in order; each ends with a restart.

    Outages that touch are one, whose state survives if the state survives each. An outage between
    two ticks has no tick: a restart alone.
    """
    found = sorted(
        (*fault.span_ticks(tick_ns), fault.state_survives)
        for fault in faults
        if fault.kind == RESTARTED
    )
    merged: list[Outage] = []
    for begin, end, survives in found:
        last = merged[-1] if merged else None
        if last is not None and begin <= last.stop:
            both = last.state_survives and survives
            merged[-1] = Outage(last.start, max(end, last.stop), both)
        else:
            merged.append(Outage(begin, end, survives))
    return tuple(merged)
