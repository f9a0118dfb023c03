"""A candidate of ``can-rig tune``: noise, response to a loss of the torque, every car of the box.

The box has the nominal car and the vertices around it. The nominal car keeps the design; each
vertex supplies the plant. A vertex need only be stable; the design may be impossible for a vertex
(its G1 or G2 may have zeros in the right half plane). Vertices prove nothing about the inside of
the box. The loop of this car is worst at the vertices; a test confirms this with cars from the
inside.

Refused candidates are counted by reason; the counts give the most helpful change.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from operator import methodcaller

import numpy as np

from can_rig.assessment.drives import Drives, Finding
from can_rig.assessment.limitations import unavoidable
from can_rig.drawing.names import names_of, with_unit
from can_rig.errors import ScenarioError, did_you_mean
from can_rig.scenario.box import plant_of_box, uncertain, with_actuators, with_values
from can_rig.scenario.build import continuous_design, continuous_plant, slowness, target
from can_rig.scenario.plant_settings import ActuatorLag, PlantSettings
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import DesignSettings, Scenario
from firmware_model.analysis.margins import HEALTHY, TORQUE_DEAD, noise_gain, peak_sensitivity
from firmware_model.analysis.sampled_loop import (
    LinearController,
    SampledLoop,
    linear_controller,
    sampled_loop,
)
from firmware_model.analysis.sampled_plant import sample
from firmware_model.analysis.simulation import simulate
from firmware_model.design.factors import unstable
from firmware_model.design.plants import Plant
from firmware_model.design.vehicle import VehicleParameters
from firmware_model.discretisation.tables import build
from firmware_model.errors import DesignError
from firmware_model.law.layout import Table
from firmware_model.law.structs import FloatArray

Range = tuple[float, float]
Law = tuple[LinearController, tuple[float, float]]  # and the remaining shares of the actuators
KEYS = tuple(field.name for field in dataclasses.fields(VehicleParameters))
MAX_KEYS = 8  # 256 vertices
MAX_DELAY_TICKS = 8  # largest extra delay of a counted margin


@dataclass(frozen=True)
class Car:
    """A stable plant, its settings, and its difference from the nominal car in words."""

    label: str
    plant: Plant
    settings: PlantSettings

    def steady_commands(self, dstar_mps2: float) -> tuple[float, float]:
        """|Torque| in N m and |X_diff| in N to hold ``dstar_mps2``, each channel alone."""
        size = abs(dstar_mps2)
        return size / abs(self.plant.g1.dc_gain), size / abs(self.plant.g2.dc_gain)


def parameter_ranges(
    nominal: PlantSettings, share: float, settings: Iterable[str] = ()
) -> dict[str, Range]:
    """The box: lowest and highest value of each uncertain parameter.

    Args:
        nominal: the car in its middle.
        share: largest difference of each of ``uncertain``, 0.2 for ±20 %; 0 for no difference.
        settings: ``plant.KEY=LOW..HIGH``, for these parameters or, for a car, other parameters.

    Raises:
        ScenarioError: a share outside 0..1, a setting that cannot be read, too many parameters.
    """
    if not 0.0 <= share < 1.0:
        raise ScenarioError(f"--box {share:g}: must be 0 to below 1, as in 0.2 for ±20 %")
    box: dict[str, Range] = {}
    if share > 0.0:
        for key, value in uncertain(nominal).items():
            box[key] = (value * (1.0 - share), value * (1.0 + share))
    keys = KEYS if nominal.is_car else tuple(uncertain(nominal))
    for setting in settings:
        key, _, text = setting.removeprefix("plant.").partition("=")
        low, _, high = text.partition("..")
        try:
            box[key] = (float(low), float(high))
        except ValueError:
            box[key] = (1.0, 0.0)
        if key not in keys or not box[key][0] <= box[key][1]:
            example = "plant.speed_mps=8..12" if nominal.is_car else f"plant.{keys[0]}=0.8..1.2"
            hint = did_you_mean(key, [] if key in keys else keys, f"as in {example}")
            raise ScenarioError(f"--box-set {setting}: must be plant.KEY=LOW..HIGH, {hint}")
    if len(box) > MAX_KEYS:
        raise ScenarioError(f"box: {len(box)} parameters; must be at most {MAX_KEYS}")
    return box


def cars_of(scenario: Scenario, share: float, settings: Iterable[str] = ()) -> list[Car]:
    """The cars that every tuning of ``scenario`` must hold, including the budget's lags.

    Raises:
        ScenarioError: as ``parameter_ranges`` and ``cars``.
    """
    ranges = parameter_ranges(scenario.model, share, settings)
    return cars(scenario.model, ranges, scenario.budget.actuator_box)


def cars(nominal: PlantSettings, box: Mapping[str, Range], lag_share: float = 0.0) -> list[Car]:
    """The nominal car, then the vertices of ``box``.

    Args:
        nominal: the car in its middle.
        box: from ``parameter_ranges``.
        lag_share: largest difference of both actuators' lags, 0.3 for ±30 %.

    Raises:
        ScenarioError: an unstable car, or an impossible car.
    """
    found = [Car("the nominal car", continuous_plant(nominal), nominal)]
    lags = (lag_share,) if nominal.torque_actuator.lags and lag_share > 0.0 else ()
    corners = product(*box.values(), *((1.0 - share, 1.0 + share) for share in lags))
    for corner in corners if box or lags else ():
        values = dict(zip(box, corner, strict=False))
        label = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        with plant_of_box(f"box: {label}", "--box or --box-set"):
            settings = with_values(nominal, values)
            if lags:
                settings = with_actuators(settings, methodcaller("slower", corner[-1]))
                label += f", lags × {corner[-1]:g}"
            found.append(Car(label, continuous_plant(settings), settings))
    return found


def laws(table: Table) -> tuple[Law, Law]:
    """The law and the actuators' remaining shares: healthy, and with the torque channel dead."""
    return (
        (linear_controller(table), HEALTHY),
        (linear_controller(table, confirmed=1.0), TORQUE_DEAD),
    )


def loops(states: tuple[Law, Law], car: Car, tick_s: float) -> list[SampledLoop]:
    """The loop with ``car``, healthy and with the torque channel dead."""
    return [sampled_loop(law, car.plant, tick_s, left) for law, left in states]


def is_stable(
    table: Table,
    some: Iterable[Car],
    tick_s: float,
    spare_ticks: int,
    states: tuple[Law, Law] | None = None,
) -> bool:
    """Whether all cars are stable, healthy and lost, with up to ``spare_ticks`` of extra delay.

    ``states`` are ``laws(table)``, where the caller has them.

    A false alarm must be stable too, without extra delay: a car other than the nominal car shows
    some d̂, and a table with compensation on confirmation may then compensate for a working
    channel.
    """
    healthy, lost = states or laws(table)
    needed = [(law, extra) for extra in range(spare_ticks, -1, -1) for law in (healthy, lost)]
    if table.compensator.on_confirmation:
        needed.append(((lost[0], HEALTHY), 0))
    return all(_is_stable(law, car, tick_s, extra) for car in some for law, extra in needed)


def delay_margin(table: Table, some: Iterable[Car], tick_s: float, known: int = -1) -> int:
    """Extra ticks of delay, up to ``MAX_DELAY_TICKS``, through which every car is stable.

    Healthy and lost; -1 for a car unstable without extra delay. All cars are known to be stable
    with ``known`` ticks.
    """
    margin, states = max(MAX_DELAY_TICKS, known), laws(table)
    for car, law in product(some, states):
        for extra in range(known + 1, margin + 1):
            if not _is_stable(law, car, tick_s, extra):
                margin = extra - 1
                break
    return margin


def _is_stable(law: Law, car: Car, tick_s: float, extra_ticks: int) -> bool:
    controller, left = law
    loop = sampled_loop(controller, car.plant, tick_s, left, extra_ticks)
    return loop.spectral_radius() < 1.0


class Refusal(StrEnum):
    """The first test that a tuning fails, in the order of the tests."""

    DESIGN = "no such design, or none that can be discretised"
    NOMINAL = "unstable with the nominal {car}"
    NOMINAL_SPARE = "unstable with the nominal {car}, only because of the ticks to spare"
    THIN = "the peak |S| above budget.peak_sensitivity with the nominal {car}"
    NOISE = "noise in a command without bound"
    TORQUE_NOISE = "{first} noise above --torque-noise-limit"
    FORCE_NOISE = "{second} noise above --noise-limit"
    TRANSIENT = "the transient after the loss does not decay with the nominal {car}"
    BOX = "unstable with a {car} of the box"
    BOX_SPARE = "unstable with a {car} of the box, only because of the ticks to spare"
    FALSE_ALARM = "a {car} of the box is taken for one that has lost {first_said}"
    REST_SPARE = "a {car} of the box does not come to rest, only because of the ticks to spare"
    REST = "a {car} of the box does not come to rest"
    BOTH_LIMITS = "a {car} of the box does not come to rest because of the limits of both commands"
    TORQUE_LIMIT = "a {car} of the box does not come to rest because of the limit of {first_said}"
    FORCE_LIMIT = "a {car} of the box does not come to rest because of the limit of {second}"

    def text(self, plant: PlantSettings) -> str:
        """In the words of ``plant``."""
        _, first, second = names_of(plant)
        return str(self).format(
            car=plant.noun, first=first.short, first_said=first.said, second=second.short
        )


class NoTuningError(ScenarioError):
    """No tuning passes every test.

    Attributes:
        refusals: how many fail each test; ``rows`` in words, in the order of the tests.
        advice: which change would help most.
    """

    exit_status = 1

    def __init__(self, scenario: Scenario, refusals: Counter[Refusal], advice: str) -> None:
        self.refusals = refusals
        self.rows = [
            (reason.text(scenario.plant), refusals[reason])
            for reason in Refusal
            if refusals[reason]
        ]
        self.advice = advice
        tried = refusals.total()
        most, count = refusals.most_common(1)[0]
        super().__init__(
            f"scenario {scenario.name}: none of {tried} tunings passes; {count}: "
            f"{most.text(scenario.plant)}; {advice}"
        )


def refusals_as_dict(refusals: Counter[Refusal]) -> dict[str, int]:
    """For JSON: numbers by the names of the reasons."""
    return {reason.name.lower(): refusals[reason] for reason in Refusal if refusals[reason]}


def advice(scenario: Scenario, cars: Iterable[Car], refusals: Counter[Refusal]) -> str:
    """The change that admits the tunings with the most tests passed.

    A tuning that fails a late test has passed all earlier tests, so a single change suffices.
    """
    furthest = [reason for reason in Refusal if refusals[reason]][-1]
    if furthest in _AT_REST:
        furthest = max(_AT_REST, key=lambda reason: refusals[reason])
    needs = zip(
        *(car.steady_commands(scenario.reference.amplitude_mps2) for car in cars), strict=True
    )
    torque_nm, force_n = (max(need) for need in needs)
    limits, (_, first, second) = scenario.limits, names_of(scenario.plant)
    car = scenario.plant.noun

    def need(size: float, unit: str) -> str:
        return f"the most demanding {car} needs {with_unit(f'{size:.4g}', unit)} to hold the step"

    return _ADVICE[furthest].format(
        car=car,
        torque=_limit("limits.torque_nm", limits.torque_nm, torque_nm, need(torque_nm, first.unit)),
        force=_limit(
            "limits.force_difference_n",
            limits.force_difference_n,
            force_n,
            need(force_n, second.unit),
        ),
    )


def _limit(key: str, limit: float | None, needed: float, need: str) -> str:
    if limit is None:
        return f"{key} is not set, and {need}"
    if needed > limit:
        return f"{key} = {limit:g} must be larger: {need}"
    return f"{key} = {limit:g} must leave more room for the transient: {need}"


_AT_REST = (Refusal.FORCE_LIMIT, Refusal.TORQUE_LIMIT, Refusal.BOTH_LIMITS, Refusal.REST)
_FASTER = "a smaller latency_ticks or a shorter tick_s would help most"
_SMALLER = "a smaller --box or a smaller reference.amplitude_mps2 would help too"
_ADVICE = {
    Refusal.DESIGN: "the {car} must be one that can be designed for; can-rig check says why",
    Refusal.NOMINAL: _FASTER,
    Refusal.NOMINAL_SPARE: "fewer --spare-ticks would help most",
    Refusal.THIN: "a larger budget.peak_sensitivity would help most, or " + _FASTER,
    Refusal.NOISE: _FASTER,
    Refusal.TORQUE_NOISE: "a larger --torque-noise-limit would help most",
    Refusal.FORCE_NOISE: "a larger --noise-limit would help most",
    Refusal.TRANSIENT: "wider limits would help most: {torque}; {force}",
    Refusal.BOX: "a smaller --box would help most",
    Refusal.BOX_SPARE: "fewer --spare-ticks or a smaller --box would help most",
    Refusal.FALSE_ALARM: "a larger budget.box, or a smaller --box, would help most",
    Refusal.REST_SPARE: "fewer --spare-ticks or a smaller --box would help most",
    Refusal.REST: "a smaller --box would help most",
    Refusal.BOTH_LIMITS: "{torque}; {force}; " + _SMALLER,
    Refusal.TORQUE_LIMIT: "{torque}; " + _SMALLER,
    Refusal.FORCE_LIMIT: "{force}; " + _SMALLER,
}


Values = tuple[float, int, float, int]  # τ, α, τ_q, α_q

E6 = (1.0, 1.5, 2.2, 3.3, 4.7, 6.8)  # preferred numbers, a factor of about 1.5 apart
E12 = (1.0, 1.2, 1.5, 1.8, 2.2, 2.7, 3.3, 3.9, 4.7, 5.6, 6.8, 8.2)
TAU_TICKS = (0.1, 10.0)  # smallest and largest of the grid, in ticks
# Largest lag of D* behind the reference, α_q τ_q: the longer.
RESPONSE_TICKS, RESPONSE_S = 20.0, 0.05
OF_ZERO = 0.05, 2.0  # and where a zero lies right of the axis at z: of 1/|z|, which F̂ cannot beat
RESPONSE_OF_ZERO = 10.0  # nor can C
HELD = 10.0  # times as slow where C has to hold the plant, in spite of all delays
ORDERS, TRACKING_ORDERS = 2, 3  # upwards from the smallest value that the car allows

BEFORE_S, AFTER_S = 2.0, 2.0  # the loss; multiplied by ``slowness`` for a plant other than a car
NOISE_SIGMAS = 3.0  # noise in a command that must fit below the limit
DECAYED = 0.5  # largest part of the peak in the last quarter of a transient that decays


@dataclass(frozen=True)
class Tuning:
    """One candidate and what it achieves.

    Attributes:
        design: its keys; the scenario supplies the rest.
        peak_mps2: largest deviation from the fault-free run after the loss.
        unavoidable_mps2: what no controller avoids; see ``unavoidable``.
        noise_to_torque: rms of the torque command for D* noise of rms 1 m/s², N m per m/s².
        noise_to_force: the same for X_diff, N per m/s²; each in the worse of the two states.
        torque_peak_nm: over the whole run, the first step of the reference included.
        torque_after_nm, force_after_n: largest commands from the loss on.
        within_limits: the peaks plus ``NOISE_SIGMAS`` of the noise stay below the limits.
        delay_margin_ticks: of the worst car of the box; None where it was not computed.
    """

    design: DesignSettings
    peak_mps2: float
    unavoidable_mps2: float
    noise_to_torque: float
    noise_to_force: float
    torque_peak_nm: float
    torque_after_nm: float
    force_after_n: float
    within_limits: bool
    delay_margin_ticks: int | None = None

    @property
    def peak_ratio(self) -> float:
        """The peak relative to the unavoidable deviation."""
        return self.peak_mps2 / self.unavoidable_mps2

    @property
    def changes(self) -> dict[str, float]:
        """The scenario keys of this tuning, for ``can_rig.run``."""
        keys = ("tau_s", "alpha", "tau_q_s", "alpha_q")
        return {f"design.{key}": getattr(self.design, key) for key in keys}


def grid(scenario: Scenario) -> list[Values]:
    """τ, α, τ_q, α_q of every candidate; round numbers between multiples of the tick."""
    car, tick_s = continuous_plant(scenario.model), scenario.tick_s
    least, least_q = car.g2.relative_degree, car.g1.relative_degree
    right = [abs(zero) for g in (car.g1, car.g2) for zero in g.zeros if zero.real > 0.0]
    zero_s = 1.0 / min(right) if right else 0.0
    slowest_s = max(RESPONSE_TICKS * tick_s, RESPONSE_S, RESPONSE_OF_ZERO * zero_s)
    slowest_s *= HELD if unstable(car.g1) else 1.0
    low_s, high_s = (max(n * tick_s, m * zero_s) for n, m in zip(TAU_TICKS, OF_ZERO, strict=True))
    return [
        (tau_s, alpha, tau_q_s, alpha_q)
        for alpha_q in range(least_q, least_q + TRACKING_ORDERS)
        for tau_q_s, tau_s, alpha in product(
            _round_numbers(E12, max(tick_s, low_s), slowest_s / alpha_q),
            _round_numbers(E6, low_s, high_s),
            range(least, least + ORDERS),
        )
    ]


def with_tuning(scenario: Scenario, values: Values) -> Scenario:
    """``scenario`` with these τ, α, τ_q, α_q."""
    tau_s, alpha, tau_q_s, alpha_q = values
    chosen = replace(scenario.design, tau_s=tau_s, alpha=alpha, tau_q_s=tau_q_s, alpha_q=alpha_q)
    return replace(scenario, design=chosen)


def assess(
    scenario: Scenario, values: Values, cars: Iterable[Car], spare_ticks: int
) -> Tuning | Refusal:
    """Steps 1 and 2 for one candidate: its tuning, or the failed test."""
    scenario, tick_s = with_tuning(scenario, values), scenario.tick_s
    cars = list(cars)
    try:
        table = trusting_table(scenario)
    except (DesignError, ScenarioError):
        return Refusal.DESIGN
    of_table = laws(table)
    if not is_stable(table, cars, tick_s, spare_ticks, of_table):
        stable = is_stable(table, cars, tick_s, 0, of_table)
        return Refusal.NOMINAL_SPARE if stable else Refusal.NOMINAL
    states = loops(of_table, cars[0], tick_s)
    own = loops(of_table, cars[-1], tick_s)  # the scenario's plant, which can-rig check judges
    if max(peak_sensitivity(loop)[0] for loop in own) > scenario.budget.peak_sensitivity:
        return Refusal.THIN
    noise_1, noise_2 = (max(noise_gain(loop, answer) for loop in states) for answer in (0, 1))
    if not math.isfinite(noise_1 + noise_2):
        return Refusal.NOISE
    return _lose_torque(scenario, table, (noise_1, noise_2))


def _lose_torque(scenario: Scenario, table: Table, noise: tuple[float, float]) -> Tuning | Refusal:
    """The loss during a settled step, or of a plant that integrates in the scenario's drive."""
    tick_s, car = scenario.tick_s, continuous_plant(scenario.plant)
    loss, drive = _loss_in_its_drive(scenario) if car.integrates else _loss_in_a_step(scenario)
    left = np.ones((len(drive), 2))
    left[loss:, 0] = 0.0
    plant = sample(car, tick_s)
    healthy = simulate(table, plant, drive)
    lost = simulate(table, plant, drive, effectiveness=left)
    deviation = np.abs(lost.measurement - healthy.measurement)[loss:]
    peak = float(deviation.max())
    if not (math.isfinite(peak) and deviation[-len(deviation) // 4 :].max() <= DECAYED * peak):
        return Refusal.TRANSIENT
    bound = unavoidable(scenario, lost.command_1[loss - scenario.latency_ticks :])
    torque, force = np.abs(lost.command_1), np.abs(lost.command_2)
    torque_after, force_after = float(torque[loss:].max()), float(force[loss:].max())
    tail = NOISE_SIGMAS * scenario.model.sensor.noise_mps2
    limits = target(scenario, None)
    room_1 = limits.limit_1 - tail * noise[0] - torque_after
    room_2 = limits.limit_2 - tail * noise[1] - force_after
    return Tuning(
        design=scenario.design,
        peak_mps2=peak,
        unavoidable_mps2=math.inf if bound is None else bound.deviation_mps2,
        noise_to_torque=noise[0],
        noise_to_force=noise[1],
        torque_peak_nm=float(torque.max()),
        torque_after_nm=torque_after,
        force_after_n=force_after,
        within_limits=bool(room_1 > 0.0 and room_2 > 0.0),
    )


def _loss_in_its_drive(scenario: Scenario) -> tuple[int, FloatArray]:
    """The tick of the scenario's loss, and its reference (ticks,)."""
    loss = round(scenario.loss.at_s / scenario.tick_s)
    return min(loss, scenario.ticks - 1), reference(scenario)


def _loss_in_a_step(scenario: Scenario) -> tuple[int, FloatArray]:
    """The tick of the loss, and the reference (ticks,)."""
    slow = slowness(scenario)
    loss = round(BEFORE_S * slow / scenario.tick_s)
    ticks = loss + round(AFTER_S * slow / scenario.tick_s)
    return loss, np.full(ticks, scenario.reference.amplitude_mps2)


def trusting_table(scenario: Scenario) -> Table:
    """The controller's table without frames, whose decision trusts the model.

    The drive before a loss decides the time of detection with another car; the tuning decides the
    response.

    Raises:
        ScenarioError, DesignError: a failing design or discretisation.
    """
    return build(continuous_design(scenario), target(scenario, None))


def _round_numbers(series: Iterable[float], low: float, high: float) -> list[float]:
    """``series`` in every decade, within ``low``..``high``."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    numbers = [float(f"{number}e{decade}") for decade in decades for number in series]
    return [number for number in numbers if low * (1 - 1e-9) <= number <= high * (1 + 1e-9)]


AT_REST = 0.05  # largest error at rest, as a share of the step


def box_refusal(
    scenario: Scenario, table: Table, cars: Sequence[Car], spare_ticks: int
) -> tuple[Refusal, Car | None] | None:
    """The first failed test of ``scenario``'s tuning, and the failing drive's car.

    None: it fails none.

    The tests cover the linear loop with each car, a drive of each car with limits and noise, and a
    drive with the spare ticks.
    """
    states = laws(table)
    if not is_stable(table, cars, scenario.tick_s, spare_ticks, states):
        stable = is_stable(table, cars, scenario.tick_s, 0, states)
        return (Refusal.BOX_SPARE if stable else Refusal.BOX), None
    stepped = replace(scenario, reference=replace(scenario.reference, kind="step"))
    if continuous_plant(scenario.model).integrates:
        stepped = scenario  # at rest no command would show the loss
    drives = Drives(stepped)

    def delayed(each: ActuatorLag) -> ActuatorLag:
        return replace(each, dead_time_s=each.dead_time_s + spare_ticks * scenario.tick_s)

    for car in cars:
        plant = with_sensor_and_limits(car.settings, scenario.plant)
        found = _finding(drives, plant)
        if found is not None and found.false_alarm:
            return Refusal.FALSE_ALARM, car
        if found is not None:
            return _limit_at_fault(stepped, plant), car
        if spare_ticks > 0:
            late = _finding(drives, with_actuators(plant, delayed))
            if late is not None and not late.false_alarm:
                return Refusal.REST_SPARE, car
    return None


def has_control_authority(scenario: Scenario, car: Car) -> bool:
    """Whether X_diff alone can hold the step with ``car``; otherwise no tuning comes to rest."""
    _, force_n = car.steady_commands(scenario.reference.amplitude_mps2)
    return (1.0 - AT_REST) * force_n <= target(scenario, None).limit_2


def with_sensor_and_limits(car: PlantSettings, own: PlantSettings) -> PlantSettings:
    """``car``, which is near the model, with the sensor and the limits of the scenario's plant."""
    torque, force = own.torque_actuator, own.force_difference_actuator
    return replace(
        car,
        sensor=own.sensor,
        torque_actuator=replace(
            car.torque_actuator, limit_nm=torque.limit_nm, rate_nm_per_s=torque.rate_nm_per_s
        ),
        force_difference_actuator=replace(
            car.force_difference_actuator, limit_n=force.limit_n, rate_n_per_s=force.rate_n_per_s
        ),
    )


def _finding(drives: Drives, plant: PlantSettings) -> Finding | None:
    return next(drives.findings("", plant, "torque dead"), None)


def _limit_at_fault(scenario: Scenario, plant: PlantSettings) -> Refusal:
    """The limit that keeps D* of ``plant`` from rest."""
    own = scenario.limits
    for reason, limits in (
        (Refusal.FORCE_LIMIT, replace(own, force_difference_n=None)),
        (Refusal.TORQUE_LIMIT, replace(own, torque_nm=None)),
        (Refusal.BOTH_LIMITS, replace(own, force_difference_n=None, torque_nm=None)),
    ):
        drives = Drives(replace(scenario, limits=limits))
        if _finding(drives, plant) is None:
            return reason
    return Refusal.REST
