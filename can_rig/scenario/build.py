"""Plant, design and target of a scenario, for the firmware and for the figures."""

import math
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

from can_rig.errors import ScenarioError
from can_rig.frames.codec import MessageCodec
from can_rig.frames.databases import shipped_dbc
from can_rig.frames.foreign_frames import Roles, map_network
from can_rig.frames.network import Network, load_network
from can_rig.scenario.box import in_box, uncertain
from can_rig.scenario.log_signals import OF_SENSORS, LogSignal, terms, unit_factor
from can_rig.scenario.plant_settings import PlantSettings, or_infinite
from can_rig.scenario.remembered import remembered
from can_rig.scenario.sensor_settings import ECHOES, LATERAL_ACCELERATION, YAW_RATE, FurtherSensor
from can_rig.scenario.settings import Scenario, made_noise
from firmware_model.design import plants
from firmware_model.design.actuator_dynamics import actuated
from firmware_model.design.continuous_design import ContinuousDesign, DesignSpecification, design
from firmware_model.design.vehicle import GRAVITY_MPS2
from firmware_model.discretisation.targets import Reporting, Target, Witness
from firmware_model.errors import DesignError
from firmware_model.law.structs import FloatArray

MOST_PLANTS = 64  # limit of the caches; a box has 40 cars

GOVERNED = 0.5  # share of the motor's limit granted to the second derivative of D*
CAR_DECAYS_PER_S = 3.5  # the slowest mode of the car's F̂
LONGEST_TICKS = 20_000  # limit for a car's response of one second
SHAPED = 2  # relative degree of a G1 whose C uses the reference's second derivative


def heard_by_law(scenario: Scenario, network: Network) -> list[tuple[FurtherSensor, MessageCodec]]:
    """The further sensors that the law hears, each with its frame."""
    frames = zip(scenario.sensors, network.witnesses, strict=True)
    return [each for each in frames if each[0].measures in scenario.heard]


def network_of(scenario: Scenario) -> Network:
    """The scenario's frames, from the shipped DBC or the user's database.

    Raises:
        DbcError: an unreadable database, or a name in ``network.signals`` missing from the
            database.
        ScenarioError: a fault that these frames cannot represent.
    """
    chosen = scenario.network
    periods = tuple(each.timing(scenario.tick_s)[0] for each in scenario.sensors)
    if not chosen.signals.of_frames:
        roles = tuple(each.role for each in scenario.sensors)
        network = _network(dbc_of(scenario), scenario.drive.is_given, roles)
        return replace(network, periods=periods) if periods else network
    data_ids = {role: number for role, number in asdict(chosen.data_ids).items() if number}
    ticks = asdict(chosen.ticks) if chosen.ticks else chosen.tick
    sensors = {
        each.role: _of_sensor(scenario, each.role, getattr(chosen.signals, each.role))
        for each in scenario.sensors
    }
    network = map_network(chosen.dbc, Roles(chosen.signals.of_frames, ticks, data_ids, sensors))
    network = replace(network, periods=periods)
    timings: dict[int, tuple[str, tuple[int, ...]]] = {}
    for each, codec in zip(scenario.sensors, network.witnesses, strict=True):
        timing = each.timing(scenario.tick_s)[:2]
        other, its = timings.setdefault(codec.frame_id, (each.measures, timing))
        if its != timing:
            raise ScenarioError(
                f"scenario {scenario.name}: sensor {each.measures!r}: must have the period_s and "
                f"phase_s of {other!r}, which is in message {codec.name} too"
            )
    for fault in scenario.faults:
        if fault.kind != "frames-corrupted":
            continue
        codec = network.can_fail[scenario.places.index(fault.place)]
        if not codec.protected:
            raise ScenarioError(
                f"scenario {scenario.name}: fault.kind = 'frames-corrupted': must be another, or "
                f"network.data_ids.{codec.role} must be set: nothing tells that {codec.name} "
                "is corrupted"
            )
    return network


def _of_sensor(
    scenario: Scenario, role: str, given: str | tuple[LogSignal, ...]
) -> tuple[str, Callable[[str], float]]:
    """The signal of a further sensor, and the factor from a unit of the database to the role's.

    Raises:
        ScenarioError: what a frame cannot be made of; the function raises it for a unit.
    """
    listed = terms(given)
    where = f"scenario {scenario.name}: network.signals.{role}"
    if len(listed) != 1 or listed[0].sign or listed[0].bus or listed[0].offset:
        raise ScenarioError(f"{where}: must be one signal, with unit and factor at most, in a run")
    (of,) = listed

    def factor(unit: str) -> float:
        return unit_factor(OF_SENSORS[role], of.unit or unit, where) * of.factor

    return of.signal, factor


def require_ours(scenario: Scenario, what: str) -> None:
    """Refuse a controller of another kind for ``what``, which is about the rig's own law.

    Raises:
        ScenarioError: the kind.
    """
    if not scenario.controller.is_ours:
        raise ScenarioError(
            f"scenario {scenario.name}: controller.kind = {scenario.controller.kind!r}: must be "
            f"'ours' for {what}"
        )


def dbc_of(scenario: Scenario) -> Path:
    """The file of the scenario's frames; the signals of a recorded drive alone are not a run's."""
    chosen = scenario.network
    own = chosen.dbc and (chosen.signals.of_frames or not chosen.signals)
    return Path(chosen.dbc) if own else shipped_dbc(scenario.dbc)


_network = cache(load_network)


def but_for_noise(settings: PlantSettings, *others: object) -> tuple[object, ...]:
    """Settings that determine a linear plant; the sensor's noise has no influence."""
    return settings.noise_free, *others


@remembered(MOST_PLANTS, by=but_for_noise)
def continuous_car(settings: PlantSettings) -> plants.Plant:
    """The linear plant of ``settings``, without actuators and sensor.

    For a plant class, the known model before the run: the thesis's car with the class's parameters.
    Designs and margins use this car; runs use the class.

    Raises:
        ScenarioError: parameters of an unstable car.
    """
    try:
        return settings.linear.make(settings)
    except DesignError as error:
        raise ScenarioError(f"plant: {error}") from None


def slowness(scenario: Scenario) -> float:
    """How many times longer than a car the model takes to settle, by its slowest pole or zero.

    1 for a car and for faster models; limited by ``LONGEST_TICKS``.
    """
    if scenario.model.is_car:
        return 1.0
    n1, n2 = continuous_car(scenario.model).coprime(scenario.design.tau_q_s).numerators
    slowest = min(abs(root.real) for root in (*n1.poles, *n1.zeros, *n2.poles, *n2.zeros))
    if slowest * LONGEST_TICKS * scenario.tick_s < CAR_DECAYS_PER_S:
        return max(1.0, LONGEST_TICKS * scenario.tick_s)
    return max(1.0, CAR_DECAYS_PER_S / slowest)


@remembered(MOST_PLANTS, by=but_for_noise)
def continuous_plant(settings: PlantSettings) -> plants.Plant:
    """``continuous_car`` with the linear parts of its actuators and its sensor.

    Raises:
        ScenarioError: as ``continuous_car``.
    """
    return actuated(continuous_car(settings), *settings.stages)


def continuous_design(scenario: Scenario) -> ContinuousDesign:
    """The controller's design, for the controller's model.

    Raises:
        ScenarioError: a car or a tuning that breaks an assumption of the thesis.
    """
    chosen = scenario.design
    specification = DesignSpecification(
        tau_s=chosen.tau_s,
        alpha=chosen.alpha,
        tau_q_s=chosen.tau_q_s,
        alpha_q=chosen.alpha_q,
        compensation=chosen.compensation != "off",
        feedback=chosen.feedback,
    )
    plant = continuous_plant(scenario.model)
    _refuse_slow_sensor(scenario)
    try:
        return design(plant, specification)
    except DesignError as error:
        raise ScenarioError(f"scenario {scenario.name}: design: {error}") from None


def _refuse_slow_sensor(scenario: Scenario) -> None:
    """Refuse a C that drives the car at frequencies hidden by the sensor's filter.

    C also inverts the sensor's filter. With q̂ faster than the filter, y follows the reference
    while D* overshoots, by C's gain above the filter's corner.
    """
    corner_hz, chosen = scenario.model.sensor.corner_hz, scenario.design
    if corner_hz is None or not chosen.feedback:
        return
    bandwidth = math.sqrt(2.0 ** (1.0 / chosen.alpha_q) - 1.0) / (2.0 * math.pi)
    least_hz = bandwidth / chosen.tau_q_s
    if corner_hz < least_hz:
        table = "plant" if scenario.plant.sensor == scenario.model.sensor else "model"
        raise ScenarioError(
            f"scenario {scenario.name}: {table}.sensor.corner_hz = {corner_hz:g}: must be at least "
            f"{least_hz:.4g} Hz, the bandwidth of q̂, or design.tau_q_s at least "
            f"{bandwidth / corner_hz:.4g}"
        )


def target(scenario: Scenario, network: Network | None) -> Target:
    """Where the design runs, trusting the model; ``mismatch`` describes the other cars.

    Without a network, commands are neither limited nor rounded.
    """
    chosen, limits = scenario.design, scenario.limits
    limit_1, limit_2 = or_infinite(limits.torque_nm), or_infinite(limits.force_difference_n)
    sensor, lsb, lsb_1, lsb_2 = scenario.model.sensor, 0.0, 0.0, 0.0
    noise, step = sensor.noise_mps2, sensor.resolution_mps2
    if sensor.is_made:
        noise, step = made_noise(scenario.model, scenario.sensors)
    if network is not None:
        command_1, command_2 = network.command_1, network.command_2
        limit_1, limit_2 = min(limit_1, command_1.maximum), min(limit_2, command_2.maximum)
        lsb_1, lsb_2 = command_1.lsb, command_2.lsb
        lsb = network.feedback.lsb
    return Target(
        tick_s=scenario.tick_s,
        latency_ticks=scenario.latency_ticks,
        estimator=chosen.estimator,
        limit_1=limit_1,
        limit_2=limit_2,
        rate_1=or_infinite(limits.torque_rate_nm_per_s),
        rate_2=or_infinite(limits.force_difference_rate_n_per_s),
        reference_acceleration=reference_acceleration(scenario),
        lsb_1=lsb_1,
        lsb_2=lsb_2,
        noise_rms=noise,
        noise_pole=math.exp(-scenario.tick_s / sensor.lag_s) if sensor.lag_s > 0.0 else 0.0,
        disturbance=scenario.budget.disturbance_mps2,
        gust=scenario.budget.gust_mps2,
        resolution=math.hypot(step, lsb),
        false_alarms_per_hour=scenario.budget.false_alarms_per_hour,
        suspicions_per_hour=scenario.budget.suspicions_per_hour,
        on_confirmation=chosen.compensation == "on-confirmation",
        supervised=chosen.supervision == "full",
        safe_stop_s=chosen.safe_stop_s,
        blind_s=limits.blind_s,
        monitor=limits.monitor,
        doubt=scenario.budget.box,
        motion_limit=scenario.model.friction * GRAVITY_MPS2 if scenario.model.is_car else math.inf,
        echoes=_echoes(scenario),
        witness=_witness(scenario),
        precision=chosen.precision,
    )


def _echoes(scenario: Scenario) -> tuple[Reporting, Reporting] | None:
    """What the actuators report, where one reports."""
    found = {each.measures: each for each in scenario.sensors if each.measures in ECHOES}
    noises = [
        math.hypot(found[echo].noise_rms, found[echo].step) if echo in found else 0.0
        for echo in ECHOES
    ]
    torque, force, _ = map(Reporting, scenario.model.stages, (*noises, 0.0))
    return (torque, force) if found else None


def _witness(scenario: Scenario) -> Witness | None:
    """What yaw rate and lateral acceleration say of D*, where the scenario has both sensors."""
    found = {each.measures: each for each in scenario.sensors}
    if not (scenario.model.is_car and YAW_RATE in scenario.heard):
        return None
    turning, lateral = found[YAW_RATE], found[LATERAL_ACCELERATION]
    model = scenario.model
    weight, speed = model.lateral_weight, model.speed_mps
    noise_rms = math.hypot(*made_noise(model, scenario.sensors))
    lag_s = (1.0 - weight) * turning.lag_s + weight * lateral.lag_s
    keys, _ = uncertain_keys(scenario)
    measured = scenario.drive.is_given or bool(scenario.network.signals.speed)
    doubt = scenario.budget.box if "speed_mps" in keys and not measured else 0.0
    return Witness(weight, speed, lag_s, noise_rms, doubt, model.sensor.is_made)


def other_plants(scenario: Scenario) -> Callable[[FloatArray], plants.Plant]:
    """The plant at a place of the budget's box, shape (k,), -1..1 across it."""
    model, budget = scenario.model, scenario.budget
    keys, late = uncertain_keys(scenario)

    def plant(place: FloatArray) -> plants.Plant:
        shares = {key: budget.box * float(x) for key, x in zip(keys, place, strict=False)}
        lags = budget.actuator_box * float(place[-1]) if late else 0.0
        return continuous_plant(in_box(model, shares, lags))

    return plant


def uncertain_keys(scenario: Scenario) -> tuple[tuple[str, ...], bool]:
    """The varying parameters of the budget's box by key, and whether actuator lags vary."""
    budget, model = scenario.budget, scenario.model
    keys = tuple(uncertain(model)) if budget.box > 0.0 else ()
    return keys, budget.actuator_box > 0.0 and model.torque_actuator.lags


def reference_acceleration(scenario: Scenario) -> float:
    """Fastest reference for C, m/s⁴: the share ``GOVERNED`` of the motor's limits.

    For a G1 of relative degree two, such as a car's, u1 = r̈/g1 plus the rest of D/N1, so half of
    the limit goes to r̈. A turn from full ahead to full back is 2R/g1, smoothed by q̂: at most
    0.37·2R/(g1 τ_q) a second for α_q = 2, less for larger α_q. The rest of D/N1 keeps the same
    amount. Other plants follow the unshaped reference, within the bandwidth of q̂.
    """
    limits = scenario.limits
    g1 = continuous_car(scenario.model).g1
    if not scenario.design.feedback or g1.relative_degree != SHAPED:  # this C never uses r̈
        return math.inf
    torque = or_infinite(limits.torque_nm)
    if limits.torque_rate_nm_per_s is not None:
        torque = min(torque, limits.torque_rate_nm_per_s * scenario.design.tau_q_s)
    return GOVERNED * torque * abs(g1.gain)
