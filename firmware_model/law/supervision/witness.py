"""The witness: D* made of yaw rate and lateral acceleration, beside the sensor of D*.

The output has three sources: the sensor (y), the model (p, the prediction with the known loss), and
the witness

    z = d a + (1 - d) V γ        (3.8), with a the lateral acceleration and γ the yaw rate

Each sample of the witness compares the three sources at the time of the sample. Where y and z are
further apart than noise explains, the model decides:

    p is near z    the sensor is *denied*: p plus the last z - p replaces y
    p is near y    the witness is wrong: nothing follows

A car that slides little has nearly equal a and V γ. Where a and V γ are further apart than y and z,
the yaw rate or the acceleration is wrong, and the witness denies nothing.

Where y and z agree against p, the sensor is *acquitted*: d̂ shows a fault of another place. A wrong
sensor may have confirmed a loss before the first contradiction; the model without that loss is
near z, and the loss is *refuted*.

``working`` samples in agreement, of a moving car, end the denial of a sensor; so does a witness
that is found wrong. A witness that stays away for long gives no information.

In a car without a sensor of D* (``makes``), z is the measurement, and nothing judges z.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

from firmware_model.compiled import firmware
from firmware_model.law.precision import real
from firmware_model.law.structs import MAX_COUNTED, FloatArray, Struct
from firmware_model.law.supervision.echoes import KEPT_TICKS

if TYPE_CHECKING:
    from firmware_model.law.layout import Table


class Constants(Struct):
    """Constants."""

    lateral_weight: Annotated[float, "1", "d"]
    speed: Annotated[float, "m/s", "V"]
    late: Annotated[float, "tick", "lag of both sensors"]
    longest: Annotated[
        int,
        "tick",
        "largest age of a witness that counts; 0: there is no witness",
        (0, MAX_COUNTED),
    ]
    keep: Annotated[float, "1", "factor per sample of the fading sums"]
    noise: Annotated[float, "y²", "fading sum that noise never reaches"]
    doubt: Annotated[float, "1", "square of the share by which V may be off; 0: V is measured"]
    nearer: Annotated[float, "1", "least ratio of the fading sums to tell who is wrong"]
    working: Annotated[int, "1", "samples in agreement that end a denial", (0, MAX_COUNTED)]
    makes: Annotated[int, "1", "1: D* is made of both, for there is no sensor of D*", (0, 1)]


class Sample(Struct):
    """The last sample of a sensor."""

    value: Annotated[float, "1", "in the unit of the sensor"]
    age: Annotated[float, "tick", "since the sample"]
    fresh: Annotated[int, "1", "1: not used yet"]


class State(Struct):
    """State."""

    yaw_rate: Annotated[Sample, "rad/s", "γ"]
    acceleration: Annotated[Sample, "m/s²", "a"]
    measured: Annotated[FloatArray, "y", "ring of y", (KEPT_TICKS,)]
    expected: Annotated[FloatArray, "y", "ring of p", (KEPT_TICKS,)]
    healthy: Annotated[FloatArray, "y", "ring of p without any known loss", (KEPT_TICKS,)]
    index: Annotated[int, "1", "index of this tick in the rings"]
    difference: Annotated[float, "y", "z - p of the last sample"]
    healthy_difference: Annotated[float, "y", "likewise, p without any known loss"]
    power: Annotated[float, "y²", "fading Σ z²"]
    apart: Annotated[float, "y²", "fading Σ (y - z)²"]
    inner: Annotated[float, "y²", "fading Σ (a - V γ)²"]
    sensor_off: Annotated[float, "y²", "fading Σ (y - p)²"]
    sensor_healthy_off: Annotated[float, "y²", "fading Σ (y - p)², p without any known loss"]
    witness_off: Annotated[float, "y²", "fading Σ (z - p)²"]
    healthy_off: Annotated[float, "y²", "fading Σ (z - p)², p without any known loss"]
    age: Annotated[float, "tick", "since the last sample"]
    left: Annotated[int, "tick", "for so long the last sample counts; 0: no witness"]
    unbroken: Annotated[float, "tick", "since y - p jumped within a tick"]
    good: Annotated[int, "1", "samples in agreement, one after another"]
    denied: Annotated[int, "1", "1: the sensor is wrong"]


@firmware
def take_sample(table: Table, own: Sample, value: float, age: float) -> None:
    """Keep a sample for the ``weigh_witness`` of this tick."""
    if table.witness.longest > 0:
        own.value, own.age, own.fresh = value, age, 1


@firmware
def weigh_witness(table: Table, own: State, y: float, expected: float, healthy: float) -> None:
    """Compare sensor, witness and model, if both sensors have news.

    Args:
        table: the constant table.
        own: changed in place.
        y: measurement of this tick; not a number if missing.
        expected: y by the model with the known loss.
        healthy: y by the model without any known loss.
    """
    before = (own.index + KEPT_TICKS - 1) % KEPT_TICKS
    jump = y - healthy - (own.measured[before] - own.healthy[before])
    if jump * jump > table.witness.noise:
        own.unbroken = real(0.0, jump)
    own.measured[own.index], own.expected[own.index] = y, expected
    own.healthy[own.index] = healthy
    if not has_news(own):
        return
    use_samples(own)
    constants, one, witness = table.witness, real(1.0, expected), said(table.witness, own)
    turning, sliding = constants.speed * own.yaw_rate.value, own.acceleration.value
    weight, oldest = constants.lateral_weight, max(own.yaw_rate.age, own.acceleration.age)
    age = weight * own.acceleration.age + (one - weight) * own.yaw_rate.age + constants.late
    counts = oldest <= real(constants.longest, age)
    if not (counts and age >= 0.0 and age < real(KEPT_TICKS, age) and math.isfinite(witness)):
        return
    at = (own.index + KEPT_TICKS - int(age)) % KEPT_TICKS
    own.age = age
    own.difference, own.left = witness - own.expected[at], constants.longest
    own.healthy_difference = witness - own.healthy[at]
    if math.isfinite(own.measured[at]):
        compare(constants, own, at, witness, sliding - turning)


@firmware
def has_news(own: State) -> bool:
    """Whether both sensors have said something since the last comparison."""
    return own.yaw_rate.fresh == 1 and own.acceleration.fresh == 1


@firmware
def use_samples(own: State) -> None:
    """The last samples are no news from now on."""
    own.yaw_rate.fresh = own.acceleration.fresh = 0


@firmware
def said(constants: Constants, own: State) -> float:
    """z of the last samples."""
    one, turning = real(1.0, own.difference), constants.speed * own.yaw_rate.value
    weight = constants.lateral_weight
    witness: float = weight * own.acceleration.value + (one - weight) * turning
    return witness


@firmware
def compare(constants: Constants, own: State, at: int, witness: float, inner: float) -> None:
    """Who is wrong, with the sample ``witness`` of the tick ``at``; ``inner``: a - V γ."""
    measured, healthy = own.measured[at], own.healthy_difference
    apart, sensor = measured - witness, measured - own.expected[at]
    sensor_healthy = measured - own.healthy[at]
    own.power = constants.keep * own.power + witness * witness
    own.apart = constants.keep * own.apart + apart * apart
    own.inner = constants.keep * own.inner + inner * inner
    own.sensor_healthy_off = (
        constants.keep * own.sensor_healthy_off + sensor_healthy * sensor_healthy
    )
    own.sensor_off = constants.keep * own.sensor_off + sensor * sensor
    own.witness_off = constants.keep * own.witness_off + own.difference * own.difference
    own.healthy_off = constants.keep * own.healthy_off + healthy * healthy
    off = own.apart > unsure(constants, own)
    if off:
        own.good = 0
    elif constants.nearer * constants.nearer * own.apart < own.power:
        own.good = min(own.good + 1, MAX_COUNTED)
    nearer = constants.nearer * own.witness_off < own.sensor_off
    nearer = nearer or constants.nearer * own.healthy_off < own.sensor_healthy_off
    sound = agrees_with_itself(constants, own)
    if off and sound and nearer:
        own.denied = 1
    wrong = off and not sound and constants.nearer * own.sensor_off < own.witness_off
    if wrong or own.good >= constants.working:
        own.denied = 0
    if not math.isfinite(own.power + own.inner + own.sensor_off + own.witness_off + own.apart):
        forget_samples(own)


@firmware
def unsure(constants: Constants, own: State) -> float:
    """The fading sum up to which noise and an unknown speed explain a difference from z.

    Three times what the speed explains: from there on ``agrees_with_itself`` tells a wrong γ.
    """
    three, of_speed = real(3.0, own.power), real(1.0, own.power) - constants.lateral_weight
    limit: float = constants.noise + three * constants.doubt * of_speed * of_speed * own.power
    return limit


@firmware
def agrees_with_itself(constants: Constants, own: State) -> bool:
    """Whether a and V γ are not as far apart as a wrong one would set y and z apart."""
    half, two = real(0.5, own.inner), real(2.0, own.inner)
    agrees: bool = own.inner < half * own.apart + two * constants.doubt * own.power
    return agrees


@firmware
def contradicts(constants: Constants, own: State) -> bool:
    """Whether a witness that agrees with itself contradicts the sensor."""
    apart = own.left > 0 and own.apart > unsure(constants, own)
    contradicted: bool = apart and agrees_with_itself(constants, own)
    return contradicted


@firmware
def agrees_with_sensor(constants: Constants, own: State) -> bool:
    """Whether the witness is no further from the sensor than noise explains."""
    agrees: bool = own.apart < unsure(constants, own)
    return agrees


@firmware
def acquits(constants: Constants, own: State) -> bool:
    """Whether the witness says of d̂ that the sensor is right, since the last jump of y."""
    limit = unsure(constants, own)
    off = own.left > 0 and own.witness_off > limit
    agrees = agrees_with_sensor(constants, own) and not own.age > own.unbroken
    acquitted: bool = off and agrees and constants.nearer * own.apart < own.sensor_off
    return acquitted


@firmware
def refutes(constants: Constants, own: State) -> bool:
    """Whether the witness says that nothing is lost."""
    off = own.left > 0 and own.witness_off > unsure(constants, own)
    refuted: bool = off and constants.nearer * own.healthy_off < own.witness_off
    return refuted


@firmware
def forget_loss(own: State) -> None:
    """The model never knew of a loss."""
    for i in range(KEPT_TICKS):
        own.expected[i] = own.healthy[i]
    own.difference = own.healthy_difference
    own.witness_off = own.healthy_off


@firmware
def advance_witness(table: Table, own: State) -> None:
    """A tick on."""
    if table.witness.longest == 0:
        return
    one = real(1.0, own.difference)
    own.index = (own.index + 1) % KEPT_TICKS
    own.yaw_rate.age += one
    own.acceleration.age += one
    own.age += one
    own.unbroken += one
    if own.left > 0:
        own.left -= 1
    if own.left == 0:
        forget_samples(own)


@firmware
def forget_samples(own: State) -> None:
    """Nothing is known from samples; a denied sensor stays denied."""
    own.good = 0
    own.power = own.apart = own.inner = own.sensor_off = own.sensor_healthy_off = 0.0
    own.witness_off = own.healthy_off = 0.0


@firmware
def settle_witness(own: State, output: float) -> None:
    """Sensor and model have said ``output`` for long; no sample has come."""
    own.measured[:] = output
    own.expected[:] = output
    own.healthy[:] = output
    own.yaw_rate.fresh = own.acceleration.fresh = own.left = own.denied = 0
    own.difference = own.healthy_difference = own.age = own.unbroken = 0.0
    forget_samples(own)
