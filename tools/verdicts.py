"""Compare the verdict of ``can-rig check`` on random scenarios with a run of each.

Cars, speeds, ticks, latencies, actuators, limits, noise, references and faults are drawn; the
design is the fastest of a few that the tick allows. A run contradicts a verdict of "stable" where

    D* is not a finite number, or a command is beyond its limit, or
    D* leaves the D* of the same car without limits, noise and fault in the last second: by more
    than the noise and a share of the demand, although X_diff could hold D*.

Any exception but a refusal of one line is a defect.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.progress import track

from can_rig.assessment.stability import StabilityCheck, check_stability
from can_rig.errors import RigError
from can_rig.plant.frameless import frameless
from can_rig.scenario.build import continuous_plant, network_of, target
from can_rig.scenario.controls import controller_table
from can_rig.scenario.loading import load
from can_rig.scenario.settings import LimitSettings, Scenario
from firmware_model.law.structs import FloatArray

KINDS = ("actuator-dead", "frames-missing", "frames-corrupted", "sensor-biased", "none")
AWAY = 0.15  # of the demand
NOISE_SIGMAS = 10.0
AFTER_S = 5.0  # from the fault to the end, so that two seconds to return leave time to look


@dataclass(frozen=True)
class Verdict:
    """The verdict on a scenario, and the contradiction by its run, if any."""

    settings: list[str]
    said: str
    wrong: str = ""


def drawn(draw: np.random.Generator) -> list[str]:
    """Random settings; some scenarios are impossible."""

    def log(low: float, high: float) -> float:
        return float(f"{np.exp(draw.uniform(np.log(low), np.log(high))):.3g}")

    def some(share: float, value: float) -> float:
        return value if draw.random() < share else 0.0

    tick_s = float(draw.choice([0.0005, 0.001, 0.002, 0.005, 0.01, 0.02]))
    latency, at_s = int(draw.integers(0, 4)), round(float(draw.uniform(4.0, 7.0)), 3)
    scale = draw.uniform(0.7, 1.4, 4)
    settings: dict[str, Any] = {
        "tick_s": tick_s,
        "latency_ticks": latency,
        "seed": int(draw.integers(0, 2**31)),
        "plant.mass_kg": round(1400.0 * scale[0], 1),
        "plant.yaw_inertia_kgm2": round(1960.0 * scale[0] * scale[1], 1),
        "plant.front_cornering_stiffness_n_per_rad": round(33700.0 * scale[2]),
        "plant.rear_cornering_stiffness_n_per_rad": round(43000.0 * scale[3]),
        "plant.speed_mps": round(float(draw.uniform(5.0, 35.0)), 2),
        "plant.torque_actuator.lag_s": some(0.7, log(0.002, 0.03)),
        "plant.force_difference_actuator.lag_s": some(0.7, log(0.002, 0.06)),
        "plant.sensor.noise_mps2": some(0.7, log(3e-4, 0.05)),
        "plant.sensor.resolution_mps2": some(0.3, 0.005),
        "limits.torque_nm": log(50.0, 2000.0),
        "limits.force_difference_n": log(500.0, 10_000.0),
        "design.alpha": 3,
        "design.alpha_q": 4,
        "design.tau_s": max(3.0 * tick_s, log(0.002, 0.02)),
        "design.tau_q_s": max(3.0 * tick_s, log(0.004, 0.04)),
        "design.estimator": "zoh",
        "design.compensation": str(draw.choice(["on-confirmation", "on-confirmation", "always"])),
        "reference.kind": str(draw.choice(["step", "sine", "lane-change"])),
        "reference.amplitude_mps2": round(float(draw.uniform(0.2, 2.0)), 2),
        "reference.frequency_rad_per_s": log(0.5, 5.0),
        "fault.kind": str(draw.choice(KINDS)),
        "fault.channel": str(draw.choice(["torque", "torque", "force-difference"])),
        "fault.at_s": at_s,
        "duration_s": at_s + AFTER_S,
        "budget.box": float(draw.choice([0.0, 0.1, 0.2])),
    }
    if draw.random() < 0.5:
        settings["limits.torque_rate_nm_per_s"] = log(500.0, 1e5)
    if draw.random() < 0.5:
        settings["limits.force_difference_rate_n_per_s"] = log(2e3, 2e5)
    if draw.random() < 0.3:
        settings["fault.left"] = round(float(draw.uniform(0.0, 0.9)), 2)
    return [f'{key}="{v}"' if isinstance(v, str) else f"{key}={v}" for key, v in settings.items()]


def verdict_on(settings: list[str]) -> Verdict:
    """Check the scenario and run it."""
    try:
        scenario = load("ideal", settings)
        said = check_stability(scenario)
    except RigError:
        return Verdict(settings, "refused")
    except Exception as error:
        return Verdict(settings, "raised", f"check: {error!r}")
    try:
        wrong = contradiction(scenario, said)
    except Exception as error:
        return Verdict(settings, "raised", f"run: {error!r}")
    return Verdict(settings, "stable" if said.stable else said.verdict.split(":")[0], wrong)


def contradiction(scenario: Scenario, said: StabilityCheck) -> str:
    """Return the contradiction between the run and the verdict; empty without a contradiction."""
    network = network_of(scenario)
    run = frameless(scenario)
    place = target(scenario, network)
    table = controller_table(scenario, network)
    for name, command, limit, actuator in (
        ("torque", run.command_1, place.limit_1, table.actuator_1),
        ("X_diff", run.command_2, place.limit_2, table.actuator_2),
    ):
        beyond = float(np.abs(command).max()) - limit
        if beyond > 1e-9 * limit:
            return f"{name} is {beyond:.3g} beyond its limit"
        slew = float(np.abs(np.diff(command, prepend=0.0)).max()) - float(actuator.slew)
        if slew > 1.001 * float(actuator.lsb):
            return f"{name} changes by {slew:.3g} more in a tick than its rate allows"
    if not said.stable:
        return ""
    away = astray(scenario, run.measurement)
    return "" if away is None else f"stable, and D* is {away:.3g} m/s² astray at the end"


def astray(scenario: Scenario, measurement: FloatArray) -> float | None:
    """How far D* is from where it should be at the end; None: no farther than it may."""
    fault = scenario.loss
    if fault.kind == "sensor-biased" or fault.left > 0.0:
        return None if np.isfinite(measurement).all() else np.inf
    free = replace(scenario.healthy.noise_free, plant=scenario.model, limits=LimitSettings())
    goal = frameless(free).measurement
    last = slice(-round(1.0 / scenario.tick_s), None)
    lost = scenario.loss.channel if scenario.loss.kind != "none" else ""
    place, plant = target(scenario, network_of(scenario)), continuous_plant(scenario.plant)
    demand = float(np.abs(goal).max())
    if lost == "torque" and demand > 0.9 * abs(plant.g2.dc_gain) * place.limit_2:
        return None if np.isfinite(measurement).all() else np.inf
    if lost != "torque" and demand > 0.9 * abs(plant.g1.dc_gain) * place.limit_1:
        return None if np.isfinite(measurement).all() else np.inf
    distance = float(np.abs(measurement - goal)[last].max())
    sensor = scenario.plant.sensor
    allowed = AWAY * demand + NOISE_SIGMAS * sensor.noise_mps2 + sensor.resolution_mps2
    return None if distance <= allowed else distance


@click.command()
@click.option("--scenarios", default=300, show_default=True)
@click.option("--seed", default=0, show_default=True)
def main(scenarios: int, seed: int) -> None:
    """Check and run random scenarios; exit status 1 if a run contradicts its verdict."""
    console, wrong = Console(), []
    said: Counter[str] = Counter()
    for index in track(range(scenarios), console=Console(stderr=True)):
        verdict = verdict_on(drawn(np.random.default_rng([seed, index])))
        said[verdict.said] += 1
        if verdict.wrong:
            wrong.append(verdict)
            console.print(f"{index}: {verdict.wrong}", markup=False)
            console.print("    can-rig check ideal " + " ".join(
                f"--set '{setting}'" for setting in verdict.settings
            ), markup=False, soft_wrap=True)  # fmt: skip
    for what, count in said.most_common():
        console.print(f"{count:5d}  {what}", markup=False)
    console.print(f"{len(wrong)} of {scenarios} runs contradict their verdict")
    raise SystemExit(bool(wrong))


if __name__ == "__main__":
    main()
