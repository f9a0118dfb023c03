"""The car of a scenario, with its actuators and its sensors, as an FMU; inputs of the scenario."""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from can_rig.drawing.names import names_of
from can_rig.export.c_files import number, plain
from can_rig.export.fmu import TICKS, Model, Variable, name_of
from can_rig.export.law import support
from can_rig.frames.codec import AGE
from can_rig.frames.frame_columns import quantised
from can_rig.plant.actuated_plant import CAR_STATES, ActuatedLinearPlant
from can_rig.plant.actuators import actuator_limits
from can_rig.plant.changing_car import plant_of
from can_rig.plant.faults.plant_faults import ADDING, PlantFaults
from can_rig.plant.sensor import NoiseColumns
from can_rig.plant.witnesses import Senses, frame_row
from can_rig.scenario.build import network_of
from can_rig.scenario.fault_settings import CHANNELS, FaultSettings
from can_rig.scenario.reference import reference
from can_rig.scenario.settings import Scenario
from can_rig.storage.files import atomic

CAR: Final = "car"
SHARES: Final = ("left_1", "left_2")
ERROR: Final = "_error"
STATE_UNITS: Final = dict(zip(CAR_STATES, ("rad", "rad/s", "", "rad"), strict=True))


def car_model(scenario: Scenario) -> Model | None:
    """The linear plant of ``scenario`` between the frames of its commands and of its sensors.

    None: the plant is a class or an FMU, or a drive or a disturbance changes the plant.

    Raises:
        ScenarioError: a car that is not stable.
    """
    actuated = plant_of(scenario)
    if not isinstance(actuated, ActuatedLinearPlant):
        return None
    plant = actuated.sampled
    network = network_of(scenario)
    senses = Senses(scenario, network.witnesses)
    timings, resolutions, witness_frames = senses.constants
    codecs = (network.command_1, network.command_2, network.feedback)
    names = CAR_STATES if scenario.plant.is_car else ()
    states = [(at, name) for at, name in enumerate(names) if name]
    n, r = len(plant.c), max(len(senses), 1)
    spare = np.zeros((r - len(senses), 1))
    commands, _ = plant.memory[2:]
    arrays: dict[str, Any] = {
        "phi": plant.phi,
        "gamma_now": plant.gamma,
        "gamma_old": plant.gamma_old,
        "sensed": plant.sensed,
        "c": plant.c,
        "looks_back": plant.looks_back,
        "rows": np.vstack([plant.readings.rows, np.tile(spare, n)]),
        "feeds": np.vstack([plant.readings.acting, np.tile(spare, 2)]),
        "limits": actuator_limits(scenario.plant, scenario.tick_s),
        "frames": np.vstack([*(frame_row(codec) for codec in codecs), witness_frames]),
        "resolutions": np.append(resolutions, spare),
    }
    parts = {CAR}
    parts |= {"changes"} if plant.gamma_old.any() else set()
    parts |= {"within"} if plant.looks_back.any() else set()
    parts |= {"late"} if len(parts) > 1 else set()
    if "changes" not in parts:
        del arrays["gamma_old"]
    del arrays["c" if "within" in parts else "looks_back"]
    wholes = {
        "timings": np.vstack([timings, np.tile(spare, 3)]),
        "dead_ticks": np.array([*plant.dead_ticks, plant.sensor_dead_ticks]),
        "states": np.array([at for at, _ in states] or [0]),
    }
    constants = [
        *(_array("double", name, values) for name, values in arrays.items()),
        *(_array("int64_t", name, values) for name, values in wholes.items()),
        _array("double", "measured_step", np.array(scenario.plant.sensor.resolution_mps2)),
        _array("int64_t", "hold_ticks", np.round(scenario.actuator.hold_s / scenario.tick_s)),
    ]
    texts = {
        "scenario": plain(scenario.name),
        "order": str(n),
        "sensors": str(len(senses)),
        "states": str(len(states)),
        "latency": str(scenario.latency_ticks),
        "commands": str(len(commands)),
        "samples": str(plant.sensor_dead_ticks + 1),
        "ring": str(max(senses.delays, default=0) + 1),
        "constants": "\n".join(constants),
    }
    sources = {name: support(name, parts, **texts) for name in ("car.h", "car.c", "rounding.h")}
    return Model(
        name_of(CAR, scenario),
        f"The car of scenario {scenario.name}, with its actuators and its sensors",
        scenario,
        sources,
        parts,
        _variables(scenario, [name for _, name in states]),
    )


def _variables(scenario: Scenario, states: Sequence[str]) -> list[Variable]:
    output, command_1, command_2 = names = names_of(scenario.plant)
    signals = [(each.usual.column, names.at(each.measures)) for each in scenario.sensors]
    error = "error of the sensor at the end of the step"
    found = [
        Variable("command_1", "input", command_1.name, command_1.unit, "0"),
        Variable("command_2", "input", command_2.name, command_2.unit, "0"),
        Variable(SHARES[0], "input", f"share of {command_1.name} that acts", start="1"),
        Variable(SHARES[1], "input", f"share of {command_2.name} that acts", start="1"),
    ]
    for name, signal in [("measurement", output), *signals]:
        found.append(Variable(name + ERROR, "input", error, signal.unit, "0"))
    found.append(Variable("measurement", "output", f"{output.name} as its frame says", output.unit))
    for name, signal in signals:
        words = f"{signal.name} as its last frame says"
        found.append(Variable(name, "output", words, signal.unit))
        found.append(Variable(name + AGE, "output", TICKS))
    found.append(Variable("output", "output", f"true {output.name}", output.unit))
    for name in states:
        found.append(Variable(name, "output", "of the car", STATE_UNITS[name]))
    words = "ticks from a command until the command acts"
    latency = str(scenario.latency_ticks)
    found.append(Variable("latency_ticks", "parameter", words, "", latency, "Integer", latency))
    return found


def write_inputs(scenario: Scenario, path: Path, force: bool) -> list[FaultSettings]:
    """Write the reference, faults and noise of ``scenario`` as inputs of both FMUs, CSV.

    A row holds for the step that begins at its time; the row before 0 s holds for the
    initialisation.

    Returns:
        The faults that no input has.

    Raises:
        LogError: the file exists and ``force`` is not given, or the file cannot be written.
    """
    network, faults = network_of(scenario), PlantFaults(scenario)
    ticks = scenario.ticks
    samples = range(ticks + 1)
    noise = NoiseColumns.of(scenario)
    bias, _ = faults.of_witnesses(samples)
    wanted = quantised(network.reference, reference(scenario))
    columns = {
        "time": np.arange(-1, ticks) * scenario.tick_s,
        "reference": np.append(wanted[:1], wanted),
        **dict(zip(SHARES, np.vstack([np.ones(2), faults.left(range(ticks))]).T, strict=True)),
        f"measurement{ERROR}": faults.bias(samples) + noise.next(ticks + 1),
    }
    errors = bias + Senses(scenario, network.witnesses).noise(ticks + 1)
    for each, column in zip(scenario.sensors, errors.T, strict=True):
        columns[each.usual.column + ERROR] = column
    with atomic(path, force=force) as part, part.open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file)
        lines.writerow(columns)
        lines.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))
    return [
        each
        for each in scenario.faults
        if each.kind != "actuator-dead" and not (each.kind in ADDING and each.place not in CHANNELS)
    ]


def _array(kind: str, name: str, values: Any) -> str:
    """A constant array of C."""
    sizes = "".join(f"[{size}]" for size in values.shape)
    return f"static const {kind} {name}{sizes} = {_nested(kind, values)};"


def _nested(kind: str, values: Any) -> str:
    if values.ndim:
        return f"{{{', '.join(_nested(kind, each) for each in values)}}}"
    return number(float(values), "float64") if kind == "double" else str(int(values))
